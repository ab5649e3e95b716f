r"""Path tracing with some of its random numbers sampled from given densities; paths may end in a photon map.

.. math::
    L = \sum_j \alpha_j \left( \frac{w^e_j L_e(z_j)}{p_j(u)} + \frac{w^d_j f_s(z_j) |cos| L_e(y)}{p(y) q_j(u)} \right)

as in ``path``; p_j and q_j are the densities of the numbers u on which the contribution depends [Leeson 2001,
sec. 5.4.1, 5.7.4].
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, setting
from etendue.film import Component
from etendue.scene import Problem, brightness, corners_of
from etendue.transport import CameraPath, CameraSampler, FirstHits, Recording, Walker, WalkVertex, dimensions as dim

from .. import radius as radii
from ..base import STEP_LANES, ImageSettings
from ..ending import EndsInMap
from ..path import EndingPathSettings
from ..photon.photons import PhotonGrid, PhotonTracer
from .dimensions import Draw, Group, NumberedSource


@dataclass(frozen=True)
class AdaptiveSettings(EndingPathSettings):
    """Settings of ``vegas`` and ``stratified``."""

    merge: bool = setting(
        True, "use one random number to select a light and as the first coordinate of the point on it; false: two"
    )
    maps: int = setting(
        0,
        "surface points of a path before it ends with a photon density estimate at the next smooth surface; 0: no "
        "photons",
        minimum=0,
    )
    light_paths: float = setting(1.0, "with maps: light paths per camera path", above=0.0, maximum=64.0)
    radius: float = setting(
        0.0,
        f"with maps: radius of density estimation in the first pass, in the unit of radius_unit; {radii.RADIUS_DOC}",
        minimum=0.0,
    )
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    alpha: float = setting(
        0.75,
        "with maps: reduction of the radius: that of pass i = 1, 2, ... is radius * i^((alpha - 1) / 2); 1: constant",
        above=0.0,
        maximum=1.0,
    )


@dataclass(kw_only=True)
class NumberedPath(CameraPath):
    """State of a camera path with the random numbers of a :class:`NumberedSource`."""

    parts: list[mi.Float]  #: luminance of the contributions that depend on each ``Drawn``; empty without learning


class AdaptivePath(EndsInMap):
    """Path tracing with the random numbers of a :class:`NumberedSource`."""

    Settings: ClassVar[type[ImageSettings]] = AdaptiveSettings
    settings: AdaptiveSettings
    spectral: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`. With ``maps``, a pilot measures the number of photons of a light path."""
        self.one_way = not self.settings.maps
        super().prepare(problem, seed)
        o = self.settings
        if o.maps and self.map is not None:
            raise OptionError("paths end in photons (maps) or in a map (map), not in both; leave out one of them")
        self._maps: PhotonGrid | None = None
        if not o.maps:
            return
        self._box = corners_of(problem.scene)
        self._discs = radii.first_radius(self, o.radius, o.radius_unit)
        self._tracer = PhotonTracer(self, seed)
        wanted = round(o.light_paths * self.camera.pixels * self.samples_per_iteration)
        self._light_paths = self._tracer.fitting(max(1, wanted))

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return STEP_LANES if self.settings.maps else super().full_lanes()

    def draw_film(self, named: Sequence[Group]) -> None:
        """Use independent offsets in the pixels if a group has numbers of ``film``."""
        film = {(0, dim.FILM), (0, dim.FILM + 1)}
        if any(film & set(draws) for group in named for draws in group.draws):
            self.camera = CameraSampler(self.problem, independent=True, packet=self.packet)

    def map_light(self, iteration: int, seed: int) -> float:
        """Trace the photons of a pass, if paths end in maps. Returns the number of rays."""
        if not self.settings.maps:
            return 0.0
        shot = self._tracer.shoot(iteration, seed, self._light_paths)
        positions, _, held = shot.vertices.positions()
        radius = radii.reduced(self._discs.largest, iteration, self.settings.alpha)
        by_kind, recorder = self.settings.components, self.recording.camera
        self._maps = PhotonGrid(shot, positions, held, radius, self._box, by_kind=by_kind, recorder=recorder)
        self._limit = dr.opaque(mi.Float, radius * radius)
        return shot.rays

    def constant_numbers(self) -> set[Draw]:
        """Random numbers without effect in this scene; those of vertex 1 stand for all surface points."""
        constant: set[Draw] = set()
        if self.settings.merge or self.lights.count == 1:
            constant.add((1, dim.NEXT_EVENT))
        if not self.camera.sensor.needs_aperture_sample():
            constant |= {(0, dim.APERTURE), (0, dim.APERTURE + 1)}
        return constant

    def left_by_pick(self) -> Callable[[mi.Float], mi.Float] | None:
        """The function for the remainder of a number that selects a light, with ``merge``."""
        return self.lights.left_by_pick if self.settings.merge else None

    # ------------------------------------------------------------------ camera paths

    @abstractmethod
    def numbers(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> NumberedSource:
        """Random numbers of the camera paths ``lanes`` in a pass with ``samples`` of them in each pixel."""

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        recording, self.recording = self.recording, Recording()  # without the paths that explore
        source = self.numbers(lanes, samples, iteration, seed)
        self.recording = recording
        self.map_light(iteration, seed)
        dr.eval(self.trace(lanes // dr.opaque(mi.UInt32, samples), source).radiance)

    def trace_from_lights(self, number: mi.UInt32, iteration: int, seed: int) -> None:
        """See :class:`ShowsRays`."""
        self._tracer.trace_again(number, iteration, seed, self._light_paths)

    def trace(
        self,
        pixel: mi.UInt32,
        source: NumberedSource,
        learning: bool = False,
        first: FirstHits | None = None,
    ) -> NumberedPath:
        """Trace a path through each pixel (indices y * width + x), not yet evaluated. ``learning``: compute
        ``parts``; ``first``: records first hits."""
        ray, importance, _ = self.camera.primary(pixel, source)
        lights = self.lights.alike_everywhere()  # one density of the number that picks a light for the whole picture
        walker = self.walker(Walker, lights=lights, proposal=self.settings.proposal, first=first)
        parts = [mi.Float(0.0) for _ in source.drawn] if learning else []
        path = NumberedPath.start(ray, walker.max_edges, parts=parts, **self.path_fields())
        path = walker.walk(path, lambda s: self._edge(s, walker, source), "path of given numbers")
        if (light := self.light_of_map(path)) is not None and path.end is not None:
            path.depth = path.end.depth
            _count(path, source, light, path.end.reached, Component.INDIRECT, by_light_point=False)
        path.weigh(importance)
        return path

    def _edge(self, s: NumberedPath, walker: Walker, source: NumberedSource) -> NumberedPath:
        """Trace one edge, and scatter at its end."""
        vertex, weights = walker.arrive(s), self.settings.direct_weights

        # ---- Emission
        hit = walker.emission(s, vertex)
        weight = weights.hit(s.pdf, hit.direct_pdf)
        _count(s, source, s.throughput * hit.radiance * weight, hit.active, s.seen, by_light_point=False)
        s.active &= vertex.valid & walker.goes_on(s, vertex) & source.goes_on(s.depth)

        # ---- After ``maps`` vertices, photon density estimation replaces the rest of the path at a smooth surface
        done = mi.Bool(False)
        if self._maps is not None:
            done = s.active & vertex.smooth & (s.depth > self.settings.maps)
            for component, reflected in self._mapped(s, walker, vertex, done):
                _count(s, source, s.throughput * reflected, done, component, by_light_point=False)

        # ---- Next event
        smooth = s.active & ~done & vertex.smooth
        lights = [walker.light_point(vertex, source, smooth)] if weights.next_event else []
        scattered, evaluated = vertex.sample(source, s.active, lights)
        for light, f in zip(lights, evaluated, strict=True):
            contribution, visible = walker.next_event(s, vertex, light, f, weights, source.counts(s.depth + 1))
            _count(s, source, contribution, visible, s.lit, by_light_point=True)

        s.pdf = walker.keep_if_null(scattered, s.pdf, dr.select(scattered.is_delta, 0.0, scattered.pdf))
        walker.advance(s, vertex, scattered, source)
        s.active &= ~done | scattered.is_delta
        return s

    def _mapped(
        self, s: NumberedPath, walker: Walker, vertex: WalkVertex, active: mi.Bool
    ) -> list[tuple[mi.UInt32 | None, mi.Spectrum]]:
        """(component, reflected radiance) at a vertex by density estimation."""
        assert self._maps is not None
        limit = self._limit * self._discs.share(vertex.position)
        reflected, _ = self._maps.reflected(vertex, walker.max_edges - s.depth, limit, active)
        return s.components_of(reflected)


def _count(
    s: NumberedPath,
    source: NumberedSource,
    contribution: mi.Spectrum,
    active: mi.Bool,
    component: mi.UInt32 | int | None,
    by_light_point: bool,
) -> None:
    """Add a contribution at the end of edge ``s.depth``, divided by the density of the numbers on which it depends."""
    active = active & source.counts(s.depth + 1 if by_light_point else s.depth)
    contribution = contribution * source.weight(s.depth, by_light_point)
    s.add(contribution, active, component)
    if s.parts:
        luminance = brightness(contribution)
        s.parts = [
            part + dr.select(active & drawn.used(s.depth, by_light_point), luminance, 0.0)
            for part, drawn in zip(s.parts, source.drawn, strict=True)
        ]
