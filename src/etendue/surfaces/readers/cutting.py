"""Polygons in space without other polygons in their plane, such as a wall without its windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from etendue.core import Array

from ..errors import PatchError
from .polygons import ears

#: Distance from a line, or from the plane, that counts as none, in units of the size of the polygon: vertices of files
#: are often rounded to single precision.
_SAME = 1e-6
#: Part of the area of what is cut off that may lie outside of the polygon.
_OUTSIDE = 1e-4


def cut_out(outline: Array, holes: Sequence[Array]) -> list[Array]:
    """Convex polygons (k, 3) that cover a polygon (k, 3) without ``holes``, polygons in its plane and inside of it, in
    either orientation.

    Polygon and holes are cut into triangles, and each piece by the lines of the edges of each triangle of a hole: what
    is outside of a line stays. Raises :class:`PatchError` for a hole that leaves the plane or the polygon, and for a
    polygon that crosses itself.
    """
    size = float(np.ptp(outline, axis=0).max())
    pieces = _triangles(outline)
    vector = np.sum([_vector(piece) for piece in pieces], axis=0)
    whole = float(np.linalg.norm(vector))
    normal = vector / max(whole, 1e-300)
    for hole in holes:
        if np.abs((hole - outline[0]) @ normal).max() > 10 * _SAME * size:
            raise PatchError("lies in another plane")
        parts = _triangles(hole if _vector(hole) @ normal > 0 else hole[::-1])
        for triangle in parts:
            pieces = [rest for piece in pieces for rest in _without(piece, triangle, normal, _SAME * size)]
        left = sum(float(np.linalg.norm(_vector(piece))) for piece in pieces)
        gone = sum(float(np.linalg.norm(_vector(part))) for part in parts)
        if abs(whole - left - gone) > _OUTSIDE * gone + _SAME * whole:
            raise PatchError("is not inside, or overlaps another one in it")
        whole = left
    return pieces


def _triangles(polygon: Array) -> list[Array]:
    if len(polygon) == 3:
        return [polygon]
    corners = ears(polygon)
    if corners is None:
        raise PatchError("crosses itself")
    return [polygon[list(triangle)] for triangle in corners]


def _vector(polygon: Array) -> Array:
    """The normal, with twice the area as length."""
    fan = polygon - polygon[0]
    return np.asarray(np.cross(fan[:-1], fan[1:]).sum(axis=0))


def _without(piece: Array, triangle: Array, normal: Array, same: float) -> list[Array]:
    """Convex parts of a convex ``piece`` outside of a ``triangle`` that is counterclockwise around the normal."""
    found: list[Array] = []
    for k in range(3):
        inwards = np.cross(normal, triangle[(k + 1) % 3] - triangle[k])
        height = (piece - triangle[k]) @ inwards / np.linalg.norm(inwards)
        height[np.abs(height) < same] = 0.0
        if (height <= 0).all():  # also a piece without area: nothing is inside
            return [*found, piece]
        if (height < 0).any():
            found.append(_half(piece, -height))
            piece = _half(piece, height)
    return found


def _half(piece: Array, height: Array) -> Array:
    """The part of a convex polygon of positive ``height``."""
    corners = []
    for k in range(len(piece)):
        after = (k + 1) % len(piece)
        if height[k] >= 0:
            corners.append(piece[k])
        if height[k] * height[after] < 0:
            share = height[k] / (height[k] - height[after])
            corners.append(piece[k] + share * (piece[after] - piece[k]))
    return np.array(corners)
