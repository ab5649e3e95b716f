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
#: Ends of the rays of a batch, 32 bits of each coordinate; fewest and most batches; and the root mean square error of
#: one in form factors without occluders: measured between plates with 484 squares between them.
_ENDS = (Sobol(4).block(64) * 2**32).astype(np.int64)
_BATCHES = 16.0, 65536.0
_OF_BATCH = 0.05
#: Points that an error needs, times that error in form factors without occluders; and for each occluder, the time of a
#: batch over that of a point that sees one piece, and what every further piece adds to the latter.
_TO_ERROR, _TIME, _OF_PIECE = 0.3, 4.0, 0.25


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
) -> None:
    """Add A_i F_ij between sides ``first`` to ``last - 1`` and all later sides to ``exchange[i, j]``, and estimates of
    errors to ``errors[i, j]``.

    tolerance: of the sum of a row, for pairs that are hidden in part.
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
                    value, error = _exchange(sides, i, j, occluders, between, tolerance, room)
                    exchange[sides.patch[i], sides.patch[j]] += value
                    errors[sides.patch[i], sides.patch[j]] += error


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
) -> tuple[float, float]:
    """A F of two sides that face each other, with the first ``count`` chosen occluders perhaps between them, and an
    estimate of its error."""
    of_p, of_q = sides.planes[i], sides.planes[j]
    p, all_of_p = in_front(sides.corners[i], of_q)
    q, all_of_q = in_front(sides.corners[j], of_p)
    rule = _rule(sides, i, j) if all_of_p and all_of_q else -1
    whole = of_contours(p, q) if rule < 0 else of_nodes(sides.nodes[i], of_p, sides.nodes[j], of_q, rule)
    for k in range(count):
        if covers(occluders, room.chosen[k], p, q):
            return 0.0, 0.0
    if count > 0:
        count = in_hull(p, of_p, q, of_q, occluders, count, room)
    if count == 0:
        return whole, 0.0
    if polygon_area(p) > polygon_area(q):
        p, of_p, q, of_q = q, of_q, p, of_p
    allowed = _SHARE * tolerance * math.sqrt(whole * polygon_area(p))
    if allowed <= 0.0:
        return 0.0, 0.0  # slivers
    batches = max((_OF_BATCH * whole / allowed) ** 2, _BATCHES[0])
    if _TIME * batches > _TO_ERROR * whole / allowed * (1 + _OF_PIECE * count):
        for level in range(len(_NUMBERS)):
            if _ERRORS[level, 0] * whole <= allowed:
                share, error = _sampled(p, of_p, q, of_q, occluders, count, _shift(i, j, 0), level, room)
                if share >= 0.0:
                    return share * whole, error * whole
                break
        else:
            value, error, done = hidden_exchange(p, of_p, q, of_q, occluders, count, allowed, room)
            if done:
                return value, error
    share, error = _by_rays(p, of_p, q, of_q, occluders, count, i, j, int(min(batches, _BATCHES[1])), room)
    return share * whole, error * whole


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
def _by_rays(
    p: Array,
    of_p: Array,
    q: Array,
    of_q: Array,
    occluders: Occluders,
    count: int,
    i: int,
    j: int,
    batches: int,
    room: Room,
) -> tuple[float, float]:
    """The share of A F that the first ``count`` chosen occluders leave, and its standard error, from rays between
    points of both polygons: for pairs between many others.

    Batches have points of Sobol's sequence with random digital shifts of their own, so that they tell the error.
    """
    x, y = np.empty(3), np.empty(3)
    seen = squares = 0.0
    for batch in range(batches):
        (a, b), (c, d) = _shift(i, j, 2 * batch + 1), _shift(i, j, 2 * batch + 2)
        some = all_ = 0.0
        for k in range(len(_ENDS)):
            _map((_ENDS[k, 0] ^ a) / 2**32, (_ENDS[k, 1] ^ b) / 2**32, p, x)
            _map((_ENDS[k, 2] ^ c) / 2**32, (_ENDS[k, 3] ^ d) / 2**32, q, y)
            weight = _kernel(x, of_p, y, of_q)
            all_ += weight
            if _sees(x, y, occluders, count, room):
                some += weight
        share = some / all_ if all_ > 0.0 else 0.0
        seen, squares = seen + share, squares + share * share
    mean = seen / batches
    return mean, math.sqrt(max(squares / batches - mean * mean, 0.0) / (batches - 1))


@njit(nogil=True, cache=True, error_model="numpy")
def _kernel(x: Array, of_p: Array, y: Array, of_q: Array) -> float:
    """cos cos / r² of points of two planes."""
    ux, uy, uz = y[0] - x[0], y[1] - x[1], y[2] - x[2]
    square = ux * ux + uy * uy + uz * uz
    from_p = of_p[0] * ux + of_p[1] * uy + of_p[2] * uz
    to_q = -(of_q[0] * ux + of_q[1] * uy + of_q[2] * uz)
    return max(from_p, 0.0) * max(to_q, 0.0) / (square * square) if square > 0.0 else 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def _sees(x: Array, y: Array, occluders: Occluders, count: int, room: Room) -> bool:
    """Whether none of the first ``count`` chosen occluders is between two points."""
    for k in range(count):
        o = room.chosen[k]
        nx, ny, nz, c = occluders.planes[o, 0], occluders.planes[o, 1], occluders.planes[o, 2], occluders.planes[o, 3]
        h = nx * x[0] + ny * x[1] + nz * x[2] - c
        g = nx * y[0] + ny * y[1] + nz * y[2] - c
        if h * g >= 0.0:
            continue
        t = h / (h - g)
        zx, zy, zz = x[0] + t * (y[0] - x[0]), x[1] + t * (y[1] - x[1]), x[2] + t * (y[2] - x[2])
        corners, inside = occluders.counts[o], True
        for m in range(corners):
            v, w = occluders.polygons[o, m], occluders.polygons[o, m + 1 if m + 1 < corners else 0]
            ex, ey, ez = w[0] - v[0], w[1] - v[1], w[2] - v[2]
            dx, dy, dz = zx - v[0], zy - v[1], zz - v[2]
            side = nx * (ey * dz - ez * dy) + ny * (ez * dx - ex * dz) + nz * (ex * dy - ey * dx)
            if side < 0.0:
                inside = False
                break
        if inside:
            return False
    return True


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
def _shift(i: int, j: int, k: int) -> tuple[int, int]:
    """Two random numbers of 32 bits, the ``k``-th for two sides [Steele et al. 2014]."""
    x = (np.uint64(i) << np.uint64(32) | np.uint64(j)) + np.uint64(k) * np.uint64(0x9E3779B97F4A7C15)
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
