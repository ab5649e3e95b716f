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
#: Largest mantissa of a channel.
POWER_LEVELS = (1 << POWER_BITS) - 1
#: Powers that differ only in this number of lowest bits of a channel count as equal: rounding depends on the order of
#: products.
_DUST = np.uint32(4)
_HASH, _MIX_1, _MIX_2 = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB


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


@njit(nogil=True, cache=True)
def _mixed(x: np.uint64) -> np.uint64:
    """Hash of 64 bits."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(_MIX_1)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(_MIX_2)
    return x ^ (x >> np.uint64(31))


@njit(nogil=True, cache=True)
def _share(random: np.uint64, part: int) -> float:
    """One of three numbers in (0, 1) from the bits of ``random``."""
    return (np.float64((random >> np.uint64(21 * part)) & np.uint64((1 << 21) - 1)) + 0.5) * 2.0**-21


@njit(nogil=True, cache=True, error_model="numpy")
def _flux_code(red: float, green: float, blue: float, random: np.uint64) -> int:
    """Exponent and three mantissas of a flux as one code; -1 if it has none. A mantissa is rounded up with the
    probability of its fraction, so that sums are right on average."""
    largest = max(red, green, blue)
    if not (red >= 0.0 and green >= 0.0 and blue >= 0.0 and largest < np.inf):
        return -1
    if largest < 2.0**-120:
        return 0 if largest == 0.0 else -1
    _, exponent = math.frexp(largest)  # largest < 2^exponent
    scale = math.ldexp(1.0, POWER_BITS - exponent)
    if largest * scale > POWER_LEVELS:  # may be rounded up to the next power of two
        exponent += 1
        scale *= 0.5
    code = exponent + 126
    code = (code << POWER_BITS) | int(red * scale + _share(random, 0))
    code = (code << POWER_BITS) | int(green * scale + _share(random, 1))
    return (code << POWER_BITS) | int(blue * scale + _share(random, 2))


@njit(nogil=True, cache=True, error_model="numpy")
def power_codes(rows: Rows, floats: Floats, keys: Codes, codes: Codes) -> bool:
    """Write the codes of powers; returns whether all powers have one. Rounding uses a hash of place, path and bounce,
    so that the same particles have the same codes."""
    for r in range(len(rows)):
        own = (np.uint64(rows[r, PATH]) << np.uint64(32)) | np.uint64(rows[r, BOUNCE])
        random = _mixed(_mixed(own + np.uint64(_HASH)) + keys[r])
        code = _flux_code(
            np.float64(floats[r, POWER]), np.float64(floats[r, POWER + 1]), np.float64(floats[r, POWER + 2]), random
        )
        if code < 0:
            return False
        codes[r] = code
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def gathered(rows: Rows, order: Words, part: Rows) -> None:
    """Copy the rows in ``order``: a separate loop before packing, so that the waits for memory overlap."""
    for i in range(len(order)):
        r = order[i]
        for c in range(rows.shape[1]):
            part[i, c] = rows[r, c]


@njit(nogil=True, cache=True, error_model="numpy")
def pack(
    rows: Rows, floats: Floats, keys: Codes, frames: Floats, bits: Bytes, bound: float,
    directions: Words, paths: Words, bounces: Words, box: Doubles, flux: Doubles,
) -> bool:  # fmt: skip
    """Direction codes, paths and bounces of rows, their bounding box (6,) and the sum of their power (3,).

    Returns whether their positions follow from frames within ``bound``."""
    framed = True
    box[:3], box[3:], flux[:] = np.inf, -np.inf, 0.0
    for r in range(len(rows)):  # rows and frames are read by two indices, because views of rows cost time
        paths[r], bounces[r] = rows[r, PATH], rows[r, BOUNCE]
        directions[r] = _octahedral(floats[r, DIRECTION], floats[r, DIRECTION + 1], floats[r, DIRECTION + 2])
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
                there = np.float32(frames[number, c] + u * frames[number, 3 + c] + v * frames[number, 6 + c])
                x = np.float64(there) - np.float64(floats[r, c])
                error += x * x
            framed &= error <= bound * bound
        else:
            framed = False
    return framed


@njit(nogil=True, cache=True, error_model="numpy")
def place(
    numbers: Index, counts: Index, codes: Words, shapes: Words, primitives: Words, bits: Bytes, shape_bits: Bytes,
    frames: Floats, with_frames: bool, rows: Rows, floats: Floats,
) -> None:  # fmt: skip
    """Write shape, primitive, uv and, with frames, position of the rows of runs; ``shapes`` and ``primitives`` have one
    entry for each run."""
    i = 0
    for run in range(len(counts)):
        number = numbers[run]
        own = np.int64(bits[number]) if number < len(bits) else np.int64(shape_bits[shapes[run]])
        step = 1.0 / (1 << own)
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
    """Write the directions of the codes in three planes."""
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
def palette(rows: Rows, index: Words, table: Words, slots: NDArray[np.int32]) -> int:
    """Number the distinct powers of rows in the order of their first occurrence: writes the number of each row to
    ``index``, the first occurrences to ``table`` (m, 3). Powers that differ by less than 2e-6 of each channel may share
    a number. Returns the count of numbers; -1 if ``table`` is too short. ``slots``: work space, a power of two."""
    slots[:] = -1
    mask, found = np.uint64(len(slots) - 1), 0
    for i in range(len(rows)):
        a, b, c = rows[i, POWER] >> _DUST, rows[i, POWER + 1] >> _DUST, rows[i, POWER + 2] >> _DUST
        mixed = (((np.uint64(a) * np.uint64(_HASH)) ^ np.uint64(b)) * np.uint64(_MIX_1)) ^ np.uint64(c)
        slot = np.int64(((mixed * np.uint64(_MIX_2)) >> np.uint64(40)) & mask)
        while True:
            known = slots[slot]
            if known < 0:
                if found == len(table):
                    return -1
                slots[slot], known = found, found
                for channel in range(3):
                    table[found, channel] = rows[i, POWER + channel]
                found += 1
                break
            if table[known, 0] >> _DUST == a and table[known, 1] >> _DUST == b and table[known, 2] >> _DUST == c:
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
