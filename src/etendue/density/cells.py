"""A box divided adaptively into cells of position and facing, with lookup by one gather.

A cell is halved across its longest side when more than a given number of samples fell into it [Muller 2017]. Surfaces
that face along different axes have separate cells from the start, since light on a floor says little about light on the
adjacent wall. All cells of a level are halved in the middle, along the same axis, so the tree can be expanded
into a table over the finest cells, and a lookup costs one gather.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, copied_to_device

#: Number of facings: plus and minus x, y, z.
FACINGS = 6
#: Largest number of halvings: the table has 2^18 entries per facing.
FINEST = 18


class Cells:
    """Cells of the box from ``lower`` to ``upper``; points outside belong to the nearest one inside.

    facing, corner, level: of each cell, on the host: (cells,), (cells, 3) in units of the finest cells, (cells,).
    """

    def __init__(self, lower: Sequence[float], upper: Sequence[float]) -> None:
        low, high = np.asarray(lower, np.float64), np.asarray(upper, np.float64)
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-30))
        sides, axes = extent.copy(), []
        for _ in range(FINEST):
            axes.append(int(np.argmax(sides)))
            sides[axes[-1]] /= 2.0
        self._axes = np.array(axes)
        halvings = np.stack([(self._axes == axis).cumsum() for axis in range(3)], axis=1)
        bits = halvings[-1]
        #: Finest cells along each axis, of a cell of each level.
        self._sizes = 1 << (bits - np.vstack([np.zeros((1, 3), np.int64), halvings]))
        # Opaque: as constants they would be compiled into every kernel.
        self._finest = mi.Vector3u(*(dr.opaque(mi.UInt32, n) for n in (1 << bits).tolist()))
        self._origin = mi.Point3f(*(dr.opaque(mi.Float, v) for v in low.tolist()))
        self._scale = mi.Vector3f(*(dr.opaque(mi.Float, v) for v in ((1 << bits) / extent).tolist()))
        self._table = np.empty((FACINGS, *(1 << bits[::-1])), np.uint32)
        self.facing = np.arange(FACINGS)
        self.corner = np.zeros((FACINGS, 3), np.int64)
        self.level = np.zeros(FACINGS, np.int64)
        self._draw(np.arange(FACINGS))

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.level)

    def boxes(self) -> tuple[Array, Array]:
        """Corners of all cells: (cells, 3) each, in scene units."""
        origin, scale = (np.array(v, np.float64).ravel() for v in (self._origin, self._scale))
        return origin + self.corner / scale, origin + (self.corner + self._sizes[self.level]) / scale

    def split(self, samples: NDArray[np.integer[Any]], most: float) -> NDArray[np.int64]:
        """Halve every cell with more than ``most`` samples, and recursively its halves, each of which is assumed to
        hold half of the samples. Returns for each new cell the old cell that contains it."""
        origin, held = np.arange(self.count), samples.astype(np.float64)
        self.level = self.level.copy()  # arrays returned by to_arrays() must not change
        changed = np.zeros(self.count, bool)
        while (split := np.flatnonzero((held > most) & (self.level < FINEST))).size:
            level = self.level[split]
            held[split] /= 2.0
            self.level[split] += 1
            corner = self.corner[split].copy()
            rows = np.arange(len(split))
            corner[rows, self._axes[level]] += self._sizes[level + 1, self._axes[level]]
            self.facing = np.concatenate([self.facing, self.facing[split]])
            self.corner = np.concatenate([self.corner, corner])
            self.level = np.concatenate([self.level, self.level[split]])
            held = np.concatenate([held, held[split]])
            origin = np.concatenate([origin, origin[split]])
            changed[split] = True
            changed = np.concatenate([changed, np.ones(len(split), bool)])
        self._draw(np.flatnonzero(changed))
        return origin

    def _draw(self, cells: NDArray[np.int64]) -> None:
        ends = self.corner + self._sizes[self.level]
        for cell in cells.tolist():
            (x, y, z), (x1, y1, z1) = self.corner[cell], ends[cell]
            self._table[self.facing[cell], z:z1, y:y1, x:x1] = cell
        self._device = copied_to_device(mi.UInt32, self._table)

    def find(self, p: mi.Point3f, normal: mi.Normal3f, active: mi.Bool | bool = True) -> mi.UInt32:
        """The cell of a surface at ``p`` that faces along ``normal``: UInt32."""
        place = (p - self._origin) * self._scale
        last = mi.Vector3i(self._finest) - 1
        x, y, z = (mi.UInt32(dr.clip(mi.Int32(place[i]), 0, last[i])) for i in range(3))
        size = dr.abs(normal)
        not_x = dr.select(size.y >= size.z, mi.UInt32(1), 2)
        axis = dr.select(size.x >= dr.maximum(size.y, size.z), 0, not_x)
        along = dr.select(axis == 0, normal.x, dr.select(axis == 1, normal.y, normal.z))
        facing = 2 * axis + dr.select(along < 0.0, mi.UInt32(1), 0)
        index = ((facing * self._finest.z + z) * self._finest.y + y) * self._finest.x + x
        return dr.gather(mi.UInt32, self._device, index, active)

    def to_arrays(self) -> dict[str, NDArray[np.int64]]:
        """Arrays from which :meth:`set_arrays` restores the cells."""
        return {"facing": self.facing, "corner": self.corner, "level": self.level}

    def set_arrays(self, arrays: Mapping[str, ArrayLike]) -> None:
        """Inverse of :meth:`to_arrays`, for cells of the same box."""
        self.facing, self.corner, self.level = (
            np.asarray(arrays[name], np.int64) for name in ("facing", "corner", "level")
        )
        self._draw(np.arange(self.count))
