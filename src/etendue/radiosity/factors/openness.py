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
    x, y, d = np.empty(3), np.empty(3), np.empty(3)
    met, distances = np.empty(len(corners), np.int64), np.empty(len(corners))
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
                found[k, side] += _seen(points[k], d, corners, planes, is_sided, met, distances)
    return found


@njit(nogil=True, cache=True, error_model="numpy")
def _seen(
    x: Array, d: Array, corners: Array, planes: Array, is_sided: NDArray[np.bool_], met: Index, distances: Array
) -> int:
    """1 if a ray sees a front first, -1 for a back, and 0 if neither is known."""
    count = 0
    for f in range(len(corners)):
        distance = _distance(x, d, corners, planes, f)
        if distance < np.inf:
            met[count], distances[count] = f, distance
            count += 1
    behind = _TOGETHER
    while True:
        nearest = np.inf
        for k in range(count):
            if distances[k] > behind:
                nearest = min(nearest, distances[k])
        if nearest == np.inf:
            return 0
        behind, net = nearest + _TOGETHER, 0
        for k in range(count):
            if nearest <= distances[k] <= behind:
                f = met[k]
                if not is_sided[f]:
                    return 1
                cosine = planes[f, 0] * d[0] + planes[f, 1] * d[1] + planes[f, 2] * d[2]
                net += 1 if cosine < 0 else -1
        if net != 0:
            return 1 if net > 0 else -1


@njit(nogil=True, cache=True, error_model="numpy")
def _distance(x: Array, d: Array, corners: Array, planes: Array, f: int) -> float:
    """Along a ray to a face, infinite if it misses. Numbers are cheaper than views."""
    nx, ny, nz = planes[f, 0], planes[f, 1], planes[f, 2]
    cosine = nx * d[0] + ny * d[1] + nz * d[2]
    if cosine == 0.0:
        return np.inf
    t = (planes[f, 3] - nx * x[0] - ny * x[1] - nz * x[2]) / cosine
    if t <= 0.0:
        return np.inf
    px, py, pz = x[0] + t * d[0], x[1] + t * d[1], x[2] + t * d[2]
    for i in range(4):
        j = (i + 1) % 4
        cx, cy, cz = corners[f, i, 0], corners[f, i, 1], corners[f, i, 2]
        ex, ey, ez = corners[f, j, 0] - cx, corners[f, j, 1] - cy, corners[f, j, 2] - cz
        ax, ay, az = px - cx, py - cy, pz - cz
        inward = nx * (ey * az - ez * ay) + ny * (ez * ax - ex * az) + nz * (ex * ay - ey * ax)
        if inward < 0.0:
            return np.inf
    return t
