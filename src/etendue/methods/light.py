r"""Light tracing: paths from the lights, every vertex of which is connected to the camera.

Estimator [Arvo 1986; Veach 1997, ch. 10], N light sub-paths of vertices y_0 (light), y_1, ...:

.. math:: I = \frac{1}{N} \sum_{i=1}^{N} \sum_j \alpha_j f_s^*(y_j) \, G(y_j, z_0) \, W_e

Emitters seen directly are rendered by points sampled on them, which are connected to the camera, too. Suited to
caustics of small lights. Limit: surfaces seen through mirrors or smooth glass are black, because their vertices cannot
be connected to the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import Carrying, SampleSource, State, UnsupportedError, setting
from etendue.film import REFLECTED, Component
from etendue.scene import Problem
from etendue.transport import (
    GUIDE,
    GUIDE_CHOICES,
    CameraSampler,
    Contribution,
    LearnedEmission,
    LightWalk,
    Mis,
    Splats,
    SplatSink,
    Techniques,
    dimensions as dim,
    learned_emission,
    ones,
    point_on,
)

from . import base
from .base import ImageMethod, ImageSettings, Lanes, Layer, total
from .numbers import path_numbers
from .openings import OpeningSettings, through_openings


@dataclass(frozen=True)
class LightSettings(OpeningSettings, ImageSettings):
    """Settings of ``light``."""

    light_paths: float = setting(1.0, "light paths per pixel and sample; more: less noise", above=0.0, maximum=64.0)
    guide_emission: str = setting("auto", GUIDE, choices=GUIDE_CHOICES)


def require_splats(camera: CameraSampler, method: str) -> None:
    """Raise :class:`UnsupportedError` for a sensor that points cannot be connected to."""
    if not camera.can_splat:
        raise UnsupportedError(
            f"light paths cannot be connected to this sensor, so '{method}' would render a black picture; use another "
            "method"
        )


class LightTracing(Carrying, ImageMethod):
    """Light tracing: every vertex of every light path is splatted."""

    name: ClassVar[str] = "light"
    Settings: ClassVar[type[ImageSettings]] = LightSettings
    settings: LightSettings
    citations: ClassVar[tuple[str, ...]] = ("Arvo1986", "Veach1997")
    media: ClassVar[str | None] = "scattering"
    spectral: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. Raises :class:`UnsupportedError` for a sensor that points cannot be connected
        to."""
        self._forget_states()
        super().prepare(problem, seed)
        self.lights = through_openings(self, seed)
        self._learning = learned_emission(self.settings.guide_emission, self.lights, problem.size)
        require_splats(self.camera, self.name)

    _learning: LearnedEmission | None = None

    @property
    def carries_on(self) -> bool:  # type: ignore[override]
        """Whether passes learn from earlier ones; known after :meth:`prepare`."""
        return self._learning is not None

    def _left(self) -> State:
        return {"emission": self._learning.state()} if self._learning else {}

    def _take(self, state: State) -> None:
        if self._learning:
            self._learning.restore(state["emission"])

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        paths = self._paths(samples)
        own = REFLECTED if self.settings.components else ("splat",)
        scattered, seen = (
            self._sink(self.splats(seed, iteration, len(each)), paths, len(each) > 1) for each in (own, ("emission",))
        )
        counters = {"rays": 0.0, "paths": float(paths), "nonfinite": 0.0}
        groups = -(-paths // base.MOST_LIGHT_LANES)
        for group in range(groups):
            lanes = Lanes(0, paths).part(group, groups)
            walk = self._walk(paths, scattered, lanes.first, learning=True)
            rays, bad = walk.trace(lanes.count, self.light_numbers(lanes, paths, seed, iteration))
            dr.eval(rays, bad, scattered.splats.array)
            if self._learning:
                self._learning.add(walk.training)
            source = self.light_numbers(lanes, paths, seed, iteration, "visible light")
            seen_rays, seen_bad = self._seen_directly(source, lanes.count, seen)
            dr.eval(seen_rays, seen_bad, seen.splats.array)
            counters["rays"] += total(rays) + total(seen_rays)
            counters["nonfinite"] += total(bad) + total(seen_bad)

        images = (image for sink in (scattered, seen) for image in sink.splats.sums(samples / paths))
        layers = dict(zip((*own, "emission"), images, strict=True))
        if self._learning:
            self._learning.end_pass(sum(layers[name] for name in own[1:]) + layers[own[0]], samples)
        return layers, counters

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`: all light paths of a pass, since any may reach a pixel."""
        paths = self._paths(self.samples_per_iteration)
        lanes, sink = Lanes(0, min(paths, base.MOST_LIGHT_LANES)), self._sink(self.splats(seed, iteration), paths)
        rays, _ = self._walk(paths, sink).trace(lanes.count, self.light_numbers(lanes, paths, seed, iteration))
        dr.eval(rays, sink.splats.array)

    def trace_from_lights(self, number: mi.UInt32, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        o, paths = self.settings, self._paths(self.samples_per_iteration)
        source = path_numbers(o.sampler, number, paths, seed, iteration, "light", o.scrambling)
        dr.eval(self._walk(paths, None).trace(dr.width(number), source))

    def _paths(self, samples: int) -> int:
        """Light paths of a pass."""
        return max(1, round(self.settings.light_paths * self.camera.pixels * samples))

    def _sink(self, splats: Splats, paths: int, components: bool = False) -> SplatSink:
        per_sample = dr.opaque(mi.Float, paths / self.samples_per_iteration)
        return SplatSink(splats=splats, paths_per_sample=per_sample, components=components)

    def _walk(self, paths: int, sink: SplatSink | None, first: int = 0, learning: bool = False) -> LightWalk:
        """The walk of the light paths of a pass, from number ``first`` on."""
        techniques = Techniques(emission=0, next_event=0, connection=0, splat=True, merge=False)
        mis = Mis(techniques, [0.0], dr.opaque(mi.Float, paths / self.samples_per_iteration))
        own = self._learning.fields(learning, first) if self._learning else {}
        return self.walker(LightWalk, camera=self.camera, mis=mis, dark=mi.Float(0.0), sink=sink, **own)

    def _seen_directly(self, source: SampleSource, paths: int, sink: SplatSink) -> tuple[mi.UInt32, mi.Bool]:
        """Connect points on the lights to the camera (s = 1, t = 1). Returns (rays, non-finite values)."""
        active = dr.full(mi.Bool, True, paths)
        light = self.lights.pick(source.next_1d(0, dim.LIGHT_PICK), active)
        u = mi.Point2f(*source.next_2d(0, dim.LIGHT_POINT))
        aperture = self.camera.splat_aperture(source, 1)
        active &= ~light.is_delta & (self.max_edges() > 0 and not self.settings.hide_emitters)

        si = dr.zeros(mi.SurfaceInteraction3f, paths)
        density = mi.Float(light.pick)  # per area; per solid angle from the camera for the environment
        if self.lights.has_area:
            si, density = point_on(self.lights, light, u, active & light.is_area)
        if self.lights.has_infinite:
            eye = dr.zeros(mi.Interaction3f)
            eye.p, eye.wavelengths = self.camera.origin, self.packet.wavelengths
            ds, _ = light.sample_direction("infinite", eye, u, active & light.is_infinite)
            si.p = dr.select(light.is_infinite, eye.p + ds.d * self.camera.far, si.p)
            si.n = dr.select(light.is_infinite, mi.Normal3f(-ds.d), si.n)
            density = dr.select(light.is_infinite, light.pick * ds.pdf, density)
            active &= density > 0.0

        si.wavelengths = self.packet.wavelengths
        joined = self.camera.connect(si, aperture, active)
        # Emitters on surfaces use the cosine only: that to the interpolated normal, which decides where a mesh emits.
        si.wi = mi.Vector3f(0.0, 0.0, dr.dot(joined.direction, si.sh_frame.n))
        cos = dr.dot(joined.direction, si.n)
        # From the light, because at the rim of a ball that emits inwards a ray from outside may end before its surface.
        ray = si.spawn_ray_to(joined.target)
        if self.lights.has_infinite:
            # The density is that of a direction: no cosine, and the squared distance cancels. The shadow ray is
            # infinite, and emitters of this kind read ``wi`` as a world direction.
            cos = dr.select(light.is_infinite, dr.square(joined.distance), cos)
            away = mi.Ray3f(joined.target, -joined.direction, dr.inf, 0.0, self.packet.wavelengths)
            ray = dr.select(light.is_infinite, away, ray)
            si.wi = dr.select(light.is_infinite, joined.direction, si.wi)
        active = joined.active & (cos > 0.0)
        radiance = light.radiance(si, active)
        place = sink.splats.place(joined, source, 1)
        contribution = radiance * (joined.importance * cos * place.weight / density)
        active &= place.on_film & ~dr.all(contribution == 0.0)
        rays = ones(active)
        crossings = dr.opaque(mi.UInt32, max(self.max_edges() - 1, 0))
        medium, media = self.visibility.medium_outside(light.row, ray), self.visibility.media
        if media is not None:
            medium = dr.select(light.is_infinite, media.of_sensor, medium)
        sight = self.visibility.along(ray, crossings, active, medium)
        active = sight.visible
        contribution *= sight.transmittance
        found = Contribution([contribution], contribution, active, active)
        return rays, sink.add(mi.UInt32(1), place, found, mi.UInt32(Component.EMISSION))
