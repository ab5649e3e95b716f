"""Loops that sort particles by surface and code their places, compiled by Numba; they release Python's lock.

A primitive has a number (:class:`Surfaces`); its parameters u and v are quantised to a number of bits each, and
interleaved to a Morton code. Sorted particles have the key ``number << 32 | code``.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..particles import Rows

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint32]
Codes = NDArray[np.uint64]
Floats = NDArray[np.float32]
Index = NDArray[np.int64]

#: Columns of :data:`Rows`.
SHAPE, PRIMITIVE, UV = 9, 10, 11
#: Blocks of ``BLOCK`` gaps share the parameter of the Rice code; gaps with quotients from ``_ESCAPE`` on are written
#: plainly.
BLOCK, _ESCAPE = 64, 20
_DIGIT = 8


@njit(nogil=True, cache=True)
def _spread(x: int) -> int:
    """The low 16 bits of x at the even places."""
    x = (x | (x << 8)) & 0x00FF00FF
    x = (x | (x << 4)) & 0x0F0F0F0F
    x = (x | (x << 2)) & 0x33333333
    return (x | (x << 1)) & 0x55555555


@njit(nogil=True, cache=True, error_model="numpy")
def _quantised(x: float, bits: int) -> int:
    size = 1 << bits
    if not x > 0.0:
        return 0
    return min(int(x * size), size - 1)


@njit(nogil=True, cache=True, error_model="numpy")
def keys_of(
    rows: Rows, floats: Floats, first: Index, primitives: Index, bits: Bytes, shape_bits: Bytes, keys: Codes
) -> bool:
    """Write the key of each row; returns whether all shapes and primitives exist. ``bits``: of the primitives with
    frames, which come first; ``shape_bits``: of the other primitives, by shape."""
    shapes = len(first)
    for i in range(len(rows)):
        shape, primitive = np.int64(rows[i, SHAPE]), np.int64(rows[i, PRIMITIVE])
        if shape >= shapes or primitive >= primitives[shape]:
            return False
        number = first[shape] + primitive
        b = np.int64(bits[number]) if number < len(bits) else np.int64(shape_bits[shape])
        u = _quantised(floats[i, UV], b)
        v = _quantised(floats[i, UV + 1], b)
        keys[i] = (np.uint64(number) << np.uint64(32)) | np.uint64(_spread(u) | (_spread(v) << 1))
    return True


@njit(nogil=True, cache=True)
def sorted_by(keys: Codes, order: Words) -> None:
    """Sort ``keys``, and write the stable order; a radix sort that skips the digits that all keys share."""
    n = len(keys)
    digits, size = -(-64 // _DIGIT), 1 << _DIGIT
    mask = np.uint64(size - 1)
    counts = np.zeros((digits, size), np.int64)
    for i in range(n):
        key = keys[i]
        order[i] = i
        for d in range(digits):
            counts[d, key & mask] += 1
            key >>= np.uint64(_DIGIT)
    a, oa, b, ob = keys, order, np.empty(n, np.uint64), np.empty(n, np.uint32)
    swapped = False
    for d in range(digits):
        shift = np.uint64(d * _DIGIT)
        if counts[d, (keys[0] >> shift) & mask] == n:
            continue
        total = 0
        for value in range(size):
            count = counts[d, value]
            counts[d, value] = total
            total += count
        for i in range(n):
            key = a[i]
            value = (key >> shift) & mask
            place = counts[d, value]
            counts[d, value] = place + 1
            b[place] = key
            ob[place] = oa[i]
        a, oa, b, ob = b, ob, a, oa
        swapped = not swapped
    if swapped:
        for i in range(n):
            keys[i] = a[i]
            order[i] = oa[i]


@njit(nogil=True, cache=True)
def runs_of(keys: Codes, numbers: Index, counts: Index) -> int:
    """Write number and count of each run of particles on one primitive; returns the number of runs."""
    runs = 0
    before = np.int64(-1)
    for i in range(len(keys)):
        number = np.int64(keys[i] >> np.uint64(32))
        if number != before:
            numbers[runs], counts[runs] = number, 0
            runs += 1
            before = number
        counts[runs - 1] += 1
    return runs


@njit(nogil=True, cache=True)
def gaps_of(keys: Codes, counts: Index, gaps: Codes) -> None:
    """Write the differences of neighbouring codes within each run; the first code of a run is its own gap."""
    i = 0
    for run in range(len(counts)):
        before = np.uint64(0)
        for _ in range(counts[run]):
            code = keys[i] & np.uint64(0xFFFFFFFF)
            gaps[i] = code - before
            before = code
            i += 1


@njit(nogil=True, cache=True)
def rice(gaps: Codes, out: Bytes) -> int:
    """Write Rice codes of numbers below 2^32; the byte before a block is its parameter. Returns the number of bytes."""
    n, place = len(gaps), 0
    acc, held = np.uint64(0), 0
    one = np.uint64(1)
    for start in range(0, n, BLOCK):
        end = min(start + BLOCK, n)
        total = np.uint64(0)
        for i in range(start, end):
            total += gaps[i]
        mean, k = total // np.uint64(end - start), 0
        while k < 31 and (one << np.uint64(k + 1)) <= mean + one:
            k += 1
        acc |= np.uint64(k) << np.uint64(held)
        held += 8
        for i in range(start, end):
            gap = gaps[i]
            quotient = int(gap >> np.uint64(k))
            width = 32
            if quotient < _ESCAPE:
                acc |= ((one << np.uint64(quotient)) - one) << np.uint64(held)
                held += quotient + 1
                low, width = gap & ((one << np.uint64(k)) - one), k
            else:
                acc |= ((one << np.uint64(_ESCAPE)) - one) << np.uint64(held)
                held += _ESCAPE
                low = gap
            while held >= 8:
                out[place] = acc & np.uint64(255)
                acc >>= np.uint64(8)
                held -= 8
                place += 1
            acc |= low << np.uint64(held)
            held += width
            while held >= 8:
                out[place] = acc & np.uint64(255)
                acc >>= np.uint64(8)
                held -= 8
                place += 1
    if held > 0:
        out[place] = acc & np.uint64(255)
        place += 1
    return place


@njit(nogil=True, cache=True)
def unrice(data: Bytes, gaps: Codes) -> bool:
    """Inverse of :func:`rice`; ``False`` if the data end too early."""
    n, place = len(gaps), 0
    acc, held = np.uint64(0), 0
    one = np.uint64(1)
    k = 0
    for i in range(n):
        while held <= 56 and place < len(data):
            acc |= np.uint64(data[place]) << np.uint64(held)
            held += 8
            place += 1
        if i % BLOCK == 0:
            k = int(acc & np.uint64(255))
            acc >>= np.uint64(8)
            held -= 8
            if k > 31:
                return False
        quotient = 0
        while quotient < _ESCAPE and acc & one:
            acc >>= one
            quotient += 1
        if quotient < _ESCAPE:
            acc >>= one
            held -= quotient + 1
        else:
            held -= _ESCAPE
        while held <= 56 and place < len(data):
            acc |= np.uint64(data[place]) << np.uint64(held)
            held += 8
            place += 1
        width = k if quotient < _ESCAPE else 32
        low = acc & ((one << np.uint64(width)) - one)
        acc >>= np.uint64(width)
        held -= width
        if held < 0:
            return False
        gaps[i] = low if quotient >= _ESCAPE else (np.uint64(quotient) << np.uint64(k)) | low
    return True


@njit(nogil=True, cache=True)
def merged_gaps(counts: Index, gaps: Codes, codes: Words) -> bool:
    """Inverse of :func:`gaps_of`; ``False`` if the runs and the gaps have different numbers of particles."""
    i = 0
    for run in range(len(counts)):
        code = np.uint64(0)
        if i + counts[run] > len(gaps) or counts[run] < 0:
            return False
        for _ in range(counts[run]):
            code += gaps[i]
            codes[i] = code
            i += 1
    return i == len(gaps)
