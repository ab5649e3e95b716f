"""Random walks, edge by edge: the operations from which every path method is composed.

A method writes the body of the loop over the edges of its paths. Each iteration traces one edge to a
:class:`WalkVertex`, adds the contributions of that vertex, and advances::

    vertex = walker.arrive(path, source)
    light = walker.light_point(vertex, source, path.active & vertex.smooth)
    scattered, (f,) = vertex.sample(source, path.active, [light])
    contribution, visible = walker.next_event(path, vertex, light, f, weights)
    walker.advance(path, vertex, scattered, source)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, TypeVar

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource, UnsupportedError
from etendue.film import COMPONENTS, Component, after_scattering, reflected
from etendue.scene import LightTable

from . import dimensions as dim
from .direct import DirectWeights
from .emission import DirectSample, emission_of_hit, is_emissive, sample_direct
from .firsthits import FirstHits
from .flight import Arrival, Flight, draw_channel, free_path, mean
from .guiding.departure import Departures
from .guiding.lights import LocalLights
from .loop import loop_traced_once
from .rays import Edge, WalkRecorder
from .scattering import Evaluated, Proposal, Scattered, roulette, scatter_camera
from .tracking import Tracked, keys_of_ray, keys_of_walk, track
from .vertex import WalkVertex
from .visibility import Sight, Visibility, is_lamp, past_lamps


@dataclass(kw_only=True)
class SubPath:
    """State of the loop over the edges of a sub-path, one lane each. Methods add fields of their own."""

    active: mi.Bool
    ray: mi.Ray3f  #: the next edge
    throughput: mi.Spectrum
    eta: mi.Float | None  #: product of the relative indices of refraction; None for light sub-paths
    depth: mi.UInt32  #: number of edges, including the next one; null surfaces count unless they bound a medium
    travelled: mi.Float  #: length of the next edge up to the last null surface that it has crossed
    rays: mi.UInt32  #: rays cast so far, including shadow rays
    #: The ``film.Component`` of a light at the end of the next edge of a camera path; None if components are not kept.
    seen: mi.UInt32 | None = None
    #: Media along the next edge; None in scenes without media, and for walks that do not see them.
    flight: Flight | None = None
    #: Whether mirrors, glass and null surfaces only are between the camera and the next edge, each passed in its most
    #: likely way; None unless it is recorded what is seen in them.
    through: mi.Bool | None = None
    #: Whether lights on the next edge are hidden: it leaves the camera, or null surfaces seen from there. None unless
    #: the camera sees no lights.
    hidden: mi.Bool | None = None

    def components_of(self, values: Sequence[mi.Spectrum]) -> list[tuple[mi.UInt32 | None, mi.Spectrum]]:
        """(component, light) that the vertex at the end of the edge reflects. ``values``: all light as one value; with
        ``seen``, one value for each of ``film.REFLECTED``, for an eye that sees the vertex directly."""
        if self.seen is None:
            (value,) = values
            return [(None, value)]
        directly, indirect = self.seen == int(Component.EMISSION), mi.UInt32(Component.INDIRECT)
        numbered = enumerate(values, int(Component.DIRECT))
        return [(dr.select(directly, mi.UInt32(number), indirect), value) for number, value in numbered]

    @property
    def lit(self) -> mi.UInt32 | None:
        """Component of light that comes directly from a light and is reflected by the vertex at the end of the edge."""
        return None if self.seen is None else reflected(self.seen)


@dataclass
class MapEnd:
    """Where a path ends in a map, one lane each."""

    reached: mi.Bool
    position: mi.Point3f
    normal: mi.Normal3f  #: geometric, on the side of the path
    throughput: mi.Spectrum  #: including the albedo
    depth: mi.UInt32  #: edges of the path up to there, one more if the end depends on a choice at the last vertex
    scatterings: mi.UInt32  #: of the path so far, by surfaces other than mirrors, glass and null surfaces
    #: For maps that reflect particles by their directions: the last edge, and lanes whose throughput does not include
    #: the albedo.
    ray: mi.Ray3f | None = None
    by_directions: mi.Bool | None = None

    @classmethod
    def none(cls, by_directions: bool = False) -> MapEnd:
        """Before the first edge."""
        end = cls(mi.Bool(False), mi.Point3f(0.0), mi.Normal3f(0.0), mi.Spectrum(0.0), mi.UInt32(0), mi.UInt32(0))
        if by_directions:
            end.ray, end.by_directions = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(0.0, 0.0, 1.0)), mi.Bool(False)
        return end


@dataclass(kw_only=True)
class CameraPath(SubPath):
    """State of a camera path that finds lights by hits and light points."""

    radiance: mi.Spectrum  #: sum of the contributions
    pdf: mi.Float  #: solid-angle density of the next edge's direction; 0 where only a hit can find a light
    end: MapEnd | None = None  #: where the path ends in a map, if paths do
    by_component: list[mi.Spectrum] = field(default_factory=list)  #: ``radiance`` by component; empty without ``seen``

    def add(self, value: mi.Spectrum, active: mi.Bool, component: mi.UInt32 | int | None) -> None:
        """Add a contribution. ``component``: ``seen`` for a light at the end of the edge, :attr:`lit` for a light point
        sampled at the vertex there."""
        self.radiance[active] += value
        for number, part in enumerate(self.by_component):
            if not isinstance(component, int):
                part[active & (component == number)] += value
            elif component == number:
                part[active] += value

    def weigh(self, importance: mi.Spectrum) -> None:
        """Multiply all that was found by the weight of the camera ray."""
        self.radiance = self.radiance * importance
        self.by_component = [part * importance for part in self.by_component]

    @classmethod
    def start(cls, ray: mi.Ray3f, max_edges: mi.UInt32, **own: Any) -> Self:
        """The state before the first edge, along ``ray``. ``own``: fields of the subclass, or other initial values."""
        fields = {
            "active": max_edges > 0,
            "ray": mi.Ray3f(ray),
            "throughput": mi.Spectrum(1.0),
            "eta": mi.Float(1.0),
            "depth": mi.UInt32(1),
            "travelled": mi.Float(0.0),
            "rays": mi.UInt32(0),
            "radiance": mi.Spectrum(0.0),
            "pdf": mi.Float(0.0),
        }
        return cls(**fields | own)


def component_fields() -> dict[str, Any]:
    """Additional fields for :meth:`CameraPath.start` if the contributions of a camera path are kept by component."""
    # Opaque, because Dr.Jit fails on literal zeros in a loop if no material of the scene adds to them.
    parts = [mi.Spectrum(dr.opaque(mi.Float, 0.0)) for _ in COMPONENTS]
    return {"seen": mi.UInt32(Component.EMISSION), "by_component": parts}


S = TypeVar("S", bound=SubPath)
V = TypeVar("V")


@dataclass
class Emission:
    """Emission at the end of an edge, one lane each. Densities include the choice of the light."""

    radiance: mi.Spectrum
    area_density: mi.Float  #: of the point under next event at the edge's start; of the direction for infinite lights
    emission_density: mi.Float  #: of point and direction under emission
    direct_pdf: mi.Float  #: solid-angle density under next event at the edge's start
    active: mi.Bool


@dataclass(kw_only=True)
class Walker:
    """Traces sub-paths in one scene."""

    from_lights: ClassVar[bool] = False
    visibility: Visibility
    lights: LightTable
    max_edges: mi.UInt32  #: opaque
    rr_depth: int
    survival: float = 1.0  #: factor on the probability by which a path survives roulette
    spare: int = 0  #: edges that the path needs after the walk's last vertex
    by_albedo: bool = False  #: roulette by the reflectance of each vertex, not by the throughput of the path
    proposal: Proposal = scatter_camera  #: samples directions
    departures: Departures | None = None  #: learned directions of emission, for its densities
    #: Side of a pixel's footprint at the first hit, on a plane that faces the sensor; None if no texture asks for it.
    footprint: Callable[[mi.Point3f], mi.Float] | None = None
    first: FirstHits | None = None  #: records the surfaces that the first edges hit
    rays: WalkRecorder | None = None  #: records all edges

    def walk(self, path: S, edge: Callable[[S], S], label: str) -> S:
        """Run the loop over the edges until all sub-paths have ended. ``edge`` is the body of the loop. Paths without a
        flight start in the medium of the sensor."""
        media = self.visibility.media
        if media is not None and path.flight is None:
            path.flight = Flight.begin(media, media.of_sensor)
        return loop_traced_once(path, lambda s: s.active, edge, label)

    def arrive(self, s: SubPath, source: SampleSource | None = None) -> WalkVertex:
        """Trace the next edge, to a surface or to a collision in a medium. ``source``: for free paths, if the method
        renders media that scatter."""
        ray, free = s.ray, self._free_path(s, source)
        if free is not None:
            ray = mi.Ray3f(ray)
            ray.maxt = dr.minimum(ray.maxt, free)
        hit = self.visibility.scene.ray_intersect_preliminary(ray, active=s.active)
        if s.hidden is not None:
            hit = past_lamps(self.visibility.scene, hit, ray, s.active & s.hidden)
        tracked = self._tracked(s, source, hit.t)
        if tracked is not None and free is not None:
            hit.t = dr.select(tracked.collision < dr.inf, dr.inf, hit.t)
            free = dr.minimum(free, tracked.collision)
        si = hit.compute_surface_interaction(s.ray, active=s.active)
        s.rays += 1
        if self.footprint is not None:
            set_footprint(si, s.ray.d, dr.select(s.depth == 1, self.footprint(si.p), 0.0))
        bsdf, medium, offset = self.visibility.material(si, s.ray), None, None
        if self.visibility.measured_on is not None and s.eta is not None:
            si, offset = self.visibility.begin_on_meter(si, bsdf, s.ray, s.depth == 1)
        passing = extinction = None
        if s.flight is not None and self.visibility.media is not None:
            media, medium = self.visibility.media, s.flight.medium
            if free is not None:
                bsdf.in_medium = s.active & ~si.is_valid() & (free < dr.inf)
                _collide(si, s.ray, free, bsdf.in_medium)
                bsdf.pointer = dr.select(bsdf.in_medium, media.material(medium), bsdf.pointer)
            arrival = Arrival.of(media, s.flight, si, bsdf.in_medium, tracked)
            s.throughput = s.throughput * arrival.factor
            passing, extinction = arrival.passing, arrival.extinction
        vertex = WalkVertex(
            si=si,
            bsdf=bsdf,
            medium=medium,
            extinction=extinction,
            number=_number(s),
            depth=mi.UInt32(s.depth),
            hit=hit,
            incoming=s.ray.d,
            distance=s.travelled + si.t,
            valid=si.is_valid(),
            proposal=self.proposal,
            passing=passing,
            offset=offset,
        )
        if self.rays is not None:
            self.rays.arrived(s, vertex)
        return vertex

    def flight_from(self, light: mi.UInt32, ray: mi.Ray3f) -> Flight | None:
        """The flight of paths that leave a light along ``ray``; None in scenes without media."""
        medium = self.visibility.medium_outside(light, ray)
        media = self.visibility.media
        return None if media is None or medium is None else Flight.begin(media, medium)

    def _free_path(self, s: SubPath, source: SampleSource | None) -> mi.Float | None:
        """Distance to the next collision with a homogeneous medium; None if no medium scatters."""
        if s.flight is None or s.flight.passed is None or self.visibility.media is None:
            return None
        if source is None:
            raise UnsupportedError("this walk does not render media that scatter light")
        passed, first = s.flight.passed, _number(s) == 1
        if passed.channel is not None:
            passed.channel = dr.select(first, draw_channel(source, mi.UInt32(0)), passed.channel)
        return free_path(self.visibility.media, s.flight, source, _number(s), s.active)

    def _tracked(self, s: SubPath, source: SampleSource | None, end: mi.Float) -> Tracked | None:
        """Null collisions up to the distance ``end``, and the collision; None if no medium is heterogeneous."""
        media = self.visibility.media
        if s.flight is None or media is None or not media.heterogeneous:
            return None
        medium, passed = s.flight.medium, s.flight.passed
        if passed is None or source is None:
            return track(media, medium, s.ray, end, keys_of_ray(s.ray), s.active)
        keys = keys_of_walk(source, _number(s))
        return track(media, medium, s.ray, end, keys, s.active, media.is_collided_with(medium), passed.channel)

    def goes_on(self, s: SubPath, vertex: WalkVertex) -> mi.Bool:
        """Whether a path may have an edge after a vertex; it may always cross a null surface that bounds a medium."""
        within = s.depth + self.spare < self.max_edges if self.spare else s.depth < self.max_edges
        if s.flight is None or not self.visibility.transparent:
            return within
        return within | (vertex.si.is_medium_transition() & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Null))

    def ends(self, vertex: WalkVertex) -> mi.Bool:
        """Whether paths end in a map at a vertex, unless they go on through its mirror or glass."""
        return mi.Bool(False)

    def emission(self, s: SubPath, vertex: WalkVertex, lights: LightTable | LocalLights | None = None) -> Emission:
        """Emission at the end of the edge, including that of the environment. ``lights``: the lights that
        :meth:`light_point` used at the start of the edge, if not the light table."""
        si, scene = vertex.si, self.visibility.scene
        active = s.active & is_emissive(scene, si)
        if s.hidden is not None:
            active &= ~s.hidden
        if vertex.bsdf.in_medium is not None:
            active &= ~vertex.bsdf.in_medium
        origin = s.ray.o - s.ray.d * s.travelled
        found = emission_of_hit(lights or self.lights, scene, si, active, origin, vertex.distance, self.departures)
        per_area = dr.square(vertex.distance) / dr.abs(dr.dot(si.n, vertex.incoming))
        direct_pdf = found[1] * dr.select(vertex.valid, per_area, 1.0)
        if vertex.passing is not None:
            direct_pdf /= vertex.passing.to_end
        if self.first is not None:
            is_first = s.depth == 1
            reached = s.active & (is_first if s.through is None else s.through)
            self.first.record(vertex, dr.select(active, found[0], 0.0), s.throughput, is_first, reached)
        return Emission(*found, direct_pdf, active)

    def light_point(
        self,
        vertex: WalkVertex,
        source: SampleSource,
        active: mi.Bool,
        index: int = 0,
        lights: LightTable | LocalLights | None = None,
    ) -> DirectSample:
        """Sample the ``index``-th light point of a vertex. ``lights`` replaces the light table."""
        if vertex.medium is not None:
            active = active & (vertex.depth < self.max_edges)
        return sample_direct(lights or self.lights, vertex.si, source, vertex.number, index, active, self.departures)

    def next_event(
        self,
        s: SubPath,
        vertex: WalkVertex,
        light: DirectSample,
        f: Evaluated,
        weights: DirectWeights,
        wanted: mi.Bool | bool = True,
    ) -> tuple[mi.Spectrum, mi.Bool]:
        """(throughput times BSDF times radiance over density, times weight and transmittance; whether the light point
        is visible).
        No shadow ray is cast where the contribution is zero or not ``wanted``."""
        contribution = s.throughput * f.value * light.radiance
        weighted = not self.visibility.volumes
        if weighted:
            contribution = contribution * self.light_weight(vertex, light, f.pdf, weights)
        tested = light.active & ~dr.all(contribution == 0.0) & wanted
        s.rays += ones(tested)
        sight = self.sight(vertex, light.target, vertex.depth + 1, tested)
        if not weighted:
            # The density of a hit depends on what the shadow ray passes.
            passing = 1.0 if sight.passing is None else mean(sight.passing)
            contribution *= self.light_weight(vertex, light, f.pdf * passing, weights)
        contribution *= sight.transmittance
        if self.rays is not None:
            self.rays.joined(Edge.NEXT_EVENT, vertex, light.target, contribution, sight.visible)
        return contribution, sight.visible

    def light_weight(self, vertex: WalkVertex, light: DirectSample, pdf: mi.Float, weights: DirectWeights) -> mi.Float:
        """Weight of a light point of a vertex. ``pdf``: density of hitting the light instead."""
        return weights.light_point(light, pdf)

    def sight(
        self, vertex: WalkVertex, target: mi.Point3f, edges: mi.UInt32, active: mi.Bool, by_camera: bool = False
    ) -> Sight:
        """What of ``target`` is seen from a vertex. ``edges``: length of the resulting path; each null surface adds
        one, up to ``max_edges``. ``by_camera``: whether the target is on the camera."""
        ray, hidden = vertex.ray_to(target), self.visibility.hidden if by_camera else None
        if hidden is not None:
            active &= ~is_lamp(vertex.si.shape)
        return self.visibility.along(ray, self.max_edges - edges, active, vertex.medium_towards(ray.d), hidden)

    def keep_if_null(self, scattered: Scattered, before: V, after: V) -> V:
        """``after`` where the path has scattered at the vertex; ``before`` where it has crossed a null surface, at
        which a path has no vertex."""
        return dr.select(scattered.is_null, before, after) if self.visibility.transparent else after

    def advance(
        self,
        s: SubPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        roulette_by: tuple[mi.Spectrum, mi.Float] | None = None,
    ) -> mi.Float:
        """Leave a vertex in the sampled direction, and play Russian roulette. Returns roulette's factor on the
        throughput.

        ``roulette_by``: throughput and eta after the vertex by which roulette decides, in place of the path's own."""
        s.throughput = s.throughput * scattered.weight
        if s.eta is not None:
            s.eta = s.eta * scattered.eta
        s.travelled = self.keep_if_null(scattered, vertex.distance, mi.Float(0.0))
        s.ray = vertex.ray(scattered.direction)
        if self.visibility.disperses:
            alone = vertex.hero_goes_on(scattered.direction) & ~scattered.is_null
            s.ray.wavelengths = dr.select(alone, mi.Spectrum(s.ray.wavelengths[0]), s.ray.wavelengths)
        counted = mi.UInt32(1)
        if s.flight is not None:
            counted -= self._fly_on(s.flight, vertex, scattered, source)
        by, eta = roulette_by or (s.throughput, s.eta)
        survival = self.survival
        if self.by_albedo:
            by, eta, survival = scattered.weight, scattered.eta if s.eta is not None else mi.Float(1.0), 1.0
        u = source.decide(vertex.number, dim.ROULETTE)
        alive, factor = roulette(by, eta, vertex.depth, self.rr_depth, u, survival)
        s.throughput = s.throughput * factor
        s.depth = vertex.depth + counted
        if s.flight is not None:
            alive &= s.depth + self.spare <= self.max_edges
        if s.seen is not None:
            s.seen = self.keep_if_null(scattered, s.seen, after_scattering(s.seen, scattered.is_delta))
        if s.hidden is not None:
            s.hidden &= scattered.is_null
        if s.through is not None and self.first is not None:
            likely = alive & (scattered.pdf >= 0.5)
            self.first.discard(s.active & s.through & scattered.active & ~vertex.smooth & ~likely)
            s.through &= scattered.is_delta & likely  # the crossing of a null surface is a delta component
        s.active &= scattered.active & alive
        if self.rays is not None:
            self.rays.scattered(vertex, scattered, s.active)
        return factor

    def _fly_on(self, flight: Flight, vertex: WalkVertex, scattered: Scattered, source: SampleSource) -> mi.UInt32:
        """Leave a vertex; behind a null surface, the same edge goes on. Returns 1 where it bounds a medium, else 0."""
        medium, media = vertex.medium_towards(scattered.direction), self.visibility.media
        assert medium is not None and media is not None
        flight.medium, passed = medium, flight.passed
        crosses = ones(scattered.is_null & vertex.si.is_medium_transition())
        if self.visibility.transparent:
            flight.crossed = flight.crossed + crosses
        if passed is not None:
            start = vertex.extinction
            passed.probability = self.keep_if_null(scattered, passed.probability, media.one())
            passed.start = self.keep_if_null(scattered, passed.start, media.one() if start is None else start)
            if passed.channel is not None:
                passed.channel = self.keep_if_null(scattered, passed.channel, draw_channel(source, vertex.number))
        return crosses


def _number(s: SubPath) -> mi.UInt32:
    """Number of the vertex at the end of the next edge, with all null surfaces that the path has crossed."""
    return mi.UInt32(s.depth) if s.flight is None else s.depth + s.flight.crossed


def _collide(si: mi.SurfaceInteraction3f, ray: mi.Ray3f, distance: mi.Float, collided: mi.Bool) -> None:
    """Make a point of a medium of an interaction, where the ray has collided; its frame is any."""
    si.t = dr.select(collided, distance, si.t)
    si.p = dr.select(collided, ray(distance), si.p)
    si.n = dr.select(collided, mi.Normal3f(0.0), si.n)
    si.sh_frame = dr.select(collided, mi.Frame3f(-ray.d), si.sh_frame)
    si.wi = dr.select(collided, mi.Vector3f(0.0, 0.0, 1.0), si.wi)


def set_footprint(si: mi.SurfaceInteraction3f, direction: mi.Vector3f, width: mi.Float) -> None:
    """Set ``duv_dx`` and ``duv_dy`` to the footprint of a square beam of a width on the surface that it meets: its
    shorter and its longer side."""
    cos = dr.maximum(dr.abs(dr.dot(si.n, direction)), 1e-3)
    across = dr.cross(si.n, direction)
    size = dr.norm(across)
    across = dr.select(size > 1e-3, across / size, mi.Frame3f(si.n).s)
    along = dr.cross(si.n, across)
    # Least squares for across = du dp_du + dv dp_dv.
    uu, uv, vv = dr.squared_norm(si.dp_du), dr.dot(si.dp_du, si.dp_dv), dr.squared_norm(si.dp_dv)
    determinant = uu * vv - uv * uv
    scale = dr.select(determinant > 0.0, dr.rcp(determinant), 0.0)

    def on_surface(offset: mi.Vector3f) -> mi.Vector2f:
        u, v = dr.dot(si.dp_du, offset), dr.dot(si.dp_dv, offset)
        return mi.Vector2f(vv * u - uv * v, uu * v - uv * u) * scale

    si.duv_dx, si.duv_dy = on_surface(across * width), on_surface(along * (width / cos))


def ones(mask: mi.Bool) -> mi.UInt32:
    """1 where a mask holds, else 0."""
    return dr.select(mask, mi.UInt32(1), mi.UInt32(0))
