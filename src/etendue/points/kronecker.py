"""Weyl's sequence, multiples of square roots of primes; and powers of pi, a counterexample."""

from __future__ import annotations

from math import isqrt

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import on_device

from .pointset import BinaryPointSet, PointSet, PointSetError
from .radical import MAX_BASES, primes
from .words import Numbers, Words, below_one, high_product, is_host


class Weyl(BinaryPointSet):
    """Weyl's (Kronecker's) sequence: ``frac(i sqrt(p_d))`` with the first primes [Weyl 1916].

    The coordinates are exact to 2^-32 for every index, because the roots have 64 bits.
    """

    name = "weyl"
    max_dimension = MAX_BASES
    citations = ("Weyl1916",)

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._roots = [isqrt(p << 128) & (2**64 - 1) for p in primes(dimension)]

    def _word(self, index: Words, dimension: int) -> Words:
        root = self._roots[dimension]
        # The middle 32 bits of the product; the bits above are the integer part.
        return index * (root >> 32) + high_product(index, root & 0xFFFFFFFF)


class PiPowers(PointSet):
    """Powers of pi in doubles: ``(frac(pi^i), ..., frac(pi^(i+d-1)))``. Do not use this set.

    The numbers ``frac(pi^i)`` are conjectured to be uniform in any number of dimensions. In double precision, powers
    have no bits after the binary point from index 32 on, so that all later points are 0; pi^30 has three bits.
    """

    name = "pi-powers"

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        powers = _fractions_in_doubles()
        last = len(powers) - 1  # this power and all later ones are 0
        if is_host(index):
            return powers[np.minimum(index.astype(np.int64) + dimension, last)]
        float_type = dr.float32_array_t(type(index))
        place = dr.minimum(dr.minimum(index, last) + dimension, last)
        return dr.gather(float_type, on_device(float_type, _rounded(powers)), place)


class ExactPiPowers(PointSet):
    """Powers of pi as :class:`PiPowers`, computed with all their digits, for up to 2^13 points.

    Pi is computed with the digits that the largest power needs; the time for ``size`` points grows almost with its cube
    (a second for the largest). The numbers behave like random ones, and are not more uniform.
    """

    name = "pi-powers-exact"
    #: Largest sum of ``size`` and dimension.
    MOST = 1 << 13

    def __init__(self, dimension: int, size: int) -> None:
        super().__init__(dimension, size)
        if size + dimension > self.MOST:
            raise PointSetError(
                f"{self.name}: {size} points in {dimension} dimensions need pi^{size + dimension}; the limit is "
                f"{self.MOST}, because every power is computed with all its digits"
            )
        self._powers = _exact_fractions(size + dimension - 1)
        self._tables: dict[type, dr.ArrayBase] = {}

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        last = len(self._powers) - 1
        if is_host(index):
            return self._powers[index.astype(np.int64) + dimension]
        float_type = dr.float32_array_t(type(index))
        if float_type not in self._tables:
            self._tables[float_type] = on_device(float_type, _rounded(self._powers))
        return dr.gather(float_type, self._tables[float_type], dr.minimum(dr.minimum(index, last) + dimension, last))


def _rounded(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rounded down to 24 bits after the binary point, so that the ``Float`` is not 1."""
    return np.floor(values * 2.0**24) * 2.0**-24


def _fractions_in_doubles() -> NDArray[np.float64]:
    """``frac(pi^i)`` in double precision, up to the first power without bits after the binary point, and one more."""
    powers = np.pi ** np.arange(36)
    return np.asarray(below_one(powers - np.floor(powers)))


def _exact_fractions(n: int) -> NDArray[np.float64]:
    """``frac(pi^i)`` for ``i`` below ``n``, to 53 bits."""
    # Each product adds an error of pi^i units in the last place: 1.66 bits a power, and 32 bits as a margin.
    places = 53 + 32 + (n * 1661) // 1000
    pi = _pi(places)
    power, fractions = 1 << places, np.empty(n)
    for i in range(n):
        fractions[i] = (power >> (places - 53) & (2**53 - 1)) * 2.0**-53
        power = power * pi >> places
    return fractions


def _pi(places: int) -> int:
    """``floor(pi 2^places)`` by Machin's formula, with 64 more bits for rounding errors."""
    unit = 1 << (places + 64)

    def arctan_inverse(x: int) -> int:
        term = unit // x
        total, n, sign = term, 1, -1
        while term:
            term //= x * x
            n += 2
            total += sign * (term // n)
            sign = -sign
        return total

    return 4 * (4 * arctan_inverse(5) - arctan_inverse(239)) >> 64
