"""Points for bundles: directions on a spiral over the hemisphere; and shuffled point sets."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, on_device, seed_key
from etendue.points import Halton, OwenSobol, PointSet

from .generators import direction

if TYPE_CHECKING:
    import mitsuba as mi

#: The golden ratio minus one: the part of a turn between consecutive directions.
_TURN = (np.sqrt(5.0) - 1) / 2
_BELOW_ONE = 1 - 2.0**-24
#: Number of points that seed a random order.
_SEEDING = 16


class SpiralPoints(PointSet):
    """Points of four dimensions for :class:`Bundles`: directions on spherical Fibonacci lattices [Marques 2013].

    Direction ``k`` of n has the height ``(k + 1/2) / n`` and is rotated by k golden sections; then all are rotated
    together at random, so that each is uniform. In a room with boxes 1024 of them have two thirds of the error of
    Sobol' points. They are in the order of the radical inverse, so that each part of them is distributed evenly, too,
    but less well. The other dimensions are those of a scrambled Sobol' sequence.

    directions: the number n, after which the next spiral begins with another rotation. The best value is the number of
    bundles, if known.
    """

    name = "spiral"
    is_random = True
    citations = ("Marques2013",)

    def __init__(self, seed: int = 0, directions: int = 1024) -> None:
        super().__init__(4)
        self.seed, self.directions = seed, directions
        self._sobol = OwenSobol(4, seed=seed)

    def randomised(self, seed: int) -> PointSet:
        """Spirals with another rotation."""
        return SpiralPoints(seed, self.directions)

    def _coordinate(self, index: mi.UInt32 | NDArray[np.integer[Any]], dimension: int) -> Any:
        if dimension > 1:
            return self._sobol._coordinate(index, dimension)
        if dr.is_jit_v(index):
            kind = dr.float32_array_t(type(index))
            return on_device(kind, self._coordinate(np.array(index), dimension).astype(np.float32))
        result = np.empty(len(index))
        spirals, places = np.divmod(index, self.directions)
        for spiral in np.unique(spirals):
            here = spirals == spiral
            result[here] = _ways(self.seed, self.directions, int(spiral))[dimension, places[here]]
        return result


class ShuffledPoints(PointSet):
    """The ``count`` points of a set from ``first`` on in a random order, at the same indices.

    Neighbours in a sequence are far apart by design; in a random order they are nearly independent. The order is seeded
    by the points, so other seeds give other orders.
    """

    name = "shuffled"

    def __init__(self, base: PointSet, count: int, first: int = 0) -> None:
        super().__init__(base.dimension)
        self.first = first
        points = base.block(count, first)
        # The seed uses 20 bits of the first points, since machines may differ in the last bits.
        start = np.floor(points[:_SEEDING] * 2.0**20).astype(np.uint32)
        self._points = points[np.random.default_rng(start.ravel()).permutation(count)]

    def _coordinate(self, index: mi.UInt32 | NDArray[np.integer[Any]], dimension: int) -> Any:
        if dr.is_jit_v(index):
            kind = dr.float32_array_t(type(index))
            return on_device(kind, self._coordinate(np.array(index), dimension).astype(np.float32))
        return self._points[index - self.first, dimension]


@lru_cache(16)
def _ways(seed: int, size: int, spiral: int) -> Array:
    """Height and rotation of the directions of a spiral, (2, size)."""
    k = np.argsort(np.argsort(Halton(1).block(size)[:, 0]))
    ways = direction(np.stack([(k + 0.5) / size, np.mod(k * _TURN, 1.0)], axis=1))
    turned, scale = np.linalg.qr(np.random.default_rng(seed_key(seed, "spiral", spiral)).normal(size=(3, 3)))
    ways = ways @ (turned * np.sign(np.diag(scale)))
    ways *= np.copysign(1.0, ways[:, 2:])  # a line has no orientation
    turn = np.mod(np.arctan2(ways[:, 1], ways[:, 0]) / (2 * np.pi), 1.0)
    return np.minimum(np.stack([ways[:, 2], turn]), _BELOW_ONE)
