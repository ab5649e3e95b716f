"""Loops compiled for the CPU by Numba: the exchange A F of all pairs of sides.

Lengths are in radii of the scene. A *side* is a face with its corners counterclockwise, (4, 3); a triangle repeats its
last corner. Its plane is (n, c), (4,); points in front of it have ``n . x - c > 0``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from etendue.core import Array
from etendue.points import Sobol

from .contours import of_contours
from .distant import of_nodes
from .occluders import Index, Occluders
from .occlusion import Room, hidden_exchange, make_room, point_factor, point_factor_of_all, polygon_area
from .shafts import covers, faces, in_front, in_hull, in_shaft, is_behind, may_be_between, places

#: Sides whose occluders are looked for together.
_BLOCK = 8
#: Of the tolerance of a row, a pair may have this times the root of its form factor without occluders: as few pairs are
#: hidden in part, the sum of squares of a row is then below the square of the tolerance.
_SHARE = 2.0
#: Points of a pair that is hidden in part, 32 bits of each coordinate; how many are taken; and root mean square errors
#: in form factors without occluders: expected, those if nothing is seen, and those if something is, plus so much times
#: the largest difference of the shares that are seen. Measured in rooms with boxes of 1,266 and 5,022 patches, and in a
#: city of 994.
_POINTS = (Sobol(2).block(256) * 2**32).astype(np.int64)
_NUMBERS = np.array([1, 4, 16, 64, 256])
_ERRORS = np.array(
    [
        [0.2, 0.16, 0.21, 0.0],
        [0.075, 0.03, 0.03, 0.12],
        [0.019, 0.003, 0.003, 0.036],
        [0.0048, 0.0003, 0.0007, 0.009],
        [0.0012, 0.0001, 0.0002, 0.0022],
    ]
)


class Sides(NamedTuple):
    """``corners`` (s, 4, 3), ``planes`` (s, 4), and ``patch`` (s,), those of a patch one after the other and backs
    without a patch last. ``balls`` (s, 4): the centre, and the square of the diameter. ``nodes`` (s, 29, 4), and
    ``distances`` (3,), from which each rule is used: see :mod:`distant`."""

    corners: Array
    planes: Array
    patch: Index
    balls: Array
    nodes: Array
    distances: Array


@njit(nogil=True, cache=True, error_model="numpy")
def exchange_rows(
    sides: Sides, occluders: Occluders, first: int, last: int, tolerance: float, exchange: Array, errors: Array
) -> tuple[int, int]:
    """Add A_i F_ij between sides ``first`` to ``last - 1`` and all later sides to ``exchange[i, j]``, and estimates of
    errors to ``errors[i, j]``.

    tolerance: of the sum of a row, for pairs that are hidden in part. Returns the sides of a pair with more pieces than
    there is room for, else -1.
    """
    total, room = len(sides.corners), make_room(len(occluders.polygons))
    ours, theirs = np.empty((_BLOCK, len(room.found)), np.uint8), np.empty((_BLOCK, len(room.found)), np.uint8)
    for a in range(first, last, _BLOCK):
        a_end = min(a + _BLOCK, last)
        a_box = _box(sides.corners[a:a_end])
        for b in range(a, total, _BLOCK):
            b_end = min(b + _BLOCK, total)
            b_box = _box(sides.corners[b:b_end])
            count = in_shaft(a_box, b_box, occluders, room)
            for k in range(count):
                for i in range(a, a_end):
                    ours[i - a, k] = places(sides.corners, sides.planes, i, occluders, room.found[k])
                for j in range(b, b_end):
                    theirs[j - b, k] = places(sides.corners, sides.planes, j, occluders, room.found[k])
            for i in range(a, a_end):
                if is_behind(b_box, sides.planes[i]):
                    continue
                for j in range(max(b, i + 1), b_end):
                    if not faces(sides.corners, i, sides.planes, j) or not faces(sides.corners, j, sides.planes, i):
                        continue
                    between = _choose(ours[i - a], theirs[j - b], count, room)
                    value, error, done = _exchange(sides, i, j, occluders, between, tolerance, room)
                    if not done:
                        return i, j
                    exchange[sides.patch[i], sides.patch[j]] += value
                    errors[sides.patch[i], sides.patch[j]] += error
    return -1, -1


@njit(nogil=True, cache=True, error_model="numpy")
def _choose(p: Array, q: Array, count: int, room: Room) -> int:
    """Choose those of the first ``count`` found occluders that may be between two sides, from their places, and return
    their number."""
    chosen = 0
    for k in range(count):
        if may_be_between(p[k], q[k]):
            room.chosen[chosen] = room.found[k]
            chosen += 1
    return chosen


@njit(nogil=True, cache=True, error_model="numpy")
def _exchange(
    sides: Sides, i: int, j: int, occluders: Occluders, count: int, tolerance: float, room: Room
) -> tuple[float, float, bool]:
    """A F of two sides that face each other, with the first ``count`` chosen occluders perhaps between them, an
    estimate of its error, and whether it could be computed."""
    of_p, of_q = sides.planes[i], sides.planes[j]
    p, all_of_p = in_front(sides.corners[i], of_q)
    q, all_of_q = in_front(sides.corners[j], of_p)
    rule = _rule(sides, i, j) if all_of_p and all_of_q else -1
    whole = of_contours(p, q) if rule < 0 else of_nodes(sides.nodes[i], of_p, sides.nodes[j], of_q, rule)
    for k in range(count):
        if covers(occluders, room.chosen[k], p, q):
            return 0.0, 0.0, True
    if count > 0:
        count = in_hull(p, of_p, q, of_q, occluders, count, room)
    if count == 0:
        return whole, 0.0, True
    if polygon_area(p) > polygon_area(q):
        p, of_p, q, of_q = q, of_q, p, of_p
    allowed = _SHARE * tolerance * math.sqrt(whole * polygon_area(p))
    for level in range(len(_NUMBERS)):
        if _ERRORS[level, 0] * whole <= allowed:
            share, error = _sampled(p, of_p, q, of_q, occluders, count, _shift(i, j), level, room)
            return share * whole, error * whole, share >= 0.0
    return hidden_exchange(p, of_p, q, of_q, occluders, count, allowed, room)


@njit(nogil=True, cache=True, error_model="numpy")
def _sampled(
    p: Array,
    of_p: Array,
    q: Array,
    of_q: Array,
    occluders: Occluders,
    count: int,
    shift: tuple[int, int],
    level: int,
    room: Room,
) -> tuple[float, float]:
    """The share of A F that the first ``count`` chosen occluders leave, and an estimate of its error, from points of
    ``p``, as many as there are at a level. The share is -1 for too many pieces.

    Points are those of Sobol's sequence with a random digital shift: without bias, so that errors of a row are
    independent. Their number must not depend on what is seen from the first ones, which would make a bias.
    """
    seen, whole, least, most, point = 0.0, 0.0, 1.0, 0.0, np.empty(3)
    for k in range(_NUMBERS[level]):
        _map((_POINTS[k, 0] ^ shift[0]) / 2**32, (_POINTS[k, 1] ^ shift[1]) / 2**32, p, point)
        some = point_factor(point, of_p, q, of_q, occluders, count, room)
        if some < 0.0:
            return -1.0, 1.0
        all_ = point_factor_of_all(point, of_p, q, room)
        seen, whole = seen + some, whole + all_
        share = some / all_ if all_ > 0.0 else 0.0
        least, most = min(least, share), max(most, share)
    error = _ERRORS[level, 1] if most == 0.0 else _ERRORS[level, 2] + _ERRORS[level, 3] * (most - least)
    return seen / whole if whole > 0.0 else 0.0, error


@njit(nogil=True, cache=True, error_model="numpy")
def _map(u: float, v: float, p: Array, point: Array) -> None:
    """Map the unit square to a convex polygon, areas in proportion."""
    rest = u * polygon_area(p)
    for k in range(1, len(p) - 1):
        ax, ay, az = p[k, 0] - p[0, 0], p[k, 1] - p[0, 1], p[k, 2] - p[0, 2]
        bx, by, bz = p[k + 1, 0] - p[0, 0], p[k + 1, 1] - p[0, 1], p[k + 1, 2] - p[0, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        area = 0.5 * math.sqrt(x * x + y * y + z * z)
        if area > 0.0 and (rest <= area or k == len(p) - 2):
            r = math.sqrt(min(rest / area, 1.0))
            point[0] = p[0, 0] + r * ((1 - v) * ax + v * bx)
            point[1] = p[0, 1] + r * ((1 - v) * ay + v * by)
            point[2] = p[0, 2] + r * ((1 - v) * az + v * bz)
            return
        rest -= area


@njit(nogil=True, cache=True, error_model="numpy")
def _shift(i: int, j: int) -> tuple[int, int]:
    """Two random numbers of 32 bits for two sides [Steele et al. 2014]."""
    x = np.uint64(i) << np.uint64(32) | np.uint64(j)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return int(x >> np.uint64(32)), int(x & np.uint64(0xFFFFFFFF))


@njit(nogil=True, cache=True, error_model="numpy")
def _rule(sides: Sides, i: int, j: int) -> int:
    """The rule with the fewest points for the distance of two sides; -1 if they are too close for all."""
    square = 0.0
    for c in range(3):
        square += (sides.balls[i, c] - sides.balls[j, c]) ** 2
    square /= max(sides.balls[i, 3], sides.balls[j, 3])
    for rule in range(len(sides.distances)):
        if square >= sides.distances[rule]:
            return rule
    return -1


@njit(nogil=True, cache=True, error_model="numpy")
def _box(corners: Array) -> Array:
    """Bounds (2, 3) of corners (s, 4, 3)."""
    box = np.empty((2, 3))
    for c in range(3):
        box[0, c] = box[1, c] = corners[0, 0, c]
        for k in range(len(corners)):
            for i in range(4):
                box[0, c], box[1, c] = min(box[0, c], corners[k, i, c]), max(box[1, c], corners[k, i, c])
    return box
