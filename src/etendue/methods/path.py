r"""Path tracing from the camera: the reference that every other method is tested against.

Estimator [Kajiya 1986; Veach 1997, ch. 9 and 10], one camera path of vertices z_0 (sensor), z_1, z_2, ...:

.. math:: L = \sum_j \alpha_j \left( w^e_j L_e(z_j) + w^d_j f_s(z_j) |cos| L_e(y) / p(y) \right)

with the throughput alpha_j, emission where the path hits a light, and one light point y drawn at each vertex. Three
modes: ``naive`` counts hits only, ``next_event`` counts light points wherever one can be drawn and hits elsewhere,
``mis`` weighs both by the balance or power heuristic.

Limits: a point or spot light seen through glass or in a mirror cannot be found at all, a small one only by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import setting
from etendue.scene import LightTable
from etendue.transport import (
    DirectSample,
    Evaluated,
    LocalLights,
    Scattered,
    emission_of_hit,
    is_emissive,
    is_smooth,
    roulette,
    sample_direct,
    scatter_camera,
    scatter_uniform,
)
from etendue.transport import dimensions as dim

from .base import CameraSettings, ImageMethod, ImageSettings, Layer, total


@dataclass(frozen=True)
class PathSettings(CameraSettings):
    """Settings of ``path``."""

    mode: str = setting(
        "mis", "how lights are found: by hits, by next event, or by both", choices=("naive", "next_event", "mis")
    )
    heuristic: str = setting("balance", "weights of mode mis", choices=("balance", "power"))
    bsdf_sampling: bool = setting(True, "draw directions by the materials; else uniformly, as a study may want")


@dataclass
class PathState:
    """What the loop over the edges of paths carries along, one lane each."""

    active: Any
    ray: Any
    throughput: Any
    radiance: Any
    eta: Any  #: product of the relative indices of refraction
    depth: Any  #: edges so far, the one being traced included
    travelled: Any  #: length of the edge before the surfaces that it has crossed
    pdf: Any  #: density of the edge's direction; 0 after a delta scattering, which no light point competes with
    rays: Any
    parts: list[Any] = field(default_factory=list)  #: what a subclass wants to know of the contribution


class Path(ImageMethod):
    """Path tracing with next event estimation and multiple importance sampling."""

    name: ClassVar[str] = "path"
    plugin: ClassVar[str | None] = ""
    Settings: ClassVar[type[ImageSettings]] = PathSettings
    citations: ClassVar[tuple[str, ...]] = ("Kajiya1986", "Veach1997")

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        state = self.trace(lanes // samples, self.camera_numbers(lanes, samples, seed, iteration))
        radiance, bad = self.kept(state.radiance)
        dr.eval(radiance, state.rays, bad)  # one kernel; the sums below would launch it once each
        counters = {"rays": total(state.rays), "paths": float(len(lanes)), "nonfinite": total(bad)}
        return {"image": self.image(radiance, seed, iteration)}, counters

    def trace(self, pixel: Any, source: Any) -> PathState:
        """A path through each of the pixels (indices y * width + x) by the numbers of ``source``."""
        ray, weight, _ = self.camera.primary(pixel, source)
        state = PathState(
            active=mi.Bool(True),
            ray=mi.Ray3f(ray),
            throughput=mi.Color3f(1.0),
            radiance=mi.Color3f(0.0),
            eta=mi.Float(1.0),
            depth=mi.UInt32(1),
            travelled=mi.Float(0.0),
            pdf=mi.Float(0.0),
            rays=mi.UInt32(0),
            parts=self.parts(source),
        )
        max_edges = dr.opaque(mi.UInt32, self.max_edges())
        state.active &= max_edges > 0
        (state,) = dr.while_loop(
            (state,), lambda s: s.active, lambda s: (self._edge(s, source, max_edges),), label="path"
        )
        state.radiance *= weight
        return state

    def _edge(self, s: PathState, source: Any, max_edges: Any) -> PathState:
        """Trace one edge and scatter at its end."""
        si = self.scene.ray_intersect(s.ray, s.active)
        s.rays += 1

        # ---- The edge ends on a light
        on_light = s.active & is_emissive(self.scene, si)
        distance = s.travelled + si.t
        radiance, area_density, _ = emission_of_hit(self.lights_of_edge(s), self.scene, si, on_light, distance)
        solid_angle = dr.select(si.is_valid(), dr.square(distance) / dr.abs(dr.dot(si.n, s.ray.d)), 1.0)
        weight = self._hit_weight(s.pdf, area_density * solid_angle)
        self.add(s, source, s.throughput * radiance * weight, on_light, False)
        s.active &= si.is_valid() & (s.depth < max_edges) & self.goes_on(s, source)

        # ---- A light point is drawn, and a way on; the BSDF is asked about both in one call
        bsdf = si.bsdf(s.ray)
        done = self.finish(s, source, si, bsdf)
        here = self.locate(s, si)
        if self.settings.mode == "naive":
            scattered, _ = self.scatter(here, bsdf, si, source, s.depth, s.active)
        else:
            looking = s.active & ~done & is_smooth(bsdf)
            direct = sample_direct(self.lights_at(here), si, source, s.depth, 0, looking)
            wo = si.to_local(direct.direction)
            scattered, (value,) = self.scatter(here, bsdf, si, source, s.depth, s.active, [(wo, direct.active)])
            contribution = s.throughput * value.value * direct.radiance * self._direct_weight(direct, value.pdf)
            lit = direct.active & ~dr.all(contribution == 0.0) & self.wants(s, source)
            s.rays += dr.select(lit, mi.UInt32(1), mi.UInt32(0))
            spare = max_edges - (s.depth + 1)
            lit, share = self.visibility.along(si.spawn_ray_to(direct.target), spare, lit)
            self.add(s, source, contribution * share, lit, True)
            self.lit(s, here, direct, contribution * share, lit)

        # ---- Scatter
        self.leave(s, here, scattered)
        s.throughput *= scattered.weight
        s.eta *= scattered.eta
        pdf = dr.select(scattered.is_delta, 0.0, scattered.pdf)
        if self.visibility.transparent:  # a surface that was crossed is no vertex: the edge goes on
            s.pdf = dr.select(scattered.is_null, s.pdf, pdf)
            s.travelled = dr.select(scattered.is_null, distance, 0.0)
        else:
            s.pdf = pdf
        s.ray = si.spawn_ray(scattered.direction)
        alive = self.survives(s, source)
        s.depth += 1
        s.active &= scattered.active & alive & (~done | scattered.is_delta)
        return s

    # ------------------------------------------------------------------ what another method may change

    def locate(self, s: PathState, si: Any) -> Any:
        """What the methods below are told of the place of vertex ``s.depth``."""
        return None

    def lights_at(self, here: Any) -> LightTable | LocalLights:
        """The lights as light points are drawn for a place."""
        return self.lights

    def lights_of_edge(self, s: PathState) -> LightTable | LocalLights:
        """The same for the vertex that the edge ``s.depth`` comes from."""
        return self.lights

    def scatter(
        self,
        here: Any,
        bsdf: Any,
        si: Any,
        source: Any,
        vertex: Any,
        active: Any,
        directions: Sequence[tuple[Any, Any]] = (),
    ) -> tuple[Scattered, list[Evaluated]]:
        """As ``transport.scatter_camera``: a way on, and the BSDF towards the given (local direction, mask) pairs."""
        scatter = scatter_camera if self.settings.bsdf_sampling else scatter_uniform
        return scatter(bsdf, si, source, vertex, active, directions)

    def lit(self, s: PathState, here: Any, direct: DirectSample, contribution: Any, active: Any) -> None:
        """A light point brought something to vertex ``s.depth``."""

    def leave(self, s: PathState, here: Any, scattered: Any) -> None:
        """The light points of vertex ``s.depth`` are counted; the path goes on from it by what :meth:`scatter` gave."""

    def survives(self, s: PathState, source: Any) -> Any:
        """Roulette after vertex ``s.depth``: whether a path goes on, and its throughput pays for those that do not."""
        u = source.decide(s.depth, dim.ROULETTE)
        alive, factor = roulette(s.throughput, s.eta, s.depth, self.settings.rr_depth, u)
        s.throughput *= factor
        return alive

    def add(self, s: PathState, source: Any, contribution: Any, active: Any, by_light_point: bool) -> None:
        """Count what a light contributes: a hit at the end of edge ``s.depth``, or a point of it joined to vertex
        ``s.depth``."""
        s.radiance[active] += contribution

    def parts(self, source: Any) -> list[Any]:
        """The first values of ``PathState.parts``."""
        return []

    def finish(self, s: PathState, source: Any, si: Any, bsdf: Any) -> Any:
        """Count all that the smooth component of vertex ``s.depth`` reflects, in some other way, and return where that
        was done."""
        return mi.Bool(False)

    def goes_on(self, s: PathState, source: Any) -> Any:
        """Whether paths of more than ``s.depth`` edges count."""
        return True

    def wants(self, s: PathState, source: Any) -> Any:
        """Whether a light point joined to vertex ``s.depth`` counts."""
        return True

    # ------------------------------------------------------------------ weights

    def _hit_weight(self, pdf: Any, direct_pdf: Any) -> Any:
        """Weight of a hit; ``pdf`` is 0 where only a hit can find the light."""
        match self.settings.mode:
            case "naive":
                return mi.Float(1.0)
            case "next_event":
                return dr.select(pdf == 0.0, mi.Float(1.0), 0.0)
        ratio = direct_pdf / pdf
        return dr.select(pdf == 0.0, 1.0, dr.rcp(1.0 + self._power(ratio)))

    def _direct_weight(self, direct: Any, pdf: Any) -> Any:
        if self.settings.mode == "next_event":
            return mi.Float(1.0)
        return dr.select(direct.is_delta, 1.0, dr.rcp(1.0 + self._power(pdf / direct.pdf)))

    def _power(self, ratio: Any) -> Any:
        return ratio * ratio if self.settings.heuristic == "power" else ratio
