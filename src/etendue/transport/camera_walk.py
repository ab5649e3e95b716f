"""The camera pass: sub-paths from the sensor, at each vertex every technique that joins it to the light side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.density import HashGrid
from etendue.scene import LightTable

from . import dimensions as dim
from .camera import Camera
from .emission import DirectSample, emission_of_hit, is_emissive, sample_direct
from .mis import Mis
from .photons import Photons, unfolded
from .pyramid import Pyramid
from .scattering import (
    Evaluated,
    cosine_ratio,
    evaluate_camera_end,
    evaluate_light_end,
    geometric_cos,
    is_smooth,
    roulette,
    scatter_camera,
    shadow_roulette,
)
from .vertices import LightVertex, LightVertices
from .visibility import Visibility


@dataclass
class _State:
    """Loop state, one lane a camera sub-path."""

    active: Any
    ray: Any
    throughput: Any
    eta: Any
    d_vcm: Any
    d_vc: Any
    depth: Any  #: edges so far, the one being traced included
    vertex: Any  #: the same without the surfaces that were crossed; used where a scene has such
    travelled: Any  #: length of the edge before this ray's origin
    rays: Any
    lane: Any  #: number of the camera path; does not change
    layers: dict[str, Any]  #: technique family -> radiance


@dataclass
class LightCache:
    """The stored light vertices as connections use them.

    With ``picks``: ``techniques.connection`` vertices drawn at random from all paths [Davidovic 2014]. The lanes of a
    block draw one number together and take consecutive vertices from there, so that they read memory together; each
    vertex is as likely as any other for each lane. Without: every vertex of the light path of the same number.
    """

    vertices: LightVertices
    count: Any  #: M, UInt32 on the device
    factor: Any  #: M / (N k), or 1 without ``picks``; Float on the device
    paths: Any  #: N, opaque UInt32
    picks: SampleSource | None  #: one number a block of ``PICK_BLOCK`` lanes


#: Lanes that pick light vertices together.
PICK_BLOCK = 16


@dataclass
class _Joined:
    """An edge from a camera vertex to a light vertex."""

    vertex: LightVertex
    direction: Any  #: world, towards the light vertex
    inverse_square: Any
    active: Any


@dataclass
class Gather:
    """The stored light vertices as merging uses them: sorted by a grid for the largest radius.

    Of each radius ``factors`` holds 1 / (n_VM pi r^2), and ``squares`` r^2.
    """

    grid: HashGrid
    photons: Photons
    factors: Sequence[Any]
    squares: Sequence[Any]

    def around(
        self,
        point: Any,
        edges: Any,
        visit: Callable[[Any, Any], Any],
        state: Any,
        active: Any,
        radius_squared: Any = None,
    ) -> Any:
        """Visit the photons around ``point`` that have at most ``edges`` edges behind them; see ``HashGrid.within``."""

        def read(photon: Any) -> tuple[Any, Any]:
            position, depth = self.photons.position(photon, active)
            return position, depth <= edges

        return self.grid.within(point, read, visit, state, active, radius_squared)


@dataclass
class CameraWalk:
    """What a camera pass needs; :meth:`trace` runs it as one kernel."""

    visibility: Visibility
    lights: LightTable
    camera: Camera
    mis: Mis
    max_edges: Any  #: opaque UInt32
    rr_depth: int
    dark: Any  #: opaque Float: radiance below which a contribution plays roulette before its shadow ray
    split_layers: bool  #: keep technique families apart
    cache: LightCache | None = None
    gather: Gather | None = None
    pyramid: Pyramid | None = None  #: gets contributions technique by technique, of the first radius
    more_radii: tuple[str, ...] = ()  #: layers of the pictures of the merging radii after the first

    def trace(self, pixel: Any, source: SampleSource) -> tuple[dict[str, Any], Any]:
        """One camera path an entry of ``pixel``. Returns (layers of radiance, rays), a lane each, not yet evaluated."""
        lanes = dr.width(pixel)
        ray, weight, aperture = self.camera.primary(pixel, source)
        self._pixel, self._weight = pixel, weight  # for the pyramid, which is filled on the way
        # The first edge is measured from the aperture, though its ray starts at the near plane.
        density, lead = self.camera.density(ray, aperture)
        d_vcm, d_vc = self.mis.start_camera(density)
        state = _State(
            active=dr.full(mi.Bool, True, lanes) & (self.max_edges > 0),
            ray=mi.Ray3f(ray),
            throughput=dr.full(mi.Color3f, 1.0, lanes),
            eta=dr.full(mi.Float, 1.0, lanes),
            d_vcm=d_vcm,
            d_vc=d_vc,
            depth=dr.full(mi.UInt32, 1, lanes),
            vertex=mi.UInt32(1),
            travelled=lead,
            rays=dr.zeros(mi.UInt32, lanes),
            lane=dr.arange(mi.UInt32, lanes),
            # Not literal zeros: Dr.Jit takes a layer that no material adds to for a constant, then stumbles over it.
            layers={name: mi.Color3f(dr.opaque(mi.Float, 0.0)) for name in (*self.layer_names(), *self.more_radii)},
        )
        (state,) = dr.while_loop((state,), lambda s: s.active, lambda s: (self._edge(s, source),), label="camera walk")
        return {name: radiance * weight for name, radiance in state.layers.items()}, state.rays

    def layer_names(self) -> tuple[str, ...]:
        """What the picture is the sum of: technique families, or the picture itself."""
        if not self.split_layers:
            return ("image",)
        t = self.mis.techniques
        used = (("next_event", t.next_event), ("connection", t.connection), ("merge", t.merge))
        return ("emission", *(name for name, on in used if on))

    def _add(self, s: _State, family: str, mask: Any, values: Sequence[Any]) -> None:
        """Add a contribution, throughput included, to its layer; one a radius."""
        for name, value in zip((family if self.split_layers else "image", *self.more_radii), values, strict=True):
            s.layers[name][mask] += value

    def _tell(self, s: _State, lights: Any, weighted: Any, alone: Any, active: Any, merged: bool = False) -> None:
        """Add a contribution to the pyramid: with its weight, and without. ``lights``: vertices of the light
        sub-path."""
        assert self.pyramid is not None
        t = self._vertex(s) + 1
        self.pyramid.add(merged, lights, t, self._pixel, weighted * self._weight, alone * self._weight, active)

    def _asked(self, lit: Any, alone: Any, active: Any) -> Any:
        """Which shadow rays are cast: those of ``lit``; for a pyramid all that may carry light without a weight."""
        return lit if self.pyramid is None else active & ~dr.all(alone == 0.0)

    def _edge(self, s: _State, source: Any) -> _State:
        """Trace one edge, join its end to the light side in every way, and scatter."""
        techniques = self.mis.techniques
        si = self.visibility.scene.ray_intersect(s.ray, s.active)
        s.rays += 1

        # ---- Arrive: the environment is weighted before the densities become those of an area
        valid = si.is_valid()
        cos = geometric_cos(si, s.ray.d)
        distance = s.travelled + si.t
        on_edge = s.d_vcm, s.d_vc
        d_vcm, d_vc = self.mis.hit(*on_edge, dr.square(distance), cos)
        s.d_vcm, s.d_vc = dr.select(valid, d_vcm, s.d_vcm), dr.select(valid, d_vc, s.d_vc)
        self._emission(s, si, distance)
        s.active &= valid

        bsdf = si.bsdf(s.ray)
        smooth = s.active & is_smooth(bsdf)
        if techniques.merge and self.gather is not None:
            self._merge(s, si, bsdf, smooth)
        s.active &= s.depth < self.max_edges
        smooth &= s.active

        # ---- Choose light points and light vertices; ask the BSDF about all of them and a way on, in one call
        direct = [
            sample_direct(self.lights, si, source, s.depth, index, smooth) for index in range(techniques.next_event)
        ]
        vertices = self._pick_vertices(s, si, smooth)
        directions = [(si.to_local(d.direction), d.active) for d in direct]
        directions += [(si.to_local(v.direction), v.active) for v in vertices]
        scattered, values = scatter_camera(bsdf, si, source, s.depth, s.active, directions)
        for index, d in enumerate(direct):
            u = source.decide(s.depth, dim.NEXT_EVENT + 4 * index + 3)
            self._next_event(s, si, d, values[index], u)
        for index, v in enumerate(vertices):
            u = source.decide(s.depth, dim.CONNECT + index)
            joined, rays = self._connection(s, si, v, values[len(direct) + index], u)
            s.rays += rays
            self._add(s, "connection", v.active, joined)
        if self.cache is not None and self.cache.picks is None:
            self._connect_pair(s, si, bsdf, source.decide(s.depth, dim.CONNECT), smooth)

        s.d_vcm, s.d_vc = self.mis.scatter_camera(
            self._vertex(s),
            s.d_vcm,
            s.d_vc,
            scattered.cos,
            scattered.pdf,
            scattered.reverse_pdf,
            scattered.is_delta,
        )
        s.travelled = mi.Float(0.0)
        if self.visibility.transparent:  # a surface that was crossed is no vertex: the edge goes on
            crossed = scattered.is_null
            s.d_vcm, s.d_vc = dr.select(crossed, on_edge[0], s.d_vcm), dr.select(crossed, on_edge[1], s.d_vc)
            s.travelled = dr.select(crossed, distance, 0.0)
            s.vertex += dr.select(crossed, mi.UInt32(0), mi.UInt32(1))
        s.throughput *= scattered.weight
        s.eta *= scattered.eta
        s.ray = si.spawn_ray(scattered.direction)
        alive, factor = roulette(s.throughput, s.eta, s.depth, self.rr_depth, source.decide(s.depth, dim.ROULETTE))
        s.throughput *= factor
        s.depth += 1
        s.active &= scattered.active & alive
        return s

    def _vertex(self, s: _State) -> Any:
        """Number of the vertex at the end of the edge, the sensor being 0."""
        return s.vertex if self.visibility.transparent else s.depth

    def _emission(self, s: _State, si: Any, distance: Any) -> None:
        """s = 0 [Georgiev 2012b, eq. 43]."""
        scene = self.visibility.scene
        on_light = s.active & is_emissive(scene, si)
        radiance, area_density, emission_density = emission_of_hit(self.lights, scene, si, on_light, distance)
        weights = self.mis.emission_weight(self._vertex(s), s.d_vcm, s.d_vc, area_density, emission_density)
        alone = s.throughput * radiance
        values = [alone * weight for weight in weights]
        self._add(s, "emission", on_light, values)
        if self.pyramid is not None:
            self._tell(s, mi.UInt32(0), values[0], alone, on_light)

    def _next_event(self, s: _State, si: Any, direct: DirectSample, bsdf: Evaluated, u: Any) -> None:
        """s = 1 [Georgiev 2012b, eq. 44, 45]."""
        cos = geometric_cos(si, direct.direction)
        weights = self.mis.next_event_weight(
            self._vertex(s),
            s.d_vcm,
            s.d_vc,
            cos,
            dr.select(direct.is_delta, 0.0, bsdf.pdf),
            bsdf.reverse_pdf,
            direct.pdf,
            direct.light_ratio * cos,
        )
        count = self.mis.techniques.next_event
        alone = s.throughput * bsdf.value * direct.radiance
        contributions = [alone * (weight / count) for weight in weights]
        lit, factor = shadow_roulette(contributions, self.dark, u, direct.active)
        asked = self._asked(lit, alone, direct.active)
        s.rays += dr.select(asked, mi.UInt32(1), mi.UInt32(0))
        spare = self.max_edges - (s.depth + 1)
        seen, share = self.visibility.along(si.spawn_ray_to(direct.target), spare, asked)
        values = [contribution * (factor * share) for contribution in contributions]
        if self.pyramid is not None:
            values = [dr.select(lit, value, 0.0) for value in values]
            self._tell(s, mi.UInt32(1), values[0], alone * (share / count), seen)
        self._add(s, "next_event", seen, values)

    def _pick_vertices(self, s: _State, si: Any, active: Any) -> list[_Joined]:
        """Light vertices drawn at random from the cache, joined to ``si``."""
        if self.cache is None or self.cache.picks is None:
            return []
        active = active & (self.cache.count > 0)
        joined = []
        for index in range(self.mis.techniques.connection):
            u = self.cache.picks.next_1d(s.depth, dim.CONNECT + index)
            offset = dr.select(self.cache.count >= PICK_BLOCK, s.lane % PICK_BLOCK, 0)
            number = mi.UInt32(u * mi.Float(self.cache.count)) + offset
            number = dr.select(number < self.cache.count, number, number - self.cache.count)
            joined.append(self._join(s, si, number, active))
        return joined

    def _connect_pair(self, s: _State, si: Any, bsdf: Any, u: Any, active: Any) -> None:
        """Connect to every vertex of the light path that goes with this camera path."""
        assert self.cache is not None
        first, count = self.cache.vertices.path_vertices(s.lane % self.cache.paths, active)

        def connect(j: Any, totals: Any, rays: Any) -> tuple[Any, Any, Any]:
            joined = self._join(s, si, first + j, active)
            value = evaluate_camera_end(bsdf, si, si.to_local(joined.direction), joined.active)
            # Roulette of all of a path's connections by one number: each decision is right by itself.
            values, ray = self._connection(s, si, joined, value, u)
            return j + 1, [total + value for total, value in zip(totals, values, strict=True)], rays + ray

        n = dr.width(s.depth)
        _, totals, rays = dr.while_loop(
            (dr.zeros(mi.UInt32, n), self._blank(n), dr.zeros(mi.UInt32, n)),
            lambda j, *_: active & (j < count),
            connect,
            label="connect",
        )
        s.rays += rays
        self._add(s, "connection", active, totals)

    def _blank(self, lanes: int) -> list[Any]:
        """Black, once a radius."""
        return [dr.zeros(mi.Color3f, lanes) for _ in range(1 + len(self.more_radii))]

    def _join(self, s: _State, si: Any, number: Any, active: Any) -> _Joined:
        """The edge between ``si`` and light vertex ``number``."""
        assert self.cache is not None
        vertex = self.cache.vertices.read(self.cache.vertices.slot(number, active), active)
        offset = vertex.si.p - si.p
        distance_squared = dr.squared_norm(offset)
        active = active & (vertex.depth + s.depth + 1 <= self.max_edges) & (distance_squared > 0.0)
        return _Joined(vertex, offset * dr.rsqrt(distance_squared), dr.rcp(distance_squared), active)

    def _connection(self, s: _State, si: Any, joined: _Joined, bsdf: Evaluated, u: Any) -> tuple[list[Any], Any]:
        """s >= 2, t >= 2: (weighted contribution by radius, shadow rays) [Georgiev 2012b, eq. 40, 41]."""
        assert self.cache is not None
        vertex = joined.vertex
        active = joined.active & ~dr.all(bsdf.value == 0.0)
        wo = vertex.si.to_local(-joined.direction)
        light = evaluate_light_end(vertex.bsdf, vertex.si, wo, active)
        cos = geometric_cos(si, joined.direction)
        weights = self.mis.connection_weight(
            self._vertex(s),
            (s.d_vcm, s.d_vc),
            (vertex.d_vcm, vertex.d_vc),
            cos,
            geometric_cos(vertex.si, vertex.direction),
            bsdf.pdf * geometric_cos(vertex.si, joined.direction) * joined.inverse_square,
            light.pdf * cos * joined.inverse_square,
            bsdf.reverse_pdf,
            light.reverse_pdf,
        )
        alone = s.throughput * vertex.throughput * bsdf.value * light.value
        alone *= joined.inverse_square * cosine_ratio(vertex.si, joined.direction) * self.cache.factor
        contributions = [alone * weight for weight in weights]
        lit, factor = shadow_roulette(contributions, self.dark, u, active)
        asked = self._asked(lit, alone, active)
        rays = dr.select(asked, mi.UInt32(1), mi.UInt32(0))
        spare = self.max_edges - (vertex.depth + s.depth + 1)
        seen, share = self.visibility.along(si.spawn_ray_to(vertex.si.p), spare, asked)
        values = [contribution * (factor * share) for contribution in contributions]
        if self.pyramid is not None:
            values = [dr.select(lit, value, 0.0) for value in values]
            self._tell(s, vertex.number + 1, values[0], alone * share, seen)
        return [dr.select(seen, value, 0.0) for value in values], rays

    def _merge(self, s: _State, si: Any, bsdf: Any, active: Any) -> None:
        """s >= 2, t >= 2, no edge between them [Georgiev 2012b, eq. 38, 39]."""
        assert self.gather is not None
        if not self.mis.techniques.merge_first:
            active = active & (self._vertex(s) > 1)

        def visit(photon: Any, totals: list[Any]) -> list[Any]:
            values = self._merged(s, si, bsdf, photon, active)
            return [total + value for total, value in zip(totals, values, strict=True)]

        totals = self.gather.around(si.p, self.max_edges - s.depth, visit, self._blank(1), active)
        factors = self.gather.factors
        values = [s.throughput * total * factor for total, factor in zip(totals, factors, strict=True)]
        self._add(s, "merge", active, values)

    def _merged(self, s: _State, si: Any, bsdf: Any, photon: Any, active: Any) -> list[Any]:
        """Weighted contribution of one photon, by radius."""
        assert self.gather is not None
        photons = self.gather.photons
        p = photons.read(photon, active)
        bsdf = evaluate_camera_end(bsdf, si, si.to_local(p.direction), active)
        weights = self.mis.merge_weight(
            self._vertex(s), (s.d_vcm, s.d_vc), (p.d_vcm, p.d_vc), bsdf.pdf, bsdf.reverse_pdf
        )
        distance_squared, share = unfolded(si, photons.position(photon, active)[0], p)
        value = p.fluence * bsdf.value * share
        inside = [distance_squared <= square for square in self.gather.squares]
        if self.pyramid is not None:
            alone = value * s.throughput * self.gather.factors[0]
            lights = photons.number(photon, active) + 1
            self._tell(s, lights, alone * weights[0], alone, active & inside[0], merged=True)
        return [dr.select(ok, value * w, 0.0) for ok, w in zip(inside, weights, strict=True)]
