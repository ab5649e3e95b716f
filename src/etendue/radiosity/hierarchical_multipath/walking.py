"""Loops compiled by Numba that exchange power along stretches of lines, past copies in their boxes.

Arrays of power (n + 2 + regions, c) have a row for each end of a stretch: patches of a part, the sky, dark, regions of
the part's own box. ``values`` is the power that each end sends along every line. An end also sends ``unshot``, the
reflected power from its last line; the power that it receives now then replaces ``unshot``, as in Multipath.
"""

from __future__ import annotations

from typing import Any

from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def exchange(ends: Any, reflectance: Any, values: Any, unshot: Any, sums: Any) -> None:
    """Exchange power along stretches without crossings, in order. Adds the received power to ``sums``, and changes
    ``unshot``."""
    for k in range(len(ends)):
        i, j = ends[k, 0], ends[k, 1]
        for c in range(values.shape[1]):
            to_j = values[i, c] + unshot[i, c]
            unshot[i, c] = 0.0  # a patch that is not flat may see itself
            to_i = values[j, c] + unshot[j, c]
            unshot[j, c] = 0.0
            unshot[i, c] += to_i * reflectance[i, c]
            unshot[j, c] += to_j * reflectance[j, c]
            sums[i, c] += to_i
            sums[j, c] += to_j


@njit(nogil=True, cache=True, error_model="numpy")
def walk(
    ends: Any,
    begins: Any,
    crossings: Any,
    transmittance: Any,
    outgoing: Any,
    incoming: Any,
    regions_from: Any,
    reflectance: Any,
    values: Any,
    unshot: Any,
    sums: Any,
) -> None:
    """:func:`exchange` along stretches that cross copies.

    Of power P that arrives at a region of transmittance T of a copy, (1 - T) P is kept in ``incoming`` (children *
    regions, c), for the lines in the copy that hit something. T P continues, plus the power per line ``outgoing`` of
    the region where the line leaves the copy [Castro 2002, sec. 5.3.6, made to conserve energy].
    """
    for k in range(len(ends)):
        i, j = ends[k, 0], ends[k, 1]
        begin, end = begins[k], begins[k + 1]
        is_through = i >= regions_from and j >= regions_from
        for c in range(values.shape[1]):
            to_j = values[i, c] + unshot[i, c]
            unshot[i, c] = 0.0
            to_i = values[j, c] + unshot[j, c]
            unshot[j, c] = 0.0
            # Light that goes straight through the part was already sent on by the part around it: it must not arrive
            # twice.
            straight_j, straight_i = (to_j, to_i) if is_through else (0.0, 0.0)
            for x in range(begin, end):
                a, b = crossings[x, 0], crossings[x, 1]
                t = transmittance[a]
                incoming[a, c] += (1 - t) * to_j
                to_j = t * to_j + outgoing[b, c]
                straight_j *= t
            for x in range(end - 1, begin - 1, -1):
                a, b = crossings[x, 1], crossings[x, 0]
                t = transmittance[a]
                incoming[a, c] += (1 - t) * to_i
                to_i = t * to_i + outgoing[b, c]
                straight_i *= t
            to_j -= straight_j
            to_i -= straight_i
            unshot[i, c] += to_i * reflectance[i, c]
            unshot[j, c] += to_j * reflectance[j, c]
            sums[i, c] += to_i
            sums[j, c] += to_j
