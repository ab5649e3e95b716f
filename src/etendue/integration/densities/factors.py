"""Factors of densities over groups of parameters, which can be sampled, evaluated and learned.

A factor over one or two parameters is piecewise constant over bins with movable borders, each with the same
probability; over three or more it is a fixed grid of cells, each with its own probability [Leeson 2001, sec. 5.5].
Every factor warps uniform numbers to its distribution, which preserves the stratification of stratified or quasi-random
numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np

from etendue.core import Array

from ..backend import Backend, Numbers, Whole
from .binning import damp, rebin, smooth

#: Points (a list of coordinates), 1 / density there, and the bin of each.
Warped: TypeAlias = "tuple[list[Numbers], Numbers, Whole]"
#: Smallest probability of a cell of a grid, relative to a uniform one, so that a missed cell is sampled again.
_FLOOR = 0.05


class Tabulated(Protocol):
    """A density on the unit cube of one group of parameters, with its bins in tables."""

    dimension: int
    bins: int
    #: Probability of each bin.
    shares: float | Array

    @property
    def volume(self) -> Array:
        """Volume of each bin, (bins,)."""
        ...

    def tables(self) -> list[Array]:
        """The tables that :meth:`look_up` reads. The tables of several densities of one shape may be concatenated, one
        row for each density."""
        ...

    def look_up(self, backend: Backend, tables: Sequence[Numbers], u: Sequence[Numbers], row: Whole | int) -> Warped:
        """(points, 1 / density, bin of each) from the tables, by the density with index ``row``."""
        ...


class Factor(Tabulated, Protocol):
    """A tabulated density that is learned."""

    #: Power of the contribution to which the bins adapt; bins with movable borders equalise its square.
    order: int

    def warp(self, backend: Backend, u: Sequence[Numbers]) -> Warped:
        """(points, 1 / density, bin of each)."""
        ...

    def pdf(self, backend: Backend, x: Sequence[Numbers]) -> Numbers:
        """Density at points."""
        ...

    def adapted(self, values: Array, smoothing: bool, damping: float | None, inertia: float) -> Factor:
        """The factor adapted to ``values`` (size ``bins``): the contributions of its bins, or their deviations."""
        ...


class _ByTables:
    """Warping by the tables, for all factors."""

    def warp(self: Any, backend: Backend, u: Sequence[Numbers]) -> Warped:
        """See :class:`Factor`."""
        return warp_rows(backend, [self], u, 0)


class AxisBins(_ByTables):
    """One parameter: K bins, each with probability 1/K. ``edges``: (K+1,), from 0 to 1."""

    dimension = 1
    order = 2

    def __init__(self, edges: Array) -> None:
        self.edges = np.asarray(edges, dtype=np.float64)
        self.bins = len(self.edges) - 1
        self.shares: float | Array = 1.0 / self.bins

    @classmethod
    def even(cls, bins: int) -> AxisBins:
        """The uniform density."""
        return cls(np.linspace(0.0, 1.0, bins + 1))

    @property
    def volume(self) -> Array:
        """See :class:`Factor`."""
        return np.diff(self.edges)

    def tables(self) -> list[Array]:
        """See :class:`Factor`: widths and lower borders of the bins."""
        return [np.diff(self.edges), self.edges[:-1]]

    def look_up(self, backend: Backend, tables: Sequence[Numbers], u: Sequence[Numbers], row: Whole | int) -> Warped:
        """See :class:`Factor`."""
        place, rest = backend.split(u[0] * self.bins, self.bins)
        index = row * self.bins + place
        width = backend.take(tables[0], index)
        return [backend.take(tables[1], index) + rest * width], width * self.bins, place

    def pdf(self, backend: Backend, x: Sequence[Numbers]) -> Numbers:
        """See :class:`Factor`."""
        density = 1.0 / (self.bins * np.maximum(np.diff(self.edges), np.finfo(float).tiny))
        place = bisect(backend, backend.table(self.edges), x[0], self.bins)
        return backend.take(backend.table(density), place)

    def adapted(self, values: Array, smoothing: bool, damping: float | None, inertia: float) -> AxisBins:
        """See :class:`Factor`."""
        return AxisBins(rebin(self.edges, stabilised(values, smoothing, damping)))


class PlaneBins(_ByTables):
    """Two parameters: K bins of the first and, in each of them, L bins of the second; each with probability 1/(K L).

    ``edges``: (K+1,) of the first; ``inner``: (K, L+1) of the second.
    """

    dimension = 2
    order = 2

    def __init__(self, edges: Array, inner: Array) -> None:
        self.edges = np.asarray(edges, dtype=np.float64)
        self.inner = np.asarray(inner, dtype=np.float64)
        self._outer_bins, self._inner_bins = len(self.edges) - 1, self.inner.shape[1] - 1
        self.bins = self._outer_bins * self._inner_bins
        self.shares: float | Array = 1.0 / self.bins

    @classmethod
    def even(cls, bins: int) -> PlaneBins:
        """The uniform density, ``bins`` to an axis."""
        edges = np.linspace(0.0, 1.0, bins + 1)
        return cls(edges, np.tile(edges, (bins, 1)))

    @property
    def volume(self) -> Array:
        """See :class:`Factor`."""
        return np.asarray(np.diff(self.inner) * np.diff(self.edges)[:, None]).ravel()

    def tables(self) -> list[Array]:
        """See :class:`Factor`: widths and lower borders, of the outer bins and of the inner ones."""
        outer, inner = self.edges, self.inner
        return [np.diff(outer), outer[:-1], np.diff(inner).ravel(), inner[:, :-1].ravel()]

    def look_up(self, backend: Backend, tables: Sequence[Numbers], u: Sequence[Numbers], row: Whole | int) -> Warped:
        """See :class:`Factor`."""
        outer, outer_rest = backend.split(u[0] * self._outer_bins, self._outer_bins)
        inner, inner_rest = backend.split(u[1] * self._inner_bins, self._inner_bins)
        place = outer * self._inner_bins + inner
        first, second = row * self._outer_bins + outer, row * self.bins + place
        width, inner_width = backend.take(tables[0], first), backend.take(tables[2], second)
        x = backend.take(tables[1], first) + outer_rest * width
        y = backend.take(tables[3], second) + inner_rest * inner_width
        return [x, y], width * inner_width * self.bins, place

    def pdf(self, backend: Backend, x: Sequence[Numbers]) -> Numbers:
        """See :class:`Factor`."""
        tiny = np.finfo(float).tiny
        density = 1.0 / (self.bins * np.maximum(np.diff(self.inner) * np.diff(self.edges)[:, None], tiny))
        outer = bisect(backend, backend.table(self.edges), x[0], self._outer_bins)
        row = outer * (self._inner_bins + 1)
        inner = bisect(backend, backend.table(self.inner), x[1], self._inner_bins, row)
        return backend.take(backend.table(density), outer * self._inner_bins + inner)

    def adapted(self, values: Array, smoothing: bool, damping: float | None, inertia: float) -> PlaneBins:
        """See :class:`Factor`. A new bin of the first parameter takes the borders of the second from the old bins that
        it overlaps, weighted by the overlap."""
        rows = np.asarray(values).reshape(self._outer_bins, self._inner_bins)
        edges = rebin(self.edges, stabilised(rows.sum(axis=1), smoothing, damping))
        inner = rebin(self.inner, stabilised(smooth(rows, 0) if smoothing else rows, smoothing, damping))
        low = np.maximum(edges[:-1, None], self.edges[None, :-1])
        share = np.maximum(np.minimum(edges[1:, None], self.edges[None, 1:]) - low, 0.0)
        total = share.sum(axis=1, keepdims=True)
        share = np.divide(share, total, out=np.eye(self._outer_bins), where=total > 0)
        return PlaneBins(edges, share @ inner)


class CellGrid(_ByTables):
    """Three or more parameters: equal cells, each with its own probability, ``probability[i, j, k, …]``."""

    order = 1

    def __init__(self, probability: Array) -> None:
        p = np.asarray(probability, dtype=np.float64)
        self.probability = p / p.sum()
        self.dimension, self.cells, self.bins = p.ndim, p.shape[0], p.size
        self.shares: float | Array = self.probability.ravel()

    @classmethod
    def even(cls, bins: int, dimension: int) -> CellGrid:
        """The uniform density."""
        return cls(np.ones((bins,) * dimension))

    @property
    def volume(self) -> Array:
        """See :class:`Factor`."""
        return np.full(self.bins, 1.0 / self.bins)

    def tables(self) -> list[Array]:
        """See :class:`Factor`: probabilities of the cells, and their sums over all cells before."""
        p = self.probability.ravel()
        return [p, np.cumsum(p) - p]

    def look_up(self, backend: Backend, tables: Sequence[Numbers], u: Sequence[Numbers], row: Whole | int) -> Warped:
        """See :class:`Factor`. The first number selects the cell, and its remainder the position in it."""
        first = row * self.bins
        place = bisect(backend, tables[1], u[0], self.bins, first)
        chosen = backend.take(tables[0], first + place)
        rest = (u[0] - backend.take(tables[1], first + place)) / chosen
        rest = backend.where(rest > 0, backend.where(rest < 1, rest, 1 - 2.0**-24), 0.0)
        x, left = [], place
        for axis in range(self.dimension):
            size = self.cells ** (self.dimension - 1 - axis)
            along = left // size
            left = left - along * size
            x.append((backend.number(along) + (rest if axis == 0 else u[axis])) * (1.0 / self.cells))
        return x, 1.0 / (chosen * self.bins), place

    def pdf(self, backend: Backend, x: Sequence[Numbers]) -> Numbers:
        """See :class:`Factor`."""
        place: Any = 0
        for value in x:
            place = place * self.cells + backend.split(value * self.cells, self.cells)[0]
        return backend.take(backend.table(self.probability * self.bins), place)

    def adapted(self, values: Array, smoothing: bool, damping: float | None, inertia: float) -> CellGrid:
        """See :class:`Factor`. A probability follows the root mean square of f, or its deviation; ``inertia`` r
        mixes old and new as (1 - r) old + r new. ``damping`` is for movable bins."""
        d = np.asarray(values).reshape(self.probability.shape)
        if smoothing:
            for axis in range(self.dimension):
                d = smooth(d, axis)
        if not d.sum() > 0:
            return self
        proposed = self.probability * d
        proposed = proposed / proposed.sum()
        mixed = (1 - inertia) * self.probability + inertia * proposed
        return CellGrid(np.maximum(mixed, _FLOOR / self.bins))


def warp_rows(backend: Backend, factors: Sequence[Tabulated], u: Sequence[Numbers], row: Whole | int) -> Warped:
    """(points, 1 / density, bin of each) by the factor with index ``row`` of ``factors``, which are of one shape."""
    tables = [backend.table(np.concatenate(parts)) for parts in zip(*(f.tables() for f in factors), strict=True)]
    return factors[0].look_up(backend, tables, u, row)


def stabilised(values: Array, smoothing: bool, damping: float | None) -> Array:
    """The values, smoothed and damped if requested."""
    values = smooth(values) if smoothing else np.asarray(values)
    return values if damping is None else damp(values, damping)


def bin_values(factor: Factor, sums: Array, samples: int, mode: str, steady: bool = False) -> Array:
    """The values of a factor's bins, from ``sums`` over the samples in each bin, of ``samples`` in all: (1, bins) of
    (f / p)^2 in mode ``"importance"``, (3, bins) of (f / p)^2, f / p and 1 in mode ``"stratified"``.

    In importance mode the value is the mean of (f / p)^2, for cells of a grid its root; in stratified mode it is the
    deviation of f / p, with the sign of [Leeson 2001, eq. 5.8] corrected. Borders that adapt to squares overshoot;
    damping compensates it. Without damping (``steady``) they adapt to the root, the contribution itself, and converge.
    """
    if mode == "importance":
        order = 1 if steady else factor.order
        return np.asarray((sums[0] / (samples * factor.shares)) ** (order / 2))
    squares, values, counts = sums
    counts = np.maximum(counts, 1)
    return np.sqrt(np.maximum(squares / counts - (values / counts) ** 2, 0.0))


def bisect(backend: Backend, table: Numbers, value: Numbers, bins: int, start: Whole | int = 0) -> Whole:
    """The bin of ``value`` between ascending borders ``table[start … start + bins]``."""
    low: Any = value * 0.0
    low = backend.split(low, 1)[0]
    step = 1 << max(bins - 1, 1).bit_length() - 1
    while step:
        # `low + step` is tried only where this bin exists, so the last border is never passed.
        tried = backend.where(low + step < bins, low + step, low)
        low = backend.where(backend.take(table, tried + start) <= value, tried, low)
        step >>= 1
    return low
