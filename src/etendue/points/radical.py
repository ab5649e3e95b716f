"""Halton's sequence and its variants: digits of the index in prime bases, mirrored at the radix point.

``radical inverse: i = sum_j a_j b^j  ->  phi_b(i) = sum_j a_j b^(-j-1)``

On the device, digits are extracted and assembled by multiplications only. The index is divided into chunks of ``K``
digits. A chunk minus half its range, ``y``, has the balanced digits ``a_j - (b - 1)/2``, so that
``q_k = round(y / b^k)`` is exact in a ``Float``. Since ``a_k = q_k - b q_(k+1)``, the mirrored chunk is
``b^(K-1) y - (b^2 - 1) sum_k q_k b^(K-1-k)``. Digits that contribute less than 2^-25 together are left out.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import on_device

from .pointset import PointSet, PointSetError
from .words import Numbers, Words, below_one, is_host, unit

#: Bases are below this number.
_BASES_BELOW = 1 << 16
#: Chunks of ``K`` digits are exact in a ``Float`` if ``base^(2 K - 1)`` is below this.
_EXACT = 1 << 28
#: Entries of a table of permuted chunks.
_TABLE_SIZE = 4096
#: Adding and subtracting this rounds a ``Float`` to a whole number.
_ROUND = 1.5 * 2.0**23


@functools.cache
def _primes() -> NDArray[np.int64]:
    is_prime = np.ones(_BASES_BELOW, bool)
    is_prime[:2] = False
    for n in range(2, int(_BASES_BELOW**0.5) + 1):
        if is_prime[n]:
            is_prime[n * n :: n] = False
    return np.flatnonzero(is_prime)


def primes(n: int) -> list[int]:
    """The first ``n`` primes; at most :data:`MAX_BASES`."""
    return [int(p) for p in _primes()[:n]]


#: Primes below 2^16, and so the dimensions of Halton's sequence.
MAX_BASES = 6542


def faure_permutation(base: int) -> NDArray[np.int64]:
    """Faure's permutation of the digits 0 to ``base`` - 1 [Faure 1992]: ``base`` 5 gives (0, 3, 2, 1, 4).

    The array is shared and read-only. Raises :class:`PointSetError` for a base that is not from 2 to 65535.
    """
    _check_base(base)
    return _faure_permutation(base)


@functools.cache
def _faure_permutation(base: int) -> NDArray[np.int64]:
    if base == 2:
        permutation = np.array([0, 1])
    elif base % 2 == 0:
        half = 2 * _faure_permutation(base // 2)
        permutation = np.concatenate([half, half + 1])
    else:
        middle = (base - 1) // 2
        even = _faure_permutation(base - 1)
        even = even + (even >= middle)
        permutation = np.concatenate([even[:middle], [middle], even[middle:]])
    permutation.setflags(write=False)
    return permutation


def _check_base(base: int) -> None:
    if not 2 <= base < _BASES_BELOW:
        raise PointSetError(f"a base must be from 2 to {_BASES_BELOW - 1}, not {base}")


def radical_inverse(index: Words, base: int) -> Numbers:
    """``index`` mirrored at the radix point in ``base``, which is below 2^16; on the device it must be 2 or odd.

    index: a ``UInt32`` of the device, or an array of NumPy. Raises :class:`PointSetError` for another base.
    """
    _check_base(base)
    if is_host(index):
        return _on_host(index, base)
    if base == 2:
        return unit(dr.brev(index))
    if base % 2 == 0:
        raise PointSetError(f"the base of a radical inverse on the device must be 2 or odd, not {base}")
    most = 1
    while base ** (2 * most + 1) < _EXACT:
        most += 1
    return _assemble(index, base, _chunks(base, most), lambda chunk, digits: _mirrored(chunk, base, digits))


def _on_host(index: NDArray[Any], base: int, permutation: NDArray[np.int64] | None = None) -> NDArray[np.float64]:
    rest = index.astype(np.uint64)
    divisor = np.uint64(base)
    # All digits as one integer below 2^53, so that only the last step rounds.
    mirrored, scale = np.zeros_like(rest), 1
    last = int(rest.max()) if rest.size else 0
    while last:
        rest, digit = np.divmod(rest, divisor)
        if permutation is not None:
            digit = permutation.astype(np.uint64)[digit]
        mirrored = mirrored * divisor + digit
        scale *= base
        last //= base
    return np.asarray(mirrored / float(scale))


def _chunks(base: int, most: int) -> list[int]:
    """Digits in each chunk, at most ``most``, until the rest contributes less than 2^-25."""
    digits = 1
    while base**digits < 2**25:
        digits += 1
    count = -(-digits // most)
    return [digits // count + (n < digits % count) for n in range(count)]


def _mirrored(chunk: dr.ArrayBase, base: int, digits: int) -> dr.ArrayBase:
    """The ``digits`` digits of ``chunk`` in reverse order, as a ``Float``."""
    float_type = dr.float32_array_t(type(chunk))
    if digits == 1:
        return float_type(chunk)
    half = base**digits // 2
    y = float_type(dr.int32_array_t(type(chunk))(chunk) - half)
    total = float_type(0.0)
    for k in range(1, digits):
        total = dr.fma(total, float(base), dr.fma(y, 1.0 / base**k, _ROUND) - _ROUND)
    # The product that is rounded separately is a multiple of 8 and therefore exact.
    return dr.fma(y, float(base ** (digits - 1)), total * -float(base * base - 1)) + float(half)


def _assemble(
    index: dr.ArrayBase, base: int, chunks: list[int], mirror: Callable[[dr.ArrayBase, int], dr.ArrayBase]
) -> dr.ArrayBase:
    """The mirrored chunks as a fraction; the chunk of the lowest digits of the index is the most significant."""
    parts = []
    for digits in chunks:
        rest = index // base**digits
        parts.append(mirror(index - rest * base**digits, digits))
        index = rest
    x = parts[-1]
    for part, digits in zip(parts[-2::-1], chunks[:0:-1], strict=True):
        x = dr.fma(x, 1.0 / base**digits, part)
    return below_one(x * (1.0 / base ** chunks[0]))


class Halton(PointSet):
    """Halton's sequence: radical inverses in the first primes [Halton 1960].

    Discrepancy ``O((log n)^d / n)``. Pairs of dimensions with large primes are correlated among the first points.
    """

    name = "halton"
    max_dimension = MAX_BASES
    citations: ClassVar[tuple[str, ...]] = ("Halton1960",)

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._bases = primes(dimension)

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        return radical_inverse(index, self._bases[dimension])


class FaureHalton(Halton):
    """Halton's sequence with Faure's permutation of every digit: ``sum_j sigma_b(a_j) b^(-j-1)`` [Faure 1992]."""

    name = "faure-halton"
    citations = ("Halton1960", "Faure1992")

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._tables: dict[tuple[type, int, int], dr.ArrayBase] = {}

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        base = self._bases[dimension]
        if base <= 3:
            return radical_inverse(index, base)  # the permutation is the identity
        if is_host(index):
            return _on_host(index, base, faure_permutation(base))
        # A chunk of digits at once, permuted and mirrored by a table.
        most = 1
        while base ** (most + 1) <= _TABLE_SIZE:
            most += 1
        return _assemble(index, base, _chunks(base, most), lambda chunk, digits: self._look_up(chunk, base, digits))

    def _look_up(self, chunk: dr.ArrayBase, base: int, digits: int) -> dr.ArrayBase:
        float_type = dr.float32_array_t(type(chunk))
        name = float_type, base, digits
        if name not in self._tables:
            mirrored = _on_host(np.arange(base**digits), base, faure_permutation(base))
            self._tables[name] = on_device(float_type, np.rint(mirrored * float(base**digits)))
        return dr.gather(float_type, self._tables[name], chunk)


class FaureBlockHalton(Halton):
    """Halton's sequence with Faure's permutation of the last digit only, which permutes the points in blocks of ``b``.

    Another interpretation of the scrambling in [Castro 2002, sec. 2.2.13], which reproduces the example there. It
    agrees with :class:`FaureHalton` for the first ``b`` points only.
    """

    name = "faure-block-halton"
    citations = ("Halton1960", "Faure1992", "Castro2002")

    def __init__(self, dimension: int) -> None:
        super().__init__(dimension)
        self._tables: dict[tuple[type, int], dr.ArrayBase] = {}

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        base = self._bases[dimension]
        if base <= 3:
            return radical_inverse(index, base)
        block = index // base
        digit = self._permuted(index - block * base, base)
        return below_one((digit + radical_inverse(block, base)) * (1.0 / base))

    def _permuted(self, digit: Words, base: int) -> Numbers:
        if is_host(digit):
            return faure_permutation(base)[digit].astype(np.float64)
        float_type = dr.float32_array_t(type(digit))
        name = float_type, base
        if name not in self._tables:
            self._tables[name] = on_device(float_type, faure_permutation(base))
        return dr.gather(float_type, self._tables[name], digit)


class Hammersley(PointSet):
    """Hammersley's points: ``i / n``, and radical inverses in the first primes [Hammersley 1960].

    Discrepancy ``O((log n)^(d-1) / n)`` for all ``size`` points, which cannot be extended.
    """

    name = "hammersley"
    max_dimension = MAX_BASES + 1
    citations = ("Hammersley1960",)

    def __init__(self, dimension: int, size: int) -> None:
        super().__init__(dimension, size)
        self._bases = primes(dimension - 1)

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        if dimension:
            return radical_inverse(index, self._bases[dimension - 1])
        assert self.size is not None
        if is_host(index):
            return index / float(self.size)
        return below_one(dr.float32_array_t(type(index))(index) * (1.0 / self.size))
