"""Loops compiled for the CPU by Numba: whether there is air or a solid on both sides of points between faces."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array

from .occluders import Index

#: Faces whose distances along a ray differ by less are met together; lengths are in radii of the scene.
_TOGETHER = 1e-5
#: Directions in the upper hemisphere, none along an axis.
_AZIMUTHS = 2.39996 * np.arange(7) + 0.3
_HEIGHTS = np.sqrt(1 - (np.arange(7) + 0.6) / 8)
_DIRECTIONS = np.column_stack(
    [np.sqrt(1 - _HEIGHTS**2) * np.cos(_AZIMUTHS), np.sqrt(1 - _HEIGHTS**2) * np.sin(_AZIMUTHS), _HEIGHTS]
)


@njit(nogil=True, cache=True, error_model="numpy")
def openness(points: Array, normals: Array, corners: Array, planes: Array, is_sided: NDArray[np.bool_]) -> Index:
    """(k, 2) what is before and behind each point, along its normal: rays that see a front, less those that see a back.

    Faces that a ray meets together, such as those of solids that touch, count as what is left when fronts and backs of
    ``is_sided`` ones cancel; if nothing is left, the ray goes on.
    """
    found = np.zeros((len(points), 2), np.int64)
    x, y, d, distances = np.empty(3), np.empty(3), np.empty(3), np.empty(len(corners))
    for k in range(len(points)):
        n = normals[k]
        axis = 0 if abs(n[0]) < 0.6 else 1
        for c in range(3):
            x[c] = (1.0 if c == axis else 0.0) - n[axis] * n[c]
        length = math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        for c in range(3):
            x[c] /= length
        y[0], y[1], y[2] = n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]
        for side in range(2):
            for local in _DIRECTIONS:
                for c in range(3):
                    d[c] = local[0] * x[c] + local[1] * y[c] + (1 - 2 * side) * local[2] * n[c]
                found[k, side] += _seen(points[k], d, corners, planes, is_sided, distances)
    return found


@njit(nogil=True, cache=True, error_model="numpy")
def _seen(x: Array, d: Array, corners: Array, planes: Array, is_sided: NDArray[np.bool_], distances: Array) -> int:
    """1 if a ray sees a front first, -1 for a back, and 0 if neither is known."""
    for f in range(len(corners)):
        distances[f] = _distance(x, d, corners[f], planes[f])
    behind = _TOGETHER
    while True:
        nearest = np.inf
        for f in range(len(corners)):
            if distances[f] > behind:
                nearest = min(nearest, distances[f])
        if nearest == np.inf:
            return 0
        behind, net = nearest + _TOGETHER, 0
        for f in range(len(corners)):
            if nearest <= distances[f] <= behind:
                if not is_sided[f]:
                    return 1
                cosine = planes[f, 0] * d[0] + planes[f, 1] * d[1] + planes[f, 2] * d[2]
                net += 1 if cosine < 0 else -1
        if net != 0:
            return 1 if net > 0 else -1


@njit(nogil=True, cache=True, error_model="numpy")
def _distance(x: Array, d: Array, corners: Array, plane: Array) -> float:
    """Along a ray to a face, infinite if it misses."""
    cosine = plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2]
    if cosine == 0.0:
        return np.inf
    t = (plane[3] - plane[0] * x[0] - plane[1] * x[1] - plane[2] * x[2]) / cosine
    if t <= 0.0:
        return np.inf
    px, py, pz = x[0] + t * d[0], x[1] + t * d[1], x[2] + t * d[2]
    for i in range(4):
        j = (i + 1) % 4
        ex, ey, ez = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1], corners[j, 2] - corners[i, 2]
        ax, ay, az = px - corners[i, 0], py - corners[i, 1], pz - corners[i, 2]
        inward = plane[0] * (ey * az - ez * ay) + plane[1] * (ez * ax - ex * az) + plane[2] * (ex * ay - ey * ax)
        if inward < 0.0:
            return np.inf
    return t
