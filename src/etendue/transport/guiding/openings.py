r"""Openings: where the light of skies and suns enters a scene.

Of the rays that a sky sends to the sphere around a building, hardly any enters a window. Camera paths find those that
do: the rays along which next event estimation, or a path that leaves the scene, finds the sky. Nor do many rays of a
sun meet a glass on a terrace, whose caustic only light paths find; the box around the glass tells where they pass. A
density of the places that these rays pass (:class:`~etendue.density.LineDensity`) is mixed with the uniform one over
the scene's disc, so that no ray is impossible. In the same way next event looks for a sky through its windows
(:class:`~etendue.density.BoxDensity`).
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, SampleSource, copied_to_device
from etendue.density import LEAST_LINES, LineDensity, fit_boxes, fit_lines
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
#: How much likelier next event and scattering together must find the lines, if that share of next event's directions
#: to skies passes learned places: little, since boxes cost little.
_SEEN_GAIN = 1.2
#: Largest value of a line, in means of all lines: so that none decides alone.
_CAP = 10.0


@dataclass(kw_only=True)
class OpeningPath(CameraPath):
    """State of a camera path that keeps one line to an infinite light, in proportion to what it contributes."""

    total: mi.Float  #: luminance of the contributions of all lines
    origin: mi.Point3f  #: of the kept line
    direction: mi.Vector3f
    picked: mi.Float  #: its density under next event; 0 if next event cannot find it
    scattered: mi.Float  #: its density under scattering


@dataclass(kw_only=True)
class OpeningWalk(Walker):
    """Path tracing that keeps lines to infinite lights."""

    weights: DirectWeights

    def trace(self, ray: mi.Ray3f, source: SampleSource) -> OpeningPath:
        """Paths along camera rays, not yet evaluated."""
        empty = {"origin": mi.Point3f(0.0), "direction": mi.Vector3f(0.0, 0.0, 1.0)}
        empty |= {name: mi.Float(0.0) for name in ("total", "picked", "scattered")}
        path = OpeningPath.start(ray, self.max_edges, **empty)
        return self.walk(path, lambda s: self._edge(s, source), "openings")

    def _edge(self, s: OpeningPath, source: SampleSource) -> OpeningPath:
        vertex = self.arrive(s, source)
        hit = self.emission(s, vertex)
        found = s.throughput * hit.radiance * self.weights.hit(s.pdf, hit.direct_pdf)
        seen = hit.active & ~vertex.valid & (s.depth > 1)
        origin, picked = s.ray.o - s.ray.d * s.travelled, dr.select(s.pdf > 0.0, hit.direct_pdf, 0.0)
        u = source.decide(vertex.number, dim.KEEP)
        self._keep(s, found, seen, origin, s.ray.d, picked, s.pdf, u)
        s.active &= vertex.valid & self.goes_on(s, vertex)

        light = self.light_point(vertex, source, s.active & vertex.smooth)
        light.active &= self.lights.row(light.light, light.active).is_infinite
        scattered, (f,) = vertex.sample(source, s.active, [light])
        found, visible = self.next_event(s, vertex, light, f, self.weights)
        picked, u = dr.select(light.is_delta, 0.0, light.pdf), source.decide(vertex.number, dim.KEEP + 1)
        self._keep(s, found, visible, vertex.si.p, light.direction, picked, f.pdf, u)
        s.pdf = self.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
        self.advance(s, vertex, scattered, source)
        return s

    def _keep(
        self,
        s: OpeningPath,
        found: mi.Spectrum,
        active: mi.Bool,
        o: mi.Point3f,
        d: mi.Vector3f,
        picked: mi.Float,
        scattered: mi.Float,
        u: mi.Float,
    ) -> None:
        value = dr.select(active, dr.maximum(brightness(found), 0.0), 0.0)
        value = dr.select(dr.isfinite(value), value, 0.0)
        s.total += value
        kept = u * s.total < value
        s.origin[kept], s.direction[kept] = o, d
        s.picked[kept], s.scattered[kept] = picked, scattered


@dataclass
class Lines:
    """Lines to infinite lights: origins and directions (n, 3), what they contribute (n,), and the solid-angle densities
    of their directions (n,) under next event, 0 if it cannot find them, and under scattering."""

    o: Array
    d: Array
    value: Array
    picked: Array
    scattered: Array

    @classmethod
    def of(
        cls,
        o: mi.Point3f,
        d: mi.Vector3f,
        value: mi.Float,
        picked: mi.Float | float = 0.0,
        scattered: mi.Float | float = 0.0,
    ) -> Lines:
        """Those of the device that contribute."""
        zeros = dr.zeros(mi.Float, dr.width(value))
        picked, scattered = picked + zeros, scattered + zeros
        dr.eval(o, d, value, picked, scattered)
        value, picked, scattered = (np.nan_to_num(np.array(one, np.float64)) for one in (value, picked, scattered))
        found = value > 0.0
        origins, directions = (np.array(line, np.float64).T[found] for line in (o, d))
        return cls(origins, directions, value[found], picked[found], scattered[found])

    @classmethod
    def alike(cls, parts: Sequence[Lines]) -> Lines:
        """Sets of lines together, with the same sum of values for each."""
        nothing = cls(np.zeros((0, 3)), np.zeros((0, 3)), *(np.zeros(0) for _ in range(3)))
        return functools.reduce(operator.add, [replace(p, value=p.value / p.value.sum()) for p in parts], nothing)

    def __add__(self, other: Lines) -> Lines:
        return Lines(*(np.concatenate(pair) for pair in zip(self.arrays(), other.arrays(), strict=True)))

    def __getitem__(self, chosen: slice | NDArray[np.bool_]) -> Lines:
        return Lines(*(part[chosen] for part in self.arrays()))

    def __len__(self) -> int:
        return len(self.value)

    def arrays(self) -> tuple[Array, ...]:
        """The lines as arrays."""
        return self.o, self.d, self.value, self.picked, self.scattered

    def fitted(self, lights: LightTable) -> tuple[LightTable, float] | None:
        """(the lights with places of rays learned from the lines, by what factor the lines are likelier, a geometric
        mean); None if little is gained."""
        few = self._few()
        even = 1.0 / (np.pi * lights.radius**2)
        found = fit_lines(few.o, few.d, few.value, *lights.box, share=_SHARE, even=even) if few else None
        if found is None or found[1] < _GAIN:
            return None
        return lights.through(LineDensity(found[0]), _SHARE), found[1]

    def windows(self, lights: LightTable, around: tuple[Array, Array]) -> tuple[LightTable, float] | None:
        """(the lights with directions of next event learned from the lines, by what factor next event and scattering
        together are likelier to find the lines, a geometric mean); None if little is gained. ``around``: corners of a
        box in which windows are looked for. Lines through panes, which next event does not pass, gain nothing."""
        passed = self.picked > 0.0
        few = self[passed]._few()
        if not few or lights.sky is None:
            return None
        rays, densities = (few.o, few.d, few.value), {"replaced": few.picked, "kept": few.scattered}
        place = mi.Point3f(*(copied_to_device(mi.Float, x.astype(np.float32)) for x in few.o.T))
        part = np.array(lights.at(place).row(mi.UInt32(lights.sky)).pick, np.float64)
        found = fit_boxes(*rays, *around, **densities, part=part, most=_SHARE)
        gain = found[1] ** float(self.value[passed].sum() / self.value.sum()) if found else 0.0
        return (lights.seen_through(found[0]), gain) if found and gain >= _SEEN_GAIN else None

    def _few(self) -> Lines:
        """At most :data:`_MOST` of them, none of which decides alone; none if some would."""
        if len(self) < LEAST_LINES:
            return self[:0]
        few = self[:: -(-len(self) // _MOST)]
        few = replace(few, value=np.minimum(few.value, _CAP * few.value.mean()))
        return few if few.value.sum() ** 2 > _KNOWN * (few.value**2).sum() else few[:0]
