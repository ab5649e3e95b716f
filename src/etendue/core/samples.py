"""Random numbers as a function of (seed, role, iteration, lane, dimension): transport never calls a generator. Every
request names its dimension, a vertex and a component of it, so a structured sampler (a point sequence, a primary-sample
chain) can replace independent numbers without changes to the transport code.
"""

from __future__ import annotations

from typing import Any, Protocol

import drjit as dr

_MASK = 0xFFFFFFFF
#: Dimensions reserved for one vertex; a component is an index below this.
COMPONENTS_PER_VERTEX = 64


class SampleSource(Protocol):
    """Numbers in [0, 1) for the lanes of one kernel."""

    def next_1d(self, vertex: Any, component: int) -> Any:
        """One number for ``component`` of ``vertex``; the same arguments give the same number."""
        ...

    def next_2d(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """Two numbers, for components ``component`` and ``component + 1``."""
        ...

    def decide(self, vertex: Any, component: int) -> Any:
        """One number for a binary decision such as roulette, which would not gain from stratification."""
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


def hash_mix(x: Any) -> Any:
    """Bijective 32-bit integer mixer with low bias (two multiplications)."""
    x = x ^ (x >> 16)
    x = x * 0x21F0AAAD
    x = x ^ (x >> 15)
    x = x * 0x735A2D97
    return x ^ (x >> 15)


def to_unit_float(bits: Any) -> Any:
    """The upper 23 bits of a 32-bit word as a float in [0, 1)."""
    float_type = dr.float32_array_t(type(bits))
    return dr.reinterpret_array(float_type, (bits >> 9) | 0x3F800000) - 1.0


def keyed_bits(key0: Any, key1: Any, word: Any) -> Any:
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
    """Independent numbers by hashing. A 64-bit lane key is mixed with the dimension, so draws need no loop state.

    ``lane`` is a UInt32 array, one entry per path, and ``high`` the upper words where lanes are numbered beyond 2^32;
    ``seed``, ``role`` and ``iteration`` enter as opaque scalars, so that another pass does not compile another kernel.
    """

    def __init__(self, lane: Any, seed: int, role: str, iteration: int, high: Any = None) -> None:
        uint32 = type(lane)
        key0, key1 = seed_key(seed, role, iteration)
        k0, k1 = dr.opaque(uint32, key0), dr.opaque(uint32, key1)
        # The pair identifies (high, lane): given the first word, the second can be mapped back to the lane.
        self._key0 = hash_mix(lane + k0 if high is None else lane + k0 + hash_mix(high))
        self._key1 = hash_mix((lane ^ self._key0) + k1)

    def _bits(self, vertex: Any, component: int) -> Any:
        if not 0 <= component < COMPONENTS_PER_VERTEX:
            raise ValueError(f"component {component} of a vertex: there are {COMPONENTS_PER_VERTEX}")
        dimension = type(self._key0)(vertex) * COMPONENTS_PER_VERTEX + component  # wraps, also for a Python int
        return keyed_bits(self._key0, self._key1, dimension)

    def next_1d(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return to_unit_float(self._bits(vertex, component))

    def next_2d(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """See :class:`SampleSource`."""
        return self.next_1d(vertex, component), self.next_1d(vertex, component + 1)

    def decide(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return self.next_1d(vertex, component)
