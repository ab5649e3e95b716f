"""Owen-scrambled Sobol' points in one and two dimensions, padded: each random number of a path has its own sequence.

The numbers for one dimension, over the index, are the first one or two dimensions of Sobol's sequence, shuffled and
with an independent nested scrambling, both by hashing [Burley 2020; Owen 1995]. Any ``2^m`` consecutive indices from a
multiple of ``2^m`` form a (0, m, 2)-net, while numbers of different dimensions and different sequences are independent
of each other.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from etendue.core import COMPONENTS_PER_VERTEX, hash_mix, keyed_bits, seed_key, to_unit_float


def sobol_2d(reversed_index: Any) -> Any:
    """Second dimension of Sobol's sequence as 32 bits after the point, from the bit-reversed index, which is the first.

    The generator matrix is Pascal's triangle modulo 2; it factors into five steps, one for each bit of a bit's number.
    """
    x = reversed_index
    for shift, mask in ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = x ^ ((x & mask) << shift)
    return x


def scramble(x: Any, seed: Any) -> Any:
    """A hash in which each bit depends on those below it and ``seed`` only [Laine and Karras 2011; Burley 2020]: nested
    scrambling of numbers whose bits are in reverse."""
    x = x ^ (x * 0x3D20ADEA)
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


class OwenSobolSource:
    """Numbers that are stratified over the paths of a sequence: a :class:`SampleSource`.

    Parameters
    ----------
    sequence: UInt32 per lane; lanes of one number share a sequence, such as the samples of a pixel.
    index: UInt32 per lane, the path's index in its sequence; each (sequence, index, high) should occur once.
    seed, role: as of ``IndependentSource``. Passes of a run continue the sequence by their indices.
    high: UInt32 per lane, the upper word of the index: each 2^32 points have a new scrambling.
    """

    def __init__(self, sequence: Any, index: Any, seed: int, role: str, high: Any = 0) -> None:
        uint32 = type(index)
        key0, key1 = (dr.opaque(uint32, word) for word in seed_key(seed, role, 0))
        self._key = hash_mix((hash_mix(uint32(sequence) + key0) ^ key1) + uint32(high))
        self._reversed_index = dr.brev(uint32(index))
        # Lanes may share the first word; the second can be mapped back to the index, and both to the sequence.
        self._lane_keys = hash_mix(uint32(index) + self._key), hash_mix(uint32(index) + key1)

    def _dimension(self, vertex: Any, component: int) -> Any:
        if not 0 <= component < COMPONENTS_PER_VERTEX:
            raise ValueError(f"component {component} of a vertex: there are {COMPONENTS_PER_VERTEX}")
        return type(self._key)(vertex) * COMPONENTS_PER_VERTEX + component

    def _shuffled(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """(bit-reversed index of the lane in the shuffled order of this dimension, seed of the dimension)."""
        seed = hash_mix(self._key ^ (self._dimension(vertex, component) * 0x9E3779B9))
        return scramble(self._reversed_index, seed), seed

    @staticmethod
    def _number(bits: Any, seed: Any) -> Any:
        return to_unit_float(dr.brev(scramble(dr.brev(bits), seed)))

    def next_1d(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        place, seed = self._shuffled(vertex, component)
        return self._number(place, seed * 0xA511E9B3 + 0x63D83595)

    def next_2d(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """See :class:`SampleSource`; the two are a point of one sequence in the square."""
        place, seed = self._shuffled(vertex, component)
        first = self._number(place, seed * 0xA511E9B3 + 0x63D83595)
        return first, self._number(sobol_2d(place), seed * 0xB4B82E39 + 0x9E485565)

    def decide(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`: an independent number, at a third of the cost."""
        return to_unit_float(keyed_bits(*self._lane_keys, self._dimension(vertex, component)))
