"""Loops compiled for the CPU by Numba: what may be between two groups of faces, and between two faces.

The *shaft* of two groups is the convex hull of their boxes [Haines and Wallace 1994]; few of the occluders meet it, and
often none. What is left is tested against the planes of two faces, and against their convex hull.

Lengths and planes are those of ``exchange``; planes of a hull face inward.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from etendue.core import Array

from .occluders import Occluders
from .occlusion import Room, cut

#: A corner this close to a plane counts as lying in it, because of the error of single precision.
_IN_PLANE = 1e-7
#: Faces must extend this far into the space between two others to occlude them.
_BETWEEN = 1e-6


@njit(nogil=True, cache=True, error_model="numpy")
def in_shaft(a: Array, b: Array, occluders: Occluders, room: Room) -> int:
    """Find the occluders that may meet the shaft of the boxes (2, 3) ``a`` and ``b``, the largest, which hides most,
    first, and return their number."""
    hull, boxes, nodes = room.hull, occluders.boxes, occluders.nodes
    planes, count, node = _shaft(a, b, hull), 0, 0
    while node < len(nodes):
        box = boxes[node]
        apart = _is_outside(box, hull, planes)
        for c in range(3):
            apart |= box[1, c] < min(a[0, c], b[0, c]) or box[0, c] > max(a[1, c], b[1, c])
        if apart:
            node = nodes[node, 2]
            continue
        for k in range(nodes[node, 0], nodes[node, 1]):
            if _is_on_one_side(a, b, occluders.planes[k]):
                continue
            if _reaches_all(occluders.polygons, k, occluders.counts[k], hull, planes):
                room.found[count] = k
                if occluders.areas[k] > occluders.areas[room.found[0]]:
                    room.found[count], room.found[0] = room.found[0], k
                count += 1
        node += 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def _shaft(a: Array, b: Array, hull: Array) -> int:
    """Write the planes of the hull of two boxes that no axis is normal to; their number. Each is through an edge of
    both boxes, parallel to an axis."""
    count = 0
    for i in range(3):
        j = i + 1 if i < 2 else 0
        for s in range(2):
            for t in range(2):
                x, y = a[s, i] - b[s, i], a[t, j] - b[t, j]
                outward_x, outward_y = 2.0 * s - 1.0, 2.0 * t - 1.0
                if x * outward_x * y * outward_y >= 0.0:
                    continue
                length = math.sqrt(x * x + y * y)
                hull[count, 3 - i - j] = 0.0
                hull[count, i], hull[count, j] = -outward_x * abs(y) / length, -outward_y * abs(x) / length
                hull[count, 3] = hull[count, i] * a[s, i] + hull[count, j] * a[t, j]
                count += 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def _is_outside(box: Array, hull: Array, planes: int) -> bool:
    """Whether a box is behind one of the planes of a hull."""
    for k in range(planes):  # noqa: SIM110 - Numba has no generators
        if is_behind(box, hull[k]):
            return True
    return False


@njit(nogil=True, cache=True, error_model="numpy")
def is_behind(box: Array, plane: Array) -> bool:
    """Whether a box (2, 3) is behind a plane."""
    far = -plane[3]
    for c in range(3):
        far += plane[c] * (box[1, c] if plane[c] > 0 else box[0, c])
    return far <= 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def _is_on_one_side(a: Array, b: Array, plane: Array) -> bool:
    """Whether two boxes are both in front of an occluder, or both behind it."""
    low, high = np.inf, -np.inf
    for box in (a, b):
        near = far = -plane[3]
        for c in range(3):
            near += plane[c] * (box[0, c] if plane[c] > 0 else box[1, c])
            far += plane[c] * (box[1, c] if plane[c] > 0 else box[0, c])
        low, high = min(low, near), max(high, far)
    return low >= plane[4] - _IN_PLANE or high <= _IN_PLANE - plane[4]


@njit(nogil=True, cache=True, error_model="numpy")
def _reaches_all(polygons: Array, number: int, count: int, hull: Array, planes: int) -> bool:
    """Whether a polygon of ``count`` corners extends in front of all planes of a hull."""
    for k in range(planes):  # noqa: SIM110
        if not _reaches(polygons, number, count, hull, k, 0.0):
            return False
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def _reaches(polygons: Array, number: int, count: int, planes: Array, k: int, least: float) -> bool:
    """Whether a polygon of ``count`` corners extends so far in front of a plane. Numbers are cheaper than views."""
    x, y, z, d = planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3] + least
    for i in range(count):
        if x * polygons[number, i, 0] + y * polygons[number, i, 1] + z * polygons[number, i, 2] > d:
            return True
    return False


@njit(nogil=True, cache=True, error_model="numpy")
def places(corners: Array, planes: Array, side: int, occluders: Occluders, number: int) -> int:
    """How a side and an occluder are to each other, for :func:`may_be_between`: bit 0, the occluder extends in front of
    the side; bits 1 and 2, the side extends in front of the occluder, and behind it."""
    if not _reaches(occluders.polygons, number, occluders.counts[number], planes, side, _BETWEEN):
        return 0
    of_occluder, low, high = occluders.planes[number], np.inf, -np.inf
    for i in range(4):
        height = of_occluder[0] * corners[side, i, 0] + of_occluder[1] * corners[side, i, 1]
        height += of_occluder[2] * corners[side, i, 2]
        low, high = min(low, height), max(high, height)
    in_plane = _IN_PLANE - of_occluder[4]
    return 1 + 2 * (high - of_occluder[3] > in_plane) + 4 * (of_occluder[3] - low > in_plane)


@njit(nogil=True, cache=True, error_model="numpy")
def may_be_between(p: int, q: int) -> bool:
    """Whether an occluder may be between two sides, from its :func:`places`: in front of both, which are not on the
    same side of it."""
    return p & q & 1 != 0 and ((p & 2 != 0 and q & 4 != 0) or (p & 4 != 0 and q & 2 != 0))


@njit(nogil=True, cache=True, error_model="numpy")
def covers(occluders: Occluders, number: int, p: Array, q: Array) -> bool:
    """Whether an occluder hides all of two polygons from each other: one is in front of it and the other one behind,
    and all lines between their corners meet it. Where these lines meet its plane are the corners of what their hull has
    of the plane."""
    polygons, planes, count = occluders.polygons, occluders.planes, occluders.counts[number]
    nx, ny, nz, sign = planes[number, 0], planes[number, 1], planes[number, 2], 0.0
    for e in range(count):
        f = e + 1 if e + 1 < count else 0
        x, y, z = polygons[number, e, 0], polygons[number, e, 1], polygons[number, e, 2]
        ex, ey, ez = polygons[number, f, 0] - x, polygons[number, f, 1] - y, polygons[number, f, 2] - z
        # Inward, in the plane of the occluder.
        mx, my, mz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        for i in range(len(p)):
            px, py, pz = p[i, 0] - x, p[i, 1] - y, p[i, 2] - z
            height, inside = nx * px + ny * py + nz * pz, mx * px + my * py + mz * pz
            if sign == 0.0:
                sign = 1.0 if height > 0.0 else -1.0
            for j in range(len(q)):
                qx, qy, qz = q[j, 0] - x, q[j, 1] - y, q[j, 2] - z
                ours, theirs = sign * height, -sign * (nx * qx + ny * qy + nz * qz)
                if min(ours, theirs) < -_IN_PLANE or theirs * inside + ours * (mx * qx + my * qy + mz * qz) < 0.0:
                    return False
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def in_hull(p: Array, of_p: Array, q: Array, of_q: Array, occluders: Occluders, count: int, room: Room) -> int:
    """Keep those of the first ``count`` chosen occluders that may intersect the convex hull of two polygons, each of
    which is in front of the other's plane, and return their number: those in front of all planes that bound it, the
    planes of both polygons and those through an edge of one and a corner of the other with both on one side."""
    planes, kept = _hull(p, of_p, q, of_q, room.hull), 0
    for k in range(count):
        number = room.chosen[k]
        if _reaches_all(occluders.polygons, number, occluders.counts[number], room.hull, planes):
            room.chosen[kept] = number
            kept += 1
    return kept


@njit(nogil=True, cache=True, error_model="numpy")
def _hull(p: Array, of_p: Array, q: Array, of_q: Array, hull: Array) -> int:
    """Write the planes of the hull of two polygons to ``hull``, a little inside of it, and return their number."""
    count = _touching(p, of_p, q, hull)
    count += _touching(q, of_q, p, hull[count:])
    for c in range(4):
        hull[count, c], hull[count + 1, c] = of_p[c], of_q[c]
    hull[count, 3] += _BETWEEN
    hull[count + 1, 3] += _BETWEEN
    return count + 2


@njit(nogil=True, cache=True, error_model="numpy")
def _touching(p: Array, of_p: Array, q: Array, hull: Array) -> int:
    """Write the planes through each edge of ``p`` that touch ``q`` to ``hull``, and return their number."""
    nx, ny, nz, count = of_p[0], of_p[1], of_p[2], 0
    for i in range(len(p)):
        j = i + 1 if i + 1 < len(p) else 0
        ex, ey, ez = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1], p[j, 2] - p[i, 2]
        # Into the polygon, in its plane.
        mx, my, mz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        length = math.sqrt(mx * mx + my * my + mz * mz)
        if length == 0.0:
            continue
        mx, my, mz = mx / length, my / length, mz / length
        # Of the corners of the other one, (y, z) in the plane across the edge, that which is farthest out.
        y_out, z_out = 1.0, 0.0
        for k in range(len(q)):
            x, y, z = q[k, 0] - p[i, 0], q[k, 1] - p[i, 1], q[k, 2] - p[i, 2]
            y, z = mx * x + my * y + mz * z, max(nx * x + ny * y + nz * z, 0.0)
            if y * z_out < y_out * z or (z == 0.0 and y < 0.0):
                y_out, z_out = y, z
        length = math.sqrt(y_out * y_out + z_out * z_out)
        if z_out <= _IN_PLANE * length:  # in the plane of the polygon, or both are
            continue
        y_out, z_out = y_out / length, z_out / length
        plane = hull[count]
        plane[0], plane[1] = z_out * mx - y_out * nx, z_out * my - y_out * ny
        plane[2] = z_out * mz - y_out * nz
        plane[3] = plane[0] * p[i, 0] + plane[1] * p[i, 1] + plane[2] * p[i, 2] + _BETWEEN
        count += 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def faces(corners: Array, side: int, planes: Array, other: int) -> bool:
    """Whether a side extends in front of the plane of another."""
    return _reaches(corners, side, corners.shape[1], planes, other, _IN_PLANE)


@njit(nogil=True, cache=True, error_model="numpy")
def in_front(p: Array, plane: Array) -> tuple[Array, bool]:
    """The part of a polygon that is in front of a plane, and whether it is all."""
    if _nearest(p, plane) >= -_IN_PLANE:
        return p, True
    result = np.empty((len(p) + 1, 3))
    return result[: cut(p, len(p), plane[0], plane[1], plane[2], plane[3], result)], False


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest(p: Array, plane: Array) -> float:
    """The least ``n . x - c`` of the corners."""
    least = np.inf
    for i in range(len(p)):
        least = min(least, plane[0] * p[i, 0] + plane[1] * p[i, 1] + plane[2] * p[i, 2] - plane[3])
    return least
