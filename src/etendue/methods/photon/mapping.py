r"""What photon mapping, progressive and stochastic progressive photon mapping share.

A pass traces photons from the lights, stores them at every vertex that is not specular, and follows each camera path
through mirrors and glass to the first surfaces with a smooth material. There the light that arrives directly is found
by next event, weighted against one more edge in the BSDF's direction, and the rest by density estimation
[Jensen 1996; Hachisuka 2008]:

.. math:: L(x, \omega) = \frac{1}{N} \sum_j \frac{K(d_j^2 / r^2)}{\pi r^2} f_s(x, \omega_j, \omega) \, \Phi_j

over the photons j within the distance r, N light paths traced. A material with a smooth and a specular component is
gathered at, and the path goes on where the specular one is sampled.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource, setting
from etendue.density import KERNELS
from etendue.scene import Problem
from etendue.transport import dimensions as dim
from etendue.transport import (
    emission_of_hit,
    geometric_cos,
    is_emissive,
    is_smooth,
    roulette,
    sample_direct,
    scatter_camera,
)

from ..base import STEP_LANES, CameraSettings, ImageMethod, Layer, total
from .photons import PhotonTracer, Shot


@dataclass(frozen=True)
class PhotonSettings(CameraSettings):
    """Settings of every photon mapping method."""

    direct: str = setting(
        "next_event",
        "light that reaches what the camera sees without a bounce: by next event and hits, or from photons too",
        choices=("next_event", "photons"),
    )
    kernel: str = setting("uniform", "weight of a photon over the disc it is gathered from", choices=tuple(KERNELS))


@dataclass
class _State:
    """Loop state, one lane a camera path."""

    active: Any
    ray: Any
    throughput: Any
    eta: Any  #: product of the relative indices of refraction
    radiance: Any
    depth: Any  #: edges so far, the one being traced included
    travelled: Any  #: length of the edge before the surfaces that it has crossed
    pdf: Any  #: density of the edge's direction if it left a smooth material, else 0
    beyond: Any  #: the path has been scattered by a smooth material
    found: Any  #: photons that were found where the path first gathered; see ``first``
    first: Any  #: nothing was gathered yet
    rays: Any
    lane: Any


class _Chosen:
    """One source of numbers or another, lane by lane."""

    def __init__(self, condition: Any, where: SampleSource, elsewhere: SampleSource) -> None:
        self._condition, self._where, self._elsewhere = condition, where, elsewhere

    def next_1d(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return dr.select(
            self._condition, self._where.next_1d(vertex, component), self._elsewhere.next_1d(vertex, component)
        )

    def next_2d(self, vertex: Any, component: int) -> tuple[Any, Any]:
        """See :class:`SampleSource`."""
        here, there = self._where.next_2d(vertex, component), self._elsewhere.next_2d(vertex, component)
        return tuple(dr.select(self._condition, a, b) for a, b in zip(here, there, strict=True))

    def decide(self, vertex: Any, component: int) -> Any:
        """See :class:`SampleSource`."""
        return dr.select(
            self._condition, self._where.decide(vertex, component), self._elsewhere.decide(vertex, component)
        )


class PhotonMapping(ImageMethod):
    """Base of the photon mapping methods. A subclass says how photons are gathered."""

    #: Whether every pass looks at the same points of the same surfaces.
    fixed_points = False
    #: Whether a path is followed for one more bounce, to gather there.
    final_gather = False

    def prepare(self, problem: Problem, seed: int) -> None:
        """Tables, and a pilot that measures how many photons a light path stores."""
        super().prepare(problem, seed)
        self._edges = dr.opaque(mi.UInt32, self.max_edges())
        self.tracer = PhotonTracer(self, seed)
        self._light_paths = self.tracer.fitting(self.light_paths())

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return STEP_LANES

    @abstractmethod
    def light_paths(self) -> int:
        """Light paths that a pass shall trace."""

    @abstractmethod
    def build(self, shot: Shot, iteration: int, seed: int) -> None:
        """Make the photons ready for :meth:`gather`."""

    @abstractmethod
    def gather(self, si: Any, bsdf: Any, s: Any, active: Any) -> tuple[Any, Any]:
        """(reflected radiance, photons found) at ``si``; ``s`` is the camera path's loop state."""

    def finish(self, found: Any) -> None:
        """Called after a pass with the number of photons that each path found where it first gathered."""

    def shoot(self, iteration: int, seed: int) -> Shot:
        """The photons of a pass."""
        return self.tracer.shoot(iteration, seed, self._light_paths)

    # ------------------------------------------------------------------ camera paths

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        shot = self.shoot(iteration, seed)
        self.build(shot, iteration, seed)
        state, weight = self._trace("", iteration, seed, samples)
        radiance, bad = self.kept(state.radiance * weight)
        dr.eval(radiance, state.rays, state.found, bad)
        self.finish(state.found)
        counters = {
            "rays": total(state.rays) + shot.rays,
            "paths": float(len(radiance[0]) + shot.paths),
            "photons": float(shot.vertices.wanted[0]),
            "nonfinite": total(bad),
        }
        return {"image": self.image(radiance, seed, 0 if self.fixed_points else iteration)}, counters

    def _trace(self, role: str, iteration: int, seed: int, samples: int) -> tuple[_State, Any]:
        """Camera paths: (last state, weight of the camera ray), not yet evaluated."""
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        fresh = self.camera_numbers(lanes, samples, seed, iteration, role + "camera")
        fixed = self.camera_numbers(lanes, samples, seed, 0, role + "camera") if self.fixed_points else fresh
        ray, weight, _ = self.camera.primary(lanes // samples, fixed)
        state = _State(
            active=dr.full(mi.Bool, True, len(lanes)) & (self._edges > 0),
            ray=mi.Ray3f(ray),
            throughput=mi.Color3f(1.0),
            eta=mi.Float(1.0),
            radiance=mi.Color3f(dr.opaque(mi.Float, 0.0)),
            depth=mi.UInt32(1),
            travelled=mi.Float(0.0),
            pdf=mi.Float(0.0),
            beyond=mi.Bool(False),
            found=mi.UInt32(0),
            first=mi.Bool(True),
            rays=mi.UInt32(0),
            lane=mi.UInt32(lanes),
        )
        (state,) = dr.while_loop(
            (state,), lambda s: s.active, lambda s: (self._edge(s, fresh, fixed),), label="photon gathering"
        )
        return state, weight

    def _edge(self, s: _State, fresh: SampleSource, fixed: SampleSource) -> _State:
        """Trace one edge; gather at its end, and scatter."""
        si = self.scene.ray_intersect(s.ray, s.active)
        s.rays += 1
        distance = s.travelled + si.t
        self._emission(s, si, distance)
        # The edge after a smooth material was for the emission at its end, and leads on only to gather there.
        going = s.active & si.is_valid() & (s.depth < self._edges)
        if not self.final_gather and not self.visibility.transparent:
            going &= ~s.beyond
        s.active = going

        bsdf = si.bsdf(s.ray)
        smooth = s.active & is_smooth(bsdf)
        here = smooth if self.final_gather else smooth & ~s.beyond
        reflected, found = self.gather(si, bsdf, s, here)
        s.radiance[here] += s.throughput * reflected
        s.found = dr.select(here & s.first, found, s.found)
        s.first &= ~here

        source: SampleSource = _Chosen(smooth, fresh, fixed) if self.fixed_points else fresh
        if self.settings.direct == "next_event":
            direct = sample_direct(self.lights, si, source, s.depth, 0, smooth & ~s.beyond)
            wo = si.to_local(direct.direction)
            scattered, (value,) = scatter_camera(bsdf, si, source, s.depth, s.active, [(wo, direct.active)])
            weight = dr.select(direct.is_delta, 1.0, dr.rcp(1.0 + value.pdf / direct.pdf))
            contribution = s.throughput * value.value * direct.radiance * weight
            lit = direct.active & ~dr.all(contribution == 0.0)
            s.rays += dr.select(lit, mi.UInt32(1), mi.UInt32(0))
            lit, share = self.visibility.along(si.spawn_ray_to(direct.target), self._edges - (s.depth + 1), lit)
            s.radiance[lit] += contribution * share
        else:
            scattered, _ = scatter_camera(bsdf, si, source, s.depth, s.active)

        rough = ~scattered.is_delta
        specular_on = scattered.is_delta if self.final_gather else scattered.is_null | (scattered.is_delta & ~s.beyond)
        # A direction of the smooth component is for the light at its end, or for the gathering there.
        rough_on = ~s.beyond & (self.settings.direct == "next_event")
        s.active &= scattered.active & (specular_on | (rough & rough_on))
        s.pdf = dr.select(scattered.is_null, s.pdf, dr.select(rough, scattered.pdf, 0.0))
        s.travelled = dr.select(scattered.is_null, distance, 0.0)
        s.beyond |= rough
        s.throughput *= scattered.weight
        s.eta *= scattered.eta
        s.ray = si.spawn_ray(scattered.direction)
        u = source.decide(s.depth, dim.ROULETTE)
        alive, factor = roulette(s.throughput, s.eta, s.depth, self.settings.rr_depth, u)
        s.throughput *= factor
        s.active &= alive
        s.depth += 1
        return s

    def _emission(self, s: _State, si: Any, distance: Any) -> None:
        """Light that the edge ends on: all of it from the camera through specular surfaces, its share against next
        event after a smooth one; what comes through more surfaces after that is in the photons."""
        on_light = s.active & is_emissive(self.scene, si)
        radiance, area_density, _ = emission_of_hit(self.lights, self.scene, si, on_light, distance)
        cos = geometric_cos(si, s.ray.d)
        direct_pdf = dr.select(si.is_valid(), area_density * dr.square(distance) / cos, area_density)
        shared = dr.rcp(1.0 + direct_pdf / s.pdf) if self.settings.direct == "next_event" else mi.Float(0.0)
        weight = dr.select(s.beyond, dr.select(s.pdf > 0.0, shared, 0.0), 1.0)
        s.radiance[on_light & (weight > 0.0)] += s.throughput * radiance * weight
