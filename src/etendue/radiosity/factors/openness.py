"""Loops compiled for the CPU by Numba: whether there is air or a solid on both sides of points between faces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array
from etendue.surfaces import box_tree

from .occluders import Index

#: Faces whose distances along a ray differ by less are met together; lengths are in radii of the scene.
_TOGETHER = 1e-5
#: Directions in the upper hemisphere, none along an axis.
_AZIMUTHS = 2.39996 * np.arange(7) + 0.3
_HEIGHTS = np.sqrt(1 - (np.arange(7) + 0.6) / 8)
_DIRECTIONS = np.column_stack(
    [np.sqrt(1 - _HEIGHTS**2) * np.cos(_AZIMUTHS), np.sqrt(1 - _HEIGHTS**2) * np.sin(_AZIMUTHS), _HEIGHTS]
)
#: Boxes of faces are wider by this, in radii of the scene: far more than rounding.
_WIDER = 1e-9


def openness(points: Array, normals: Array, corners: Array, planes: Array, is_sided: NDArray[np.bool_]) -> Index:
    """(k, 2) what is before and behind each point, along its normal: rays that see a front, less those that see a back.

    Faces that a ray meets together, such as those of solids that touch, count as what is left when fronts and backs of
    ``is_sided`` ones cancel; if nothing is left, the ray goes on.
    """
    tree = box_tree(corners.min(axis=1) - _WIDER, corners.max(axis=1) + _WIDER)
    result: Index = _openness(points, normals, corners, planes, is_sided, *tree)
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _openness(
    points: Array,
    normals: Array,
    corners: Array,
    planes: Array,
    is_sided: NDArray[np.bool_],
    boxes: Array,
    links: Index,
    order: Index,
    depth: int,
) -> Any:
    found = np.zeros((len(points), 2), np.int64)
    x, y, d = np.empty(3), np.empty(3), np.empty(3)
    met, distances = np.empty(len(corners), np.int64), np.empty(len(corners))
    stack = np.empty(depth + 2, np.int64)
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
                count, top = 0, 1
                stack[0] = 0
                while top > 0:
                    top -= 1
                    node = stack[top]
                    if not _meets(points[k], d, boxes, node):
                        continue
                    if links[node, 1] == 0:
                        stack[top], stack[top + 1] = node + 1, links[node, 0]
                        top += 2
                        continue
                    for f in order[links[node, 0] : links[node, 0] + links[node, 1]]:
                        distance = _distance(points[k], d, corners, planes, f)
                        if distance < np.inf:
                            met[count], distances[count] = f, distance
                            count += 1
                found[k, side] += _seen(d, planes, is_sided, met, distances, count)
    return found


@njit(nogil=True, cache=True, error_model="numpy")
def _meets(x: Array, d: Array, boxes: Array, node: int) -> bool:
    """Whether a ray meets the box of a node."""
    begin, end = 0.0, np.inf
    for c in range(3):
        if d[c] == 0.0:
            if x[c] < boxes[node, 0, c] or x[c] > boxes[node, 1, c]:
                return False
            continue
        one, other = (boxes[node, 0, c] - x[c]) / d[c], (boxes[node, 1, c] - x[c]) / d[c]
        begin, end = max(begin, min(one, other)), min(end, max(one, other))
    return begin <= end


@njit(nogil=True, cache=True, error_model="numpy")
def _seen(d: Array, planes: Array, is_sided: NDArray[np.bool_], met: Index, distances: Array, count: int) -> int:
    """Of ``count`` faces that a ray has ``met``: 1 if it sees a front first, -1 for a back, 0 if neither is known."""
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
