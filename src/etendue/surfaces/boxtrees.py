"""Loops: trees of boxes (bounding volume hierarchies), and coplanar faces found by them.

Numba compiles them; without it they run as Python, a hundred times slower.
"""

from __future__ import annotations

from typing import Any

import numpy as np

try:
    from numba import njit
except ImportError:

    def njit(**_: Any) -> Any:
        """Functions as they are."""
        return lambda function: function


#: Largest number of primitives of a leaf, number of bins along an axis, and depth of the stack: nodes at the greatest
#: depth that it allows are leaves of any size.
_LEAF, _BINS, _DEPTH = 4, 16, 128
#: Least cosine between the normals of coplanar faces, up to the sign: small faces in single precision have inexact
#: normals.
_ALIKE = 0.9


@njit(nogil=True, cache=True, error_model="numpy")
def build(low: Any, high: Any) -> Any:
    """A tree over boxes (n, 3): corners of its nodes (m, 2, 3), links (m, 3), the order of the primitives, and the
    depth of the deepest leaf.

    Links are: the second child (the first child follows its parent), or of a leaf its first place in the order; the
    number of primitives of a leaf, 0 for inner nodes; the axis of the split. Splits minimise the surface area
    heuristic.
    """
    count = len(low)
    order = np.arange(count)
    corners = np.empty((2 * count + 1, 2, 3))
    links = np.zeros((2 * count + 1, 3), np.int64)
    stack = np.empty((_DEPTH, 4), np.int64)
    # By numbers: to assign, fill or reduce arrays takes Numba some seconds to compile.
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, count, -1, 0
    top, made, deepest = 1, 0, 0
    first, last, middle_low, middle_high = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    bins_low, bins_high = np.empty((_BINS, 3)), np.empty((_BINS, 3))
    bins, area = np.empty(_BINS, np.int64), np.empty(_BINS)
    while top > 0:
        top -= 1
        begin, end, parent, depth = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        deepest = max(deepest, depth)
        node = made
        made += 1
        if parent >= 0:
            links[parent, 0] = node
        _empty_box(first, last)
        _empty_box(middle_low, middle_high)
        for k in range(begin, end):
            for a in range(3):
                x, y = low[order[k], a], high[order[k], a]
                first[a], last[a] = min(first[a], x), max(last[a], y)
                middle_low[a], middle_high[a] = min(middle_low[a], x + y), max(middle_high[a], x + y)
        axis, width = 0, middle_high[0] - middle_low[0]
        for a in range(3):
            corners[node, 0, a], corners[node, 1, a] = first[a], last[a]
            if middle_high[a] - middle_low[a] > width:
                axis, width = a, middle_high[a] - middle_low[a]
        if end - begin <= _LEAF or width <= 0 or depth == _DEPTH - 1:
            links[node, 0], links[node, 1] = begin, end - begin
            continue
        for b in range(_BINS):
            bins[b] = 0
            _empty_box(bins_low[b], bins_high[b])
        for k in range(begin, end):
            p = order[k]
            b = min(int((low[p, axis] + high[p, axis] - middle_low[axis]) / width * _BINS), _BINS - 1)
            bins[b] += 1
            for a in range(3):
                bins_low[b, a], bins_high[b, a] = min(bins_low[b, a], low[p, a]), max(bins_high[b, a], high[p, a])
        # Area times number of primitives on the right of each split, then on its left.
        _empty_box(first, last)
        n = 0
        for b in range(_BINS - 1, 0, -1):
            n += bins[b]
            for a in range(3):
                first[a], last[a] = min(first[a], bins_low[b, a]), max(last[a], bins_high[b, a])
            area[b] = n * _half_area(first, last) if n else 0.0
        _empty_box(first, last)
        n, best, cut = 0, np.inf, 1
        for b in range(_BINS - 1):
            n += bins[b]
            for a in range(3):
                first[a], last[a] = min(first[a], bins_low[b, a]), max(last[a], bins_high[b, a])
            cost = (n * _half_area(first, last) if n else 0.0) + area[b + 1]
            if 0 < n < end - begin and cost < best:
                best, cut = cost, b + 1
        left, right = begin, end - 1
        while left <= right:
            p = order[left]
            if min(int((low[p, axis] + high[p, axis] - middle_low[axis]) / width * _BINS), _BINS - 1) < cut:
                left += 1
            else:
                order[left], order[right] = order[right], order[left]
                right -= 1
        links[node, 2] = axis
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = left, end, node, depth + 1
        top += 1
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = begin, left, -1, depth + 1
        top += 1
    return corners[:made].copy(), links[:made].copy(), order, deepest


@njit(nogil=True, cache=True, error_model="numpy")
def _empty_box(low: Any, high: Any) -> None:
    for a in range(3):
        low[a], high[a] = np.inf, -np.inf


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _half_area(low: Any, high: Any) -> Any:
    x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
    return x * y + y * z + z * x


@njit(nogil=True, cache=True, error_model="numpy")
def overlapping(corners: Any, normals: Any, areas: Any, tree: Any, margin: Any) -> Any:
    """Pairs (k, 2) of flat convex faces (f, 4, 3) that lie on each other: all corners of the smaller face are nearer
    than ``margin`` to the plane of the other one, and inside that plane the faces overlap by more than ``margin``.

    tree: of the boxes around the faces, as of :func:`build`.
    """
    nodes, links, order = tree
    found, count = np.empty((64, 2), np.int64), 0
    stack = np.empty(_DEPTH, np.int64)
    low, high = np.empty(3), np.empty(3)
    for a in range(len(corners)):
        _bounds(corners[a], margin, low, high)
        stack[0], top = 0, 1
        while top > 0:
            top -= 1
            node = stack[top]
            if not _meet(nodes[node], low, high):
                continue
            if links[node, 1] == 0 and links[node, 0] > 0:
                stack[top], stack[top + 1] = node + 1, links[node, 0]
                top += 2
                continue
            for k in range(links[node, 0], links[node, 0] + links[node, 1]):
                b = order[k]
                if b <= a:
                    continue
                large, small = (a, b) if areas[a] >= areas[b] else (b, a)
                if not _lies_on(corners[small], normals[small], corners[large], normals[large], margin):
                    continue
                if count == len(found):
                    wider = np.empty((2 * count, 2), np.int64)
                    for i in range(count):
                        wider[i, 0], wider[i, 1] = found[i, 0], found[i, 1]
                    found = wider
                found[count, 0], found[count, 1] = a, b
                count += 1
    return found[:count].copy()


@njit(nogil=True, cache=True, error_model="numpy")
def _bounds(face: Any, margin: Any, low: Any, high: Any) -> None:
    for c in range(3):
        low[c] = min(min(face[0, c], face[1, c]), min(face[2, c], face[3, c])) - margin
        high[c] = max(max(face[0, c], face[1, c]), max(face[2, c], face[3, c])) + margin


@njit(nogil=True, cache=True, error_model="numpy")
def _meet(box: Any, low: Any, high: Any) -> bool:
    x = box[0, 0] <= high[0] and box[1, 0] >= low[0]
    y = box[0, 1] <= high[1] and box[1, 1] >= low[1]
    return bool(x and y and box[0, 2] <= high[2] and box[1, 2] >= low[2])


@njit(nogil=True, cache=True, error_model="numpy")
def _lies_on(small: Any, n_small: Any, large: Any, n_large: Any, margin: Any) -> bool:
    cosine = n_small[0] * n_large[0] + n_small[1] * n_large[1] + n_small[2] * n_large[2]
    if abs(cosine) < _ALIKE:
        return False
    for i in range(4):
        off = 0.0
        for c in range(3):
            off += (small[i, c] - large[0, c]) * n_large[c]
        if abs(off) > margin:
            return False
    return _overlap(large, small, n_large, margin) and _overlap(small, large, n_large, margin)


@njit(nogil=True, cache=True, error_model="numpy")
def _overlap(one: Any, other: Any, normal: Any, margin: Any) -> bool:
    """Whether no edge of a convex face separates it from another one in its plane."""
    for i in range(4):
        j = (i + 1) % 4
        ex, ey, ez = one[j, 0] - one[i, 0], one[j, 1] - one[i, 1], one[j, 2] - one[i, 2]
        x, y, z = ey * normal[2] - ez * normal[1], ez * normal[0] - ex * normal[2], ex * normal[1] - ey * normal[0]
        length = np.sqrt(x * x + y * y + z * z)
        if length == 0.0:  # a triangle repeats its last corner
            continue
        least, most, its_least, its_most = np.inf, -np.inf, np.inf, -np.inf
        for k in range(4):
            at = x * one[k, 0] + y * one[k, 1] + z * one[k, 2]
            least, most = min(least, at), max(most, at)
            at = x * other[k, 0] + y * other[k, 1] + z * other[k, 2]
            its_least, its_most = min(its_least, at), max(its_most, at)
        if min(most, its_most) - max(least, its_least) <= margin * length:
            return False
    return True
