"""Sampling of points on area lights whose radiance varies, by the power of the cells of :mod:`.radiance`.

    p_A = P(cell) / A(cell),    P(cell) = (1 - f) power(cell) / power + f A(cell) / A

The share f that is sampled by area finds light that the measurement of a cell has missed, and bounds the weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import on_device

from .radiance import SURFACES, RadianceCells, place_of

#: Share of the points that are sampled by area.
_BY_AREA = 0.05
#: Largest number below 1.
_BELOW_ONE = 1.0 - 2.0**-24
_KINDS = ("mesh", *SURFACES)


class LightPoints:
    """Tables of cells for the lights of a scene; ``lights`` has None for lights with uniform points.

    The cells of a light are stored row by row. One number selects a row, another a cell in it, and their remainders
    give the point in the cell, which preserves the stratification of the numbers.
    """

    def __init__(self, lights: Sequence[RadianceCells | None]) -> None:
        heads, kinds, rows, cells, factors = [], [], [], [], []
        first_row = first_cell = 0
        for light in lights:
            share = np.ones((1, 1)) if light is None else light.share
            chosen = share if light is None else _probabilities(light)
            height, width = share.shape
            below = _cumulative(chosen.sum(axis=1))
            within = np.stack([_cumulative(row) for row in chosen])
            # From the rounded sums.
            exact = np.diff(below, prepend=0.0)[:, None] * np.diff(within, prepend=0.0, axis=1)
            heads.append([width, height, first_row, first_cell])
            kinds.append(_KINDS.index(light.surface) if light else len(_KINDS))
            rows.append(below)
            cells.append(within.ravel())
            factors.append(np.divide(exact, share, out=np.ones_like(share), where=share > 0.0).ravel())
            first_row, first_cell = first_row + height, first_cell + width * height
        self._surfaces = {_KINDS[k] for k in kinds if k < len(_KINDS)}
        self._steps = [int(max(head[i] for head in heads) - 1).bit_length() for i in (0, 1)]
        self._heads = on_device(mi.UInt32, np.array(heads, np.uint32).ravel())
        self._kinds = on_device(mi.UInt32, kinds)
        self._rows, self._cells, self._factors = (
            on_device(mi.Float, np.concatenate(parts).astype(np.float32)) for parts in (rows, cells, factors)
        )

    def draw(self, light: mi.UInt32, u: mi.Point2f, active: mi.Bool | bool) -> tuple[mi.Point2f, mi.UInt32, mi.Float]:
        """A point of light number ``light`` by ``u``: (place, triangle, factor). Place and triangle are for
        :func:`~etendue.scene.surface_point`, the factor is the density by area times the light's area."""
        width, height, first_row, first_cell = dr.gather(mi.Vector4u, self._heads, light, active)
        row, v = self._pick(self._rows, first_row, height, self._steps[1], u.y, active)
        first = first_cell + row * width
        column, u_left = self._pick(self._cells, first, width, self._steps[0], u.x, active)
        place = mi.Point2f((mi.Float(column) + u_left) / mi.Float(width), (mi.Float(row) + v) / mi.Float(height))
        triangle = row * width + column
        if "mesh" in self._surfaces:
            of_mesh = dr.gather(mi.UInt32, self._kinds, light, active) == _KINDS.index("mesh")
            place = dr.select(of_mesh, mi.warp.square_to_uniform_triangle(mi.Point2f(u_left, v)), place)
        return place, triangle, dr.gather(mi.Float, self._factors, first + column, active)

    def _pick(
        self, sums: mi.Float, first: mi.UInt32, count: mi.UInt32, steps: int, u: mi.Float, active: mi.Bool | bool
    ) -> tuple[mi.UInt32, mi.Float]:
        """The index among ``count`` cumulative sums from ``first`` on that ``u`` selects, and the remainder of
        ``u``."""
        low, high = mi.UInt32(0), count - 1
        for _ in range(steps):
            middle = (low + high) >> 1
            beyond = u >= dr.gather(mi.Float, sums, first + middle, active)
            low, high = dr.select(beyond, dr.minimum(middle + 1, high), low), dr.select(beyond, high, middle)
        end = dr.gather(mi.Float, sums, first + low, active)
        start = dr.select(low > 0, dr.gather(mi.Float, sums, first + dr.maximum(low, 1) - 1, active), 0.0)
        return low, dr.clip((u - start) / dr.maximum(end - start, 1e-30), 0.0, _BELOW_ONE)

    def factor(self, light: mi.UInt32, uv: mi.Point2f, triangle: mi.UInt32, active: mi.Bool | bool) -> mi.Float:
        """The density by area of a point, known by its texture coordinates or triangle, times the light's area."""
        width, height, _, first_cell = dr.gather(mi.Vector4u, self._heads, light, active)
        kind = dr.gather(mi.UInt32, self._kinds, light, active)
        cell = mi.UInt32(0)
        for surface in sorted(self._surfaces):
            if surface == "mesh":
                own = triangle
            else:
                place = place_of(surface, uv)
                column, row = (
                    dr.minimum(mi.UInt32(dr.maximum(place[i], 0.0) * mi.Float(n)), n - 1)
                    for i, n in ((0, width), (1, height))
                )
                own = row * width + column
            cell = dr.select(kind == _KINDS.index(surface), own, cell)
        return dr.gather(mi.Float, self._factors, first_cell + cell, active)


def _probabilities(light: RadianceCells) -> NDArray[np.float64]:
    """P of each cell."""
    power = light.share * np.maximum(light.radiance, 0.0)
    if power.sum() <= 0.0:
        return light.share
    mixed: NDArray[np.float64] = (1.0 - _BY_AREA) * power / power.sum() + _BY_AREA * light.share
    return mixed


def _cumulative(probabilities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cumulative sums, in single precision, of normalised probabilities."""
    sums = np.cumsum(probabilities)
    if sums[-1] <= 0.0:  # a row of triangles without area, which is never picked
        return np.ones(len(sums))
    rounded = (sums / sums[-1]).astype(np.float32).astype(np.float64)
    rounded[-1] = 1.0
    return rounded
