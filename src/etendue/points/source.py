"""Radical inverses as random numbers of paths, beside :class:`OwenSobolSource`.

The prime of a number depends on its vertex, which is known on the device only, so digits are extracted in a loop, by
multiplication with the reciprocal of a prime from a table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import drjit as dr
import numpy as np

from etendue.core import COMPONENTS_PER_VERTEX, hash_mix, keyed_bits, on_device, seed_key, to_unit_float

from .radical import primes
from .words import below_one

#: Digits that contribute less are left out.
_LEAST = 2.0**-25


@dataclass(frozen=True)
class Coordinates:
    """Maps the random numbers of a path to the coordinates of a sequence.

    first: maps a component of vertex 0 to its coordinate. later: maps a component of a vertex j >= 1 to its offset
    among the ``each`` coordinates of that vertex, which follow those of the vertices before it. Coordinates are below
    ``limit``; all other random numbers are independent.
    """

    first: Mapping[int, int]
    later: Mapping[int, int]
    each: int
    limit: int

    def of(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase | int | None:
        """The coordinate, which may be ``limit`` or above; ``None`` for an independent number."""
        if isinstance(vertex, int) and vertex == 0:
            return self.first.get(component)
        offset = self.later.get(component)
        return None if offset is None else (vertex - 1) * self.each + (len(self.first) + offset)


class RadicalSource:
    """A :class:`SampleSource` of Halton's sequence or Hammersley's points [Halton 1960; Hammersley 1960].

    Coordinate d uses prime d. The first coordinates, with small primes, should serve the most important random numbers,
    since pairs of coordinates with large primes are correlated for few points [Leeson 2001, sec. 5.6.3]. Over seeds,
    every number is uniform.

    Parameters
    ----------
    sequence, index, high: as for :class:`OwenSobolSource`; lanes with the same sequence have the same randomisation.
    seed, role, iteration: determine the randomisation.
    coordinates: the coordinates of the random numbers.
    digits: ``False`` shifts each coordinate modulo 1 [Cranley 1976]. ``True`` maps digit a at place j to
        ``(m_j a + s_j) mod b`` with random m_j, s_j for each place.
    size: number of points of Hammersley's set, whose coordinate 0 is ``index / size`` and whose coordinate d uses prime
        d - 1; ``None`` for Halton's sequence.
    """

    def __init__(
        self,
        sequence: dr.ArrayBase,
        index: dr.ArrayBase,
        seed: int,
        role: str,
        coordinates: Coordinates,
        *,
        high: dr.ArrayBase | int = 0,
        iteration: int = 0,
        digits: bool = True,
        size: int | None = None,
    ) -> None:
        uint32 = type(index)
        float32 = dr.float32_array_t(uint32)
        key0, key1 = (dr.opaque(uint32, word) for word in seed_key(seed, role, iteration))
        self._key = hash_mix((hash_mix(uint32(sequence) + key0) ^ key1) + uint32(high))
        self._lane_keys = hash_mix(uint32(index) + self._key), hash_mix(uint32(index) + key1)
        self._index, self._coordinates, self._digits = uint32(index), coordinates, digits
        self._even = None
        bases = np.array(primes(coordinates.limit), np.uint32)
        if size is not None:
            bases = np.concatenate([[2], bases[:-1]]).astype(np.uint32)  # the base of coordinate 0 is not used
            whole = float32(uint32(index)) + float32(uint32(high)) * 2.0**32
            self._even = whole * dr.opaque(float32, 1.0 / size)
        self._bases = on_device(uint32, bases)

    def _one(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        if not 0 <= component < COMPONENTS_PER_VERTEX:
            raise ValueError(f"component {component} of a vertex must be in 0 to {COMPONENTS_PER_VERTEX - 1}")
        place = self._coordinates.of(vertex, component)
        if place is None:
            return self.decide(vertex, component)
        uint32 = type(self._key)
        place = uint32(place)
        known = place < self._coordinates.limit
        seed = hash_mix(self._key ^ (place * 0x9E3779B9 + 0x7F4A7C15))
        base = dr.maximum(dr.gather(uint32, self._bases, place, known), 2)
        number = self._scrambled(base, seed, known) if self._digits else self._shifted(base, seed, known)
        if self._even is not None:
            number = dr.select(place == 0, _wrapped(self._even + to_unit_float(seed)), number)
        return dr.select(known, below_one(number), self.decide(vertex, component))

    def _shifted(self, base: dr.ArrayBase, seed: dr.ArrayBase, active: dr.ArrayBase) -> dr.ArrayBase:
        """The radical inverse, shifted modulo 1."""
        float32 = dr.float32_array_t(type(base))
        magic, inverse = _reciprocal(base), 1.0 / float32(base)

        def step(rest, x, scale):  # type: ignore[no-untyped-def]
            rest, digit = _divided(rest, base, magic)
            return rest, dr.fma(float32(digit), scale, x), scale * inverse

        start = dr.select(active, self._index, 0), dr.zeros(float32, dr.width(base)), inverse + 0.0
        _, x, _ = dr.while_loop(start, lambda rest, x, scale: rest > 0, step, label="radical inverse")
        return _wrapped(x + to_unit_float(seed))

    def _scrambled(self, base: dr.ArrayBase, seed: dr.ArrayBase, active: dr.ArrayBase) -> dr.ArrayBase:
        """The radical inverse with mapped digits, including the zero digits beyond those of the index."""
        float32 = dr.float32_array_t(type(base))
        magic, inverse = _reciprocal(base), 1.0 / float32(base)

        def step(rest, x, scale, word):  # type: ignore[no-untyped-def]
            rest, digit = _divided(rest, base, magic)
            word = hash_mix(word + 0x9E3779B9)
            factor = dr.mul_hi(word, base - 1) + 1
            shift = dr.mul_hi(word * 0xA511E9B3 + 0x63D83595, base)
            _, digit = _divided(factor * digit + shift, base, magic)
            return rest, dr.fma(float32(digit), scale, x), scale * inverse, word

        scale = dr.select(active, inverse, 0.0)
        start = self._index + 0, dr.zeros(float32, dr.width(base)), scale, seed
        _, x, _, _ = dr.while_loop(
            start, lambda rest, x, scale, word: scale > _LEAST, step, label="scrambled radical inverse"
        )
        return x

    def next_1d(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        """See :class:`SampleSource`."""
        return self._one(vertex, component)

    def next_2d(self, vertex: dr.ArrayBase | int, component: int) -> tuple[dr.ArrayBase, dr.ArrayBase]:
        """See :class:`SampleSource`."""
        return self._one(vertex, component), self._one(vertex, component + 1)

    def decide(self, vertex: dr.ArrayBase | int, component: int) -> dr.ArrayBase:
        """See :class:`SampleSource`: an independent number."""
        word = type(self._key)(vertex) * COMPONENTS_PER_VERTEX + component
        return to_unit_float(keyed_bits(*self._lane_keys, word))


def _reciprocal(base: dr.ArrayBase) -> dr.ArrayBase:
    """``floor((2^32 - 1) / base) + 1``."""
    return type(base)(0xFFFFFFFF) // base + 1


def _divided(number: dr.ArrayBase, base: dr.ArrayBase, magic: dr.ArrayBase) -> tuple[dr.ArrayBase, dr.ArrayBase]:
    """(quotient, remainder) of any 32-bit number."""
    quotient = dr.mul_hi(number, magic)
    rest = number - quotient * base
    above = rest >= base  # the quotient was 1 too large, and the remainder is below 0
    return dr.select(above, quotient - 1, quotient), dr.select(above, rest + base, rest)


def _wrapped(x: dr.ArrayBase) -> dr.ArrayBase:
    """``x`` in [0, 2), modulo 1."""
    return dr.select(x >= 1.0, x - 1.0, x)
