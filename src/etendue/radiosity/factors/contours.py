"""Loops compiled for the CPU by Numba: form factors of flat polygons by contour integrals; of those that others hide in
part, see ``occlusion``.

    A_i F_ij = 1 / (2 pi) times the integral over both contours of ln r dx . dy          [Sparrow 1963]

The integral along one edge is in closed form; that along the other, by Gauss-Legendre quadrature. If edges are close to
each other, the outer one is divided where the inner integral is not smooth, with denser points at these divisions.

Lengths are in radii of the scene. A *side* is a face with its corners counterclockwise, (4, 3); a triangle repeats its
last corner. Its plane is (n, c), (4,); points in front of it have ``n . x - c > 0``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array

from .occlusion import CORNERS, PIECES, cut, hidden_exchange, polygon_area

#: A corner this close to a plane counts as lying in it, because of the error of single precision.
_IN_PLANE = 1e-7
#: Faces must extend this far into the space between two others to occlude them.
_BETWEEN = 1e-6

#: Quadrature points on [0, 1] and weights: three rules for distant to closer edges, and one with points concentrated at
#: both ends.
_COUNTS = np.array([3, 5, 10, 24])
_POINTS, _WEIGHTS = np.zeros((4, 24)), np.zeros((4, 24))
for _k, _n in enumerate(_COUNTS):
    _x, _w = np.polynomial.legendre.leggauss(_n)
    _POINTS[_k, :_n], _WEIGHTS[_k, :_n] = (_x + 1) / 2, _w / 2
# s -> s^3 (10 - 15 s + 6 s^2) makes s ln s smooth enough.
_WEIGHTS[3] *= 30 * _POINTS[3] ** 2 * (1 - _POINTS[3]) ** 2
_POINTS[3] = _POINTS[3] ** 3 * (10 - 15 * _POINTS[3] + 6 * _POINTS[3] ** 2)


@njit(nogil=True, cache=True, error_model="numpy")
def exchange_rows(
    sides: Array,
    planes: Array,
    patch: NDArray[np.int64],
    blockers: Array,
    boxes: Array,
    nodes: NDArray[np.int64],
    first: int,
    last: int,
    tolerance: float,
    exchange: Array,
    errors: Array,
) -> tuple[int, int, int]:
    """Add A_i F_ij between sides ``first`` to ``last - 1`` and all later sides to ``exchange[i, j]``, and estimates of
    errors to ``errors[i, j]``.

    sides (s, 4, 3) in ascending order of their patch (s,), backs without a patch last; blockers (b, 4, 3): faces that
    may occlude others, in a tree of ``boxes`` (t, 2, 3) and ``nodes`` (t, 3): the number of the first blocker of a leaf
    and behind its last, and the node that follows if a box is left out. tolerance: of A F of pairs that are hidden in
    part, in units of the smaller area. Returns the number of pairs that were, and the sides of one with more pieces
    than there is room for, else -1.
    """
    buffers, polygons = np.empty((2, 32, 3)), np.empty((2, 8, 3))
    pieces, sizes = np.empty((2, PIECES, CORNERS, 3)), np.empty((2, PIECES), np.int64)
    work, bounds = np.empty((4, CORNERS, 3)), np.empty((2, 3))
    hull, chosen, hidden = np.empty((64, 4)), np.empty(len(blockers), np.int64), 0
    for a in range(first, last):
        for b in range(a + 1, len(sides)):
            m, n = _in_front(sides[a], planes[b], polygons[0]), 0
            if m > 2:
                n = _in_front(sides[b], planes[a], polygons[1])
            if n < 3:
                continue
            p, q = polygons[0, :m], polygons[1, :n]
            count = _between(p, planes[a], q, planes[b], blockers, boxes, nodes, hull, buffers, bounds, chosen)
            if count == 0:
                exchange[patch[a], patch[b]] += _of_contours(p, q)
                continue
            largest = 0
            for k in range(1, count):  # what hides most comes first
                if polygon_area(blockers[chosen[k]]) > polygon_area(blockers[chosen[largest]]):
                    largest = k
            chosen[0], chosen[largest] = chosen[largest], chosen[0]
            least = tolerance * min(polygon_area(p), polygon_area(q))
            value, error, done = hidden_exchange(
                p, planes[a], q, planes[b], blockers, chosen, count, least, pieces, sizes, work
            )
            if not done:
                return hidden, a, b
            hidden += 1
            exchange[patch[a], patch[b]] += value
            errors[patch[a], patch[b]] += error
    return hidden, -1, -1


@njit(nogil=True, cache=True, error_model="numpy")
def _of_contours(p: Array, q: Array) -> float:
    """A F of two polygons that see each other."""
    total, m, n = 0.0, len(p), len(q)
    for i in range(m):
        for j in range(n):
            total += _edges(p[i], p[(i + 1) % m], q[j], q[(j + 1) % n])
    return max(total / (2 * math.pi), 0.0)


@njit(nogil=True, cache=True, error_model="numpy")
def _edges(a: Array, a_end: Array, b: Array, b_end: Array) -> float:
    """Double integral of ln r over two edges, times the cosine of the angle between the edges."""
    ux, uy, uz = a_end[0] - a[0], a_end[1] - a[1], a_end[2] - a[2]
    vx, vy, vz = b_end[0] - b[0], b_end[1] - b[1], b_end[2] - b[2]
    length, inner = math.sqrt(ux * ux + uy * uy + uz * uz), math.sqrt(vx * vx + vy * vy + vz * vz)
    if length == 0.0 or inner == 0.0:
        return 0.0
    if length > inner:  # the shorter one is the outer
        a, b = b, a
        ux, uy, uz, length, vx, vy, vz, inner = vx, vy, vz, inner, ux, uy, uz, length
    ux, uy, uz, vx, vy, vz = ux / length, uy / length, uz / length, vx / inner, vy / inner, vz / inner
    cosine = ux * vx + uy * vy + uz * vz
    if abs(cosine) < 1e-14:
        return 0.0
    wx, wy, wz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    wu, wv = wx * ux + wy * uy + wz * uz, wx * vx + wy * vy + wz * vz
    distance = _distance(wx, wy, wz, ux, uy, uz, length, vx, vy, vz, inner, wu, wv, cosine)
    if distance > 0.5 * length:
        rule = 0 if distance > 8 * length else 1 if distance > 2 * length else 2
        return cosine * _along(0.0, length, rule, wx, wy, wz, ux, uy, uz, vx, vy, vz, inner)
    # The inner integral is not smooth opposite the ends of the inner edge, and where the two lines are closest.
    first, second, third = -wu, -wu + inner * cosine, 0.0
    if cosine * cosine < 1 - 1e-12:
        third = (cosine * wv - wu) / (1 - cosine * cosine)
    low, high = min(first, second), max(first, second)
    low, middle, high = min(low, third), max(low, min(high, third)), max(high, third)
    total, start = 0.0, 0.0
    for end in (low, middle, high, length):
        end = min(max(end, 0.0), length)
        if end - start > 1e-12 * length or (end == length and end > start):
            total += _along(start, end, 3, wx, wy, wz, ux, uy, uz, vx, vy, vz, inner)
            start = end
    return cosine * total


@njit(nogil=True, cache=True, error_model="numpy")
def _along(
    start: Any,
    end: Any,
    rule: Any,
    wx: float,
    wy: float,
    wz: float,
    ux: float,
    uy: float,
    uz: float,
    vx: float,
    vy: float,
    vz: float,
    inner: float,
) -> Any:
    """Integral over ``w + s u``, s from ``start`` to ``end``, of the integral of ln r over ``t v``, t from 0 to
    ``inner``."""
    total = 0.0
    for k in range(_COUNTS[rule]):
        s = start + (end - start) * _POINTS[rule, k]
        x, y, z = wx + s * ux, wy + s * uy, wz + s * uz
        # Relative to the foot of the point on the other line, the edge extends from `near` to `far`.
        near = -(x * vx + y * vy + z * vz)
        far = near + inner
        cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
        square = cx * cx + cy * cy + cz * cz
        d = math.sqrt(square)
        value = d * math.atan2(d * inner, square + near * far) - inner
        r2 = square + far * far
        if r2 > 0.0:
            value += 0.5 * far * math.log(r2)
        r2 = square + near * near
        if r2 > 0.0:
            value -= 0.5 * near * math.log(r2)
        total += _WEIGHTS[rule, k] * value
    return total * (end - start)


@njit(nogil=True, cache=True, error_model="numpy")
def _distance(
    wx: float,
    wy: float,
    wz: float,
    ux: float,
    uy: float,
    uz: float,
    length: float,
    vx: float,
    vy: float,
    vz: float,
    inner: float,
    wu: float,
    wv: float,
    cosine: float,
) -> Any:
    """Distance between the edges ``w + s u``, s from 0 to ``length``, and ``t v``, t from 0 to ``inner``."""
    s, across = 0.0, 1 - cosine * cosine
    if across > 1e-12:
        s = min(max((cosine * wv - wu) / across, 0.0), length)
    t = wv + s * cosine
    if t < 0.0 or t > inner:
        t = min(max(t, 0.0), inner)
        s = min(max(t * cosine - wu, 0.0), length)
    x, y, z = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return math.sqrt(x * x + y * y + z * z)


@njit(nogil=True, cache=True, error_model="numpy")
def _in_front(p: Array, plane: Array, result: Array) -> int:
    """Write to ``result`` the part of a polygon that is in front of a plane, and return its number of corners."""
    if _farthest(p, plane) <= _IN_PLANE:
        return 0
    if _nearest(p, plane) >= -_IN_PLANE:
        result[: len(p)] = p
        return len(p)
    return cut(p, len(p), plane[0], plane[1], plane[2], plane[3], result)


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest(p: Array, plane: Array) -> float:
    """The least ``n . x - c`` of the corners."""
    least = np.inf
    for i in range(len(p)):
        least = min(least, plane[0] * p[i, 0] + plane[1] * p[i, 1] + plane[2] * p[i, 2] - plane[3])
    return least


@njit(nogil=True, cache=True, error_model="numpy")
def _farthest(p: Array, plane: Array) -> float:
    """The largest ``n . x - c`` of the corners."""
    most = -np.inf
    for i in range(len(p)):
        most = max(most, plane[0] * p[i, 0] + plane[1] * p[i, 1] + plane[2] * p[i, 2] - plane[3])
    return most


@njit(nogil=True, cache=True, error_model="numpy")
def _between(
    p: Array,
    of_p: Array,
    q: Array,
    of_q: Array,
    blockers: Array,
    boxes: Array,
    nodes: NDArray[np.int64],
    hull: Array,
    buffers: Array,
    bounds: Array,
    chosen: NDArray[np.int64],
) -> int:
    """Write to ``chosen`` the blockers that intersect the convex hull of two polygons, each of which is in front of the
    other's plane, and return their number.

    Blockers are clipped by every plane that bounds the hull: the planes of both polygons, and planes through an edge of
    one and a corner of the other with both polygons on one side.
    """
    if len(nodes) == 0:
        return 0
    low, high = bounds
    for c in range(3):
        low[c] = high[c] = p[0, c]
        for i in range(1, len(p)):
            low[c], high[c] = min(low[c], p[i, c]), max(high[c], p[i, c])
        for i in range(len(q)):
            low[c], high[c] = min(low[c], q[i, c]), max(high[c], q[i, c])
    planes, count, node = 0, 0, 0
    while node < len(nodes):
        box = boxes[node]
        apart = False
        for c in range(3):
            apart |= box[1, c] < low[c] or box[0, c] > high[c]
        if not apart:
            if planes == 0:
                planes = _hull(p, of_p, q, of_q, hull)
            apart = _is_outside(box, hull, planes)
        if apart:
            node = nodes[node, 2]
            continue
        for k in range(nodes[node, 0], nodes[node, 1]):
            if _meets(blockers[k], low, high, hull, planes, buffers):
                chosen[count] = k
                count += 1
        node += 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def _is_outside(box: Array, hull: Array, planes: int) -> bool:
    """Whether a box is behind one of the planes of a hull."""
    for k in range(planes):
        far = -hull[k, 3]
        for c in range(3):
            far += hull[k, c] * (box[1, c] if hull[k, c] > 0 else box[0, c])
        if far <= 0.0:
            return True
    return False


@njit(nogil=True, cache=True, error_model="numpy")
def _meets(face: Array, low: Array, high: Array, hull: Array, planes: int, buffers: Array) -> bool:
    """Whether a face intersects a hull with these bounds."""
    for c in range(3):
        if max(max(face[0, c], face[1, c]), max(face[2, c], face[3, c])) < low[c]:
            return False
        if min(min(face[0, c], face[1, c]), min(face[2, c], face[3, c])) > high[c]:
            return False
    for k in range(planes):  # most faces are behind one of the planes
        nx, ny, nz, d = hull[k, 0], hull[k, 1], hull[k, 2], hull[k, 3]
        for i in range(4):
            if nx * face[i, 0] + ny * face[i, 1] + nz * face[i, 2] > d:
                break
        else:
            return False
    rest, other, count = buffers[0], buffers[1], 4
    for i in range(4):
        for c in range(3):
            rest[i, c] = face[i, c]
    for k in range(planes):
        count = cut(rest, count, hull[k, 0], hull[k, 1], hull[k, 2], hull[k, 3], other)
        rest, other = other, rest
        if count < 3:
            return False
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def _hull(p: Array, of_p: Array, q: Array, of_q: Array, hull: Array) -> int:
    """Write the planes of the hull of two polygons to ``hull``, a little inside of it, and return their number."""
    hull[0], hull[1], count = of_p, of_q, 2
    hull[0, 3] += _BETWEEN
    hull[1, 3] += _BETWEEN
    for k in range(2):
        ours, theirs = (p, q) if k == 0 else (q, p)
        for i in range(len(ours)):
            for j in range(len(theirs)):
                plane = hull[count]
                if count == len(hull) - 1 or not _through(ours[i], ours[(i + 1) % len(ours)], theirs[j], plane):
                    continue
                if min(_nearest(ours, plane), _nearest(theirs, plane)) < -_IN_PLANE:
                    plane *= -1.0
                    if min(_nearest(ours, plane), _nearest(theirs, plane)) < -_IN_PLANE:
                        continue
                if max(_farthest(ours, plane), _farthest(theirs, plane)) <= _IN_PLANE:
                    continue
                plane[3] += _BETWEEN
                count += 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def _through(a: Array, b: Array, c: Array, plane: Array) -> bool:
    """Write the plane through three points to ``plane``; return false if they are collinear."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(x * x + y * y + z * z)
    if length <= 1e-9 * math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)):
        return False
    plane[0], plane[1], plane[2] = x / length, y / length, z / length
    plane[3] = plane[0] * a[0] + plane[1] * a[1] + plane[2] * a[2]
    return True
