"""Sobol's sequence in up to 2048 dimensions, with and without Owen's scrambling.

Coordinate ``d`` of point ``i`` is the exclusive or of the direction numbers of ``d`` at the set bits of ``i``, in the
original order of points, not that of Gray's code [Sobol 1967]. The direction numbers are those of [Joe 2008]; étendue
contains them with their licence.
"""

from __future__ import annotations

import functools
from importlib import resources

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import seed_key

from .owen import scramble, sobol_2d
from .pointset import BinaryPointSet, PointSet
from .words import Keys, Words, is_host, reverse_bits

_BITS = 32


@functools.cache
def _table() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Primitive polynomials, (dimensions,), and initial numbers, (dimensions, largest degree)."""
    with resources.files(__package__).joinpath("data/joe_kuo.npz").open("rb") as file, np.load(file) as arrays:
        return arrays["polynomials"], arrays["initial"].T


@functools.cache
def direction_numbers(dimension: int) -> tuple[int, ...]:
    """The 32 direction numbers of one dimension as 32-bit fractions; that of index bit 0 first."""
    if dimension == 0:
        return tuple(1 << (_BITS - 1 - k) for k in range(_BITS))
    polynomials, initial = _table()
    polynomial = int(polynomials[dimension])
    degree = polynomial.bit_length() - 1
    m = [int(number) for number in initial[dimension, :degree]]
    for k in range(degree, _BITS):
        # The recurrence of the polynomial, whose first coefficient belongs to m[k].
        following = m[k - degree]
        for j in range(1, degree + 1):
            if polynomial >> (degree - j) & 1:
                following ^= m[k - j] << j
        m.append(following)
    return tuple(number << (_BITS - 1 - k) for k, number in enumerate(m))


def _xor(index: Words, numbers: tuple[int, ...]) -> Words:
    """The exclusive or of ``numbers`` at the bits of ``index``."""
    if is_host(index):
        x = np.zeros_like(index)
        for k in range(int(index.max(initial=0)).bit_length()):
            x ^= np.where(index >> k & 1, np.uint32(numbers[k]), np.uint32(0))
        return x
    x = type(index)(0)
    for k, number in enumerate(numbers):
        x = dr.select((index & (1 << k)) != 0, x ^ number, x)
    return x


class Sobol(BinaryPointSet):
    """Sobol's sequence [Sobol 1967; Joe 2008].

    Every 2^m points from a multiple of 2^m are a (t, m, d)-net in base 2, with t = 0 for the first two dimensions.
    Discrepancy ``O((log n)^d / n)``. Use powers of two: the net property holds for complete nets only.
    """

    name = "sobol"
    max_dimension = 2048
    citations = ("Sobol1967", "Joe2008")

    def randomised(self, seed: int) -> PointSet:
        """The sequence with Owen's scrambling."""
        return OwenSobol(self.dimension, seed)

    def _word(self, index: Words, dimension: int) -> Words:
        if dimension == 0:
            return reverse_bits(index)
        if dimension == 1:
            return sobol_2d(reverse_bits(index))
        return _xor(index, direction_numbers(dimension))


class OwenSobol(BinaryPointSet):
    """Sobol's sequence with Owen's nested scrambling, by hashing [Owen 1995; Burley 2020].

    The points are nets as those of :class:`Sobol`, each point is uniform, and the error for smooth integrands falls as
    ``n^(-3/2)`` at powers of two. The scrambling is a hash in which each bit depends on more significant ones; it does
    not reach all nested scramblings.
    """

    name = "owen-sobol"
    max_dimension = Sobol.max_dimension
    is_random = True
    citations = ("Sobol1967", "Joe2008", "Owen1995", "LaineKarras2011", "Burley2020")

    def __init__(self, dimension: int, seed: int = 0) -> None:
        super().__init__(dimension)
        self._seeds = [seed_key(seed, "owen", d)[0] for d in range(dimension)]
        self._keys = Keys()

    def randomised(self, seed: int) -> PointSet:
        """The sequence with another scrambling."""
        return OwenSobol(self.dimension, seed)

    def _word(self, index: Words, dimension: int) -> Words:
        if dimension == 0:
            reversed_bits = index
        elif dimension == 1:
            reversed_bits = reverse_bits(sobol_2d(reverse_bits(index)))
        else:
            reversed_bits = _xor(index, _reversed_numbers(dimension))
        return reverse_bits(scramble(reversed_bits, self._keys.like(index, self._seeds[dimension])))


@functools.cache
def _reversed_numbers(dimension: int) -> tuple[int, ...]:
    """The direction numbers with reversed bits, as the scrambling needs them."""
    numbers = np.array(direction_numbers(dimension), np.uint32)
    return tuple(int(number) for number in np.asarray(reverse_bits(numbers)))
