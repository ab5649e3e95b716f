"""Random numbers as a function of (seed, role, iteration, lane, dimension).

Transport code requests each number by its dimension (a vertex and a component of the vertex), so that other samplers
(point sequences, Markov chains) can replace independent numbers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import drjit as dr
import numpy as np

if TYPE_CHECKING:
    import mitsuba as mi
    from numpy.typing import NDArray

_MASK = 0xFFFFFFFF
#: Dimensions reserved for one vertex; a component is an index below this.
COMPONENTS_PER_VERTEX = 64


class SampleSource(Protocol):
    """Numbers in [0, 1) for the lanes of one kernel."""

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """One number for ``component`` of ``vertex``; the same arguments give the same number."""
        ...

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """Two numbers, for components ``component`` and ``component + 1``."""
        ...

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """One number for a binary decision such as roulette, which does not need stratification."""
        ...


def seed_key(seed: int, role: str, iteration: int) -> tuple[int, int]:
    """Two 32-bit words from (seed, role, iteration), by TEA; computed on the host."""
    role_word = 0
    for byte in role.encode():
        role_word = (role_word * 31 + byte) & _MASK
    a, b = _tea(seed & _MASK, (seed >> 32) ^ role_word)
    return _tea(a ^ (iteration & _MASK), b ^ (iteration >> 32))


def _tea(v0: int, v1: int, rounds: int = 8) -> tuple[int, int]:
    """Tiny Encryption Algorithm on two 32-bit words [Zafar 2010]."""
    total = 0
    for _ in range(rounds):
        total = (total + 0x9E3779B9) & _MASK
        v0 = (v0 + (((v1 << 4) + 0xA341316C) ^ (v1 + total) ^ ((v1 >> 5) + 0xC8013EA4))) & _MASK
        v1 = (v1 + (((v0 << 4) + 0xAD90777D) ^ (v0 + total) ^ ((v0 >> 5) + 0x7E95761E))) & _MASK
    return v0, v1


def hash_mix(x: mi.UInt32 | NDArray[np.uint32]) -> mi.UInt32 | NDArray[np.uint32]:
    """Bijective 32-bit integer mixer with low bias (two multiplications)."""
    x = x ^ (x >> 16)
    x = x * 0x21F0AAAD
    x = x ^ (x >> 15)
    x = x * 0x735A2D97
    return x ^ (x >> 15)


def to_unit_float(bits: mi.UInt32) -> mi.Float:
    """The upper 23 bits of a 32-bit word as a float in [0, 1)."""
    float_type = dr.float32_array_t(type(bits))
    return dr.reinterpret_array(float_type, (bits >> 9) | 0x3F800000) - 1.0


def keyed_bits(key0: mi.UInt32, key1: mi.UInt32, word: mi.UInt32) -> mi.UInt32:
    """32 random bits for ``word`` under a key of 64 bits, whose two words are already mixed."""
    x = key0 + word * 0x9E3779B9
    x = x ^ (x >> 16)
    x = x * 0x21F0AAAD
    x = (x ^ (x >> 15)) + key1
    x = x * 0x735A2D97
    x = x ^ (x >> 15)
    x = x * 0x9E3779B1
    return x ^ (x >> 16)


class IndependentSource:
    """Independent numbers by hashing a 64-bit key of the lane and the dimension; without loop state.

    ``lane``: one entry per path; ``high``: upper words of lane numbers above 2^32. ``seed``, ``role`` and ``iteration``
    are opaque scalars in kernels, so that all passes share the kernels.
    """

    DRJIT_STRUCT: ClassVar = {"_key0": object, "_key1": object}

    def __init__(self, lane: mi.UInt32, seed: int, role: str, iteration: int, high: mi.UInt32 | None = None) -> None:
        key0, key1 = seed_key(seed, role, iteration)
        self._mix(lane, dr.opaque(type(lane), key0), dr.opaque(type(lane), key1), high)

    @classmethod
    def of_key(cls, lane: mi.UInt32, key0: mi.UInt32, key1: mi.UInt32) -> Self:
        """The source of a key of :func:`seed_key` that is on the device already, as in a frozen function."""
        source = cls.__new__(cls)
        source._mix(lane, key0, key1, None)
        return source

    def _mix(self, lane: mi.UInt32, key0: mi.UInt32, key1: mi.UInt32, high: mi.UInt32 | None) -> None:
        # The pair of keys is unique for (high, lane): the second word is a bijection of the lane, given the first.
        self._key0 = hash_mix(lane + key0 if high is None else lane + key0 + hash_mix(high))
        self._key1 = hash_mix((lane ^ self._key0) + key1)

    def _bits(self, vertex: mi.UInt32 | int, component: int) -> mi.UInt32:
        if not 0 <= component < COMPONENTS_PER_VERTEX:
            raise ValueError(f"component {component} of a vertex must be in 0 to {COMPONENTS_PER_VERTEX - 1}")
        dimension = type(self._key0)(vertex) * COMPONENTS_PER_VERTEX + component  # wraps, also for a Python int
        return keyed_bits(self._key0, self._key1, dimension)

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return to_unit_float(self._bits(vertex, component))

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        return self.next_1d(vertex, component), self.next_1d(vertex, component + 1)

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self.next_1d(vertex, component)


def in_steps(probability: NDArray[np.float64], bits: int) -> NDArray[np.float64]:
    """Probabilities as multiples of 2^-bits, such as random numbers are, whose sum is one; a positive one remains
    positive."""
    steps = np.where(probability > 0.0, 1.0, 0.0)
    steps += np.floor(probability / probability.sum() * (2.0**bits - steps.sum()))
    steps[np.argmax(steps)] += 2.0**bits - steps.sum()
    result: NDArray[np.float64] = steps / 2.0**bits
    return result
