"""Independent random points, and latin hypercubes."""

from __future__ import annotations

import drjit as dr
import numpy as np

from etendue.core import hash_mix, seed_key

from .pointset import BinaryPointSet, PointSet
from .words import Keys, Numbers, Words, below_one, is_host, unit


class Independent(BinaryPointSet):
    """Independent uniform numbers, by hashing seed, index and dimension: plain Monte Carlo.

    The error of a mean falls as ``n^(-1/2)``, in any dimension and for any integrand of finite variance.
    """

    name = "independent"
    is_random = True

    def __init__(self, dimension: int, seed: int = 0) -> None:
        super().__init__(dimension)
        self.seed = seed
        self._keys = Keys()

    def randomised(self, seed: int) -> PointSet:
        """Other independent numbers."""
        return Independent(self.dimension, seed)

    def _word(self, index: Words, dimension: int) -> Words:
        return _hash(index, self._keys, seed_key(self.seed, "independent", 0), dimension)


class LatinHypercube(PointSet):
    """A latin hypercube: in each dimension, each of ``size`` equal intervals has one point [McKay 1979].

    The order in each dimension is an independent pseudo-random permutation, computed by hashing [Kensler 2013]; a point
    is uniform in its interval. The variance of a mean is that of independent points for the integrand without its
    additive part, the sum of functions of one coordinate.
    """

    name = "latin-hypercube"
    is_random = True
    citations = ("McKay1979", "Kensler2013")

    def __init__(self, dimension: int, size: int, seed: int = 0) -> None:
        super().__init__(dimension, size)
        self.seed = seed
        self._keys = Keys()

    def randomised(self, seed: int) -> PointSet:
        """Another latin hypercube with the same number of points."""
        assert self.size is not None
        return LatinHypercube(self.dimension, self.size, seed)

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        assert self.size is not None
        within = unit(_hash(index, self._keys, seed_key(self.seed, "latin jitter", 0), dimension))
        keys = [self._keys.like(index, word) for word in self._permutation_keys(dimension)]
        place = _permuted(index, self.size, keys, self._keys)
        if is_host(index):
            return below_one((place + within) / self.size)
        return below_one((type(within)(place) + within) * (1.0 / self.size))

    def _permutation_keys(self, dimension: int) -> tuple[int, ...]:
        keys = (seed_key(self.seed, "latin order", dimension), seed_key(self.seed, "latin order 2", dimension))
        return keys[0] + keys[1]


def _hash(index: Words, keys: Keys, words: tuple[int, int], dimension: int) -> Words:
    """Pseudo-random words from the index, two words of a seed and the dimension. The part that does not depend on the
    dimension comes first, so that a kernel computes it once."""
    a = hash_mix(index + keys.like(index, words[0]))
    b = hash_mix((index ^ a) + keys.like(index, words[1]))
    x = a + (dimension * 0x9E3779B9 & 0xFFFFFFFF)
    x = (x ^ (x >> 16)) * 0x21F0AAAD
    x = ((x ^ (x >> 15)) + b) * 0x735A2D97
    x = (x ^ (x >> 15)) * 0x9E3779B1
    return x ^ (x >> 16)


def _permuted(index: Words, size: int, words: list[Words], keys: Keys) -> Words:
    """The image of ``index`` under a permutation of 0 to ``size`` - 1.

    A permutation of the next power of two is applied until the result is in range [Kensler 2013].
    """
    bits = max((size - 1).bit_length(), 1)
    mask, half = (1 << bits) - 1, (bits + 1) // 2

    def once(x: Words) -> Words:
        # Addition, multiplication by an odd number and xor with upper bits are bijections of words of ``bits`` bits.
        for word in words:
            x = (x + word) & mask
            x = ((x ^ (x >> half)) * 0x21F0AAAD) & mask
            x = ((x ^ (x >> half)) * ((word >> 8) | 1)) & mask
            x = x ^ (x >> half)
        return x

    if is_host(index):
        x = once(index)
        while (outside := x >= size).any():
            x = np.where(outside, once(x), x)
        return x
    last = keys.like(index, size - 1)
    # The loop might not end for an index out of range.
    x = once(dr.minimum(index, last))
    (x,) = dr.while_loop((x,), lambda x: x > last, lambda x: (once(x),), label="latin hypercube")
    return x
