"""Steps to which packed positions are rounded, and the bounds of all errors of packed particles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .strips import kernels
from .surfaces import Surfaces

#: Bits of a parameter on the largest primitive; smaller ones get so many that a step is about as long.
PARAMETER_BITS = 16


class Grid:
    """Steps of the parameters on all primitives of a scene."""

    def __init__(self, surfaces: Surfaces) -> None:
        self.surfaces = surfaces
        edges = surfaces.frames.astype(np.float64)
        longest = np.sqrt(np.maximum((edges[:, 3:6] ** 2).sum(1), (edges[:, 6:] ** 2).sum(1)))
        # Where a scene has curved shapes only, a step is relative to the root of their area.
        size = max(longest.max(initial=0.0), np.sqrt(np.nan_to_num(surfaces.areas[~surfaces.framed]).max(initial=0.0)))
        #: Length of a step on a primitive with frame, at most; in the scene's units.
        self.step = float(size if size > 0 else 1.0) / (1 << PARAMETER_BITS)
        bits = np.full(surfaces.total, PARAMETER_BITS, np.uint8)
        bits[: len(longest)] = np.ceil(np.log2(np.maximum(longest / self.step, 1.0)) - 1e-9)
        #: Bits of a parameter, for each primitive by number.
        self.bits: NDArray[np.uint8] = bits

    @property
    def position_step(self) -> float:
        """Step of coordinates of particles on curved shapes."""
        return float(self.step * np.sqrt(2 / 3))

    @property
    def bounds(self) -> dict[str, float]:
        """Bounds of the errors of a packed particle: ``position`` in the scene's units; ``direction`` in radians;
        ``power``, of each channel relative to the largest one."""
        loops = kernels()
        return {
            "position": self.position_bound,
            "direction": 4.5 / loops.DIRECTION_LEVELS,
            "power": 2.0**-loops.POWER_BITS,
        }

    @property
    def position_bound(self) -> float:
        """Half a step along both parameters, and the rounding of coordinates to single precision."""
        size = float(np.abs(self.surfaces.frames).max(initial=0.0))
        return float(self.step * np.sqrt(0.5) * 1.01 + 4e-7 * size)
