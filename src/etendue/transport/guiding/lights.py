"""Probabilities of light selection, learned for each cell of the scene.

The light table selects lights by the place that they light, as if nothing were in between, which is inefficient in
cells where a strong light is occluded. Here each cell selects a light with probability proportional to the contribution
of its light points in the cell, mixed with the selection by place.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import copied_to_device
from etendue.scene import LightsAt, LightTable

#: Most lights of a scene for which selection is learned; each light costs one table lookup per sample.
MOST_LIGHTS = 16
#: Probability with which a light is selected by place.
_BY_PLACE = 0.2


class LocalLights(LightsAt):
    """A light table with the selection probabilities of a cell and a place, one of each per lane.

    shares: (cells * lights) on the device, learned probabilities times that of a learned selection; zero for all lights
        of a cell where nothing has been learned.
    """

    def __init__(self, table: LightTable, shares: mi.Float, cell: mi.UInt32, p: mi.Point3f | None = None) -> None:
        super().__init__(table, p)
        self._shares, self._cell = shares, cell

    def at(self, p: mi.Point3f) -> LocalLights:
        """These lights at a place."""
        return LocalLights(self.table, self._shares, self._cell, p)

    def _learned(self, active: mi.Bool | bool) -> list[mi.Float]:
        """Learned part of the probabilities of all lights."""
        count = self.table.count
        return [dr.gather(mi.Float, self._shares, self._cell * count + row, active) for row in range(count)]

    def chance(self, row: mi.UInt32, active: mi.Bool | bool = True) -> mi.Float:
        """See :class:`LightsAt`."""
        learned, own = self._learned(active), mi.Float(0.0)
        for number, share in enumerate(learned):
            own = dr.select(row == number, share, own)
        return own + (1.0 - sum(learned)) * super().chance(row, active)

    def likelier(self, row: mi.UInt32, p: mi.Point3f, active: mi.Bool) -> mi.Float:
        """By what factor a light is likelier to be selected at a place than without what was learned."""
        here = self.at(p)
        plain = LightsAt.chance(here, row, active)
        return dr.select(active, here.chance(row, active) / dr.maximum(plain, 1e-6), 1.0)

    def drawn(self, u: mi.Float, active: mi.Bool | bool = True) -> mi.UInt32:
        """See :class:`LightsAt`."""
        learned = self._learned(active)
        row, below = mi.UInt32(0), mi.Float(0.0)
        for number, share in enumerate(learned):
            row = dr.select(u >= below, mi.UInt32(number), row)
            below = below + share
        rest = dr.clip((u - below) / dr.maximum(1.0 - below, 1e-6), 0.0, 1.0 - 2.0**-24)
        return dr.select(u >= below, super().drawn(rest, active), row)


class LightChoice:
    """Selection probabilities of the lights in each of ``cells`` cells; by place before the first training."""

    def __init__(self, lights: LightTable, cells: int) -> None:
        self._lights = lights
        self.shares = np.zeros((cells, lights.count))
        self._upload()

    def _upload(self) -> None:
        self._probability = copied_to_device(mi.Float, ((1.0 - _BY_PLACE) * self.shares).astype(np.float32))

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
        """Set the learned probabilities, (cells, lights), before selection by place is mixed in; zero in cells where
        nothing has been learned."""
        self.shares = np.array(shares, np.float64)
        self._upload()
