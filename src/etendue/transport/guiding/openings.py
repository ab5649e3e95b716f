r"""Openings: where the light of skies and suns enters a scene.

Of the rays that a sky sends to the sphere around a building, hardly any enters a window. Camera paths find those that
do: the rays along which next event estimation, or a path that leaves the scene, finds the sky. Nor do many rays of a
sun meet a glass on a terrace, whose caustic only light paths find; the box around the glass tells where they pass. A
density of the places that these rays pass (:class:`~etendue.density.LineDensity`) is mixed with the uniform one over
the scene's disc, so that no ray is impossible.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, SampleSource
from etendue.density import LEAST_LINES, LineDensity, fit_lines
from etendue.scene import LightTable, brightness

from .. import dimensions as dim
from ..direct import DirectWeights
from ..walk import CameraPath, Walker

#: Most lines of a fit, and least number of lines that count alike.
_MOST, _KNOWN = 1 << 13, 64.0
#: Share of the rays that have learned places, and how much likelier they must make the lines. The other rays bound what
#: learning costs light that enters otherwise, such as that of the ground outside: its photons are at most four times as
#: rare.
_SHARE, _GAIN = 0.75, 2.0
#: Largest value of a line, in means of all lines: so that none decides alone.
_CAP = 10.0


@dataclass(kw_only=True)
class OpeningPath(CameraPath):
    """State of a camera path that keeps one line to an infinite light, in proportion to what it contributes."""

    total: mi.Float  #: luminance of the contributions of all lines
    origin: mi.Point3f  #: of the kept line
    direction: mi.Vector3f


@dataclass(kw_only=True)
class OpeningWalk(Walker):
    """Path tracing that keeps lines to infinite lights."""

    weights: DirectWeights

    def trace(self, ray: mi.Ray3f, source: SampleSource) -> OpeningPath:
        """Paths along camera rays, not yet evaluated."""
        empty = {"total": mi.Float(0.0), "origin": mi.Point3f(0.0), "direction": mi.Vector3f(0.0, 0.0, 1.0)}
        path = OpeningPath.start(ray, self.max_edges, **empty)
        return self.walk(path, lambda s: self._edge(s, source), "openings")

    def _edge(self, s: OpeningPath, source: SampleSource) -> OpeningPath:
        vertex = self.arrive(s, source)
        hit = self.emission(s, vertex)
        found = s.throughput * hit.radiance * self.weights.hit(s.pdf, hit.direct_pdf)
        seen = hit.active & ~vertex.valid & (s.depth > 1)
        self._keep(s, found, seen, s.ray.o, s.ray.d, source.decide(vertex.number, dim.KEEP))
        s.active &= vertex.valid & self.goes_on(s, vertex)

        light = self.light_point(vertex, source, s.active & vertex.smooth)
        light.active &= self.lights.row(light.light, light.active).is_infinite
        scattered, (f,) = vertex.sample(source, s.active, [light])
        found, visible = self.next_event(s, vertex, light, f, self.weights)
        self._keep(s, found, visible, vertex.si.p, light.direction, source.decide(vertex.number, dim.KEEP + 1))
        s.pdf = self.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
        self.advance(s, vertex, scattered, source)
        return s

    def _keep(
        self, s: OpeningPath, found: mi.Spectrum, active: mi.Bool, o: mi.Point3f, d: mi.Vector3f, u: mi.Float
    ) -> None:
        value = dr.select(active, dr.maximum(brightness(found), 0.0), 0.0)
        value = dr.select(dr.isfinite(value), value, 0.0)
        s.total += value
        kept = u * s.total < value
        s.origin[kept] = o
        s.direction[kept] = d


@dataclass
class Lines:
    """Lines to infinite lights: origins and directions (n, 3), and what they contribute (n,)."""

    o: Array
    d: Array
    value: Array

    @classmethod
    def of(cls, o: mi.Point3f, d: mi.Vector3f, value: mi.Float) -> Lines:
        """Those of the device that contribute."""
        dr.eval(o, d, value)
        values = np.nan_to_num(np.array(value, np.float64))
        found = values > 0.0
        origins, directions = (np.array(line, np.float64).T[found] for line in (o, d))
        return cls(origins, directions, values[found])

    @classmethod
    def alike(cls, parts: Sequence[Lines]) -> Lines:
        """Sets of lines together, with the same sum of values for each."""
        nothing = cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
        return functools.reduce(operator.add, [cls(p.o, p.d, p.value / p.value.sum()) for p in parts], nothing)

    def __add__(self, other: Lines) -> Lines:
        return Lines(*(np.concatenate(pair) for pair in zip(self.arrays(), other.arrays(), strict=True)))

    def __len__(self) -> int:
        return len(self.value)

    def arrays(self) -> tuple[Array, Array, Array]:
        """The lines as arrays."""
        return self.o, self.d, self.value

    def fitted(self, lights: LightTable) -> tuple[LightTable, float] | None:
        """(the lights with places of rays learned from the lines, by what factor the lines are likelier, a geometric
        mean); None if little is gained."""
        if len(self) < LEAST_LINES:
            return None
        o, d, value = (part[:: -(-len(self) // _MOST)] for part in self.arrays())
        value = np.minimum(value, _CAP * value.mean())
        if value.sum() ** 2 <= _KNOWN * (value**2).sum():
            return None
        even = 1.0 / (np.pi * lights.radius**2)
        found = fit_lines(o, d, value, *lights.box, share=_SHARE, even=even)
        if found is None or found[1] < _GAIN:
            return None
        cells, gain = found
        return lights.through(LineDensity(cells), _SHARE), gain
