"""The light walk: sub-paths from the lights, whose vertices are stored and connected to the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.film import after_light_scattering
from etendue.scene import brightness

from .. import dimensions as dim
from ..camera import CameraConnection
from ..emission import EmittedRay, emit, seen_through
from ..flight import Passing
from ..lamps.spheres import seen_density
from ..rays import Edge
from ..scattering import Evaluated, Proposal, Scattered, scatter_light
from ..vertex import WalkVertex
from ..walk import ones
from .kinds import Kind, after
from .linear import Carried
from .mis import Weights
from .moments import Moments
from .sinks import SplatSink
from .vertices import LightVertices
from .walk import BidirectionalPath, BidirectionalWalk


@dataclass(kw_only=True)
class LightPath(BidirectionalPath):
    """State of a light sub-path."""

    stored: mi.UInt32  #: vertices stored so far
    kind: mi.UInt32  #: the :class:`Kind` of the vertex that the edge leads to
    from_infinity: mi.Bool  #: whether the edge being traced leaves an infinite light
    light: mi.UInt32 | None  #: number of the light that the path left; None where next event samples it alike
    waiting: mi.Float | None  #: area density that :meth:`Mis.lit` corrects at the end of the first edge; 0 after it
    nonfinite: mi.UInt32
    found: mi.Float | None  #: contributions by splats so far, for a guide of emission; None without
    flux: mi.Float | None  #: flux at the start, relative to which roulette decides; None: the power of all lights


@dataclass(kw_only=True)
class LightWalk(BidirectionalWalk):
    """Traces light sub-paths; :meth:`trace` is one kernel."""

    from_lights: ClassVar[bool] = True
    proposal: Proposal = scatter_light
    kind: type[LightPath] = LightPath  #: class of the state
    spare: int = 1
    sink: SplatSink | None = None
    moments: Moments | None = None

    def trace(
        self, paths: int, source: SampleSource, vertices: LightVertices | None = None
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """Trace ``paths`` sub-paths; their vertices are added to ``vertices`` and splatted to the sink, if given.
        Returns (rays, non-finite splats), one lane per path, not yet evaluated."""
        numbered = self.pyramid is not None or (vertices is not None and vertices.numbered)
        state, path = self.begin(paths, source, numbered), dr.arange(mi.UInt32, paths)
        state = self.walk(state, lambda s: self._edge(s, path, source, vertices), "light walk")
        if vertices is not None:
            vertices.close_paths(path, state.stored)
        if self.training is not None:
            self.training.splatted(state.found)
        return state.rays, state.nonfinite

    def begin(self, paths: int, source: SampleSource, numbered: bool = False, **own: Any) -> LightPath:
        """The state before the first edge of ``paths`` sub-paths. ``numbered``: vertices are counted without null
        surfaces; ``own``: fields of a subclass of the state ``kind``."""
        emitted = emit(self.lights, source, mi.Bool(True), self.departures)
        if self.training is not None:
            self.training.begin(emitted)
        d_vcm, d_vc = self.mis.start_light(
            emitted.area_density, emitted.emission_density, emitted.cos_light, emitted.is_delta
        )
        # Next event picks lights by the place that they light, and samples spherical ones by solid angle, and skies
        # through windows: its density depends on the end of the first edge.
        depends = self.lights.has_sphere or self.lights.groups is not None or self.lights.windows is not None
        waits = depends and self.mis.techniques.next_event > 0
        return self.kind(
            **own,
            active=emitted.active & (self.max_edges > 1),
            ray=emitted.ray,
            throughput=emitted.throughput,
            eta=None,
            d_vcm=d_vcm,
            d_vc=d_vc,
            depth=dr.full(mi.UInt32, 1, paths),
            vertex=mi.UInt32(1) if numbered else None,
            place=self.start,
            stored=dr.zeros(mi.UInt32, paths),
            kind=dr.select(emitted.area_density > 0.0, mi.UInt32(Kind.DIRECT), mi.UInt32(Kind.BEAM)),
            from_infinity=emitted.is_infinite,
            light=mi.UInt32(emitted.light) if waits else None,
            waiting=mi.Float(emitted.area_density) if waits else None,
            travelled=mi.Float(0.0),
            rays=dr.zeros(mi.UInt32, paths),
            nonfinite=dr.zeros(mi.UInt32, paths),
            found=None if self.training is None else dr.zeros(mi.Float, paths),
            flux=self._flux(emitted),
            flight=self.flight_from(emitted.light, emitted.ray),
        )

    def _flux(self, emitted: EmittedRay) -> mi.Float | None:
        """Flux of the paths at their start: those from lights that are picked more often than by power, or along
        learned directions or through learned places, have little, but contribute as much."""
        if self.departures is not None or self.lights.lines is not None:
            return dr.sum(emitted.throughput) / float(dr.size_v(mi.Spectrum))
        return None if self.lights.count == 1 else self.lights.flux_of(emitted.light, emitted.active)

    def _edge(self, s: LightPath, path: mi.UInt32, source: SampleSource, vertices: LightVertices | None) -> LightPath:
        """Trace one edge; splat, store and scatter at its end."""
        vertex = self.arrive(s, source)
        s.active &= vertex.valid
        on_edge, light_cos = self.land(s, vertex)
        place = None
        if self.choice is not None:
            place = self.choice.classify(vertex.si)
            s.d_vcm = self.mis.chosen(s.d_vcm, self.choice.pair(place, s.place, s.active)[1])

        # ---- Store
        smooth = s.active & vertex.smooth
        used = smooth & (s.kind != mi.UInt32(Kind.DIRECT)) if self.mis.techniques.leaves_direct else smooth
        if vertices is not None:
            mis, fluence = (s.d_vcm, s.d_vc), self.mis.fluence(light_cos)
            kept = smooth if vertices.connected else used
            kind = self._drawn(s.kind, vertex, source)
            vertices.append(path, s.stored, vertex, s.throughput, fluence, mis, kind, kept, self.number(s), place)
            s.stored += ones(kept)

        # ---- Splat and scatter. The next vertex is useful only if the path may have two more edges
        s.active &= self.goes_on(s, vertex)
        if self.sink is None:
            scattered, _ = vertex.sample(source, s.active)
        else:
            joined = self.camera.connect(vertex.si, self.camera.splat_aperture(source, vertex.number), used)
            scattered, (f,) = vertex.sample(source, s.active, [joined])
            self._splat(s, path, vertex, joined, light_cos, f, source, self.sink)

        # ---- Advance
        self.go_on(s, vertex, scattered, source, on_edge, light_cos, place)
        return s

    def _drawn(self, kind: mi.UInt32, vertex: WalkVertex, source: SampleSource) -> mi.UInt32:
        """The kind to store, with those vertices marked that are not to be merged."""
        if not self.mis.techniques.thins:
            return kind
        u = source.decide(vertex.number, dim.MERGED)
        unmerged = (kind == mi.UInt32(Kind.DIFFUSE)) & (u >= self.mis.techniques.diffuse)
        return dr.select(unmerged, mi.UInt32(Kind.UNMERGED), kind)

    def land(self, s: LightPath, vertex: WalkVertex) -> tuple[tuple[Carried, Carried], mi.Float]:
        """Convert ``d_vcm`` and ``d_vc`` to area at the end of an edge: (the two before, cosine at which light
        arrives)."""
        on_edge = s.d_vcm, s.d_vc
        light_cos = vertex.cos(vertex.incoming)
        distance_squared = dr.square(vertex.distance)
        if self.lights.has_infinite:
            distance_squared = dr.select(s.from_infinity, 1.0, distance_squared)
        d_vcm = s.d_vcm
        if s.waiting is not None:
            waits = s.active & (s.waiting > 0.0)
            light = self.lights.at(vertex.position).row(s.light, waits)
            waiting = dr.select(waits, s.waiting, 1.0)
            alone = waiting / dr.select(waits, self.lights.row(s.light, waits).pick, 1.0)
            density = light.pick * alone
            if self.lights.windows is not None:
                infinite = waits & light.is_infinite
                seen = seen_through(self.lights, light, vertex.position, -vertex.incoming, alone, infinite)
                density = dr.select(infinite, seen, density)
            if self.lights.has_sphere:
                density = seen_density(light, vertex.position, -vertex.incoming, vertex.distance, density)
            d_vcm = self.mis.lit(d_vcm, dr.select(waits, density / waiting, 1.0))
        s.d_vcm, s.d_vc = self.mis.hit(*self.passed(vertex, d_vcm, s.d_vc), distance_squared, light_cos)
        return on_edge, light_cos

    def go_on(
        self,
        s: LightPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        on_edge: tuple[Carried, Carried],
        light_cos: mi.Float,
        place: mi.UInt32 | None = None,
    ) -> None:
        """Leave a vertex of the class ``place``; ``on_edge`` and ``light_cos`` are those of :meth:`land`."""
        sampled = scattered.cos, scattered.pdf, scattered.reverse_pdf, scattered.is_delta
        mis = self.mis.at(self.share(vertex))
        s.d_vcm, s.d_vc = mis.scatter_light(s.d_vcm, s.d_vc, light_cos, *sampled, mis.merged(s.kind))
        if mis.techniques.thins:
            kind = after(s.kind, scattered.pdf, scattered.is_delta)
        else:
            kind = after_light_scattering(s.kind, scattered.is_delta)
        s.kind = self.keep_if_null(scattered, s.kind, kind)
        s.from_infinity = self.keep_if_null(scattered, s.from_infinity, mi.Bool(False))
        if s.waiting is not None:
            s.waiting = self.keep_if_null(scattered, s.waiting, mi.Float(0.0))
        relative = s.throughput * scattered.weight / (self.lights.flux if s.flux is None else s.flux)
        self.leave(s, vertex, scattered, source, on_edge, (relative, 1.0), place)

    def _splat(
        self,
        s: LightPath,
        path: mi.UInt32,
        vertex: WalkVertex,
        joined: CameraConnection,
        light_cos: mi.Float,
        f: Evaluated,
        source: SampleSource,
        sink: SplatSink,
    ) -> None:
        """Connect the vertex to the camera (t = 1) [Georgiev 2012b, eq. 46, 47]."""
        area_pdf = joined.area_pdf(vertex.cos(joined.direction))
        place = sink.splats.place(joined, source, vertex.number)
        factor = joined.importance * place.weight * vertex.cosine_ratio(joined.direction)
        alone = s.throughput * f.value

        def weigh(passing: Passing | None) -> tuple[Weights, list[mi.Spectrum]]:
            density = area_pdf if passing is None else area_pdf * passing.to_start
            mis = self.mis.at(self.share(vertex))
            ends = s.d_vcm, s.d_vc, light_cos, f.reverse_pdf, density
            weights = mis.splat_weight(*ends, mis.merged(s.kind) if mis.techniques.thins else None)
            return weights, [alone * (factor * weight) for weight in weights]

        # Splats are summed over paths, camera paths over samples: the threshold is scaled accordingly.
        threshold, u = self.dark * self.mis.paths_per_sample, source.decide(vertex.number, dim.SPLAT_SHADOW)
        on_film = joined.active & place.on_film
        roulette = alone * factor, threshold, u
        edge = self.connect(vertex, joined.target, s.depth + 1, weigh, *roulette, on_film, by_camera=True)
        contribution, weights = edge.contribution, edge.weights
        s.rays += edge.rays
        if self.rays is not None:
            self.record(Edge.SPLAT, vertex, joined.target, contribution, path, self.rays.on_film(joined.position))
        if self.moments:
            self.moments.splat(joined.position, contribution.weighted[0], weights.ratios, contribution.active)
        if self.training is not None:
            x, y = (mi.UInt32(dr.maximum(coordinate, 0.0)) for coordinate in joined.position)
            worth = self.training.worth(y * self.camera.width + x, contribution.active)
            value = brightness(contribution.weighted[0]) * worth / self.mis.paths_per_sample
            s.found = s.found + dr.select(contribution.active & dr.isfinite(value), value, 0.0)
        s.nonfinite += ones(sink.add(self.number(s) + 1, place, contribution, s.kind))
