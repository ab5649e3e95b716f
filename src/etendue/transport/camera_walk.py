"""The camera pass: sub-paths from the sensor, at each vertex every technique that joins it to the light side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core.samples import SampleSource
from etendue.density import HashGrid
from etendue.scene import LightTable

from . import dimensions as dim
from .camera import Camera
from .emission import emission_of_hit, is_emissive, sample_direct
from .mis import Mis
from .scattering import (
    evaluate_from_eye,
    evaluate_from_light,
    exchanged,
    geometric_cos,
    is_smooth,
    roulette,
    scatter_camera,
)
from .vertices import LightVertex, LightVertices, Photons


@dataclass
class _State:
    """Loop state, one lane a camera sub-path."""

    active: Any
    ray: Any
    throughput: Any
    eta: Any
    d_vcm: Any
    d_vc: Any
    depth: Any
    rays: Any
    lane: Any  #: number of the camera path; does not change
    layers: dict[str, Any]  #: technique family -> radiance


@dataclass
class LightCache:
    """The stored light vertices as connections use them.

    ``pairs`` false: ``techniques.connection`` vertices drawn at random from all paths, ``factor`` = M / (N k)
    [Davidovic 2014]. ``pairs`` true: all vertices of the light path with the camera path's number.
    """

    vertices: LightVertices
    count: Any  #: M, opaque UInt32
    factor: Any  #: opaque Float
    paths: Any  #: N, opaque UInt32
    pairs: bool


@dataclass
class Gather:
    """The stored light vertices as merging uses them: sorted by a grid; ``factor`` = 1 / (n_VM pi r^2)."""

    grid: HashGrid
    photons: Photons
    factor: Any


@dataclass
class CameraWalk:
    """What a camera pass needs; :meth:`trace` runs it as one kernel."""

    scene: Any
    lights: LightTable
    camera: Camera
    mis: Mis
    max_edges: Any  #: opaque UInt32
    rr_depth: int
    split_layers: bool  #: keep technique families apart
    cache: LightCache | None = None
    gather: Gather | None = None

    def trace(self, pixel: Any, source: SampleSource) -> tuple[dict[str, Any], Any]:
        """One camera path for each entry of ``pixel``. Returns (layers of radiance, rays), a lane, not yet evaluated."""
        lanes = dr.width(pixel)
        ray, weight, aperture = self.camera.primary(pixel, source)
        state = _State(
            active=dr.full(mi.Bool, True, lanes) & (self.max_edges > 0),
            ray=mi.Ray3f(ray),
            throughput=dr.full(mi.Color3f, 1.0, lanes),
            eta=dr.full(mi.Float, 1.0, lanes),
            d_vcm=dr.zeros(mi.Float, lanes),
            d_vc=dr.zeros(mi.Float, lanes),
            depth=dr.full(mi.UInt32, 1, lanes),
            rays=dr.zeros(mi.UInt32, lanes),
            lane=dr.arange(mi.UInt32, lanes),
            layers={name: dr.zeros(mi.Color3f, lanes) for name in self.layer_names()},
        )
        (state,) = dr.while_loop(
            (state,), lambda s: s.active, lambda s: (self._edge(s, source, aperture),), label="camera walk"
        )
        return {name: radiance * weight for name, radiance in state.layers.items()}, state.rays

    def layer_names(self) -> tuple[str, ...]:
        """Technique families that a camera pass adds to."""
        if not self.split_layers:
            return ("image",)
        t = self.mis.techniques
        used = (("next_event", t.next_event), ("connection", t.connection), ("merge", t.merge))
        return ("emission", *(name for name, on in used if on))

    def _add(self, s: _State, family: str, mask: Any, value: Any) -> None:
        layer = s.layers[family if self.split_layers else "image"]
        layer[mask] += s.throughput * value

    def _edge(self, s: _State, source: Any, aperture: Any) -> _State:
        """Trace one edge, join its end to the light side in every way, and scatter."""
        techniques = self.mis.techniques
        si = self.scene.ray_intersect(s.ray, s.active)
        s.rays += 1

        # ---- Arrive: the environment is weighted before the densities become those of an area
        valid = si.is_valid()
        cos = geometric_cos(si, s.ray.d)
        if techniques.splat:
            first = s.active & valid & (s.depth == 1)
            density = self.camera.pixel_density(si, aperture, first) * dr.square(si.t)
            s.d_vcm[first] = self.mis.start_camera(density)[0]
        d_vcm, d_vc = self.mis.hit(s.d_vcm, s.d_vc, dr.square(si.t), cos)
        s.d_vcm, s.d_vc = dr.select(valid, d_vcm, s.d_vcm), dr.select(valid, d_vc, s.d_vc)
        self._emission(s, si)
        s.active &= valid

        bsdf = si.bsdf(s.ray)
        smooth = s.active & is_smooth(bsdf)
        if techniques.merge and self.gather is not None:
            self._merge(s, si, bsdf, smooth)
        s.active &= s.depth < self.max_edges
        smooth &= s.active
        for index in range(techniques.next_event):
            self._next_event(s, si, bsdf, source, index, smooth)
        if techniques.connection and self.cache is not None:
            self._connect(s, si, bsdf, source, smooth)

        # ---- Scatter
        scattered = scatter_camera(bsdf, si, source, s.depth, s.active)
        s.d_vcm, s.d_vc = self.mis.scatter_camera(
            s.depth, s.d_vcm, s.d_vc, scattered.cos, scattered.pdf, scattered.reverse_pdf, scattered.is_delta
        )
        s.throughput *= scattered.weight
        s.eta *= scattered.eta
        s.ray = si.spawn_ray(scattered.direction)
        alive, factor = roulette(
            s.throughput, s.eta, s.depth, self.rr_depth, source.next_1d(s.depth, dim.ROULETTE)
        )
        s.throughput *= factor
        s.depth += 1
        s.active &= scattered.active & alive
        return s

    def _emission(self, s: _State, si: Any) -> None:
        """s = 0 [Georgiev 2012b, eq. 43]."""
        on_light = s.active & is_emissive(self.scene, si)
        radiance, area_density, emission_density = emission_of_hit(self.lights, self.scene, si, on_light)
        weight = self.mis.emission_weight(s.depth, s.d_vcm, s.d_vc, area_density, emission_density)
        self._add(s, "emission", on_light, radiance * weight)

    def _next_event(self, s: _State, si: Any, bsdf: Any, source: Any, index: int, active: Any) -> None:
        """s = 1 [Georgiev 2012b, eq. 44, 45]."""
        direct = sample_direct(self.lights, si, source, s.depth, index, active)
        wo = si.to_local(direct.direction)
        value, pdf, reverse_pdf = evaluate_from_eye(bsdf, si, wo, direct.active)
        weight = self.mis.next_event_weight(
            s.depth,
            s.d_vcm,
            s.d_vc,
            dr.select(direct.is_delta, 0.0, pdf),
            reverse_pdf,
            direct.pdf,
            direct.light_ratio * geometric_cos(si, direct.direction),
        )
        contribution = value * direct.radiance * (weight / self.mis.techniques.next_event)
        lit = direct.active & dr.any(contribution != 0.0)
        s.rays += dr.select(lit, mi.UInt32(1), mi.UInt32(0))
        lit &= ~self.scene.ray_test(si.spawn_ray_to(direct.target), lit)
        self._add(s, "next_event", lit, contribution)

    def _connect(self, s: _State, si: Any, bsdf: Any, source: Any, active: Any) -> None:
        """s >= 2, t >= 2 [Georgiev 2012b, eq. 40, 41]."""
        assert self.cache is not None
        cache = self.cache
        if not cache.pairs:
            active = active & (cache.count > 0)
            for index in range(self.mis.techniques.connection):
                u = source.next_1d(s.depth, dim.CONNECT + index)
                number = dr.minimum(mi.UInt32(u * mi.Float(cache.count)), cache.count - 1)
                value, rays = self._connection(s, si, bsdf, number, active)
                s.rays += rays
                self._add(s, "connection", active, value * cache.factor)
            return
        first, count = cache.vertices.path_vertices(s.lane % cache.paths, active)
        n = dr.width(s.depth)
        _, total, rays = dr.while_loop(
            (dr.zeros(mi.UInt32, n), dr.zeros(mi.Color3f, n), dr.zeros(mi.UInt32, n)),
            lambda j, total, rays: active & (j < count),
            lambda j, total, rays: _accumulate(j, total, rays, self._connection(s, si, bsdf, first + j, active)),
            label="connect",
        )
        s.rays += rays
        self._add(s, "connection", active, total)

    def _connection(self, s: _State, si: Any, bsdf: Any, number: Any, active: Any) -> tuple[Any, Any]:
        """(weighted contribution of joining with light vertex ``number`` over the throughput, shadow rays)."""
        assert self.cache is not None
        vertex: LightVertex = self.cache.vertices.read(self.cache.vertices.slot(number, active), active)
        active = active & (vertex.depth + s.depth + 1 <= self.max_edges)
        offset = vertex.si.p - si.p
        distance_squared = dr.squared_norm(offset)
        active &= distance_squared > 0.0
        direction = offset * dr.rsqrt(distance_squared)
        inverse = dr.rcp(distance_squared)

        value, pdf, reverse_pdf = evaluate_from_eye(bsdf, si, si.to_local(direction), active)
        active &= dr.any(value != 0.0)
        wo = vertex.si.to_local(-direction)
        light_value, light_reverse_pdf = evaluate_from_light(vertex.bsdf, vertex.si, wo, -direction, active)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        light_pdf = vertex.bsdf.pdf(context, vertex.si, wo, active)
        weight = self.mis.connection_weight(
            s.depth,
            (s.d_vcm, s.d_vc),
            (vertex.d_vcm, vertex.d_vc),
            pdf * geometric_cos(vertex.si, direction) * inverse,
            light_pdf * geometric_cos(si, direction) * inverse,
            reverse_pdf,
            light_reverse_pdf,
        )
        contribution = vertex.throughput * value * light_value * (weight * inverse)
        joined = active & dr.any(contribution != 0.0)
        rays = dr.select(joined, mi.UInt32(1), mi.UInt32(0))
        joined &= ~self.scene.ray_test(si.spawn_ray_to(vertex.si.p), joined)
        return dr.select(joined, contribution, 0.0), rays

    def _merge(self, s: _State, si: Any, bsdf: Any, active: Any) -> None:
        """s >= 2, t >= 2, no edge between them [Georgiev 2012b, eq. 38, 39]."""
        assert self.gather is not None
        if not self.mis.techniques.merge_first:
            active = active & (s.depth > 1)
        query = self.gather.grid.query(si.p, active)
        n = dr.width(s.depth)
        _, total = dr.while_loop(
            (dr.zeros(mi.UInt32, n), dr.zeros(mi.Color3f, n)),
            lambda i, total: active & (i < query.total),
            lambda i, total: (i + 1, total + self._merged(s, si, bsdf, query, i, active)),
            label="merge",
        )
        self._add(s, "merge", active, total * self.gather.factor)

    def _merged(self, s: _State, si: Any, bsdf: Any, query: Any, i: Any, active: Any) -> Any:
        """Weighted contribution of the query's ``i``-th candidate, without the kernel's factor."""
        assert self.gather is not None
        index, row = self.gather.grid.candidate(query, i)
        position, depth = self.gather.photons.position(index, active)
        near = active & self.gather.grid.accepts(query, row, position) & (depth + s.depth <= self.max_edges)
        throughput, direction, d_vcm, d_vc = self.gather.photons.flux(index, near)
        wo = si.to_local(direction)
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo, near)
        reverse_pdf = bsdf.pdf(mi.BSDFContext(mi.TransportMode.Importance), exchanged(si, wo), si.wi, near)
        # eval carries the shading cosine; a photon's flux per area already holds the geometric one.
        cos = geometric_cos(si, direction)
        near &= cos > 0.0
        weight = self.mis.merge_weight(s.depth, (s.d_vcm, s.d_vc), (d_vcm, d_vc), pdf, reverse_pdf)
        return dr.select(near, throughput * value * (weight / dr.select(near, cos, 1.0)), 0.0)


def _accumulate(j: Any, total: Any, rays: Any, result: tuple[Any, Any]) -> tuple[Any, Any, Any]:
    return j + 1, total + result[0], rays + result[1]
