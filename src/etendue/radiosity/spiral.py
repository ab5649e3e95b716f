"""Points for a known number of bundles, whose directions are a spiral over the hemisphere."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from etendue.core import on_device, seed_key
from etendue.points import Halton, OwenSobol, PointSet

from .lines import direction

#: The golden ratio less one: the part of a turn from one direction to the next.
_TURN = (np.sqrt(5.0) - 1) / 2
_BELOW_ONE = 1 - 2.0**-24


class SpiralPoints(PointSet):
    """Points of four dimensions for :class:`Bundles`: directions on a spherical Fibonacci lattice [Marques 2013].

    Direction ``k`` of ``size`` has the height ``(k + 1/2) / size`` and is turned by k golden sections; then all are
    turned together at random, so that each is even by itself. In a room with boxes, a thousand leave half the error of
    Sobol' points. They come in the order of the radical inverse, so that each part of them is spread, too. The other
    dimensions are those of a scrambled Sobol' sequence.
    """

    name = "spiral"
    is_random = True
    citations = ("Marques2013",)

    def __init__(self, size: int, seed: int = 0) -> None:
        super().__init__(4, size)
        self._sobol = OwenSobol(4, seed=seed)
        k = np.argsort(np.argsort(Halton(1).block(size)[:, 0]))
        ways = direction(np.stack([(k + 0.5) / size, np.mod(k * _TURN, 1.0)], axis=1))
        turned, scale = np.linalg.qr(np.random.default_rng(seed_key(seed, "spiral", size)).normal(size=(3, 3)))
        ways = ways @ (turned * np.sign(np.diag(scale)))
        ways *= np.copysign(1.0, ways[:, 2:])  # a line has no sense
        turn = np.mod(np.arctan2(ways[:, 1], ways[:, 0]) / (2 * np.pi), 1.0)
        self._ways = np.minimum(np.stack([ways[:, 2], turn]), _BELOW_ONE)

    def randomised(self, seed: int) -> PointSet:
        """The same directions in another place."""
        assert self.size is not None
        return SpiralPoints(self.size, seed)

    def _coordinate(self, index: Any, dimension: int) -> Any:
        if dimension >= len(self._ways):
            return self._sobol._coordinate(index, dimension)
        if not dr.is_jit_v(index):
            return self._ways[dimension][index]
        kind = dr.float32_array_t(type(index))
        return dr.gather(kind, on_device(kind, self._ways[dimension].astype(np.float32)), index)
