"""Left-balanced kd-trees: an order of points in which the tree needs no pointers, on the host.

The node at place i has its children at 2 i + 1 and 2 i + 2; all levels are full but the last, which is filled from the
left [Jensen 2001, ch. 6; Bentley 1975]. A node separates its children along the axis of the longest side of their box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

Index = NDArray[np.int64]


def left_balanced(points: Array) -> tuple[Index, NDArray[np.uint8]]:
    """(order (n,): the point at each place; axis (n,) of each place) of points (n, d), level by level."""
    count = len(points)
    order, axes = np.empty(count, np.int64), np.zeros(count, np.uint8)
    # Points of one subtree are a segment of ``left``; ``start`` are the segments, ``place`` their roots.
    left, start, place = np.arange(count), np.array([0]), np.array([0])
    sizes = np.array([count])
    while len(left):
        segment = np.repeat(np.arange(len(start)), sizes)
        values = points[left]
        low, high = (f.reduceat(values, start, axis=0) for f in (np.minimum, np.maximum))
        axis = np.argmax(high - low, axis=1)
        key = values[np.arange(len(left)), axis[segment]]
        left = left[np.lexsort((key, segment))]
        below = _below(sizes)
        root = start + below
        order[place], axes[place] = left[root], axis
        # The root leaves; what is below and above it are the segments of the next level.
        kept = np.ones(len(left), bool)
        kept[root] = False
        left = left[kept]
        sizes = np.stack([below, sizes - 1 - below], axis=1).ravel()
        place = np.stack([2 * place + 1, 2 * place + 2], axis=1).ravel()
        there = sizes > 0
        sizes, place = sizes[there], place[there]
        start = np.cumsum(sizes) - sizes
    return order, axes


def _below(sizes: Index) -> Index:
    """Points of the left child of a left-balanced tree of so many points."""
    levels = np.floor(np.log2(sizes + 0.5)).astype(np.int64)  # of full levels below the root: 2^levels <= size
    last = sizes - (2**levels - 1)  # points of the last level
    half = 2 ** np.maximum(levels - 1, 0)
    inner = 2 ** np.maximum(levels - 1, 0) - 1
    return np.where(levels == 0, 0, inner + np.minimum(last, half))


def nearest(points: Array, axes: NDArray[np.uint8], at: Array, k: int) -> tuple[Index, Array]:
    """(places, squared distances) of the ``k`` points nearest to ``at`` (d,), nearest first; ``points`` (n, d) in the
    order of the tree."""
    found: list[tuple[float, int]] = []
    waiting: list[tuple[float, int]] = [(0.0, 0)]
    while waiting:
        gap, place = waiting.pop()
        if place >= len(points) or (len(found) == k and gap > found[-1][0]):
            continue
        offset = at - points[place]
        distance = float(offset @ offset)
        if len(found) < k or distance < found[-1][0]:
            found = sorted([*found, (distance, place)])[:k]
        along = float(offset[axes[place]])
        near = 2 * place + 1 + (along > 0)
        far = 4 * place + 3 - near
        waiting += [(max(gap, along * along), far), (gap, near)]
    return np.array([place for _, place in found], np.int64), np.array([distance for distance, _ in found])
