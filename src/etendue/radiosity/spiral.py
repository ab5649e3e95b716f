"""Points for bundles, whose directions are a spiral over the hemisphere."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import drjit as dr
import numpy as np

from etendue.core import Array, on_device, seed_key
from etendue.points import Halton, OwenSobol, PointSet

from .lines import direction

#: The golden ratio less one: the part of a turn from one direction to the next.
_TURN = (np.sqrt(5.0) - 1) / 2
#: Directions of a spiral.
_SIZE = 1024
_BELOW_ONE = 1 - 2.0**-24


class SpiralPoints(PointSet):
    """Points of four dimensions for :class:`Bundles`: directions on spherical Fibonacci lattices [Marques 2013].

    Direction ``k`` of 1024 has the height ``(k + 1/2) / 1024`` and is turned by k golden sections; then all are turned
    together at random, so that each is even by itself. In a room with boxes they leave two thirds of the error of
    Sobol' points. They come in the order of the radical inverse, so that each part of them is spread, too. Every 1024
    points make a spiral of their own. The other dimensions are those of a scrambled Sobol' sequence.
    """

    name = "spiral"
    is_random = True
    citations = ("Marques2013",)

    def __init__(self, seed: int = 0) -> None:
        super().__init__(4)
        self.seed = seed
        self._sobol = OwenSobol(4, seed=seed)

    def randomised(self, seed: int) -> PointSet:
        """Spirals turned otherwise."""
        return SpiralPoints(seed)

    def _coordinate(self, index: Any, dimension: int) -> Any:
        if dimension > 1:
            return self._sobol._coordinate(index, dimension)
        if dr.is_jit_v(index):
            kind = dr.float32_array_t(type(index))
            return on_device(kind, self._coordinate(np.array(index), dimension).astype(np.float32))
        result = np.empty(len(index))
        for spiral in np.unique(index // _SIZE):
            here = index // _SIZE == spiral
            result[here] = _ways(self.seed, int(spiral))[dimension, index[here] % _SIZE]
        return result


@lru_cache(16)
def _ways(seed: int, spiral: int) -> Array:
    """Height and turn of the directions of a spiral, (2, 1024)."""
    k = np.argsort(np.argsort(Halton(1).block(_SIZE)[:, 0]))
    ways = direction(np.stack([(k + 0.5) / _SIZE, np.mod(k * _TURN, 1.0)], axis=1))
    turned, scale = np.linalg.qr(np.random.default_rng(seed_key(seed, "spiral", spiral)).normal(size=(3, 3)))
    ways = ways @ (turned * np.sign(np.diag(scale)))
    ways *= np.copysign(1.0, ways[:, 2:])  # a line has no sense
    turn = np.mod(np.arctan2(ways[:, 1], ways[:, 0]) / (2 * np.pi), 1.0)
    return np.minimum(np.stack([ways[:, 2], turn]), _BELOW_ONE)
