"""Loops compiled for the CPU by Numba: form factors of flat polygons that see all of each other, by contour integrals.

    A_i F_ij = 1 / (2 pi) times the integral over both contours of ln r dx . dy          [Sparrow 1963]

The integral along one edge is in closed form; that along the other, by Gauss-Legendre quadrature. If edges are close to
each other, the outer one is divided where the inner integral is not smooth, with denser points at these divisions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from etendue.core import Array

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
def of_contours(p: Array, q: Array) -> float:
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
            total += _along(start, end, len(_COUNTS) - 1, wx, wy, wz, ux, uy, uz, vx, vy, vz, inner)
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
