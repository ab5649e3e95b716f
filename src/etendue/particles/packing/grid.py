"""The grid to which packed positions are rounded, and the bounds of all errors of packed particles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from ..surfaces import Surfaces
from .strips import kernels

#: Bits of a parameter or coordinate on the largest primitive; smaller primitives have as many bits as make their steps
#: about as long, but at least ``_FEWEST``.
PARAMETER_BITS, _FEWEST = 16, 8


class Grid:
    """Steps of the parameters on all primitives of a scene, and of coordinates on shapes whose primitives have no
    frames.

    A coordinate is a level in the box of its shape: ``low + level * coordinate_steps``, ``level`` at most ``MOST``."""

    MOST = (1 << PARAMETER_BITS) - 1

    def __init__(self, surfaces: Surfaces) -> None:
        self.surfaces = surfaces
        edges = surfaces.frames.astype(np.float64)
        one, other = edges[:, 3:6], edges[:, 6:]
        # The distance from the middle of a cell to a corner is half a diagonal.
        diagonals = np.maximum(((one + other) ** 2).sum(1), ((one - other) ** 2).sum(1))
        longest = _finite(np.sqrt(0.5 * diagonals))
        boxes = surfaces.boxes
        extents = _finite((boxes[:, 3:] - boxes[:, :3]).max(1, initial=0.0))
        # Errors of half a step in three coordinates must not exceed those in two parameters, hence the root of 3/2.
        coarsest = extents[~surfaces.framed].max(initial=0.0) * np.sqrt(1.5) / self.MOST
        step = max(longest.max(initial=0.0) / (1 << PARAMETER_BITS), coarsest)
        #: Largest absolute coordinate.
        self._size = float(_finite(np.abs(boxes)).max(initial=0.0))
        #: Largest length of a step on a primitive with frame, in the scene's units; not finer than single precision.
        self.step = float(max(step, self._size * 2.0**-23)) or 2.0**-PARAMETER_BITS
        #: Bits of a parameter, for each primitive with frame by number.
        self.bits = self._bits(longest, self.step)
        #: Bits of a parameter, for the primitives without frame of each shape.
        self.shape_bits = self._bits(extents / np.sqrt(np.maximum(surfaces.primitives, 1)), self.step)
        levels = (1 << self._bits(extents, self.step * np.sqrt(2 / 3), 1).astype(np.int64)) - 1
        #: Lowest coordinates of each shape, and their step.
        self.low: Array = boxes[:, :3]
        self.coordinate_steps: Array = np.where(extents > 0, extents, 1.0) / levels

    @staticmethod
    def _bits(lengths: Array, step: float, ends: int = 0) -> NDArray[np.uint8]:
        """Bits with which the steps of each length are at most ``step``; ``ends``: number of levels minus steps."""
        bits = np.ceil(np.log2(np.maximum(lengths / step + ends, 1.0)) - 1e-9)
        return np.clip(bits, _FEWEST, PARAMETER_BITS).astype(np.uint8)

    @property
    def bounds(self) -> dict[str, float]:
        """Bounds of the errors of a packed particle: ``position`` in the scene's units; ``direction`` in radians;
        ``power``, of each channel relative to the largest one."""
        loops = kernels()
        return {
            "position": self.position_bound,
            "direction": 4.5 / loops.DIRECTION_LEVELS,
            "power": 2.0 / loops.POWER_LEVELS,
        }

    @property
    def position_bound(self) -> float:
        """Half a step along both parameters, and the rounding of coordinates to single precision."""
        return float(self.step * np.sqrt(0.5) * 1.01 + 4e-7 * self._size)


def _finite(values: Array) -> Array:
    """The values, with 0 in place of those that are not finite."""
    return np.where(np.isfinite(values), values, 0.0)
