"""Loops that pack and unpack the fields of particles, compiled for the CPU by Numba; they release Python's lock."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..particles import Rows

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint32]
Codes = NDArray[np.uint64]
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Index = NDArray[np.int64]

#: Columns of :data:`Rows`.
POSITION, DIRECTION, POWER, SHAPE, PRIMITIVE, UV, PATH, BOUNCE = 0, 3, 6, 9, 10, 11, 13, 14
#: Bits of a component of an octahedral direction, and of a channel of power.
DIRECTION_BITS, POWER_BITS = 12, 10
#: Largest component of the code of a direction.
DIRECTION_LEVELS = _LARGEST = (1 << DIRECTION_BITS) - 1
_HASH = 0x9E3779B97F4A7C15


@njit(nogil=True, cache=True)
def _gathered(x: int) -> int:
    """Inverse of :func:`_spread`."""
    x &= 0x55555555
    x = (x | (x >> 1)) & 0x33333333
    x = (x | (x >> 2)) & 0x0F0F0F0F
    x = (x | (x >> 4)) & 0x00FF00FF
    return (x | (x >> 8)) & 0x0000FFFF


@njit(nogil=True, cache=True, error_model="numpy")
def _octahedral(x: float, y: float, z: float) -> int:
    """Code of a direction on the unfolded octahedron [Meyer 2010]."""
    size = abs(x) + abs(y) + abs(z)
    if not size > 0.0:
        return 0
    u, v = x / size, y / size
    if z < 0.0:
        u, v = (1.0 - abs(v)) * (1.0 if u >= 0 else -1.0), (1.0 - abs(u)) * (1.0 if v >= 0 else -1.0)
    a = min(max(int((0.5 * u + 0.5) * _LARGEST + 0.5), 0), _LARGEST)
    b = min(max(int((0.5 * v + 0.5) * _LARGEST + 0.5), 0), _LARGEST)
    return a | (b << DIRECTION_BITS)


@njit(nogil=True, cache=True, error_model="numpy")
def _flux_code(red: float, green: float, blue: float) -> int:
    """Exponent and three mantissas of a flux; -1 if it has none."""
    largest = max(red, green, blue)
    if not (red >= 0.0 and green >= 0.0 and blue >= 0.0 and largest < np.inf):
        return -1
    if largest < 2.0**-120:
        return 0 if largest == 0.0 else -1
    _, exponent = math.frexp(largest)  # largest < 2^exponent
    scale = math.ldexp(1.0, POWER_BITS - exponent)
    if int(largest * scale + 0.5) >> POWER_BITS:  # rounded up to the next power of two
        exponent += 1
        scale *= 0.5
    code = exponent + 126
    code = (code << POWER_BITS) | int(red * scale + 0.5)
    code = (code << POWER_BITS) | int(green * scale + 0.5)
    return (code << POWER_BITS) | int(blue * scale + 0.5)


@njit(nogil=True, cache=True, error_model="numpy")
def gathered(rows: Rows, order: Words, part: Rows) -> None:
    """Copy the rows in ``order``. Done before they are packed, the waits for memory overlap."""
    for i in range(len(order)):
        r = order[i]
        for c in range(rows.shape[1]):
            part[i, c] = rows[r, c]


@njit(nogil=True, cache=True, error_model="numpy")
def pack(
    rows: Rows, floats: Floats, keys: Codes, frames: Floats, bits: Bytes, bound: float,
    directions: Words, powers: Codes, paths: Words, bounces: Words, box: Doubles, flux: Doubles,
) -> tuple[bool, bool]:  # fmt: skip
    """Direction and power codes, paths and bounces of rows, their bounding box (6,) and the sum of their power (3,).

    Returns (whether their positions follow from frames within ``bound``, whether their powers have codes)."""
    framed, coded = True, True
    box[:3], box[3:], flux[:] = np.inf, -np.inf, 0.0
    for r in range(len(rows)):  # rows and frames are read by two indices, because views of rows cost time
        paths[r], bounces[r] = rows[r, PATH], rows[r, BOUNCE]
        directions[r] = _octahedral(floats[r, DIRECTION], floats[r, DIRECTION + 1], floats[r, DIRECTION + 2])
        code = _flux_code(floats[r, POWER], floats[r, POWER + 1], floats[r, POWER + 2])
        coded &= code >= 0
        powers[r] = code
        for c in range(3):
            x = np.float64(floats[r, c])
            box[c], box[3 + c] = min(box[c], x), max(box[3 + c], x)
            flux[c] += floats[r, POWER + c]
        number = np.int64(keys[r] >> np.uint64(32))
        if framed and number < len(frames):
            step = 1.0 / (1 << np.int64(bits[number]))
            low = np.int64(keys[r] & np.uint64(0xFFFFFFFF))
            u, v = (_gathered(low) + 0.5) * step, (_gathered(low >> 1) + 0.5) * step
            error = 0.0
            for c in range(3):
                x = frames[number, c] + u * frames[number, 3 + c] + v * frames[number, 6 + c] - floats[r, c]
                error += x * x
            framed &= error <= bound * bound
        else:
            framed = False
    return framed, coded


@njit(nogil=True, cache=True, error_model="numpy")
def place(
    numbers: Index, counts: Index, codes: Words, shapes: Words, primitives: Words, bits: Bytes, frames: Floats,
    with_frames: bool, rows: Rows, floats: Floats,
) -> None:  # fmt: skip
    """Write shape, primitive, uv and, with frames, position of the rows of runs; ``shapes``, ``primitives``: of each
    run."""
    i = 0
    for run in range(len(counts)):
        number = numbers[run]
        step = 1.0 / (1 << np.int64(bits[number]))
        for _ in range(counts[run]):
            low = np.int64(codes[i])
            u, v = (_gathered(low) + 0.5) * step, (_gathered(low >> 1) + 0.5) * step
            rows[i, SHAPE], rows[i, PRIMITIVE] = shapes[run], primitives[run]
            floats[i, UV], floats[i, UV + 1] = u, v
            if with_frames:
                for c in range(3):
                    floats[i, c] = frames[number, c] + u * frames[number, 3 + c] + v * frames[number, 6 + c]
            i += 1


@njit(nogil=True, cache=True, error_model="numpy")
def unpack_directions(low: Bytes, first: Bytes, second: Bytes, floats: Floats) -> None:
    """Write the directions of codes in three planes."""
    for i in range(len(low)):
        a = (np.int64(first[i]) << 4) | (np.int64(low[i]) & 15)
        b = (np.int64(second[i]) << 4) | (np.int64(low[i]) >> 4)
        u, v = 2.0 * a / _LARGEST - 1.0, 2.0 * b / _LARGEST - 1.0
        z = 1.0 - abs(u) - abs(v)
        if z < 0.0:
            u, v = (1.0 - abs(v)) * (1.0 if u >= 0 else -1.0), (1.0 - abs(u)) * (1.0 if v >= 0 else -1.0)
        size = 1.0 / np.sqrt(u * u + v * v + z * z)
        floats[i, DIRECTION] = u * size
        floats[i, DIRECTION + 1] = v * size
        floats[i, DIRECTION + 2] = z * size


@njit(nogil=True, cache=True)
def direction_planes(codes: Words, low: Bytes, first: Bytes, second: Bytes) -> None:
    """Inverse of :func:`unpack_directions`: high bytes of both components, and their low nibbles."""
    for i in range(len(codes)):
        a, b = codes[i] & np.uint32(_LARGEST), codes[i] >> np.uint32(DIRECTION_BITS)
        low[i] = (a & np.uint32(15)) | ((b & np.uint32(15)) << np.uint32(4))
        first[i] = a >> np.uint32(4)
        second[i] = b >> np.uint32(4)


@njit(nogil=True, cache=True, error_model="numpy")
def unpack_powers(codes: Codes, floats: Floats) -> None:
    """Write the powers of codes."""
    mask = np.uint64((1 << POWER_BITS) - 1)
    for i in range(len(codes)):
        code = codes[i]
        exponent = np.int64(code >> np.uint64(3 * POWER_BITS)) - 126
        scale = math.ldexp(1.0, int(exponent - POWER_BITS)) if code else 0.0
        floats[i, POWER] = np.float64((code >> np.uint64(2 * POWER_BITS)) & mask) * scale
        floats[i, POWER + 1] = np.float64((code >> np.uint64(POWER_BITS)) & mask) * scale
        floats[i, POWER + 2] = np.float64(code & mask) * scale


@njit(nogil=True, cache=True)
def palette(codes: Codes, index: Words, table: Codes, slots: NDArray[np.int32]) -> int:
    """Number the distinct codes in the order of their first occurrence: the number of each to ``index``, the codes to
    ``table``. Returns how many there are; -1 if ``table`` is too short. ``slots``: work space, a power of two."""
    slots[:] = -1
    mask, found = np.uint64(len(slots) - 1), 0
    for i in range(len(codes)):
        code = codes[i]
        slot = np.int64(((code * np.uint64(_HASH)) >> np.uint64(40)) & mask)
        while True:
            known = slots[slot]
            if known < 0:
                if found == len(table):
                    return -1
                slots[slot], table[found], known = found, code, found
                found += 1
                break
            if table[known] == code:
                break
            slot = np.int64(np.uint64(slot + 1) & mask)
        index[i] = known
    return found


@njit(nogil=True, cache=True)
def entropy_counts(data: Bytes, counts: Index, every: int) -> None:
    """Count the values of every n-th byte."""
    counts[:] = 0
    for i in range(0, len(data), every):
        counts[data[i]] += 1
