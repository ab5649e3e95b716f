"""The base of point sets and sequences, which compute coordinate ``d`` of point ``i``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import drjit as dr
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError, is_whole, seed_key

from .words import Keys, Numbers, Words, below_one, doubles, is_host, unit

#: An index is a word of 32 bits.
MAX_POINTS = 1 << 32


class PointSetError(OptionError):
    """An invalid dimension, index, number of points or size for a point set or one of its measures."""


class PointSet(ABC):
    """Points in the unit cube, each a function of its index, without state.

    A *sequence* has no ``size``: its first n points are a point set for every n. A point set with a ``size`` is made
    for that number of points and cannot be extended.

    Coordinates can be computed on the device, as ``Float``, and in NumPy, as doubles; the two differ by less than
    2^-23, and neither is ever 1.
    """

    #: Name for :func:`etendue.points.point_set`.
    name: ClassVar[str]
    #: The largest dimension, ``None`` for any.
    max_dimension: ClassVar[int | None] = None
    #: Whether a seed selects other points, so that a mean over the points is unbiased.
    is_random: ClassVar[bool] = False
    #: Papers, as keys of the bibliography.
    citations: ClassVar[tuple[str, ...]] = ()

    def __init__(self, dimension: int, size: int | None = None) -> None:
        if not is_whole(dimension) or dimension < 1:
            raise PointSetError(f"{self.name}: the dimension must be a whole number from 1, not {dimension!r}")
        if self.max_dimension is not None and dimension > self.max_dimension:
            raise PointSetError(
                f"{self.name} has at most {self.max_dimension} dimensions, not {dimension}; independent has any"
            )
        if size is not None and (not is_whole(size) or not 1 <= size <= MAX_POINTS):
            raise PointSetError(f"{self.name}: the number of points must be from 1 to 2^32, not {size!r}")
        self.dimension = int(dimension)
        self.size = None if size is None else int(size)

    def coordinate(self, index: dr.ArrayBase | ArrayLike, dimension: int) -> Numbers:
        """Coordinate ``dimension`` of the points ``index``, in [0, 1).

        index: a ``UInt32`` of the device, for which the result is a ``Float`` (an index beyond the ``size`` is not
        detected and gives a number in [0, 1)); or integers for NumPy, which give doubles of the same shape.

        Raises :class:`PointSetError` for a dimension or an index that the set does not have.
        """
        if not is_whole(dimension) or not 0 <= dimension < self.dimension:
            raise PointSetError(f"{self.name} has the dimensions 0 to {self.dimension - 1}, not {dimension!r}")
        if dr.is_jit_v(index):
            if dr.depth_v(index) != 1 or not dr.is_unsigned_v(index) or dr.itemsize_v(index) != 4:
                raise PointSetError(f"{self.name}: an index on the device is a UInt32, not a {type(index).__name__}")
            return self._coordinate(index, int(dimension))
        lanes = self._checked(index)
        return self._coordinate(lanes.ravel(), int(dimension)).reshape(lanes.shape)[()]

    def value(self, index: int) -> NDArray[np.float64]:
        """Point ``index``: (dimension,). Raises as :meth:`coordinate`."""
        return self.block(1, index)[0]

    def block(self, n: int, first: int = 0) -> NDArray[np.float64]:
        """``n`` points from ``first`` on: (n, dimension). Raises as :meth:`coordinate`."""
        self._check_block(n, first)
        if n == 0:
            return np.empty((0, self.dimension))
        lanes = np.arange(first, first + n, dtype=np.uint32 if first + n < MAX_POINTS else np.uint64).astype(np.uint32)
        return np.stack([self._coordinate(lanes, d) for d in range(self.dimension)], axis=-1)

    def lanes(self, index_type: type[dr.ArrayBase], n: int, first: int = 0) -> list[dr.ArrayBase]:
        """``n`` points from ``first`` on, on the device in double precision: a ``Float64`` for each dimension.
        ``index_type``: the ``UInt32`` of the device. Raises as :meth:`coordinate`."""
        double = dr.float64_array_t(index_type)
        return [double(np.ascontiguousarray(column)) for column in self.block(n, first).T]

    def randomised(self, seed: int) -> PointSet:
        """A randomisation of the set in which each point is uniform; different seeds are independent. A random shift
        modulo 1, unless the set has a better randomisation."""
        return RandomShift(self, seed)

    @abstractmethod
    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        """:meth:`coordinate` for ``UInt32`` lanes, or for a ``uint32`` array of NumPy with one axis."""

    def _check_block(self, n: int, first: int) -> None:
        if not is_whole(n) or n < 0:
            raise PointSetError(f"{self.name}: the number of points must be a whole number from 0, not {n!r}")
        if not is_whole(first):
            raise PointSetError(f"{self.name}: an index is a whole number, not {first!r}")
        if n:
            self._checked([first, first + n - 1])  # before memory is allocated

    def _checked(self, index: ArrayLike) -> NDArray[np.uint32]:
        lanes = np.asarray(index)
        if lanes.dtype.kind not in "iu":
            raise PointSetError(f"{self.name}: an index is a whole number, not {index!r}"[:200])
        low, high = (int(lanes.min()), int(lanes.max())) if lanes.size else (0, 0)
        if low < 0:
            raise PointSetError(f"{self.name}: an index is at least 0, not {low}")
        if self.size is not None and high >= self.size:
            raise PointSetError(
                f"{self.name} was made for {self.size} points and has no point {high}; use a larger size, or a "
                "sequence, which has no size"
            )
        if high >= MAX_POINTS:
            raise PointSetError(f"{self.name}: an index is below 2^32, not {high}")
        return lanes.astype(np.uint32)

    def __repr__(self) -> str:
        size = "" if self.size is None else f", size={self.size}"
        return f"{type(self).__name__}({self.dimension}{size})"


class BinaryPointSet(PointSet):
    """A point set whose coordinates are 32-bit fractions, so that the device computes all their bits."""

    def lanes(self, index_type: type[dr.ArrayBase], n: int, first: int = 0) -> list[dr.ArrayBase]:
        """See :class:`PointSet`; computed on the device."""
        self._check_block(n, first)
        # Opaque, so that all blocks share a kernel.
        index = dr.arange(index_type, n) + dr.opaque(index_type, first)
        return [doubles(self._word(index, d)) for d in range(self.dimension)]

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        return unit(self._word(index, dimension))

    @abstractmethod
    def _word(self, index: Words, dimension: int) -> Words:
        """The 32 bits of :meth:`_coordinate`."""


class RandomShift(PointSet):
    """A point set, shifted by a random vector modulo 1 [Cranley 1976]."""

    name = "shift"
    is_random = True
    citations = ("Cranley1976",)

    def __init__(self, base: PointSet, seed: int = 0) -> None:
        # Set before the checks, whose messages contain the name.
        self.name = f"{base.name}+shift"  # type: ignore[misc]
        super().__init__(base.dimension, base.size)
        self.base = base
        self._shifts = [seed_key(seed, "shift", d)[0] >> 8 for d in range(base.dimension)]
        self._keys = Keys()

    def randomised(self, seed: int) -> PointSet:
        """The same set with another shift."""
        return RandomShift(self.base, seed)

    def _coordinate(self, index: Words, dimension: int) -> Numbers:
        x, shift = self.base._coordinate(index, dimension), self._shifts[dimension]
        if is_host(x):
            rest = 1.0 - shift * 2.0**-24
            return below_one(np.where(x < rest, x + (1.0 - rest), x - rest))
        gap = 1.0 - type(x)(self._keys.like(index, shift)) * 2.0**-24
        return below_one(dr.select(x < gap, x + (1.0 - gap), x - gap))
