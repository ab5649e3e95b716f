"""Left-balanced kd-trees: an order of points that is a tree without pointers, on the host.

The node at place i has its children at 2 i + 1 and 2 i + 2. All levels are full but the last, which is filled from the
left, and level l is cut along the axis l modulo the number of axes, so that a packed record needs no further data to be
a node [Bentley 1975; Jensen 2001, ch. 6]. :class:`KdTree` is for searches on the device; this order is for files.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

Index = NDArray[np.int64]


def left_balanced(points: Array) -> Index:
    """(n,) index of the point at each place of the tree over points (n, d), level by level."""
    points = np.asarray(points)
    order = np.empty(len(points), np.int64)
    # The points of each subtree are a segment of ``left``; ``place``: the places of the roots.
    left, sizes, place, level = np.arange(len(points)), np.array([len(points)]), np.array([0]), 0
    while len(left):
        segment = np.repeat(np.arange(len(sizes)), sizes)
        left = left[np.lexsort((points[left, level % points.shape[1]], segment))]
        below = _left_of(sizes)
        root = np.cumsum(sizes) - sizes + below
        order[place] = left[root]
        # Without the roots, the points before and after each are the segments of the next level.
        left = np.delete(left, root)
        sizes = np.stack([below, sizes - 1 - below], axis=1).ravel()
        place = np.stack([2 * place + 1, 2 * place + 2], axis=1).ravel()
        place, sizes, level = place[sizes > 0], sizes[sizes > 0], level + 1
    return order


def _left_of(sizes: Index) -> Index:
    """Number of points in the left subtree of left-balanced trees of ``sizes`` points."""
    full = 2 ** np.floor(np.log2(sizes + 0.5)).astype(np.int64)  # points that the last level can hold
    half = full // 2
    found: Index = np.where(sizes > 1, half - 1 + np.minimum(sizes - full + 1, half), 0)
    return found


def nearest(points: Array, at: Array, k: int) -> tuple[Index, Array]:
    """(places, squared distances) of the ``k`` points nearest to ``at`` (d,), nearest first; ``points`` (n, d) in the
    order of the tree."""
    found: list[tuple[float, int]] = []
    waiting = [(0.0, 0)]
    while waiting:
        gap, place = waiting.pop()
        if place >= len(points) or (len(found) == k and gap > found[-1][0]):
            continue
        offset = np.asarray(at, np.float64) - points[place]
        distance = float(offset @ offset)
        if len(found) < k or distance < found[-1][0]:
            found = sorted([*found, (distance, place)])[:k]
        along = float(offset[((place + 1).bit_length() - 1) % len(offset)])
        near = 2 * place + 1 + (along > 0)
        waiting += [(max(gap, along * along), 4 * place + 3 - near), (gap, near)]
    return np.array([place for _, place in found], np.int64), np.array([distance for distance, _ in found])
