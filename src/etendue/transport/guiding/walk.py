"""The guided walk: camera paths with directions, light choice and roulette from a :class:`Guide`, and training samples.

The estimator is that of path tracing, for any guide. Roulette compares the light that the guide expects beyond a vertex
with that beyond the first vertex [Vorba 2016]. Roulette by throughput would end the best paths, since throughput is
small where the guide expects much light.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import LightTable, brightness

from ..direct import DirectWeights
from ..emission import DirectSample
from ..scattering import Evaluated, roulette
from ..vertex import WalkVertex
from ..walk import CameraPath, Walker
from .guide import FITS, NOWHERE, Guide, GuidedScattered, over
from .lights import LocalLights

#: Training samples are summed as integers, so that the sum does not depend on the order of the additions. Units per
#: mean luminance of a path, and the largest value of one sample.
FOUND_UNITS = 1 << 20
_MOST = FOUND_UNITS << 14
#: Most vertices of a path that are recorded, from the first on; and bytes of a recorded vertex.
_VERTICES = 6
_BYTES = 16
#: Least throughput by which contributions are divided.
_FAINT = 1e-20
#: Roulette ends paths where the light expected beyond is below one part in so many of that at the first vertex, the
#: lower end of a window of size 5 [Vorba 2016]; and least survival probability.
_WINDOW, _LEAST_SURVIVAL = 3.0, 0.1


@dataclass(kw_only=True)
class GuidedPath(CameraPath):
    """State of a guided camera path."""

    found: mi.Float  #: luminance of the contributions so far
    expected: mi.Float  #: expected luminance of the contributions after the last vertex; 0: unknown
    expected_at_first: mi.Float  #: ``expected`` at the first vertex where it was known
    cell: mi.UInt32  #: the guide's cell at the start of the next edge
    odds: mi.Float  #: by what factor the path is likelier than without the guide, without its last direction
    plain_pdf: mi.Float  #: density of the last direction by the BSDF alone
    plain: mi.Float  #: luminance of the contributions so far, each times its odds
    plain_square: mi.Float  #: its expectation is that of the square of the luminance of a path without the guide


@dataclass(frozen=True)
class _Odds:
    """By what factors a contribution is likelier, or larger, than without the guide.

    A hit and a light point share the light by the balance heuristic. With the densities p of the direction, d of the
    light point and q = p + d, and primes for those without the guide, the contributions of both are f / q and f / q'.
    """

    all: mi.Float  #: the sampling of path and contribution by both techniques: that of the path times q / q'
    own: mi.Float | float = 1.0  #: factor that makes its mean over this technique that without the guide
    aside: mi.Float | float = 1.0  #: the sampling of what later contributions do not share: d / d' of a light point


class TrainingSamples:
    """Training samples of a pass: light that vertices reflect, by incident direction, and light points' contributions.

    Parameters
    ----------
    lanes: numbers of the paths.
    stride: one path in ``stride`` is recorded.
    unit: mean luminance of a path, or 0 if unknown; light points are then not counted.
    recording: whether the guide is trained in this pass.
    """

    #: Memory of the samples of one path.
    path_bytes = _BYTES * _VERTICES

    def __init__(self, guide: Guide, lanes: mi.UInt32, stride: int, unit: float, recording: bool) -> None:
        opaque = dr.opaque(mi.UInt32, stride)
        self._count = -(-len(lanes) // stride) if recording else 0
        self._path = lanes // opaque
        self._mine = dr.opaque(mi.Bool, recording) & (self._path * opaque == lanes)
        self._stride = opaque
        self._packets = dr.zeros(mi.UInt32, 4 * max(1, self._count * _VERTICES))
        self._scale = dr.opaque(mi.Float, FOUND_UNITS / unit if recording and unit > 0.0 else 0.0)
        self._lights = guide.light_count
        #: (cells * lights) contributions of light points, in units.
        self.brought = dr.zeros(mi.UInt64, guide.cells * max(1, self._lights))

    def record(self, s: GuidedPath, cell: mi.UInt32, scattered: GuidedScattered, wanted: mi.Bool) -> None:
        """Store the sampled direction at vertex ``s.depth`` in ``cell``, and luminance and throughput of the path
        before it."""
        active = self._mine & s.active & wanted & (scattered.place != NOWHERE) & (s.depth <= _VERTICES)
        carried = dr.rcp(dr.maximum(brightness(s.throughput), _FAINT))
        bits = (dr.reinterpret_array(mi.UInt32, value) for value in (s.found, carried))
        packet = mi.Vector4u(scattered.place + 1, *bits, cell * FITS + scattered.fit)
        dr.scatter(self._packets, packet, self._path * _VERTICES + (s.depth - 1), active)

    def record_light(
        self, s: GuidedPath, cell: mi.UInt32, light: DirectSample, contribution: mi.Spectrum, seen: mi.Bool
    ) -> None:
        """Add the contribution of a light point to a vertex in ``cell``."""
        if not self._lights:
            return
        units = brightness(contribution) / dr.maximum(brightness(s.throughput), _FAINT) * self._scale
        units = mi.UInt64(dr.minimum(dr.select(seen & (units >= 1.0), units, 0.0), float(_MOST)))
        place = cell * self._lights + light.light
        dr.scatter_add(self.brought, units, place, seen & (self._scale > 0.0), dr.ReduceMode.Direct)

    def deposit(self, guide: Guide, found: mi.Float, unit: float) -> tuple[mi.UInt64, mi.UInt32, mi.UInt64]:
        """Sums over the samples of the pass: (light in each of the guide's places, in units; samples there; light of
        each cell by classes of directions). ``found``: luminance of the finished paths."""
        light, seen = dr.zeros(mi.UInt64, guide.places), dr.zeros(mi.UInt32, guide.places)
        fits = dr.zeros(mi.UInt64, guide.cells * FITS)
        path = dr.arange(mi.UInt32, self._count)
        found = dr.gather(mi.Float, found, path * self._stride)
        scale = dr.opaque(mi.Float, FOUND_UNITS / unit)
        for vertex in range(_VERTICES):
            packet = dr.gather(mi.Vector4u, self._packets, path * _VERTICES + vertex)
            before, factor = (dr.reinterpret_array(mi.Float, packet[i]) for i in (1, 2))
            value = dr.minimum((found - before) * factor * scale, float(_MOST))
            active = packet[0] > 0
            place = packet[0] - 1
            # Direct mode, because other modes compile the number of places into the kernel.
            dr.scatter_add(seen, mi.UInt32(1), place, active, dr.ReduceMode.Direct)
            active &= value >= 1.0
            for sums, index in ((light, place), (fits, packet[3])):
                dr.scatter_add(sums, mi.UInt64(value), index, active, dr.ReduceMode.Direct)
        return light, seen, fits


@dataclass(kw_only=True)
class GuidedWalk(Walker):
    """Traces guided paths. Directions are sampled from the mixture of ``guide`` and ``proposal``."""

    guide: Guide
    weights: DirectWeights
    training: TrainingSamples

    def trace(self, ray: mi.Ray3f, source: SampleSource, **own: Any) -> GuidedPath:
        """Paths along camera rays, not yet evaluated. ``own``: further fields of the state."""
        path = GuidedPath.start(
            ray,
            self.max_edges,
            found=mi.Float(0.0),
            expected=mi.Float(0.0),
            expected_at_first=mi.Float(0.0),
            cell=mi.UInt32(0),
            odds=mi.Float(1.0),
            plain_pdf=mi.Float(0.0),
            plain=mi.Float(0.0),
            plain_square=mi.Float(0.0),
            **own,
        )
        return self.walk(path, lambda s: self._edge(s, source), "guided path")

    def _edge(self, s: GuidedPath, source: SampleSource) -> GuidedPath:
        """Trace one edge, and scatter at its end."""
        vertex = self.arrive(s, source)

        # ---- Emission, weighted by the light choice of the cell where the edge begins
        local = self.guide.lights_at(s.cell, self.lights)
        hit = self.emission(s, vertex, local)
        reached = dr.select(s.pdf == 0.0, 1.0, over(s.pdf, s.plain_pdf))
        plain_direct_pdf = hit.direct_pdf
        if isinstance(local, LocalLights):
            row = self.lights.of(vertex.si.emitter(self.visibility.scene), hit.active).row
            plain_direct_pdf = hit.direct_pdf / local.likelier(row, s.ray.o, hit.active)
        both, plain = (
            self.weights.together(*pdfs) for pdfs in ((s.pdf, hit.direct_pdf), (s.plain_pdf, plain_direct_pdf))
        )
        found = dr.select(s.pdf == 0.0, 1.0, over(both, plain))
        light = s.throughput * hit.radiance * self.weights.hit(s.pdf, hit.direct_pdf)
        self.add(s, light, hit.active, s.seen, _Odds(s.odds * found, found / reached))
        reached *= s.odds
        s.active &= vertex.valid & self.goes_on(s, vertex)

        # ---- Light point and direction by the cell of the vertex
        cell = self.guide.locate(vertex.si, s.active)
        local = self.guide.lights_at(cell, self.lights)
        smooth = s.active & vertex.smooth
        lights = [self.light_point(vertex, source, smooth, lights=local)] if self.weights.next_event else []
        guided = functools.partial(self.guide.scatter, cell, vertex.proposal)
        scattered, evaluated = vertex.sample(source, s.active, lights, guided)
        for light, f in zip(lights, evaluated, strict=True):
            contribution, visible = self.next_event(s, vertex, light, f, self.weights)
            self.add(s, contribution, visible, s.lit, self._odds_of_light(reached, light, f, local, vertex))
            self.training.record_light(s, cell, light, contribution, visible)

        # ---- Advance; roulette by expected light
        assert isinstance(scattered, GuidedScattered)
        self.training.record(s, cell, scattered, ~self.ends(vertex))
        known = s.active & (scattered.glow > 0.0)
        carried = brightness(s.throughput) * scattered.glow
        s.expected = dr.select(known, carried, s.expected * dr.max(scattered.weight))
        s.expected_at_first = dr.select(known & (s.expected_at_first == 0.0), carried, s.expected_at_first)
        s.cell = dr.select(scattered.is_null, s.cell, cell)
        s.pdf = self.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
        estimated = s.expected_at_first > 0.0
        ratio = mi.Spectrum(dr.maximum(_WINDOW * s.expected / s.expected_at_first, _LEAST_SURVIVAL))
        by = dr.select(estimated, ratio, s.throughput * scattered.weight)
        eta = dr.select(estimated, 1.0, s.eta * scattered.eta)
        plain_by = s.throughput * scattered.weight * (reached * scattered.likelier)
        factor = self.advance(s, vertex, scattered, source, (by, eta))
        s.expected = s.expected * factor
        # The same roulette without the guide: by throughput.
        _, plain_factor = roulette(plain_by, s.eta, vertex.depth, self.rr_depth, mi.Float(0.0))
        s.odds = self.keep_if_null(scattered, s.odds, reached * dr.select(scattered.is_delta, scattered.likelier, 1.0))
        s.odds *= dr.minimum(plain_factor / factor, 1e6)
        s.plain_pdf = self.keep_if_null(scattered, s.plain_pdf, scattered.plain_pdf)
        return s

    def _odds_of_light(
        self,
        reached: mi.Float,
        light: DirectSample,
        f: Evaluated,
        local: LightTable | LocalLights,
        vertex: WalkVertex,
    ) -> _Odds:
        """Odds of a light point of a vertex with the odds ``reached``."""
        chance: mi.Float | float = 1.0
        if isinstance(local, LocalLights):
            chance = local.likelier(light.light, vertex.si.p, light.active)
        both, plain = (self.weights.together(*pdfs) for pdfs in ((f.pdf, light.pdf), (f.plain_pdf, light.pdf / chance)))
        found = dr.select(light.is_delta, chance, over(both, plain))
        return _Odds(reached * found, found / chance, chance)

    def add(
        self,
        s: GuidedPath,
        contribution: mi.Spectrum,
        active: mi.Bool,
        component: mi.UInt32 | int | None,
        odds: _Odds | None = None,
    ) -> None:
        """Add a contribution; see :meth:`CameraPath.add`."""
        s.add(contribution, active, component)
        # The light of a map may be negative, by a correction at edges; a guide learns from positive values only.
        value = dr.select(active, dr.maximum(brightness(contribution), 0.0), 0.0)
        s.found = s.found + value
        odds = odds or _Odds(s.odds)
        s.plain_square += value * (value * odds.all + 2.0 * odds.own * s.plain)
        s.plain += value * odds.all / odds.aside
