"""One technique per path: a light sub-path of s vertices, a camera sub-path of t, and the connection of their ends.

The estimator of ``bpt`` applies all techniques to all vertices of a pair of sub-paths. Here a lane has its own (s, t)
and evaluates this technique alone, with the same recursive weight: one edge per vertex, and at most one shadow ray.

Null surfaces are no vertices, so a sub-path of given length may end at each of several surfaces in a row, of which all
but the last also transmit light. It ends at each of these, except the last, with probability 1/2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, SampleSource
from etendue.film import Component
from etendue.scene import LightTable

from .. import dimensions as dim
from ..camera import CameraConnection, CameraSampler
from ..emission import is_emissive, sample_direct
from ..scattering import evaluate_light_end, scatter_camera
from ..vertex import WalkVertex
from ..visibility import Visibility, is_lamp
from ..walk import ones
from .light_walk import LightPath, LightWalk
from .linear import Carried
from .mis import Mis
from .walk import BidirectionalPath, BidirectionalWalk

P = TypeVar("P", bound=BidirectionalPath)


@dataclass(kw_only=True)
class _Ending:
    """Fields of a sub-path that keeps its last vertex."""

    wanted: mi.UInt32  #: vertices after the first one
    emissive: mi.Bool  #: whether it may end at a light
    hit: mi.PreliminaryIntersection3f  #: at the end of the last edge
    reached: mi.Bool  #: whether the sub-path has as many edges as wanted


@dataclass(kw_only=True)
class _LightEnding(_Ending, LightPath):
    pass


@dataclass(kw_only=True)
class _CameraEnding(_Ending, BidirectionalPath):
    pass


@dataclass(kw_only=True)
class _LightSide(LightWalk):
    """Light sub-paths of given lengths."""

    kind: type[LightPath] = _LightEnding

    def trace_to(self, edges: mi.UInt32, source: SampleSource) -> _LightEnding:
        """Sub-paths of ``edges`` edges each, 0 for none."""
        lanes = dr.width(edges)
        ending = {
            "wanted": edges,
            "emissive": _no(lanes),
            "hit": dr.zeros(mi.PreliminaryIntersection3f, lanes),
            "reached": _no(lanes),
        }
        state: Any = self.begin(lanes, source, numbered=True, **ending)
        state.active &= edges > 0

        def edge(s: _LightEnding) -> _LightEnding:
            vertex = self.arrive(s)
            on_edge, light_cos = self.land(s, vertex)
            stop = _Stop.at(self, s, vertex, source, on_edge)
            scattered, _ = vertex.sample(source, stop.going)
            self.go_on(s, vertex, scattered, source, on_edge, light_cos)
            return stop.apply(s)

        return self.walk(state, edge, "light sub-path")


@dataclass(kw_only=True)
class _CameraSide(BidirectionalWalk):
    """Camera sub-paths of given lengths."""

    def trace_to(
        self,
        edges: mi.UInt32,
        emissive: mi.Bool,
        primary: tuple[mi.Ray3f, mi.Spectrum, mi.Point2f],
        source: SampleSource,
        components: bool,
    ) -> _CameraEnding:
        """Sub-paths of ``edges`` edges each, 0 for none. ``emissive``: sub-paths that may end at a light; ``primary``:
        camera rays from ``CameraSampler``. The last edge may miss the scene, where the environment is seen.
        ``components``: whether the state keeps ``seen``, the component of a light at the end."""
        lanes = dr.width(edges)
        ray, importance, aperture = primary
        density, lead = self.camera.density(ray, aperture)
        d_vcm, d_vc = self.mis.start_camera(density)
        state = _CameraEnding(
            active=edges > 0,
            ray=mi.Ray3f(ray),
            throughput=mi.Spectrum(importance),
            eta=dr.full(mi.Float, 1.0, lanes),
            d_vcm=d_vcm,
            d_vc=d_vc,
            depth=dr.full(mi.UInt32, 1, lanes),
            vertex=mi.UInt32(1),
            travelled=lead,
            rays=dr.zeros(mi.UInt32, lanes),
            seen=mi.UInt32(Component.EMISSION) if components else None,
            hidden=self.visibility.hidden,
            wanted=edges,
            emissive=emissive,
            hit=dr.zeros(mi.PreliminaryIntersection3f, lanes),
            reached=_no(lanes),
        )

        def edge(s: _CameraEnding) -> _CameraEnding:
            vertex = self.arrive(s)
            on_edge, cos = (s.d_vcm, s.d_vc), vertex.cos(vertex.incoming)
            d_vcm, d_vc = self.mis.hit(*on_edge, dr.square(vertex.distance), cos)
            s.d_vcm, s.d_vc = dr.select(vertex.valid, d_vcm, s.d_vcm), dr.select(vertex.valid, d_vc, s.d_vc)
            stop = _Stop.at(self, s, vertex, source, on_edge)
            scattered, _ = vertex.sample(source, stop.going)
            sampled = scattered.cos, scattered.pdf, scattered.reverse_pdf, scattered.is_delta
            number = self.number(s)
            s.d_vcm, s.d_vc = self.mis.scatter_camera(number, self.mis.joined(number, s.d_vcm), s.d_vc, *sampled)
            self.leave(s, vertex, scattered, source, on_edge)
            return stop.apply(s)

        return self.walk(state, edge, "camera sub-path")


def _no(lanes: int) -> mi.Bool:
    return dr.full(mi.Bool, False, lanes)


#: State that a sub-path keeps at a vertex where it does not scatter.
_KEPT = (
    *("ray", "throughput", "d_vcm", "d_vc", "depth", "travelled", "vertex", "eta", "from_infinity", "waiting"),
    *("seen", "kind", "hidden"),
)


@dataclass
class _Stop:
    """What happens at a vertex in place of scattering: the sub-path ends, or crosses a null surface on its last
    edge."""

    going: mi.Bool  #: lanes that scatter
    crossing: mi.Bool
    kept: dict[str, Any]
    crossed: dict[str, Any]  #: values that replace those of ``kept`` behind a null surface

    @classmethod
    def at(
        cls,
        walk: BidirectionalWalk,
        s: Any,
        vertex: WalkVertex,
        source: SampleSource,
        on_edge: tuple[Carried, Carried],
    ) -> _Stop:
        """Decide at the end of an edge."""
        last = s.active & (walk.number(s) == s.wanted)
        crossing, crossed = mi.Bool(False), {}
        if walk.visibility.transparent:
            null = last & vertex.valid & mi.has_flag(vertex.bsdf.flags(), mi.BSDFFlags.Null)
            both = null & dr.select(s.emissive, is_emissive(walk.visibility.scene, vertex.si), vertex.smooth)
            crossing = null & (~both | (source.decide(vertex.number, dim.ROULETTE) < 0.5))
            s.throughput = s.throughput * dr.select(both, 2.0, 1.0)
            crossed = {
                "ray": vertex.ray(vertex.incoming),
                "throughput": s.throughput
                * vertex.bsdf.call(mi.BSDF.eval_null_transmission, vertex.si, active=crossing),
                "d_vcm": on_edge[0],
                "d_vc": on_edge[1],
                "depth": s.depth + 1,
                "travelled": vertex.distance,
            }
        ends = last & ~crossing
        s.hit = dr.select(ends, vertex.hit, s.hit)
        s.reached |= ends
        kept = {name: type(value)(value) for name in _KEPT if (value := getattr(s, name, None)) is not None}
        if (medium := vertex.medium_towards(vertex.incoming)) is not None:
            kept["flight"] = replace(s.flight)
            counted = ones(~vertex.si.is_medium_transition())
            crossed["flight"] = replace(s.flight, medium=medium, crossed=s.flight.crossed + (1 - counted))
            crossed["depth"] = s.depth + counted
        return cls(s.active & ~last & vertex.valid, crossing, kept, crossed)

    def apply(self, s: P) -> P:
        """The state after the edge; ``s``: after scattering."""
        for name, value in self.kept.items():
            if name in self.crossed:
                value = dr.select(self.crossing, self.crossed[name], value)
            setattr(s, name, dr.select(self.going, getattr(s, name), value))
        s.active = (s.active & self.going) | self.crossing
        return s


@dataclass
class SingleContribution:
    """One lane each."""

    position: mi.Point2f  #: on the film, in pixels
    value: mi.Spectrum  #: with its weight; times the number of techniques of its length, it estimates their sum
    alone: mi.Spectrum  #: without the weight
    rays: mi.UInt32
    component: mi.UInt32 | None = None  #: ``film.Component``, if asked for


@dataclass(kw_only=True)
class SingleTechnique:
    """Evaluates one technique a lane in one scene, in one kernel.

    ``mis``: one sample of each technique, and as many light sub-paths per camera path of a pixel as there are pixels.
    """

    visibility: Visibility
    lights: LightTable
    camera: CameraSampler
    mis: Mis
    max_edges: mi.UInt32  #: opaque; null surfaces that a path crosses count
    components: bool = False  #: whether to tell the component of a contribution

    def __post_init__(self) -> None:
        if self.mis.techniques.leaves_direct:
            raise OptionError("a single technique cannot leave direct light to next event; set direct=True")

    def trace(
        self, s: mi.UInt32, t: mi.UInt32, place: mi.Point2f, camera: SampleSource, light: SampleSource
    ) -> SingleContribution:
        """Paths of ``s + t - 1`` edges, by ``s`` light vertices and ``t >= 1`` camera vertices; ``t = 1`` needs ``s >=
        2``. ``place``: film position of the camera sub-path in pixels."""
        common: dict[str, Any] = {
            "visibility": self.visibility,
            "lights": self.lights,
            "max_edges": self.max_edges,
            "rr_depth": 1 << 30,
            "camera": self.camera,
            "mis": self.mis,
            "dark": mi.Float(0.0),
            "sink": None,
        }
        eye_walk, light_walk = _CameraSide(proposal=scatter_camera, **common), _LightSide(**common)
        primary = self.camera.through(place, camera)
        eye = eye_walk.trace_to(t - 1, s == 0, primary, camera, self.components)
        lit = light_walk.trace_to(dr.select(s >= 2, s - 1, 0), light)
        eye_end, light_end = self._end(eye), self._end(lit)
        # Edges of both sub-paths, crossings of null surfaces included, and of the one between their ends.
        edges = dr.select(t >= 2, eye.depth, 0) + dr.select(s >= 2, lit.depth, 0)
        edges += dr.select(s == 0, mi.UInt32(0), 1)
        short = edges <= self.max_edges
        eye.reached &= short
        lit.reached &= short
        eye_ok = eye.reached & eye_end.valid & eye_end.smooth
        light_ok = lit.reached & light_end.valid & light_end.smooth

        number = eye_walk.number(eye)

        # ---- s = 0: a hit on a light
        eye.active = eye.reached & (s == 0)
        hit = eye_walk.emission(eye, eye_end)
        weight = self.mis.emission_weight(number, eye.d_vcm, eye.d_vc, hit.area_density, hit.emission_density)[0]
        by_hit = _masked(eye.throughput * hit.radiance, weight, hit.active)

        # ---- The other ends: light points, light vertices, the sensor
        point = sample_direct(self.lights, eye_end.si, camera, 0, 0, eye_ok & (s == 1))
        offset = light_end.position - eye_end.position
        distance_squared = dr.squared_norm(offset)
        joins = eye_ok & light_ok & (distance_squared > 0.0)
        between = offset * dr.rsqrt(dr.select(joins, distance_squared, 1.0))
        sensor = self._connect(light_end, light, light_ok & (t == 1))

        towards = dr.select(s == 1, point.direction, between)
        f = eye_end.evaluate(towards, dr.select(s == 1, point.active, joins))
        back = dr.select(t == 1, sensor.direction, -between)
        g = evaluate_light_end(
            light_end.bsdf, light_end.si, light_end.si.to_local(back), dr.select(t == 1, sensor.active, joins)
        )
        geometric, lit_cos = eye_end.cos(towards), light_end.cos(light_end.incoming)
        light_cos, ratio = light_end.cos(back), light_end.cosine_ratio(back)
        on_eye, on_light = (self.mis.joined(number, eye.d_vcm), eye.d_vc), (lit.d_vcm, lit.d_vc)

        # ---- s = 1: next event
        hit_pdf = dr.select(point.is_delta, 0.0, f.pdf)
        weight = self.mis.next_event_weight(
            number, *on_eye, geometric, hit_pdf, f.reverse_pdf, point.pdf, point.light_ratio * geometric
        )[0]
        by_point = _masked(eye.throughput * f.value * point.radiance, weight, point.active)

        # ---- s, t >= 2: connection
        inverse = dr.rcp(dr.select(joins, distance_squared, 1.0))
        weight = self.mis.connection_weight(
            number,
            on_eye,
            on_light,
            geometric,
            lit_cos,
            f.pdf * light_cos * inverse,
            g.pdf * geometric * inverse,
            f.reverse_pdf,
            g.reverse_pdf,
            g.pdf,
        )[0]
        by_join = _masked(eye.throughput * lit.throughput * f.value * g.value * (inverse * ratio), weight, joins)

        # ---- t = 1: splat
        weight = self.mis.splat_weight(*on_light, lit_cos, g.reverse_pdf, sensor.area_pdf(light_cos))[0]
        on_film = sensor.active & self.camera.on_film(sensor.position)
        factor = sensor.importance * ratio / self.camera.pixels
        by_splat = _masked(lit.throughput * g.value * factor, weight, on_film)

        # ---- One shadow ray
        weighted, alone = (by_point[i] + by_join[i] + by_splat[i] for i in range(2))
        tested = ~dr.all(alone == 0.0)
        target = dr.select(t == 1, sensor.target, dr.select(s == 1, point.target, light_end.position))
        ray = dr.select(t == 1, light_end.ray_to(target), eye_end.ray_to(target))
        medium = None
        if (towards_light := eye_end.medium_towards(ray.d)) is not None:
            medium = dr.select(t == 1, light_end.medium_towards(ray.d), towards_light)
        hidden = None
        if self.visibility.hides_lights:
            hidden = t == 1
            tested &= ~(hidden & is_lamp(light_end.si.shape))
        sight = self.visibility.along(ray, self.max_edges - edges, tested, medium, hidden)
        weighted, alone = (dr.select(sight.visible, value * sight.transmittance, 0.0) for value in (weighted, alone))
        # A sub-path without an end is connected from the origin, where the projection may be undefined.
        position = dr.select((t == 1) & sensor.active, sensor.position, place)
        rays = eye.rays + lit.rays + ones(tested)
        component = None
        if eye.seen is not None and eye.lit is not None:
            component = dr.select(s == 1, eye.lit, mi.UInt32(Component.INDIRECT))
            component = dr.select(t == 1, dr.maximum(lit.kind, mi.UInt32(Component.DIRECT)), component)
            component = dr.select(s == 0, eye.seen, component)
        return SingleContribution(position, weighted + by_hit[0], alone + by_hit[1], rays, component)

    def _connect(self, vertex: WalkVertex, source: SampleSource, active: mi.Bool) -> CameraConnection:
        """A light vertex connected to the sensor."""
        if self.camera.can_splat:
            return self.camera.connect(vertex.si, self.camera.splat_aperture(source, 1), active)
        nowhere = dr.zeros(mi.Point2f, dr.width(active))
        return CameraConnection(
            nowhere, mi.Vector3f(0.0, 0.0, 1.0), mi.Point3f(0.0), mi.Float(1.0), mi.Float(0.0), mi.Bool(False)
        )

    def _end(self, s: Any) -> WalkVertex:
        """The last vertex of a sub-path."""
        si = s.hit.compute_surface_interaction(s.ray, active=s.reached)
        valid = s.reached & si.is_valid()
        return WalkVertex(
            si=si,
            bsdf=self.visibility.material(si, s.ray),
            number=s.depth,
            depth=s.depth,
            hit=s.hit,
            incoming=s.ray.d,
            distance=s.travelled + si.t,
            valid=valid,
            medium=None if s.flight is None else s.flight.medium,
        )


def _masked(value: mi.Spectrum, weight: mi.Float, active: mi.Bool) -> tuple[mi.Spectrum, mi.Spectrum]:
    """(``value`` times ``weight``, ``value``), 0 where not ``active``."""
    return dr.select(active, value * weight, 0.0), dr.select(active, value, 0.0)
