"""The light pass: sub-paths from the lights, joined to the camera on the way and stored vertex by vertex."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import LightTable

from . import dimensions as dim
from .camera import Camera, CameraConnection, Splats
from .emission import emit
from .mis import Mis
from .pyramid import Pyramid
from .scattering import Evaluated, cosine_ratio, geometric_cos, is_smooth, roulette, scatter_light, shadow_roulette
from .spheres import seen_density
from .vertices import Kind, LightVertices
from .visibility import Visibility


@dataclass
class _State:
    """Loop state, one lane a light sub-path."""

    active: Any
    ray: Any
    throughput: Any
    d_vcm: Any
    d_vc: Any
    depth: Any  #: edges so far, the one being traced included
    vertex: Any  #: the same without the surfaces that were crossed; counted for a pyramid where a scene has such
    stored: Any  #: vertices stored so far
    kind: Any  #: the :class:`Kind` of the vertex that the edge leads to
    from_infinity: Any  #: the edge being traced leaves an infinite light
    light: Any  #: number of the light that the path left; None where no light is spherical
    waiting: (
        Any  #: area density of the light point until the end of the first edge says another; 0 from there on, or None
    )
    travelled: Any  #: length of the edge before the surfaces that it has crossed
    rays: Any
    nonfinite: Any


@dataclass
class LightWalk:
    """What a light pass needs; :meth:`trace` runs it as one kernel."""

    visibility: Visibility
    lights: LightTable
    camera: Camera
    mis: Mis
    max_edges: Any  #: opaque UInt32
    rr_depth: int
    dark: Any  #: opaque Float: radiance below which a contribution plays roulette before its shadow ray
    pyramid: Pyramid | None = None  #: gets splats technique by technique

    def trace(
        self, paths: int, source: SampleSource, vertices: LightVertices | None, splats: Splats | None
    ) -> tuple[Any, Any]:
        """Trace ``paths`` sub-paths. Stores into ``vertices`` and adds to ``splats`` where they are
        given. Returns (rays, non-finite splats) a lane, not yet evaluated."""
        emitted = emit(self.lights, source, mi.Bool(True))
        d_vcm, d_vc = self.mis.start_light(
            emitted.area_density, emitted.emission_density, emitted.cos_light, emitted.is_delta
        )
        path = dr.arange(mi.UInt32, paths)
        waits = self._waits
        state = _State(
            active=emitted.active & (self.max_edges > 1),
            ray=emitted.ray,
            throughput=emitted.throughput,
            d_vcm=d_vcm,
            d_vc=d_vc,
            depth=dr.full(mi.UInt32, 1, paths),
            vertex=mi.UInt32(1),
            stored=dr.zeros(mi.UInt32, paths),
            # A beam is out of reach for next event, so what it shines on counts as a caustic.
            kind=dr.select(emitted.area_density > 0.0, mi.UInt32(Kind.DIRECT), mi.UInt32(Kind.CAUSTIC)),
            from_infinity=emitted.is_infinite,
            light=mi.UInt32(emitted.light) if waits else None,
            waiting=mi.Float(emitted.area_density) if waits else None,
            travelled=mi.Float(0.0),
            rays=dr.zeros(mi.UInt32, paths),
            nonfinite=dr.zeros(mi.UInt32, paths),
        )
        (state,) = dr.while_loop(
            (state,),
            lambda s: s.active,
            lambda s: (self._edge(s, path, source, vertices, splats),),
            label="light walk",
        )
        if vertices is not None:
            vertices.close_paths(path, state.stored)
        return state.rays, state.nonfinite

    def _edge(self, s: _State, path: Any, source: Any, vertices: LightVertices | None, splats: Splats | None) -> _State:
        """Trace one edge; splat, store and scatter at its end."""
        waits = self._waits
        hit = self.visibility.scene.ray_intersect_preliminary(s.ray, active=s.active)
        si = hit.compute_surface_interaction(s.ray, active=s.active)
        s.rays += 1
        s.active &= si.is_valid()

        distance = s.travelled + si.t
        distance_squared = dr.square(distance)
        if self.lights.has_infinite:
            distance_squared = dr.select(s.from_infinity, 1.0, distance_squared)
        on_edge = s.d_vcm, s.d_vc
        light_cos = geometric_cos(si, s.ray.d)
        d_vcm = s.d_vcm
        if waits:
            light = self.lights.row(s.light, s.active & (s.waiting > 0.0))
            waiting = dr.select(s.waiting > 0.0, s.waiting, 1.0)
            density = seen_density(light, si.p, -s.ray.d, distance, waiting)
            d_vcm = self.mis.lit(d_vcm, dr.select(s.waiting > 0.0, density / waiting, 1.0))
        s.d_vcm, s.d_vc = self.mis.hit(d_vcm, s.d_vc, distance_squared, light_cos)

        bsdf = si.bsdf(s.ray)
        smooth = s.active & is_smooth(bsdf)
        if vertices is not None:
            mis, number, fluence = (s.d_vcm, s.d_vc), self._vertex(s), self.mis.fluence(light_cos)
            vertices.append(path, s.stored, s.depth, hit, si, bsdf, s.throughput, fluence, mis, s.kind, smooth, number)
            s.stored += dr.select(smooth, mi.UInt32(1), mi.UInt32(0))
        # Going on takes an edge, and using the vertex it leads to at least one more.
        s.active &= s.depth + 1 < self.max_edges
        if splats is None:
            scattered, _ = scatter_light(bsdf, si, source, s.depth, s.active)
        else:
            joined = self.camera.connect(si, self.camera.splat_aperture(source, s.depth), smooth)
            wo = si.to_local(joined.direction)
            scattered, (value,) = scatter_light(bsdf, si, source, s.depth, s.active, [(wo, joined.active)])
            self._splat(s, si, joined, light_cos, value, source, splats)
        s.d_vcm, s.d_vc = self.mis.scatter_light(
            s.d_vcm, s.d_vc, light_cos, scattered.cos, scattered.pdf, scattered.reverse_pdf, scattered.is_delta
        )
        through = dr.select(s.kind == mi.UInt32(Kind.INDIRECT), s.kind, mi.UInt32(Kind.CAUSTIC))
        kind = dr.select(scattered.is_delta, through, mi.UInt32(Kind.INDIRECT))
        s.kind = dr.select(scattered.is_null, s.kind, kind)
        if self.visibility.transparent:
            crossed = scattered.is_null
            s.d_vcm, s.d_vc = dr.select(crossed, on_edge[0], s.d_vcm), dr.select(crossed, on_edge[1], s.d_vc)
            s.travelled = dr.select(crossed, distance, 0.0)
            s.from_infinity &= crossed
            if waits:
                s.waiting = dr.select(crossed, s.waiting, 0.0)
            if self.pyramid is not None:
                s.vertex += dr.select(crossed, mi.UInt32(0), mi.UInt32(1))
        else:
            s.from_infinity = mi.Bool(False)
            if waits:
                s.waiting = mi.Float(0.0)
        s.throughput *= scattered.weight
        s.ray = si.spawn_ray(scattered.direction)
        alive, factor = roulette(
            s.throughput / self.lights.total_power, 1.0, s.depth, self.rr_depth, source.decide(s.depth, dim.ROULETTE)
        )
        s.throughput *= factor
        s.depth += 1
        s.active &= scattered.active & alive
        return s

    @property
    def _waits(self) -> bool:
        """Whether next event draws the points of some light by the point that is lit: the end of the first edge."""
        return self.lights.has_sphere and self.mis.techniques.next_event > 0

    def _vertex(self, s: _State) -> Any:
        """Number of the vertex at the end of the edge, the light point being 0; asked for by a pyramid alone."""
        return s.vertex if self.visibility.transparent else s.depth

    def _splat(
        self,
        s: _State,
        si: Any,
        joined: CameraConnection,
        light_cos: Any,
        bsdf: Evaluated,
        source: Any,
        splats: Splats,
    ) -> None:
        """Join the vertex to the camera (t = 1) [Georgiev 2012b, eq. 46, 47]."""
        area_pdf = joined.area_pdf(geometric_cos(si, joined.direction))
        weights = self.mis.splat_weight(s.d_vcm, s.d_vc, light_cos, bsdf.reverse_pdf, area_pdf)
        place = self.camera.splat_place(joined, source, s.depth)
        factor = joined.importance * place.weight * cosine_ratio(si, joined.direction)
        contributions = [s.throughput * bsdf.value * (factor * weight) for weight in weights]
        # One splat is to its pixel's sum over paths what a camera path is to that over samples.
        lit, roulette_factor = shadow_roulette(
            contributions,
            self.dark * self.mis.paths_per_sample,
            source.decide(s.depth, dim.SPLAT_SHADOW),
            joined.active & place.on_film,
        )
        asked = lit
        alone = s.throughput * bsdf.value * factor
        if self.pyramid is not None:  # a technique by itself wants every ray that may carry light
            asked = joined.active & place.on_film & ~dr.all(alone == 0.0)
        s.rays += dr.select(asked, mi.UInt32(1), mi.UInt32(0))
        spare = self.max_edges - (s.depth + 1)
        seen, share = self.visibility.along(si.spawn_ray_to(joined.target), spare, asked)
        visible = seen
        contributions = [contribution * (roulette_factor * share) for contribution in contributions]
        if self.pyramid is not None:
            visible = seen & lit
            scale = dr.rcp(self.mis.paths_per_sample)
            weighted = dr.select(visible, contributions[0] * scale, 0.0)
            self.pyramid.add_splat(self._vertex(s) + 1, place, weighted, alone * (share * scale), seen)
        finite = mi.Bool(True)
        for contribution in contributions:
            finite &= dr.all(dr.isfinite(contribution))
        s.nonfinite += dr.select(visible & ~finite, mi.UInt32(1), mi.UInt32(0))
        visible &= finite
        splats.add(place, contributions, visible)
