r"""Base of photon mapping, progressive and stochastic progressive photon mapping.

A pass traces photons from the lights, stores them at every vertex that is not specular, and traces each camera path
through mirrors and glass to the first surface with a smooth component. There direct light is found by next event, and
by one more edge in a direction sampled from the BSDF, combined by MIS. Other light is found by density estimation
[Jensen 1996; Hachisuka 2008]:

.. math:: L(x, \omega) = \frac{1}{N} \sum_j \frac{K(d_j^2 / r^2)}{\pi r^2} f_s(x, \omega_j, \omega) \, \Phi_j

over the photons j within the distance r, of N light paths. At a material with a smooth and a specular component,
photons are gathered, and the path continues if the specular component is sampled.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource, setting
from etendue.density import KERNELS
from etendue.scene import Problem, materials
from etendue.transport import CameraPath, DirectWeights, Walker, WalkVertex

from ..base import CameraSettings, ImageMethod, Layer, total
from ..openings import OpeningSettings, through_openings
from .photons import PEAK, Peaks, PhotonShot, PhotonTracer


@dataclass(frozen=True)
class PhotonSettings(OpeningSettings, CameraSettings):
    """Settings of every photon mapping method."""

    direct: str = setting(
        "next_event",
        "estimator of direct light: next event and hits (next_event), or density of photons, with more blur (photons)",
        choices=("next_event", "photons"),
    )
    kernel: str = setting(
        "uniform",
        "kernel of the density estimation: weight of a photon by its distance; all but uniform decrease outwards",
        choices=tuple(KERNELS),
    )


@dataclass(kw_only=True)
class GatherPath(CameraPath):
    """State of a camera path that gathers photons."""

    beyond: mi.Bool  #: whether it has scattered at a smooth component
    found: mi.UInt32  #: photons found at its first gather point
    first: mi.Bool  #: whether it has no gather point yet
    peaked: mi.Bool  #: whether it has scattered in a peak of a smooth component
    point: mi.UInt32  #: number of the camera path in a pass; does not change


class _SelectedSource:
    """Random numbers of one of two sources, selected by a mask."""

    def __init__(self, condition: mi.Bool, where: SampleSource, elsewhere: SampleSource) -> None:
        self._condition, self._where, self._elsewhere = condition, where, elsewhere

    def next_1d(self, vertex: mi.UInt32, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return dr.select(
            self._condition, self._where.next_1d(vertex, component), self._elsewhere.next_1d(vertex, component)
        )

    def next_2d(self, vertex: mi.UInt32, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        here, there = self._where.next_2d(vertex, component), self._elsewhere.next_2d(vertex, component)
        return tuple(dr.select(self._condition, a, b) for a, b in zip(here, there, strict=True))

    def decide(self, vertex: mi.UInt32, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return dr.select(
            self._condition, self._where.decide(vertex, component), self._elsewhere.decide(vertex, component)
        )


def _glossy() -> tuple[mi.BSDFFlags, ...]:
    return mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.GlossyTransmission


class PhotonMapping(ImageMethod):
    """Base of the photon mapping methods. A subclass implements the gathering of photons."""

    settings: PhotonSettings
    #: Whether all passes have the same gather points.
    fixed_points = False
    #: Whether photons are gathered one bounce later.
    final_gather = False

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. A pilot measures the number of photons of a light path."""
        super().prepare(problem, seed)
        self.lights = through_openings(self, seed)
        self.tracer = PhotonTracer(self, seed)
        self._light_paths = self.tracer.fitting(self.light_paths())
        bsdfs = [one for one in materials(problem.scene) if isinstance(one, mi.BSDF)]
        glossy = any(mi.has_flag(bsdf.flags(), flag) for bsdf in bsdfs for flag in _glossy())
        self.peaks = (
            Peaks(self.lights.has_delta or self.lights.has_beam)
            if glossy and self.settings.direct == "next_event"
            else None
        )

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`. Half as many: photons are gathered pass by pass."""
        return super().full_lanes() // 2

    @abstractmethod
    def light_paths(self) -> int:
        """Light paths of a pass, before memory limits it."""

    @abstractmethod
    def build(self, shot: PhotonShot, iteration: int, seed: int) -> None:
        """Prepare the photons of a pass for :meth:`gather`."""

    @abstractmethod
    def gather(self, s: GatherPath, vertex: WalkVertex, active: mi.Bool) -> tuple[list[mi.Spectrum], mi.UInt32]:
        """(reflected radiance at a vertex by density estimation, one value, or with ``components`` one for each
        of ``film.REFLECTED``; number of photons found)."""

    def finish(self, found: mi.UInt32) -> None:
        """Called after a pass with the number of photons that each path found at its first gather point."""

    def shoot(self, iteration: int, seed: int) -> PhotonShot:
        """The photons of a pass."""
        return self.tracer.shoot(iteration, seed, self._light_paths)

    # ------------------------------------------------------------------ camera paths

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        shot = self.shoot(iteration, seed)
        self.build(shot, iteration, seed)
        path = self._trace("", iteration, seed, self._lanes(), samples)
        radiance, bad = self.kept_layers(path)
        dr.eval(radiance, path.rays, path.found, bad)
        self.finish(path.found)
        counters = {
            "rays": total(path.rays) + shot.rays,
            "paths": float(dr.width(path.rays) + shot.paths),
            "photons": float(shot.vertices.wanted[0]),
            "nonfinite": total(bad),
        }
        return self.images(radiance, seed, 0 if self.fixed_points else iteration), counters

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        self.build(self.shoot(iteration, seed), iteration, seed)
        dr.eval(self._trace("", iteration, seed, lanes, samples).radiance)

    def trace_from_lights(self, number: mi.UInt32, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        self.tracer.trace_again(number, iteration, seed, self._light_paths)

    def _lanes(self) -> mi.UInt32:
        """The camera paths of a pass."""
        return dr.arange(mi.UInt32, self.camera.pixels * self.samples_per_iteration)

    def _trace(self, role: str, iteration: int, seed: int, lanes: mi.UInt32, samples: int) -> GatherPath:
        """The camera paths ``lanes`` of ``samples`` in a pixel, not yet evaluated. If a pass has less in a pixel, its
        gather points are used again and again."""
        own, points = self.samples_per_iteration, lanes
        if samples != own:
            count = dr.opaque(mi.UInt32, samples)
            points = lanes // count * own + lanes % count % own
        fresh = fixed = self.camera_numbers(lanes, samples, seed, iteration, role + "camera")
        if self.fixed_points:
            fixed = self.camera_numbers(points, own, seed, 0, role + "camera")
        ray, importance, _ = self.camera.primary(points // own, fixed)
        walker = self.walker(Walker, first=self.first_hits(lanes, 0 if self.fixed_points else iteration))
        path = GatherPath.start(
            ray,
            walker.max_edges,
            **self.path_fields(),
            radiance=mi.Spectrum(dr.opaque(mi.Float, 0.0)),  # not literal, for scenes without smooth surfaces
            beyond=mi.Bool(False),
            found=mi.UInt32(0),
            first=mi.Bool(True),
            peaked=mi.Bool(False),
            point=mi.UInt32(points),
        )
        path = walker.walk(path, lambda s: self._edge(s, walker, fresh, fixed), "photon gathering")
        path.weigh(importance)
        return path

    def _edge(self, s: GatherPath, walker: Walker, fresh: SampleSource, fixed: SampleSource) -> GatherPath:
        """Trace one edge; gather and scatter at its end."""
        vertex, weights = walker.arrive(s, fresh), DirectWeights()
        next_event = self.settings.direct == "next_event"

        # ---- Emission: weight 1 after specular surfaces only, MIS weight one edge after a smooth surface, 0 later,
        # because the photons contain that light
        hit = walker.emission(s, vertex)
        shared = weights.hit(s.pdf, hit.direct_pdf) if next_event else mi.Float(0.0)
        in_photons = s.beyond | s.peaked if self.peaks and self.peaks.keep_caustics else s.beyond
        weight = dr.select(s.pdf > 0.0, shared, dr.select(in_photons, 0.0, 1.0))
        s.add(s.throughput * hit.radiance * weight, hit.active & (weight > 0.0), s.seen)
        # The edge after a smooth surface is for emission only, unless photons are gathered at its end.
        s.active &= vertex.valid & walker.goes_on(s, vertex)
        if not self.final_gather and not self.visibility.transparent:
            s.active &= ~s.beyond

        # ---- Density estimation
        smooth = s.active & vertex.smooth
        here = smooth if self.final_gather else smooth & ~s.beyond
        reflected, found = self.gather(s, vertex, here)
        for component, value in s.components_of(reflected):
            s.add(s.throughput * value, here, component)
        s.found = dr.select(here & s.first, found, s.found)

        # ---- Next event
        source: SampleSource = _SelectedSource(smooth, fresh, fixed) if self.fixed_points else fresh
        lights = [walker.light_point(vertex, source, smooth & ~s.beyond)] if next_event else []
        scattered, evaluated = vertex.sample(source, s.active, lights)
        for light, f in zip(lights, evaluated, strict=True):
            contribution, visible = walker.next_event(s, vertex, light, f, weights)
            s.add(contribution, visible, s.lit)

        # ---- Advance: through specular components and peaks, and for one edge after other scattering
        rough = ~scattered.is_delta
        peak = rough & ~s.beyond & ~(scattered.pdf <= PEAK) if self.peaks else mi.Bool(False)
        s.peaked |= peak
        s.first &= ~here | peak
        specular = scattered.is_delta if self.final_gather else scattered.is_null | (scattered.is_delta & ~s.beyond)
        continues = specular | (rough & ~s.beyond & next_event)
        s.beyond |= rough & ~peak
        s.pdf = walker.keep_if_null(scattered, s.pdf, dr.select(rough, scattered.pdf, 0.0))
        walker.advance(s, vertex, scattered, source)
        s.active &= continues
        return s
