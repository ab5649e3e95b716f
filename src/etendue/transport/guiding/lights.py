"""Probabilities of light selection, learned for each cell of the scene.

The light table selects lights by power, which is inefficient in cells where a strong light is occluded or far away.
Here each cell selects a light with probability proportional to the contribution of its light points in the cell, mixed
with selection by power.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import copied_to_device
from etendue.scene import Light, LightTable

#: Most lights of a scene for which selection is learned; each light costs one table lookup per sample.
MOST_LIGHTS = 16
#: Probability with which a light is selected by power.
_BY_POWER = 0.2


@dataclass
class LocalLights:
    """A light table with the selection probabilities of a cell, one cell per lane."""

    table: LightTable
    probability: mi.Float  #: (cells * lights) on the device
    cell: mi.UInt32  #: cell of each lane

    def __post_init__(self) -> None:
        table = self.table
        self.has_area, self.has_point = table.has_area, table.has_point
        self.has_infinite, self.has_beam = table.has_infinite, table.has_beam
        self.points, self.has_sphere, self.has_smooth = table.points, table.has_sphere, table.has_smooth

    def _chance(self, row: mi.UInt32 | int, active: mi.Bool | bool) -> mi.Float:
        return dr.gather(mi.Float, self.probability, self.cell * self.table.count + row, active)

    def pick(self, u: mi.Float, active: mi.Bool | bool = True) -> Light:
        """As :meth:`LightTable.pick`, with the cell's probabilities."""
        row, below = mi.UInt32(0), mi.Float(0.0)
        for number in range(self.table.count - 1):
            below = below + self._chance(number, active)
            row = dr.select(u >= below, mi.UInt32(number + 1), row)
        return self._local(self.table.row(row, active), active)

    def of(self, emitter: mi.EmitterPtr, active: mi.Bool | bool = True) -> Light:
        """As :meth:`LightTable.of`."""
        return self._local(self.table.of(emitter, active), active)

    def _local(self, light: Light, active: mi.Bool | bool) -> Light:
        light.pick = self._chance(light.row, active)
        return light


class LightChoice:
    """Selection probabilities of the lights in each of ``cells`` cells; by power before the first training."""

    def __init__(self, lights: LightTable, cells: int) -> None:
        self._lights = lights
        self.shares = np.tile(lights.probabilities, (cells, 1))
        self._upload()

    def _upload(self) -> None:
        mixed = (1.0 - _BY_POWER) * self.shares + _BY_POWER * self._lights.probabilities
        self._probability = copied_to_device(mi.Float, mixed.astype(np.float32))

    def at(self, cell: mi.UInt32) -> LocalLights:
        """The lights with the probabilities of cells."""
        return LocalLights(self._lights, self._probability, cell)

    def learn(self, found: NDArray[np.float64], origin: NDArray[np.int64]) -> None:
        """Learn from contributions ``found`` of light points, (cells, lights). ``origin``: for each new cell, the old
        cell whose probabilities it inherits. A cell without contributions keeps its probabilities."""
        total = found.sum(axis=1, keepdims=True)
        shares = np.divide(found, total, out=self.shares.copy(), where=total > 0.0)
        self.restore(shares[origin])

    def restore(self, shares: NDArray[np.float64]) -> None:
        """Set the learned probabilities, (cells, lights), before selection by power is mixed in."""
        self.shares = np.array(shares, np.float64)
        self._upload()
