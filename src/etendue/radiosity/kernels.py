"""Loops compiled for the CPU by Numba: over stored segments, and of solvers.

Only this file, ``scanlines``, files behind ``factors.exchange`` and of ``hierarchical_multipath`` use Numba. Their
functions release Python's lock, so that threads run in parallel. Results do not depend on the number of threads, except
for the order of additions.

A *segment* is a pair of patch indices, or a patch index and ``n`` for the sky, ``n + 1`` for dark (the back of a face).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array

Pairs = NDArray[np.uint32]
#: Indices of a sparse matrix.
Index = NDArray[np.int32] | NDArray[np.int64]


@njit(nogil=True, cache=True, error_model="numpy")
def gather(pairs: Pairs, values: Array, sums: Array) -> None:
    """For each segment, add the ``values`` (n + 2, c) of each end to the ``sums`` (n + 2, c) of the other end."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        for c in range(values.shape[1]):
            sums[i, c] += values[j, c]
            sums[j, c] += values[i, c]


@njit(nogil=True, cache=True, error_model="numpy")
def gather_one(pairs: Pairs, values: Array, sums: Array) -> None:
    """:func:`gather` for one channel, (n + 2,)."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        sums[i] += values[j]
        sums[j] += values[i]


@njit(nogil=True, cache=True, error_model="numpy")
def count_ends(pairs: Pairs, counts: NDArray[np.int64]) -> None:
    """Add to ``counts`` (n + 2, 3) of each end: all segments, segments to the sky, and segments to dark."""
    sky = len(counts) - 2
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        counts[i, 0] += 1
        counts[j, 0] += 1
        if i >= sky:
            counts[j, 1 + i - sky] += 1
        if j >= sky:
            counts[i, 1 + j - sky] += 1


@njit(nogil=True, cache=True, error_model="numpy")
def count_parts(pairs: Pairs, ends: Index, near: Index, far: Index, counts: Array) -> None:
    """Add to ``counts`` (n, parts) the segments of each patch that lead to the sky, by the part of the sky.

    ends: (b,) the index behind the last segment of each bundle; near, far: (b,) the part from which its lines come, and
    the part to which they go.
    """
    sky, k = len(counts), 0
    for b in range(len(ends)):
        while k < ends[b]:
            i, j = pairs[k, 0], pairs[k, 1]
            if i == sky and j < sky:
                counts[j, near[b]] += 1
            elif j == sky and i < sky:
                counts[i, far[b]] += 1
            k += 1


@njit(nogil=True, cache=True, error_model="numpy")
def count_rows(pairs: Pairs, patches: int, rows: Index) -> None:
    """Add to ``rows[i]`` (n,) the number of segments between patches whose smaller index is i."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if i < patches and j < patches:
            rows[min(i, j)] += 1


@njit(nogil=True, cache=True, error_model="numpy")
def fill_rows(pairs: Pairs, patches: int, ends: Index, columns: Index) -> None:
    """Write the larger patch index of each of these segments to its row of ``columns``, at the positions ``ends``."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if i < patches and j < patches:
            row = min(i, j)
            columns[ends[row]] = max(i, j)
            ends[row] += 1


@njit(nogil=True, cache=True, error_model="numpy")
def merge_rows(
    begin: Index, columns: Pairs, counts: Array, starts: Index, more: Pairs
) -> tuple[NDArray[np.int64], Pairs, Array]:
    """Rows of unique ``columns`` with their ``counts``, from ``begin`` (n + 1,), and with ``more`` columns, from
    ``starts`` (n + 1,), each of which counts one: the new row starts, columns and counts."""
    patches = len(begin) - 1
    made_begin = np.zeros(patches + 1, np.int64)
    made_columns = np.empty(len(columns) + len(more), np.uint32)
    made_counts = np.empty(len(columns) + len(more), np.float64)
    where = np.full(patches, -1, np.int64)
    made = 0
    for row in range(patches):
        first = made
        for k in range(begin[row], begin[row + 1]):
            where[columns[k]] = made
            made_columns[made], made_counts[made] = columns[k], counts[k]
            made += 1
        for k in range(starts[row], starts[row + 1]):
            column = more[k]
            if where[column] >= first:
                made_counts[where[column]] += 1
            else:
                where[column] = made
                made_columns[made], made_counts[made] = column, 1
                made += 1
        made_begin[row + 1] = made
    return made_begin, made_columns[:made].copy(), made_counts[:made].copy()


@njit(nogil=True, cache=True, error_model="numpy")
def multipath(pairs: Pairs, reflectance: Array, per_line: Array, unshot: Array, received: Array) -> None:
    """Exchange power along segments one after the other [Sbert 1996]; arrays (n + 2, c), the last two changed.

    Each end sends its unshot power and its own power per line; the part that the other end reflects replaces the unshot
    power of that end. Sky and dark must have reflectance zero.
    """
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        for c in range(reflectance.shape[1]):
            to_j = unshot[i, c] + per_line[i, c]
            to_i = unshot[j, c] + per_line[j, c]
            received[i, c] += to_i
            received[j, c] += to_j
            unshot[i, c] = to_i * reflectance[i, c]
            unshot[j, c] = to_j * reflectance[j, c]


@njit(nogil=True, cache=True, error_model="numpy")
def gauss_seidel(
    starts: Index, columns: Index, data: Array, reflectance: Array, known: Array, radiosity: Array
) -> None:
    """One sweep over a CSR matrix F: each row of ``radiosity`` (n, c) in turn becomes ``known + reflectance F B``."""
    sums = np.empty(radiosity.shape[1])
    for i in range(len(radiosity)):
        sums[:] = 0.0
        own = 0.0
        for k in range(starts[i], starts[i + 1]):
            if columns[k] == i:
                own = data[k]
            else:
                for c in range(len(sums)):
                    sums[c] += data[k] * radiosity[columns[k], c]
        for c in range(len(sums)):
            radiosity[i, c] = (known[i, c] + reflectance[i, c] * sums[c]) / (1 - reflectance[i, c] * own)


@njit(nogil=True, cache=True, error_model="numpy")
def shoot(
    starts: Index,
    rows: Index,
    data: Array,
    areas: Array,
    reflectance: Array,
    unshot: Array,
    radiosity: Array,
    steps: int,
) -> None:
    """Steps of progressive refinement over the columns (CSC) of F: the patch with the most unshot power distributes it
    to all others [Cohen 1988]. ``unshot``, ``radiosity`` (n, c) are changed."""
    power = np.empty(len(areas))
    for i in range(len(areas)):
        power[i] = areas[i] * unshot[i].sum()
    sent = np.empty(unshot.shape[1])
    for _ in range(steps):
        shooter = np.argmax(power)
        sent[:] = unshot[shooter]
        unshot[shooter] = 0.0
        power[shooter] = 0.0
        for k in range(starts[shooter], starts[shooter + 1]):
            i = rows[k]
            gained = 0.0
            for c in range(len(sent)):
                more = reflectance[i, c] * data[k] * sent[c]
                radiosity[i, c] += more
                unshot[i, c] += more
                gained += more
            power[i] += areas[i] * gained
