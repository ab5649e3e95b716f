"""Which light to draw a point on, learned for each cell of the scene.

The light table picks lights by their power. In a cell from which a strong lamp is not seen, or far away, that is waste:
here each cell picks a light in proportion to what its points brought there, and now and then by power.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import copied_to_device
from etendue.scene import Light, LightTable

#: Lights of a scene whose choice is learned at most: each costs a look at a table.
MOST_LIGHTS = 16
#: Probability with which a light is picked by its power all the same.
_BY_POWER = 0.2


@dataclass
class LocalLights:
    """A light table as seen from the cells of lanes: it picks, and knows how probable a pick was, by the cell."""

    table: LightTable
    probability: Any  #: of each light in each cell, on the device
    cell: Any

    def __post_init__(self) -> None:
        table = self.table
        self.has_area, self.has_point = table.has_area, table.has_point
        self.has_infinite, self.has_beam = table.has_infinite, table.has_beam
        self.points, self.has_sphere = table.points, table.has_sphere

    def _chance(self, row: Any, active: Any) -> Any:
        return dr.gather(mi.Float, self.probability, self.cell * self.table.count + row, active)

    def pick(self, u: Any, active: Any = True) -> Light:
        """As :meth:`LightTable.pick`, with the cell's probabilities."""
        row, below = mi.UInt32(0), mi.Float(0.0)
        for number in range(self.table.count - 1):
            below = below + self._chance(number, active)
            row = dr.select(u >= below, mi.UInt32(number + 1), row)
        return self._local(self.table.row(row, active), active)

    def of(self, emitter: Any, active: Any = True) -> Light:
        """As :meth:`LightTable.of`."""
        return self._local(self.table.of(emitter, active), active)

    def _local(self, light: Light, active: Any) -> Light:
        light.pick = self._chance(light.row, active)
        return light


class LightChoice:
    """Probabilities of the lights for each of ``cells`` cells; by power until something is learned."""

    def __init__(self, lights: LightTable, cells: int) -> None:
        self._lights = lights
        self.shares = np.tile(lights.probabilities, (cells, 1))
        self._upload()

    def _upload(self) -> None:
        mixed = (1.0 - _BY_POWER) * self.shares + _BY_POWER * self._lights.probabilities
        self._probability = copied_to_device(mi.Float, mixed.astype(np.float32))

    def at(self, cell: Any) -> LocalLights:
        """The lights as seen from cells."""
        return LocalLights(self._lights, self._probability, cell)

    def learn(self, found: NDArray[np.float64], origin: NDArray[np.int64]) -> None:
        """Take over what points of each light brought to each cell, (cells, lights). ``origin``: for each cell that
        there will be, the one whose probabilities it inherits. A cell that found nothing keeps its own."""
        total = found.sum(axis=1, keepdims=True)
        shares = np.divide(found, total, out=self.shares.copy(), where=total > 0.0)
        self.restore(shares[origin])

    def restore(self, shares: NDArray[np.float64]) -> None:
        """Set the probabilities, (cells, lights), before power is mixed in."""
        self.shares = np.array(shares, np.float64)
        self._upload()
