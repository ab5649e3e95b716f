"""The camera walk: sub-paths from the sensor, with emission, next event, connections and merging at each vertex."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.film import REFLECTED, Component, by_component

from .. import dimensions as dim
from ..emission import DirectSample
from ..flight import Passing
from ..guiding.connections import ConnectionTraining
from ..rays import Edge
from ..scattering import Evaluated
from ..vertex import WalkVertex
from ..walk import ones
from .cache import LightCache, Pick
from .mis import Left, Weights
from .moments import Moments, Sums
from .photons import Gather, weigh as weigh_photon
from .sinks import CameraSink, Contribution
from .vertices import LightVertex
from .walk import BidirectionalPath, BidirectionalWalk


@dataclass(kw_only=True)
class _State(BidirectionalPath):
    """Loop state, one lane per camera sub-path."""

    lane: mi.UInt32  #: number of the camera path; does not change
    layers: dict[str, mi.Spectrum]  #: technique family -> radiance
    worth: mi.Float | None  #: factor on contributions to its pixel in the training of a guide; None without
    sums: Sums | None  #: of ``moments``
    #: :meth:`Mis.left_out` at the vertex that the edge leaves, and from its end on, what d_vc still lacks.
    left: Left | None


@dataclass
class _Joined:
    """An untraced edge from a camera vertex to a light vertex."""

    vertex: LightVertex
    direction: mi.Vector3f  #: world, towards the light vertex
    inverse_square: mi.Float
    active: mi.Bool
    pick: Pick | None  #: how the vertex was chosen; None: uniformly


@dataclass(kw_only=True)
class CameraWalk(BidirectionalWalk):
    """Traces camera sub-paths; :meth:`trace` is one kernel."""

    # The rest of a path costs less than a new path with its light paths; measured on ten scenes.
    survival: float = 2.0
    sink: CameraSink
    seen: bool = True  #: whether lights that the camera sees directly contribute
    cache: LightCache | None = None
    gather: Gather | None = None
    gather_in_media: Gather | None = None
    moments: Moments | None = None
    choosing: ConnectionTraining | None = None  #: learns which light vertices connections should prefer

    def trace(
        self, pixel: mi.UInt32, source: SampleSource, number: mi.UInt32 | None = None
    ) -> tuple[dict[str, mi.Spectrum], mi.UInt32]:
        """Trace one camera path for each entry of ``pixel``. ``number``: of each path in the pass, for the choice of
        light vertices; None: that of its lane. Returns (layers of radiance, rays), one lane per path, not yet
        evaluated."""
        return self.follow(self.camera.primary(pixel, source), pixel, source, number)

    def follow(
        self,
        primary: tuple[mi.Ray3f, mi.Spectrum, mi.Point2f],
        pixel: mi.UInt32,
        source: SampleSource,
        number: mi.UInt32 | None = None,
    ) -> tuple[dict[str, mi.Spectrum], mi.UInt32]:
        """:meth:`trace` for the given camera rays: (ray, weight, aperture sample)."""
        lanes = dr.width(pixel)
        ray, importance, aperture = primary
        # The first edge starts at the aperture, its ray at the near plane.
        density, lead = self.camera.density(ray, aperture)
        d_vcm, d_vc = self.mis.start_camera(density)
        learner = self.training or self.choosing
        state = _State(
            active=dr.full(mi.Bool, True, lanes) & (self.max_edges > 0),
            ray=mi.Ray3f(ray),
            throughput=dr.full(mi.Spectrum, 1.0, lanes),
            eta=dr.full(mi.Float, 1.0, lanes),
            d_vcm=d_vcm,
            d_vc=d_vc,
            depth=dr.full(mi.UInt32, 1, lanes),
            vertex=mi.UInt32(1),
            travelled=lead,
            rays=dr.zeros(mi.UInt32, lanes),
            seen=mi.UInt32(Component.EMISSION) if self.sink.components else None,
            through=self.first.through if self.first else None,
            hidden=self.visibility.hidden,
            lane=dr.arange(mi.UInt32, lanes) if number is None else mi.UInt32(number),
            layers=self.sink.begin(self.mis.techniques, pixel, importance),
            worth=learner.worth_of_lane(pixel, dr.arange(mi.UInt32, lanes)) if learner else None,
            place=self.start,
            sums=self.moments.begin(lanes, importance) if self.moments else None,
            left=self.mis.nothing_left(lanes),
        )
        state = self.walk(state, lambda s: self._edge(s, source), "camera walk")
        if self.moments and state.sums:
            self.moments.close(state.sums, pixel)
        return {name: radiance * importance for name, radiance in state.layers.items()}, state.rays

    def _edge(self, s: _State, source: SampleSource) -> _State:
        """Trace one edge, apply the techniques at its end, and scatter."""
        techniques = self.mis.techniques
        vertex = self.arrive(s, source)

        # ---- Arrive. Emission of the environment has densities per solid angle: no conversion where the ray missed
        on_edge = s.d_vcm, s.d_vc
        cos = vertex.cos(vertex.incoming)
        s.d_vcm, s.d_vc = self.passed(vertex, *on_edge)
        d_vcm, d_vc = self.mis.hit(s.d_vcm, s.d_vc, dr.square(vertex.distance), cos)
        s.d_vcm, s.d_vc = dr.select(vertex.valid, d_vcm, s.d_vcm), dr.select(vertex.valid, d_vc, s.d_vc)
        left = s.left
        if left is not None:
            s.left = self.mis.landed(left, dr.select(vertex.valid, cos, 1.0), vertex.passing)
        self._emission(s, vertex)
        s.active &= vertex.valid
        if s.left is not None and s.left.splat is not None:
            s.d_vc, s.left = s.d_vc + s.left.splat, Left(s.left.merge, None)

        place, ratio, share = None, None, self.share(vertex)
        if self.choice is not None:
            place = self.choice.classify(vertex.si)
            ratio = self.choice.pair(s.place, place, s.active)[1]
        s.d_vcm = self.mis.joined(self.number(s), s.d_vcm, ratio)

        smooth = s.active & vertex.smooth
        if s.sums is not None:
            s.sums.edges = s.sums.edges + 1
            s.sums.smooth = s.sums.smooth + ones(smooth)
        if techniques.merge and self.gather is not None:
            in_medium = vertex.bsdf.in_medium
            self._merge(self.gather, s, vertex, share, smooth if in_medium is None else smooth & ~in_medium)
            if self.gather_in_media is not None and in_medium is not None:
                self._merge(self.gather_in_media, s, vertex, share, smooth & in_medium)
        s.active &= self.goes_on(s, vertex)
        smooth &= s.active

        # ---- Light points: the BSDF is sampled, and evaluated for all of them, in one call
        lights = [self.light_point(vertex, source, smooth, index) for index in range(techniques.next_event)]
        scattered, evaluated = vertex.sample(source, s.active, lights)
        for index, (light, f) in enumerate(zip(lights, evaluated, strict=True)):
            u = source.decide(vertex.number, dim.NEXT_EVENT + 4 * index + 3)
            self._next_event(s, vertex, light, f, u, share)

        # ---- Light vertices: by the same function as their own BSDFs and merges, so that kernels stay small
        connections = []
        for index, joined in enumerate(self._pick_vertices(s, vertex, place, smooth)):
            u = source.decide(vertex.number, dim.CONNECT + index)
            contribution, weights, rays = self._connection(s, vertex, joined, u, share)
            s.rays += rays
            self.sink.add(s.layers, "connection", contribution, joined.active, Component.INDIRECT)
            if self.choosing is not None and joined.pick is not None:
                pick, value = joined.pick, contribution[0] * joined.pick.chance
                self.choosing.add(pick.camera, joined.vertex.place, value, s.worth, pick.drawn, joined.active)
            connections.append((contribution[0], weights.ratios, joined.active))
        if self.moments and s.sums:
            self.moments.add_connections(s.sums, connections)
        if self.cache is not None and self.cache.picks is None:
            self._connect_pair(s, vertex, source.decide(vertex.number, dim.CONNECT), share, smooth)

        # ---- Advance
        sampled, mis = (scattered.cos, scattered.pdf, scattered.reverse_pdf, scattered.is_delta), self.mis.at(share)
        d_vc = mis.completed(s.d_vc, s.left, scattered.reverse_pdf, scattered.is_delta)
        if left is not None:
            new = mis.left_out(self.number(s), s.d_vcm, scattered.cos, scattered.pdf, scattered.is_delta)
            s.left = self.keep_if_null(scattered, left, new)
        s.d_vcm, s.d_vc = mis.scatter_camera(self.number(s), s.d_vcm, d_vc, *sampled)
        self.leave(s, vertex, scattered, source, on_edge, place=place)
        return s

    def _emission(self, s: _State, vertex: WalkVertex) -> None:
        """s = 0 [Georgiev 2012b, eq. 43]."""
        hit = self.emission(s, vertex)
        if not self.seen:
            hit.active &= self.number(s) > 1
        number, d_vc = self.number(s), self.mis.completed(s.d_vc, s.left)
        if self.mis.techniques.leaves_direct:
            d_vc = dr.select(hit.area_density > 0.0, s.d_vc, d_vc)
        weights = self.mis.emission_weight(number, s.d_vcm, d_vc, hit.area_density, hit.emission_density)
        alone = s.throughput * hit.radiance
        values = [alone * weight for weight in weights]
        self.sink.add(s.layers, "emission", values, hit.active, s.seen)
        if self.moments and s.sums:
            self.moments.add(s.sums, "emission", values[0], weights.ratios, hit.active)
        self.sink.show(mi.UInt32(0), number + 1, Contribution(values, alone, hit.active, hit.active))

    def _next_event(
        self,
        s: _State,
        vertex: WalkVertex,
        light: DirectSample,
        f: Evaluated,
        u: mi.Float,
        share: mi.Float | None,
    ) -> None:
        """s = 1 [Georgiev 2012b, eq. 44, 45]."""
        number, cos = self.number(s), vertex.cos(light.direction)
        hit_pdf = dr.select(light.is_delta, 0.0, f.pdf)
        count, d_vc = self.mis.techniques.next_event, self.mis.completed(s.d_vc, s.left, f.reverse_pdf)
        alone = s.throughput * f.value * light.radiance

        def weigh(passing: Passing | None) -> tuple[Weights, list[mi.Spectrum]]:
            to_light, to_vertex = hit_pdf, light.light_ratio * cos
            if passing is not None:
                to_light, to_vertex = to_light * passing.to_end, to_vertex * passing.to_start
            weights = self.mis.at(share).next_event_weight(
                number, s.d_vcm, d_vc, cos, to_light, f.reverse_pdf, light.pdf, to_vertex
            )
            return weights, [alone * (weight / count) for weight in weights]

        joined = self.connect(vertex, light.target, s.depth + 1, weigh, alone / count, self.dark, u, light.active)
        contribution, weights, values = joined.contribution, joined.weights, joined.unshadowed
        s.rays += joined.rays
        self.record(Edge.NEXT_EVENT, vertex, light.target, contribution)
        self.sink.show(mi.UInt32(1), number + 1, contribution)
        self.sink.add(s.layers, "next_event", contribution.weighted, contribution.active, s.lit)
        if self.moments and s.sums:
            self.moments.add(s.sums, "next_event", contribution.weighted[0], weights.ratios, contribution.active)
        if self.training is not None:
            found, unshadowed = (contribution.weighted[0], contribution.active), (values[0], light.active)
            self.training.add_light(light.light, found, unshadowed, s.worth)

    def _pick_vertices(self, s: _State, vertex: WalkVertex, place: mi.UInt32 | None, active: mi.Bool) -> list[_Joined]:
        """Edges from a camera vertex of the class ``place`` to light vertices sampled from the cache."""
        if self.cache is None or self.cache.picks is None:
            return []
        picked = [
            self.cache.draw(s.lane, s.depth, index, place, active, self.visibility)
            for index in range(self.mis.techniques.connection)
        ]
        return [self._join(s, vertex, light, drawn, pick) for light, drawn, pick in picked]

    def _connect_pair(
        self, s: _State, vertex: WalkVertex, u: mi.Float, share: mi.Float | None, active: mi.Bool
    ) -> None:
        """Connect to every vertex of the light path with the number of this camera path."""
        assert self.cache is not None
        stored = self.cache.vertices
        first, count = stored.path_vertices(s.lane % self.cache.paths, active)

        def connect(
            j: mi.UInt32, totals: list[mi.Spectrum], rays: mi.UInt32
        ) -> tuple[mi.UInt32, list[mi.Spectrum], mi.UInt32]:
            light = stored.read(stored.slot(first + j, active), active, self.visibility)
            joined = self._join(s, vertex, light, active)
            # One random number for all connections of the vertex: each is unbiased, though they are correlated.
            values, _, ray = self._connection(s, vertex, joined, u, share)
            return j + 1, [total + value for total, value in zip(totals, values, strict=True)], rays + ray

        n = dr.width(s.depth)
        _, totals, rays = dr.while_loop(
            (dr.zeros(mi.UInt32, n), self._blank(n), dr.zeros(mi.UInt32, n)),
            lambda j, *_: active & (j < count),
            connect,
            label="connect",
        )
        s.rays += rays
        self.sink.add(s.layers, "connection", totals, active, Component.INDIRECT)

    def _blank(self, lanes: int, parts: int = 1) -> list[mi.Spectrum]:
        """Zero radiance for each radius, divided into ``parts`` for the first radius."""
        return [dr.zeros(mi.Spectrum, lanes) for _ in range(parts + len(self.sink.more_radii))]

    def _join(
        self, s: _State, vertex: WalkVertex, light: LightVertex, active: mi.Bool, pick: Pick | None = None
    ) -> _Joined:
        """The edge between a camera vertex and a light vertex."""
        offset = light.position - vertex.position
        distance_squared = dr.squared_norm(offset)
        active = active & (light.depth + s.depth + 1 <= self.max_edges) & (distance_squared > 0.0)
        return _Joined(light, offset * dr.rsqrt(distance_squared), dr.rcp(distance_squared), active, pick)

    def _connection(
        self, s: _State, vertex: WalkVertex, joined: _Joined, u: mi.Float, share: mi.Float | None
    ) -> tuple[list[mi.Spectrum], Weights, mi.UInt32]:
        """s >= 2, t >= 2: (weighted contribution by radius, weights, shadow rays) [Georgiev 2012b, eq. 40, 41]."""
        assert self.cache is not None
        other, number, pick = joined.vertex, self.number(s), joined.pick
        f = vertex.evaluate(joined.direction, joined.active)
        d_vc = self.mis.completed(s.d_vc, s.left, f.reverse_pdf)
        active = joined.active & ~dr.all(f.value == 0.0)
        f_light = other.evaluate(-joined.direction, active)
        cos = vertex.cos(joined.direction)
        alone = s.throughput * other.throughput * f.value * f_light.value
        alone *= joined.inverse_square * other.cosine_ratio(joined.direction) * self.cache.factor
        if pick is not None:
            alone /= pick.chance
        if self.visibility.disperses:  # both sub-paths count the hero four times
            both = vertex.hero_goes_on(joined.direction) & other.hero_goes_on(-joined.direction)
            alone = dr.select(both, 0.25 * alone, alone)

        def weigh(passing: Passing | None) -> tuple[Weights, list[mi.Spectrum]]:
            to_light = f.pdf * other.cos(joined.direction) * joined.inverse_square
            to_camera = f_light.pdf * cos * joined.inverse_square
            if passing is not None:
                to_light, to_camera = to_light * passing.to_end, to_camera * passing.to_start
            weights = self.mis.at(share).connection_weight(
                number,
                (s.d_vcm, d_vc),
                (other.d_vcm, other.d_vc),
                cos,
                other.cos(other.direction),
                to_light,
                to_camera,
                f.reverse_pdf,
                f_light.reverse_pdf,
                f_light.pdf,
                pick.ratio if pick else None,
                self.mis.merged(other.kind),
                self.mis.at(self.share(other)),
            )
            return weights, [alone * weight for weight in weights]

        edges = other.depth + s.depth + 1
        edge = self.connect(vertex, other.position, edges, weigh, alone, self.dark, u, active, end=other.extinction)
        contribution = edge.contribution
        self.record(Edge.CONNECTION, vertex, other.position, contribution, other.path)
        self.sink.show(other.number + 1, number + 1, contribution)
        if self.training is not None:
            self.training.add(other.path, contribution.weighted[0], s.worth, contribution.active)
        return [dr.select(contribution.active, value, 0.0) for value in contribution.weighted], edge.weights, edge.rays

    def _merge(self, gather: Gather, s: _State, vertex: WalkVertex, share: mi.Float | None, active: mi.Bool) -> None:
        """s >= 2, t >= 2, no edge between them [Georgiev 2012b, eq. 38, 39]."""
        if not self.mis.techniques.merge_first:
            active = active & (self.number(s) > 1)

        parts, photons = 1 if s.seen is None else len(REFLECTED), gather.photons
        area = share
        if vertex.bsdf.in_medium is not None:
            area = None if gather.in_media or not self.places else self.places.share(vertex.position)
        squares, factors = gather.at(area)

        def visit(
            photon: mi.UInt32, found: tuple[list[mi.Spectrum], Sums | None]
        ) -> tuple[list[mi.Spectrum], Sums | None]:
            values, weights = self._merged(gather, s, vertex, photon, area, share, active)
            totals, sums = found
            if self.moments and sums:
                sums.photons = sums.photons + 1
                self.moments.add(sums, "merge", s.throughput * values[0] * factors[0], weights.ratios, active)
            if s.seen is not None:
                values[:1] = by_component(values[0], photons.component(photon, active))
            return [total + value for total, value in zip(totals, values, strict=True)], sums

        found = self._blank(1, parts), s.sums
        widest = None if area is None else functools.reduce(dr.maximum, squares)
        totals, s.sums = gather.around(vertex.position, self.max_edges - s.depth, visit, found, active, widest)
        for component, total in s.components_of(totals[:parts]):
            self.sink.add_first(s.layers, "merge", s.throughput * total * factors[0], active, component)
        more = [s.throughput * total * factor for total, factor in zip(totals[parts:], factors[1:], strict=True)]
        self.sink.add_more(s.layers, more, active)

    def _merged(
        self,
        gather: Gather,
        s: _State,
        vertex: WalkVertex,
        photon: mi.UInt32,
        area: mi.Float | None,
        share: mi.Float | None,
        active: mi.Bool,
    ) -> tuple[list[mi.Spectrum], Weights]:
        """(weighted contribution of one photon, by radius; weights). ``area``: see :meth:`Gather.at`."""
        photons, number = gather.photons, self.number(s)
        squares, factors = gather.at(area)
        p, position = photons.read(photon, active), photons.position(photon, active)[0]
        f = vertex.evaluate(p.direction, active)
        merged = self.mis.merged(photons.kind(photon, active)) if self.mis.techniques.thins else None
        ends = (s.d_vcm, self.mis.completed(s.d_vc, s.left, f.reverse_pdf)), (p.d_vcm, p.d_vc)
        weights = self.mis.at(share).merge_weight(*ends, f.pdf, f.reverse_pdf, merged)
        distance_squared, weight = weigh_photon(vertex, position, p, gather.in_media)
        value = p.fluence * f.value * (weight if merged is None else weight / merged)
        inside = [distance_squared <= square for square in squares]
        if self.pyramid is not None:
            alone = value * s.throughput * factors[0]
            here = active & inside[0]
            merged = Contribution([alone * weights[0]], alone, here, here)
            self.sink.show(photons.number(photon, active) + 1, number + 1, merged, merged=True)
        if self.rays is not None:
            brought = value * s.throughput * (factors[0] * weights[0])
            self.rays.joined(Edge.MERGE, vertex, position, brought, active & inside[0], photons.path(photon, active))
        if self.training is not None:
            credit = value * s.throughput * (factors[0] * weights[0])
            self.training.add(photons.path(photon, active), credit, s.worth, active & inside[0])
        return [dr.select(ok, value * w, 0.0) for ok, w in zip(inside, weights, strict=True)], weights
