"""Loops compiled for the CPU by Numba: form factors of flat polygons that others hide in part.

The inner integral, from a point to what it sees of a polygon, is in closed form: the polygon without the shadows of its
occluders is a set of convex pieces, over whose contours the form factor of a point is a sum [Sparrow 1963]. The outer
one, over the other polygon, is a quadrature of triangles, which are divided where two rules differ.

Lengths and planes are those of ``exchange``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from etendue.core import Array

from .occluders import Index, Occluders

#: What is this close to a plane through the point of sight is in it.
_THIN = 1e-12
#: Most pieces of a polygon, corners of a piece, and divisions of a triangle in a row.
PIECES, CORNERS = 512, 24
_DEPTH = 8
#: Points of a triangle in barycentric coordinates: between the middle and the corners; near the corners, where a part
#: may be hidden that is seen from the middle; and the middle. The first three with equal weights integrate parabolas,
#: and so do the others with these.
_NEAR = 0.94
_NODES = np.concatenate([1 / 6 + np.eye(3) / 2, (1 - _NEAR) / 3 + _NEAR * np.eye(3), np.full((1, 3), 1 / 3)])
_WEIGHT = 1 / (12 * _NEAR**2)
#: The quarters of a triangle: their corners, and from 3 on the middles of its edges.
_PARTS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
#: Error of the mean of two rules, relative to their largest difference: measured, a tenth in the sums of rows of a city
#: of 994 facets, at tolerances of 1e-5 and 2e-5, less in an L-shaped room.
_ERROR = 0.25


class Room(NamedTuple):
    """Arrays that loops write over: planes of a hull, polygons that are cut, numbers of occluders, and pieces."""

    hull: Array
    clipped: Array
    found: Index
    chosen: Index
    pieces: Array
    sizes: Index


@njit(nogil=True, cache=True, error_model="numpy")
def make_room(occluders: int) -> Room:
    """For so many occluders."""
    return Room(
        np.empty((32, 4)),
        np.empty((4, CORNERS, 3)),
        np.empty(occluders, np.int64),
        np.empty(occluders, np.int64),
        np.empty((2, PIECES, CORNERS, 3)),
        np.empty((2, PIECES), np.int64),
    )


@njit(nogil=True, cache=True, error_model="numpy")
def hidden_exchange(
    p: Array, of_p: Array, q: Array, of_q: Array, occluders: Occluders, count: int, tolerance: float, room: Room
) -> tuple[float, float, bool]:
    """A_p F_pq of two polygons with the first ``count`` chosen occluders between them, an estimate of its error, and
    whether it could be computed: not with more than :data:`PIECES` pieces.

    tolerance: of A F, at which triangles of ``p`` are no longer divided.
    """
    whole, point = polygon_area(p), np.zeros(3)
    # By numbers, as all that follows: to assign arrays takes Numba some seconds to compile.
    stack, depth, corners = np.empty((4 * _DEPTH + 8, 3, 3)), np.empty(4 * _DEPTH + 8, np.int64), np.empty((6, 3))
    total, error, top = 0.0, 0.0, 0
    for k in range(1, len(p) - 1):
        for c in range(3):
            stack[top, 0, c], stack[top, 1, c], stack[top, 2, c] = p[0, c], p[k, c], p[k + 1, c]
        depth[top] = 0
        top += 1
    while top > 0:
        top -= 1
        level = depth[top]
        for k in range(3):
            for c in range(3):
                corners[k, c] = stack[top, k, c]
        t = corners[:3]
        area = polygon_area(t)
        if area <= 0.0:
            continue
        inner = outer = 0.0
        for k in range(7):
            for c in range(3):
                point[c] = _NODES[k, 0] * t[0, c] + _NODES[k, 1] * t[1, c] + _NODES[k, 2] * t[2, c]
            seen = point_factor(point, of_p, q, of_q, occluders, count, room)
            if seen < 0.0:
                return 0.0, 0.0, False
            if k < 3:
                inner += seen / 3
            else:
                outer += (_WEIGHT if k < 6 else 1 - 3 * _WEIGHT) * seen
        # `seen` is now from the middle; two rules may agree by chance, three seldom do.
        value = 0.5 * (inner + outer)
        change = _ERROR * area * max(abs(inner - outer), abs(inner - seen), abs(outer - seen))
        # From few points alone, a hole may be missed that is as large as a quarter of the triangle.
        if (change <= tolerance * math.sqrt(area / whole) and level > 0) or level == _DEPTH:
            total += area * value
            error += change
            continue
        for k in range(3):
            for c in range(3):
                corners[3 + k, c] = 0.5 * (t[k, c] + t[(k + 1) % 3, c])
        for part in range(4):
            for k in range(3):
                for c in range(3):
                    stack[top, k, c] = corners[_PARTS[part, k], c]
            depth[top] = level + 1
            top += 1
    return total, error, True


@njit(nogil=True, cache=True, error_model="numpy")
def point_factor(x: Array, of_p: Array, q: Array, of_q: Array, occluders: Occluders, count: int, room: Room) -> float:
    """The form factor from a point in the plane ``of_p`` to what it sees of ``q``; -1 for too many pieces."""
    shade, rest, pieces, sizes = room.clipped[0], room.clipped[1], room.pieces, room.sizes
    now, made = 0, 1
    sizes[0, 0] = len(q)
    for i in range(len(q)):
        for c in range(3):
            pieces[0, 0, i, c] = q[i, c] - x[c]
    # The planes relative to the point: of a polygon, n . y = c - n . x.
    own = of_p[3] - (of_p[0] * x[0] + of_p[1] * x[1] + of_p[2] * x[2])
    far = of_q[3] - (of_q[0] * x[0] + of_q[1] * x[1] + of_q[2] * x[2])
    for k in range(count):
        corners = occluders.counts[room.chosen[k]]
        for i in range(corners):
            for c in range(3):
                shade[i, c] = occluders.polygons[room.chosen[k], i, c] - x[c]
        # What is behind the point's own plane, or behind the polygon, hides nothing.
        corners = cut(shade, corners, of_p[0], of_p[1], of_p[2], own + 1e-9, rest)
        corners = cut(rest, corners, of_q[0], of_q[1], of_q[2], far + 1e-9, shade)
        if corners < 3 or not _is_open(shade, corners):
            continue
        other, left = 1 - now, 0
        for m in range(made):
            added = _without(
                pieces[now, m], sizes[now, m], shade, corners, pieces[other, left:], sizes[other, left:], room.clipped
            )
            if added < 0:
                return -1.0
            left += added
        now, made = other, left
        if made == 0:
            return 0.0
    total = 0.0
    for m in range(made):
        total += _of_contour(pieces[now, m], sizes[now, m], of_p)
    return max(total / (2 * math.pi), 0.0)


@njit(nogil=True, cache=True, error_model="numpy")
def point_factor_of_all(x: Array, of_p: Array, q: Array, room: Room) -> float:
    """The form factor from a point in the plane ``of_p`` to all of ``q``."""
    whole = room.clipped[0]
    for i in range(len(q)):
        for c in range(3):
            whole[i, c] = q[i, c] - x[c]
    return max(_of_contour(whole, len(q), of_p) / (2 * math.pi), 0.0)


@njit(nogil=True, cache=True, error_model="numpy")
def cut(p: Array, count: int, nx: float, ny: float, nz: float, d: float, result: Array) -> int:
    """Write the part of a convex polygon of ``count`` corners with n . x > d to ``result``, and return its number of
    corners."""
    made, h = 0, nx * p[0, 0] + ny * p[0, 1] + nz * p[0, 2] - d
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        t = nx * p[j, 0] + ny * p[j, 1] + nz * p[j, 2] - d
        if h > 0:
            for c in range(3):
                result[made, c] = p[i, c]
            made += 1
        if (h > 0) != (t > 0):
            share = h / (h - t)
            for c in range(3):
                result[made, c] = p[i, c] + share * (p[j, c] - p[i, c])
            made += 1
        h = t
    return made


@njit(nogil=True, cache=True, error_model="numpy")
def _is_open(shade: Array, count: int) -> bool:
    """Whether a polygon is seen from the origin under an angle, and not from the side; turns it so that the origin is
    behind it."""
    volume, size = 0.0, 0.0
    for i in range(1, count - 1):
        ax, ay, az = shade[0, 0], shade[0, 1], shade[0, 2]
        bx, by, bz = shade[i, 0], shade[i, 1], shade[i, 2]
        cx, cy, cz = shade[i + 1, 0], shade[i + 1, 1], shade[i + 1, 2]
        volume += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        size = max(size, ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz)
    if abs(volume) <= _THIN * size * math.sqrt(size):
        return False
    if volume < 0:
        for i in range(count // 2):
            for c in range(3):
                shade[i, c], shade[count - 1 - i, c] = shade[count - 1 - i, c], shade[i, c]
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def _without(piece: Array, size: int, shade: Array, count: int, result: Array, sizes: Index, clipped: Array) -> int:
    """Write the convex pieces of a convex polygon outside of the cone from the origin through ``shade`` to ``result``;
    their number, -1 if there are too many. Nothing is cut from a polygon outside of the cone."""
    # First whether the cone and the piece are apart.
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        nx, ny, nz = _cone_plane(shade, i, j)
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            continue
        inside = False
        for m in range(size):
            if nx * piece[m, 0] + ny * piece[m, 1] + nz * piece[m, 2] > _THIN:
                inside = True
                break
        if not inside:
            if len(result) == 0:
                return -1
            for m in range(size):
                for c in range(3):
                    result[0, m, c] = piece[m, c]
            sizes[0] = size
            return 1
    rest, kept, left, made = clipped[2], clipped[3], size, 0
    for m in range(size):
        for c in range(3):
            rest[m, c] = piece[m, c]
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        nx, ny, nz = _cone_plane(shade, i, j)
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            continue
        if made >= len(result) or left + 2 > CORNERS:
            return -1
        out = cut(rest, left, -nx, -ny, -nz, 0.0, result[made])
        if out >= 3:
            sizes[made] = out
            made += 1
        left = cut(rest, left, nx, ny, nz, 0.0, kept)
        if left < 3:
            break
        rest, kept = kept, rest
    return made


@njit(nogil=True, cache=True, error_model="numpy")
def _cone_plane(shade: Array, i: int, j: int) -> tuple[float, float, float]:
    """The normal of the plane through the origin and an edge, inward, of unit length; zero for an edge without one."""
    x = shade[i, 1] * shade[j, 2] - shade[i, 2] * shade[j, 1]
    y = shade[i, 2] * shade[j, 0] - shade[i, 0] * shade[j, 2]
    z = shade[i, 0] * shade[j, 1] - shade[i, 1] * shade[j, 0]
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@njit(nogil=True, cache=True, error_model="numpy")
def _of_contour(p: Array, count: int, of_p: Array) -> float:
    """2 pi times the form factor from a point with the normal of ``of_p`` to a polygon whose front faces it."""
    total = 0.0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        x = p[i, 1] * p[j, 2] - p[i, 2] * p[j, 1]
        y = p[i, 2] * p[j, 0] - p[i, 0] * p[j, 2]
        z = p[i, 0] * p[j, 1] - p[i, 1] * p[j, 0]
        sine = math.sqrt(x * x + y * y + z * z)
        if sine > 0.0:
            cosine = p[i, 0] * p[j, 0] + p[i, 1] * p[j, 1] + p[i, 2] * p[j, 2]
            total -= math.atan2(sine, cosine) * (of_p[0] * x + of_p[1] * y + of_p[2] * z) / sine
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def polygon_area(p: Array) -> float:
    """The area of a flat polygon."""
    x = y = z = 0.0
    for i in range(1, len(p) - 1):
        ux, uy, uz = p[i, 0] - p[0, 0], p[i, 1] - p[0, 1], p[i, 2] - p[0, 2]
        vx, vy, vz = p[i + 1, 0] - p[0, 0], p[i + 1, 1] - p[0, 1], p[i + 1, 2] - p[0, 2]
        x += uy * vz - uz * vy
        y += uz * vx - ux * vz
        z += ux * vy - uy * vx
    return 0.5 * math.sqrt(x * x + y * y + z * z)
