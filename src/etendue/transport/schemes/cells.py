r"""Emission by importance: more rays where their light reaches surfaces that the camera sees.

The random numbers of a ray are divided into cells: for each light, a grid over the numbers of the point and one over
those of the direction. A pilot traces paths by plain emission and measures for each path the flux S that arrives at
points that the camera sees, directly or after scattering. Cells are then chosen with probability

.. math:: P(c) = (1 - \delta) \frac{P_0(c) \sqrt{E[S^2 | c]}}{\sum_k P_0(k) \sqrt{E[S^2 | k]}} + \delta P_0(c),

where P_0 is their probability by plain emission. The first part has the least variance of the mean of S for constant
densities in the cells; the share delta bounds the weights, 1/delta at most, and keeps the estimate unbiased where the
pilot has found nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, IndependentSource, SampleSource, copied_to_device
from etendue.scene import LightTable, brightness

from .. import dimensions as dim
from ..camera import CameraSampler
from ..emission import EmittedRay, emit
from ..scattering import scatter_light
from ..vertex import WalkVertex
from ..walk import SubPath, Walker
from .numbers import emit_from

#: Average number of pilot rays per cell, which determines the resolution; and the largest resolution.
_RAYS_PER_CELL, _FINEST = 16, 16
#: Weight of a light's mean in the estimate of a cell, in rays.
_PRIOR = 4.0


@dataclass(frozen=True)
class Resolution:
    """Cells per side of the point's grid and of the direction's grid."""

    point: int
    direction: int

    @classmethod
    def fitting(cls, rays: int, lights: int) -> Resolution:
        """The resolution for a pilot of ``rays`` rays: twice as many cells per side for directions as for points."""
        side = max(1, int((rays / (_RAYS_PER_CELL * lights) / 4.0) ** 0.25))
        return cls(min(side, _FINEST // 2), min(2 * side, _FINEST))

    @property
    def cells(self) -> int:
        """Cells of a light."""
        return (self.point * self.direction) ** 2

    def cell(self, row: mi.UInt32, point: mi.Point2f, direction: mi.Point2f) -> mi.UInt32:
        """Number of the cell of a ray."""
        cell = mi.UInt32(row)
        for u, side in ((point, self.point), (direction, self.direction)):
            for x in (u.x, u.y):
                cell = cell * side + dr.minimum(mi.UInt32(x * side), side - 1)
        return cell


class CellEmission:
    """Emission from a density that is constant in cells; see :class:`~.numbers.EmissionScheme`.

    probability: (lights * cells,) of each cell.
    """

    def __init__(self, lights: LightTable, resolution: Resolution, probability: Array) -> None:
        self.resolution = resolution
        #: Probability of each cell.
        self.probability = probability
        plain = np.repeat(lights.probabilities / resolution.cells, resolution.cells)
        # Random numbers are multiples of 2^-23, so the probabilities are, too; none is rounded to zero.
        steps = np.where(probability > 0.0, 1.0, 0.0)
        steps += np.floor(probability / probability.sum() * (2.0**23 - steps.sum()))
        steps[np.argmax(steps)] += 2.0**23 - steps.sum()
        exact = steps / 2.0**23
        rounded = np.cumsum(exact)
        density = np.divide(exact, plain, out=np.ones_like(exact), where=plain > 0.0)
        self._sums = copied_to_device(mi.Float, rounded.astype(np.float32))
        self._density = copied_to_device(mi.Float, density.astype(np.float32))

    def __call__(self, lights: LightTable, source: SampleSource, active: mi.Bool) -> EmittedRay:
        """See :class:`~.numbers.EmissionScheme`."""
        u = source.next_1d(0, dim.LIGHT_PICK)
        cell = dr.binary_search(0, len(self.probability) - 1, lambda i: dr.gather(mi.Float, self._sums, i, active) <= u)
        density = dr.gather(mi.Float, self._density, cell, active)
        numbers, rest = [], cell
        for side, component in (
            (self.resolution.direction, dim.LIGHT_DIRECTION),
            (self.resolution.point, dim.LIGHT_POINT),
        ):
            v = source.next_2d(0, component)
            y, rest = rest % side, rest // side
            x, rest = rest % side, rest // side
            inside = [dr.minimum((mi.Float(k) + n) / side, 1.0 - 2.0**-24) for k, n in zip((x, y), v, strict=True)]
            numbers.append(mi.Point2f(*inside))
        direction, point = numbers
        return emit_from(lights, lights.number_of(rest, active), point, direction, density, active)


@dataclass(kw_only=True)
class _State(SubPath):
    arrived: mi.Float  #: luminance of the flux that has arrived at points that the camera sees


@dataclass(kw_only=True)
class ImportancePilot(Walker):
    """Measures how much of the flux of light paths arrives at points that a camera sees."""

    camera: CameraSampler

    def learn(self, rays: int, seed: int, defence: float = 0.25) -> CellEmission:
        """Emission by importance, from ``rays`` independent light paths. ``defence``: the share of plain emission."""
        count = self.lights.count
        resolution = Resolution.fitting(rays, count)
        lane = dr.arange(mi.UInt32, rays)
        source = IndependentSource(lane, seed, "importance pilot", 0)
        seen = self._seen(rays, source)
        row = self.lights.pick(source.next_1d(0, dim.LIGHT_PICK)).row
        point, direction = (mi.Point2f(*source.next_2d(0, c)) for c in (dim.LIGHT_POINT, dim.LIGHT_DIRECTION))
        cell = resolution.cell(row, point, direction)
        dr.eval(seen, cell)
        value, where = np.array(seen, np.float64), np.array(cell)
        value[~np.isfinite(value)] = 0.0
        return CellEmission(self.lights, resolution, self._probability(value, where, resolution, defence))

    def _probability(self, value: Array, cell: NDArray[np.uint32], resolution: Resolution, defence: float) -> Array:
        total = self.lights.count * resolution.cells
        rays = np.bincount(cell, minlength=total).astype(np.float64)
        squares = np.bincount(cell, value**2, minlength=total)
        by_light = squares.reshape(-1, resolution.cells).sum(1), rays.reshape(-1, resolution.cells).sum(1)
        overall = squares.sum() / max(rays.sum(), 1.0)
        prior = np.repeat((by_light[0] + overall) / (by_light[1] + 1.0), resolution.cells)
        root = np.sqrt((squares + _PRIOR * prior) / (rays + _PRIOR))
        plain = np.repeat(self.lights.probabilities / resolution.cells, resolution.cells)
        wanted = plain * root
        if wanted.sum() <= 0.0:  # the camera sees none of the light
            return plain
        mixed: Array = (1.0 - defence) * wanted / wanted.sum() + defence * plain
        return mixed

    def _seen(self, rays: int, source: IndependentSource) -> mi.Float:
        emitted = emit(self.lights, source, dr.full(mi.Bool, True, rays))
        state = _State(
            active=emitted.active & (self.max_edges > 0),
            ray=emitted.ray,
            throughput=emitted.throughput,
            eta=None,
            depth=dr.full(mi.UInt32, 1, rays),
            travelled=mi.Float(0.0),
            rays=dr.zeros(mi.UInt32, rays),
            arrived=dr.zeros(mi.Float, rays),
        )
        return self.walk(state, lambda s: self._edge(s, source), "importance pilot").arrived

    def _edge(self, s: _State, source: IndependentSource) -> _State:
        vertex: WalkVertex = self.arrive(s)
        s.active &= vertex.valid
        joined = self.camera.connect(
            vertex.si, self.camera.splat_aperture(source, vertex.number), s.active & vertex.smooth
        )
        on_film = joined.active & self.camera.on_film(joined.position)
        visible = self.sight(vertex, joined.target, s.depth + 1, on_film, by_camera=True).visible
        s.arrived += dr.select(visible, brightness(s.throughput), 0.0)
        s.active &= self.goes_on(s, vertex)
        scattered, _ = vertex.sample(source, s.active, proposal=scatter_light)
        relative = s.throughput * scattered.weight / self.lights.flux
        self.advance(s, vertex, scattered, source, roulette_by=(relative, mi.Float(1.0)))
        return s
