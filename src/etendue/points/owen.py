"""Owen-scrambled Sobol' points in one and two dimensions, padded: each random number of a path has its own sequence.

The numbers of one dimension of a path are the first one or two dimensions of Sobol's sequence, shuffled and with an
independent nested scrambling, both by hashing [Burley 2020; Owen 1995]. Any ``2^m`` consecutive indices from a multiple
of ``2^m`` form a (0, m, 2)-net. Numbers of different dimensions or sequences are independent.
"""

from __future__ import annotations

from typing import ClassVar

import drjit as dr

from etendue.core import COMPONENTS_PER_VERTEX, hash_mix, keyed_bits, seed_key, to_unit_float

from .words import Words


def sobol_2d(reversed_index: Words) -> Words:
    """Second dimension of Sobol's sequence as 32-bit fractions, from the bit-reversed index, the first dimension.

    The generator matrix is Pascal's triangle modulo 2, which is a product of five sparse matrices.
    """
    x = reversed_index
    for shift, mask in ((16, 0x0000FFFF), (8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        x = x ^ ((x & mask) << shift)
    return x


def scramble(x: Words, seed: Words) -> Words:
    """Nested scrambling of numbers with reversed bits: a hash in which each bit depends only on lower bits and ``seed``
    [LaineKarras 2011; Burley 2020]."""
    x = x ^ (x * 0x3D20ADEA)
    x = x + seed
    x = x * ((seed >> 16) | 1)
    x = x ^ (x * 0x05526C56)
    return x ^ (x * 0x53A22864)


class OwenSobolSource:
    """A :class:`SampleSource` with numbers that are stratified over the paths of a sequence.

    Parameters
    ----------
    sequence: UInt32 per lane; lanes with the same number share a sequence, as the samples of a pixel do.
    index: UInt32 per lane, the index of the path in its sequence; each (sequence, index, high) should occur once.
    seed, role: as for ``IndependentSource``. Later passes of a run continue the sequence with larger indices.
    high: UInt32 per lane, the upper word of the index; every 2^32 points have a different scrambling.
    """

    DRJIT_STRUCT: ClassVar = {"_key": object, "_reversed_index": object, "_lane_keys": tuple}

    def __init__(
        self, sequence: dr.ArrayBase, index: dr.ArrayBase, seed: int, role: str, high: dr.ArrayBase | int = 0
    ) -> None:
        uint32 = type(index)
        key0, key1 = (dr.opaque(uint32, word) for word in seed_key(seed, role, 0))
        self._key = hash_mix((hash_mix(uint32(sequence) + key0) ^ key1) + uint32(high))
        self._reversed_index = dr.brev(uint32(index))
        # The pair is unique for (sequence, index): the second word is a bijection of the index.
        self._lane_keys = hash_mix(uint32(index) + self._key), hash_mix(uint32(index) + key1)

    def _dimension(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        if not 0 <= component < COMPONENTS_PER_VERTEX:
            raise ValueError(f"component {component} of a vertex must be in 0 to {COMPONENTS_PER_VERTEX - 1}")
        return type(self._key)(vertex) * COMPONENTS_PER_VERTEX + component

    def _shuffled(self, vertex: dr.ArrayBase | int, component: int) -> tuple[dr.ArrayBase, dr.ArrayBase]:
        """(bit-reversed index of each lane in the shuffled order of the dimension, seed of the dimension)."""
        seed = hash_mix(self._key ^ (self._dimension(vertex, component) * 0x9E3779B9))
        return scramble(self._reversed_index, seed), seed

    @staticmethod
    def _number(bits: dr.ArrayBase, seed: dr.ArrayBase) -> dr.ArrayBase:
        return to_unit_float(dr.brev(scramble(dr.brev(bits), seed)))

    def next_1d(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        """See :class:`SampleSource`."""
        place, seed = self._shuffled(vertex, component)
        return self._number(place, seed * 0xA511E9B3 + 0x63D83595)

    def next_2d(self, vertex: dr.ArrayBase | int, component: int) -> tuple[dr.ArrayBase, dr.ArrayBase]:
        """See :class:`SampleSource`; the two numbers are a point of a two-dimensional sequence."""
        place, seed = self._shuffled(vertex, component)
        first = self._number(place, seed * 0xA511E9B3 + 0x63D83595)
        return first, self._number(sobol_2d(place), seed * 0xB4B82E39 + 0x9E485565)

    def decide(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        """See :class:`SampleSource`: an independent number, which takes a third of the time."""
        return to_unit_float(keyed_bits(*self._lane_keys, self._dimension(vertex, component)))
