"""Boxes that fill the unit cube, each with its probability: the result of a recursive division as a density."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from etendue.core import Array

from .backend import Backend, Numbers, Whole
from .densities import Warped, bisect


class Regions:
    """A density that is constant in each of R boxes.

    Parameters
    ----------
    low, side: (R, d), corners and edges of the boxes in the unit cube.
    probability: (R,), above zero, in any unit.

    The boxes are padded with empty ones to ``bins``, a power of two, since on the device each number of bins needs its
    own kernel. ``len()`` is the number without padding.
    """

    def __init__(self, low: Array, side: Array, probability: Array) -> None:
        self._count, self.dimension = np.shape(low)
        self.bins = 1 << max(self._count - 1, 1).bit_length()
        self.low, self.side = np.zeros((self.bins, self.dimension)), np.zeros((self.bins, self.dimension))
        self.shares: float | Array = np.zeros(self.bins)
        self.low[: self._count], self.side[: self._count] = low, side
        self.shares[: self._count] = probability / np.sum(probability)

    def __len__(self) -> int:
        return self._count

    @property
    def volume(self) -> Array:
        """Volume of each box."""
        return np.asarray(self.side.prod(axis=1))

    def tables(self) -> list[Array]:
        """The tables of :meth:`look_up`: probabilities, sums of those before, 1 / density, corners, edges."""
        p = self.shares
        empty = np.arange(self.bins) >= self._count
        reached = np.where(empty, 2.0, np.cumsum(p) - p)  # empty boxes are never selected
        return [p, reached, self.volume / np.where(empty, 1.0, p), *self.low.T, *self.side.T]

    def look_up(self, backend: Backend, tables: Sequence[Numbers], u: Sequence[Numbers], row: Whole | int) -> Warped:
        """(points, 1 / density, box of each). The first number selects the box, and its remainder the position in it,
        so that stratified numbers stay stratified within the boxes."""
        first = row * self.bins
        place = bisect(backend, tables[1], u[0], self.bins, first)
        index = first + place
        rest = (u[0] - backend.take(tables[1], index)) / backend.take(tables[0], index)
        rest = backend.where(rest > 0, backend.where(rest < 1, rest, 1 - 2.0**-24), 0.0)
        low, side = tables[3 : 3 + self.dimension], tables[3 + self.dimension :]
        x = [
            backend.take(a, index) + backend.take(b, index) * (rest if axis == 0 else u[axis])
            for axis, (a, b) in enumerate(zip(low, side, strict=True))
        ]
        return x, backend.take(tables[2], index), place
