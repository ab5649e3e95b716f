"""Polygons in space without other polygons in their plane, such as a wall without its windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from etendue.core import Array

from ..errors import PatchError
from .polygons import ears

#: Distance from a line that counts as none, in units of the size of the polygon: vertices of files are often rounded to
#: single precision.
_SAME = 1e-6
#: Distance of a hole from the plane of the polygon, in the same units, and part of its area that may lie outside of it:
#: cities are rounded to millimetres, or to centimetres.
_APART, _OUTSIDE = 2e-3, 5e-3


def cut_out(name: str, outline: Array, holes: Sequence[tuple[str, Array]]) -> list[Array]:
    """Convex polygons (k, 3) that cover a polygon (k, 3) without ``holes``, polygons in its plane and inside of it, in
    either orientation; all with names, for messages.

    Polygon and holes are cut into triangles, and each piece by the lines of the edges of each triangle of a hole: what
    is outside of a line stays. Raises :class:`PatchError` for a hole that leaves the plane or the polygon, and for a
    polygon that crosses itself.
    """
    size = float(np.ptp(outline, axis=0).max())
    pieces = _triangles(name, outline)
    vector = np.sum([_vector(piece) for piece in pieces], axis=0)
    whole = float(np.linalg.norm(vector))
    normal = vector / max(whole, 1e-300)
    apart = float(np.abs((outline - outline[0]) @ normal).max()) + _APART * size
    for hole_name, hole in holes:
        if np.abs((hole - outline[0]) @ normal).max() > apart:
            raise PatchError(f"{hole_name} lies in another plane")
        low, high = hole.min(axis=0) - apart, hole.max(axis=0) + apart
        near: list[Array] = []
        others: list[Array] = []
        for piece in pieces:
            is_near = (piece.max(axis=0) > low).all() and (piece.min(axis=0) < high).all()
            (near if is_near else others).append(piece)
        before = _area(near)
        parts = _triangles(hole_name, hole if _vector(hole) @ normal > 0 else hole[::-1])
        for triangle in parts:
            inwards = np.cross(normal, np.roll(triangle, -1, axis=0) - triangle)
            inwards /= np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-300)
            near = [rest for piece in near for rest in _without(piece, triangle, inwards, _SAME * size)]
        gone = _area(parts)
        if abs(before - _area(near) - gone) > _OUTSIDE * gone + _SAME * whole:
            raise PatchError(f"{hole_name} is not inside, or overlaps another one in it")
        pieces = others + near
    return pieces


def _triangles(name: str, polygon: Array) -> list[Array]:
    if len(polygon) == 3:
        return [polygon]
    corners = ears(polygon)
    if corners is None:
        raise PatchError(f"{name} crosses itself")
    return [polygon[list(triangle)] for triangle in corners]


def _area(polygons: list[Array]) -> float:
    """Twice their area."""
    return sum(float(np.linalg.norm(_vector(polygon))) for polygon in polygons)


def _vector(polygon: Array) -> Array:
    """The normal, with twice the area as length."""
    fan = polygon - polygon[0]
    return np.asarray(np.cross(fan[:-1], fan[1:]).sum(axis=0))


def _without(piece: Array, triangle: Array, inwards: Array, same: float) -> list[Array]:
    """Convex parts of a convex ``piece`` outside of a ``triangle`` with unit vectors ``inwards`` from its edges."""
    found: list[Array] = []
    for corner, direction in zip(triangle, inwards, strict=True):
        height = (piece - corner) @ direction
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
