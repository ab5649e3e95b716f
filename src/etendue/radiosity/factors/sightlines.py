r"""Loops compiled for the CPU by Numba: what segments of a plane exchange along the lines that join them.

In 2-D, L_i F_ij is half the measure dp d\theta of the lines from i to j that nothing meets [Hottel 1954]. The borders
of these sets of lines are lines through ends of segments. A line through each end is therefore turned around it: the
two sets beside this line, which differ by what meets the segments of the end, get the integral of its p on the one side
and lose it on the other. What the line meets changes only in directions of other ends [Orti 1996].
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array

#: Angle below which a segment is seen edge on.
_EDGE_ON = 1e-13


@njit(nogil=True, cache=True, error_model="numpy")
def exchange_of_ends(
    points: Array, edges: NDArray[Any], sides: NDArray[Any], sky: int, first: int, last: int, exchange: Array
) -> None:
    """Add to ``exchange`` (s, s) what lines through the points ``first`` to ``last`` border: L_i F_ij of sides, in two
    halves, (i, j) and (j, i).

    points: (v, 2). edges: (e, 2) their ends, which meet others in their ends only. sides: (e, 2) what is to the left
    and to the right of each, one of the indices of ``exchange``. sky: the index of what is behind all edges.
    """
    count = len(points) - 1
    places = np.zeros(count + 1, np.int64)
    own = np.empty(len(edges), np.int64)
    for v in range(first, last):
        x, y = points[v]
        angles = np.zeros(count + 1)
        for k in range(count + 1):
            if k != v:
                angle = math.atan2(points[k, 1] - y, points[k, 0] - x)
                angles[k] = angle if angle >= 0 else angle + 2 * math.pi
        turns = np.where(angles >= math.pi, angles - math.pi, angles)
        turns[v] = 4.0  # last
        order = np.argsort(turns)
        for rank in range(count):
            k = order[rank]
            places[k] = rank + (count if angles[k] >= math.pi else 0)
        middle, half = np.empty(count), np.empty(count)
        for m in range(count):
            begin = turns[order[m]]
            end = turns[order[m + 1]] if m + 1 < count else turns[order[0]] + math.pi
            middle[m], half[m] = (begin + end) / 2, (end - begin) / 2
        ux, uy = np.cos(middle), np.sin(middle)

        near, met = np.full(2 * count, np.inf), np.full(2 * count, -1)
        meeting = 0
        for e in range(len(edges)):
            a, b = edges[e]
            if a == v or b == v:
                own[meeting] = e
                meeting += 1
                continue
            ax, ay, bx, by = points[a, 0] - x, points[a, 1] - y, points[b, 0] - x, points[b, 1] - y
            area = ax * by - ay * bx
            if area * area <= _EDGE_ON**2 * (ax * ax + ay * ay) * (bx * bx + by * by):
                continue
            place, stop = (places[a], places[b]) if area > 0 else (places[b], places[a])
            while place != stop:
                m, sign = (place, 1.0) if place < count else (place - count, -1.0)
                distance = area / (sign * (ux[m] * (by - ay) - uy[m] * (bx - ax)))
                if 0 < distance < near[place]:
                    near[place], met[place] = distance, e
                place = (place + 1) % (2 * count)

        for m in range(count):
            # The half of the integral of p = y cos - x sin over the angles of this interval.
            share = math.sin(half[m]) * (y * ux[m] - x * uy[m])
            behind, ahead = sky, sky
            if met[m + count] >= 0:
                behind = sides[met[m + count], 1 - _arrived(points, edges[met[m + count]], ux[m], uy[m])]
            if met[m] >= 0:
                ahead = sides[met[m], _arrived(points, edges[met[m]], ux[m], uy[m])]
            for left in (True, False):
                weight, before, farthest = -share if left else share, behind, -2.0
                while True:
                    # The next edge of this end along the line, a little to the left or to the right of it.
                    found, least = -1, 2.0
                    for k in range(meeting):
                        a, b = edges[own[k]]
                        other = b if a == v else a
                        dx, dy = points[other, 0] - x, points[other, 1] - y
                        if (ux[m] * dy - uy[m] * dx > 0) == left:
                            cosine = (ux[m] * dx + uy[m] * dy) / math.sqrt(dx * dx + dy * dy)
                            if farthest < cosine < least:
                                found, least = own[k], cosine
                    if found < 0:
                        break
                    side = _arrived(points, edges[found], ux[m], uy[m])
                    exchange[before, sides[found, side]] += weight
                    before, farthest = sides[found, 1 - side], least
                exchange[before, ahead] += weight


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _arrived(points: Array, edge: NDArray[Any], ux: float, uy: float) -> int:
    """The side of an edge at which a direction arrives: 0 for the left, 1 for the right."""
    dx, dy = points[edge[1], 0] - points[edge[0], 0], points[edge[1], 1] - points[edge[0], 1]
    return 1 if dx * uy - dy * ux > 0 else 0
