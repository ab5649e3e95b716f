r"""Loops compiled for the CPU by Numba: what rings of surfaces of revolution exchange.

Points of two rings at an angle \phi about the axis have c = \cos\phi. In c, what a point faces is an interval, and so
is what a third ring hides: at its place t, a straight line between the points has a squared distance from the axis that
is linear in c, so it meets the ring there for one c(t), and the shadow is the range of c(t) along the ring. Over the
rest, the kernel \cos\theta \cos\theta' / d^2 is integrated over \phi in closed form, and over both profiles by Gauss'
rule, in squares that are divided where four of them differ from one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array

#: Gauss' rules on [0, 1]: along profiles, and over the angle for points near the axis.
_PLACES, _WEIGHTS = (np.polynomial.legendre.leggauss(4)[0] + 1) / 2, np.polynomial.legendre.leggauss(4)[1] / 2
_TURNS, _SHARES = (np.polynomial.legendre.leggauss(12)[0] + 1) / 2, np.polynomial.legendre.leggauss(12)[1] / 2
#: Gaps between shadows that are none, and 2 r r' over the largest squared distance below which the closed form rounds.
_GAP, _ON_AXIS = 1e-14, 1e-3
#: Squares are divided so often at most, and at least where a shadow falls on them.
_DEEPEST, _SHADED = 16, 1
#: Corners of squares, in shares of their sides, and how often they are looked at.
_CORNER, _LOOKS = 0.01, 8


@njit(nogil=True, cache=True, error_model="numpy")
def exchange_of_ring(
    rings: Array, sides: NDArray[Any], seen: int, i: int, tolerances: Array, exchange: Array, errors: Array
) -> None:
    """Write A F between the sides of ring ``i`` and those of the rings from it on, and estimates of its error, to
    ``exchange`` and ``errors`` (n, 4): left to left, left to right, right to left, right to right.

    rings: (n, 4) r, z, r, z, of which flat ones have one z. sides: (n, 2) what is to the left and to the right, -1 for
    nothing; light between sides from ``seen`` on is left out. tolerances: (n,) of the exchange in the squares along a
    line, such as the edge of a shadow.
    """
    n = len(rings)
    shadows = np.empty((n, 2))
    todo = np.empty((3 * _DEEPEST + 4, 4))
    whole = np.empty((3 * _DEEPEST + 4, 4))
    parts = np.empty((4, 4))
    wanted = np.empty(4, np.bool_)
    for j in range(i, n):
        for kind in range(4):
            a, b = sides[i, kind // 2], sides[j, kind % 2]
            # The two sides of a ring do not see each other.
            wanted[kind] = a >= 0 and b >= 0 and min(a, b) < seen and (i != j or kind == 0 or kind == 3)
        exchange[j], errors[j] = 0.0, 0.0
        if not wanted.any() or (i == j and rings[i, 1] == rings[i, 3]):
            continue
        todo[0, 0], todo[0, 1], todo[0, 2], todo[0, 3] = 0.0, 0.0, 1.0, 0.0
        _square(rings, i, j, 0.0, 0.0, 1.0, wanted, shadows, whole[0])
        count = 1
        while count:
            count -= 1
            x, y, half, depth = todo[count, 0], todo[count, 1], todo[count, 2] / 2, todo[count, 3]
            is_shaded = False
            for part in range(4):
                at = x + half * (part % 2), y + half * (part // 2)
                is_shaded |= _square(rings, i, j, at[0], at[1], half, wanted, shadows, parts[part])
            worst = 0.0
            for kind in range(4):
                worst = max(worst, abs(parts[:, kind].sum() - whole[count, kind]))
            allowed = 2 * half * tolerances[j]
            is_fine = worst <= allowed and (depth >= _SHADED or not is_shaded)
            if is_fine and is_shaded and i != j and depth < _LOOKS and np.abs(parts).max() <= allowed:
                is_fine = _corners(rings, i, j, x, y, 2 * half, wanted, shadows) <= allowed
            if is_fine or depth >= _DEEPEST:
                for kind in range(4):
                    finer = parts[:, kind].sum()
                    exchange[j, kind] += finer
                    errors[j, kind] += abs(finer - whole[count, kind])
                continue
            for part in range(4):
                todo[count, 0], todo[count, 1] = x + half * (part % 2), y + half * (part // 2)
                todo[count, 2], todo[count, 3] = half, depth + 1
                whole[count] = parts[part]
                count += 1


@njit(nogil=True, cache=True, error_model="numpy")
def _square(
    rings: Array, i: int, j: int, x: float, y: float, size: float, wanted: NDArray[Any], shadows: Array, out: Array
) -> bool:
    """Write the exchange of a square of both profiles, in shares of their lengths, to ``out`` (4,); whether anything
    casts a shadow. Of a ring with itself, y is a share of x: of two points in both orders, one is taken."""
    out[:] = 0.0
    is_shaded = False
    for k in range(len(_PLACES)):
        for m in range(len(_PLACES)):
            s, t = x + size * _PLACES[k], y + size * _PLACES[m]
            weight = size * size * _WEIGHTS[k] * _WEIGHTS[m]
            if i == j:
                weight *= s
                t *= s
            is_shaded |= _between(rings, i, j, s, t, weight, wanted, shadows, out)
    return is_shaded


@njit(nogil=True, cache=True, error_model="numpy")
def _corners(
    rings: Array, i: int, j: int, x: float, y: float, size: float, wanted: NDArray[Any], shadows: Array
) -> float:
    """The exchange of a square if all of it were as its corners, near which what is seen may be small."""
    found = np.zeros(4)
    for corner in range(4):
        s = x + size * (_CORNER if corner % 2 == 0 else 1 - _CORNER)
        t = y + size * (_CORNER if corner // 2 == 0 else 1 - _CORNER)
        _between(rings, i, j, s, t, size * size, wanted, shadows, found)
    return found.max()


@njit(nogil=True, cache=True, error_model="numpy")
def _between(
    rings: Array, i: int, j: int, s: float, t: float, weight: float, wanted: NDArray[Any], shadows: Array, out: Array
) -> bool:
    """Add the exchange of two circles, at shares ``s`` and ``t`` of the profiles of two rings."""
    r1, z1 = rings[i, 0] + s * (rings[i, 2] - rings[i, 0]), rings[i, 1] + s * (rings[i, 3] - rings[i, 1])
    r2, z2 = rings[j, 0] + t * (rings[j, 2] - rings[j, 0]), rings[j, 1] + t * (rings[j, 3] - rings[j, 1])
    up = z2 - z1
    # Normals to the left, times the lengths of the profiles: cos d at either end is p + q c, and u + v c.
    nr1, nz1 = rings[i, 1] - rings[i, 3], rings[i, 2] - rings[i, 0]
    nr2, nz2 = rings[j, 1] - rings[j, 3], rings[j, 2] - rings[j, 0]
    q, v = nr1 * r2, nr2 * r1
    p_q, u_v = nr1 * (r2 - r1) + nz1 * up, nr2 * (r1 - r2) - nz2 * up
    least, most = 1.0, -1.0
    lows, highs = np.empty(4), np.empty(4)
    for kind in range(4):
        low, high = _facing(p_q, q, kind // 2 == 0)
        other_low, other_high = _facing(u_v, v, kind % 2 == 0)
        lows[kind], highs[kind] = max(low, other_low), min(high, other_high)
        if wanted[kind] and lows[kind] < highs[kind]:
            least, most = min(least, lows[kind]), max(most, highs[kind])
    if least >= most:
        return False

    count = 0
    for k in range(len(rings)):
        low, high = _shadow(rings[k], r1, z1, r2, z2, k == i, k == j)
        if low < high and low < most and high > least:
            if low <= least and high >= most:
                return True
            place = count
            while place > 0 and shadows[place - 1, 0] > low:
                shadows[place] = shadows[place - 1]
                place -= 1
            shadows[place, 0], shadows[place, 1] = low, high
            count += 1

    close, b = (r1 - r2) ** 2 + up**2, 2 * r1 * r2
    begin = least
    for k in range(count + 1):
        end = most if k == count else min(shadows[k, 0], most)
        if end > begin + _GAP:
            for kind in range(4):
                low, high = max(lows[kind], begin), min(highs[kind], end)
                if wanted[kind] and low < high:
                    sign = 1.0 if kind == 0 or kind == 3 else -1.0
                    out[kind] += weight * sign * 2 * b * _kernel(p_q, q, u_v, v, close, b, low, high)
        if k < count:
            begin = max(begin, shadows[k, 1])
    return count > 0


@njit(nogil=True, cache=True, error_model="numpy")
def _facing(at_one: float, slope: float, left: bool) -> tuple[float, float]:
    """The c in [-1, 1] for which ``at_one`` + ``slope`` (c - 1) is positive, for the left side; or negative."""
    if not left:
        at_one, slope = -at_one, -slope
    if slope == 0:
        return (-1.0, 1.0) if at_one > 0 else (1.0, -1.0)
    c = 1 - at_one / slope
    return (max(c, -1.0), 1.0) if slope > 0 else (-1.0, min(c, 1.0))


@njit(nogil=True, cache=True, error_model="numpy")
def _shadow(
    ring: Array, r1: float, z1: float, r2: float, z2: float, is_first: bool, is_second: bool
) -> tuple[float, float]:
    """The range of c for which the straight line from one point to the other meets a ring, on which they may lie.

    With the ring's radius g + h t at t, c(t) is (alpha t^2 + beta t + gamma) / (2 r1 r2 t (1 - t)).
    """
    nothing = 2.0, -2.0
    up, (ra, za, rb, zb) = z2 - z1, (ring[0], ring[1], ring[2], ring[3])
    if is_first and is_second:
        return nothing
    double = 2 * r1 * r2
    if za == zb:
        if is_first or is_second or (z1 - za) * (z2 - za) >= 0:
            return nothing
        t = (za - z1) / up
        free = (r1 * (1 - t)) ** 2 + (r2 * t) ** 2
        one, other = (ra * ra - free) / (double * t * (1 - t)), (rb * rb - free) / (double * t * (1 - t))
        return min(one, other), max(one, other)
    if up == 0:
        if (z1 - za) * (z1 - zb) > 0:
            return nothing
        begin, end = 0.0, 1.0
    else:
        begin, end = (za - z1) / up, (zb - z1) / up
        begin, end = abs(max(min(begin, end), 0.0)), min(max(begin, end), 1.0)  # no -0, by which limits turn over
        if begin >= end:
            return nothing
    slope = (rb - ra) / (zb - za)
    h = slope * up
    g = ra + slope * (z1 - za)
    if is_first:
        g = r1
    elif is_second:
        g = r2 - h
    alpha, beta, gamma = h * h - r1 * r1 - r2 * r2, 2 * g * h + 2 * r1 * r1, g * g - r1 * r1
    if is_first or is_second:  # a factor t, or 1 - t, of both polynomials is left out: monotonic
        if is_first:
            one, other = (alpha * begin + beta) / (1 - begin), (alpha * end + beta) / (1 - end)
        else:
            one, other = (gamma - alpha * begin) / begin, (gamma - alpha * end) / end
        return min(one, other) / double, max(one, other) / double
    low, high = np.inf, -np.inf
    root = math.sqrt(max(gamma * (gamma + alpha + beta), 0.0))
    for k in range(4):
        if k < 2:
            t = begin if k == 0 else end
        else:  # where the derivative vanishes
            t = gamma / (gamma + root) if k == 2 else gamma / (gamma - root)
            if not begin < t < end or root == 0:
                continue
        c = (alpha * t * t + beta * t + gamma) / (double * t * (1 - t))
        low, high = min(low, c), max(high, c)
    return low, high


@njit(nogil=True, cache=True, error_model="numpy")
def _kernel(p_q: float, q: float, u_v: float, v: float, close: float, b: float, low: float, high: float) -> float:
    """The integral of (p + q c) (u + v c) / d^4 over angles with c in [low, high], where d^2 = close + b (1 - c)."""
    a = close + b
    begin, end = math.acos(high), math.acos(low)
    if b < _ON_AXIS * a:
        found = 0.0
        for k in range(len(_TURNS)):
            off = 1 - math.cos(begin + (end - begin) * _TURNS[k])
            found += _SHARES[k] * (p_q - q * off) * (u_v - v * off) / (close + b * off) ** 2
        return found * (end - begin)
    # (p + q c) (u + v c) as a polynomial of d^2, and the integrals of its powers by tan(psi / 2) = k tan(phi / 2).
    first, second = p_q + q * close / b, u_v + v * close / b
    psi, sine = _turned(high, close, a + b)
    to_psi, to_sine = _turned(low, close, a + b)
    psi, sine = to_psi - psi, to_sine - sine
    product = close * (a + b)
    span = math.sqrt(product)
    return (
        first * second * (a * psi + b * sine) / (product * span)
        - (first * v + second * q) / b * psi / span
        + q * v / (b * b) * (end - begin)
    )


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _turned(c: float, close: float, far: float) -> tuple[float, float]:
    """psi and its sine, of an angle phi with c = cos phi."""
    x, y = math.sqrt(far * (1 - c)), math.sqrt(close * (1 + c))
    return 2 * math.atan2(x, y), 2 * x * y / (x * x + y * y)
