"""Owen-scrambled Sobol' points in one and two dimensions, padded: every draw of a path is a sequence of its own.

The numbers of one draw, taken over the index, are the first one or two dimensions of Sobol's sequence in an order and
with a nested scrambling of their own, both by hashing [Burley 2020; Owen 1995]. Over ``2^m`` consecutive indices from a
multiple of ``2^m`` they are stratified in every way a (0, m, 2)-net is, while draws of different dimensions, and of
different sequences, are independent of each other.
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
    """Numbers of paths that lie well among each other: a :class:`SampleSource`.

    Parameters
    ----------
    sequence: UInt32 per lane; lanes of one number share a sequence, such as the samples of a pixel.
    index: UInt32 per lane, the path's place in its sequence; each (sequence, index, high) should occur once.
    seed, role: as of ``IndependentSource``. Passes of a run go on with the sequence by their indices.
    high: UInt32 per lane, the upper word of the place: each 2^32 points are a sequence scrambled anew.
    """

    def __init__(self, sequence: Any, index: Any, seed: int, role: str, high: Any = 0) -> None:
        uint32 = type(index)
        key0, key1 = (dr.opaque(uint32, word) for word in seed_key(seed, role, 0))
        self._key = hash_mix((hash_mix(uint32(sequence) + key0) ^ key1) + uint32(high))
        self._reversed_index = dr.brev(uint32(index))
        # The first word may be that of another lane; the second leads back to the index, both to the sequence.
        self._lane_keys = hash_mix(uint32(index) + self._key), hash_mix(uint32(index) + key1)

    def _dimension(self, vertex: Any, component: int) -> Any:
        if not 0 <= component < COMPONENTS_PER_VERTEX:
            raise ValueError(f"component {component} of a vertex: there are {COMPONENTS_PER_VERTEX}")
        return type(self._key)(vertex) * COMPONENTS_PER_VERTEX + component

    def _shuffled(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """(bit-reversed place of the lane in the draw's own order, seed of the draw)."""
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
