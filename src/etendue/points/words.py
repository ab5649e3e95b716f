"""Operations that differ between device arrays and NumPy arrays.

An *index* is a ``UInt32`` array of Dr.Jit or a one-dimensional ``uint32`` array of NumPy; both wrap modulo 2^32.
"""

from __future__ import annotations

from typing import TypeAlias

import drjit as dr
import numpy as np
from numpy.typing import NDArray

#: 32-bit words: a ``UInt32`` array of Dr.Jit, or a ``uint32`` array of NumPy.
Words: TypeAlias = "dr.ArrayBase | NDArray[np.uint32]"
#: Numbers in [0, 1): a ``Float`` array of Dr.Jit, or a ``float64`` array of NumPy.
Numbers: TypeAlias = "dr.ArrayBase | NDArray[np.float64]"

#: The largest numbers below 1 in the precision of the device and of NumPy.
BELOW_ONE_32 = 1.0 - 2.0**-24
BELOW_ONE_64 = 1.0 - 2.0**-53


def is_host(x: object) -> bool:
    """Whether ``x`` is a NumPy array."""
    return isinstance(x, np.ndarray)


def reverse_bits(x: Words) -> Words:
    """The 32 bits of each word in reverse order."""
    if not is_host(x):
        return dr.brev(x)
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        x = ((x >> shift) & mask) | ((x & mask) << shift)
    return (x >> 16) | (x << 16)


def high_product(x: Words, factor: int) -> Words:
    """The upper 32 bits of the 64-bit product of each word and ``factor``."""
    if is_host(x):
        return ((x.astype(np.uint64) * np.uint64(factor)) >> np.uint64(32)).astype(np.uint32)
    return dr.mul_hi(x, type(x)(factor))


def unit(bits: Words) -> Numbers:
    """Words as numbers in [0, 1): with all 32 bits in NumPy's doubles, with the upper 24 in a ``Float``."""
    if is_host(bits):
        return bits * 2.0**-32
    return dr.float32_array_t(type(bits))(bits >> 8) * 2.0**-24


def doubles(bits: dr.ArrayBase) -> dr.ArrayBase:
    """Words of the device as ``Float64`` in [0, 1), with all bits."""
    return dr.float64_array_t(type(bits))(bits) * 2.0**-32


def below_one(x: Numbers) -> Numbers:
    """``x``, limited to the largest number below 1, against rounding."""
    return np.minimum(x, BELOW_ONE_64) if is_host(x) else dr.minimum(x, BELOW_ONE_32)


class Keys:
    """The words of a randomisation; opaque on the device, so that all seeds share kernels."""

    def __init__(self) -> None:
        self._device: dict[tuple[type, int], dr.ArrayBase] = {}

    def like(self, index: Words, word: int) -> Words:
        """``word`` as an operand for ``index``."""
        if is_host(index):
            return np.uint32(word)
        name = type(index), word
        if name not in self._device:
            self._device[name] = dr.opaque(type(index), word)
        return self._device[name]
