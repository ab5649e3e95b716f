r"""Paths that end early, in an ambient term for all light that is reflected more often.

Estimator [Castro 2002, ch. 6]: that of ``path`` or ``light`` for light that is reflected up to m = ``bounces`` times,
and for the rest a term at one vertex of the path,

.. math:: \alpha \, \rho(z) \, \frac{H_k(n)}{\pi}, \quad H_k = F \, (1 - R F)^{-1} (R F)^{k - 1} B_1

with the throughput alpha up to the vertex z, its albedo rho and its normal n. H_k is the irradiance of light that has
been reflected at least k times before; B_1 (radiosity by direct light), R (albedo) and F are means over classes of
normals, see :mod:`etendue.transport.endings.ambient`. ``ambient_path`` adds the term at the m-th vertex from the
camera, with k = 1; ``ambient_light`` at the first, with k = m, because it cannot add light at the ends of light paths.

Biased: the ambient term ignores corners, shadows and the position of a surface. The bias decreases with more bounces,
not with more time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, SampleSource, setting
from etendue.film import Component
from etendue.scene import LightTable, Problem
from etendue.surfaces import AMBIENT_TERMS
from etendue.transport import (
    AMBIENT_WALKS,
    AmbientScene,
    AmbientTable,
    CameraPath,
    DirectSample,
    LightPath,
    LightWalk,
    LocalLights,
    Scattered,
    SubPath,
    Walker,
    WalkVertex,
    ambient_scene,
    dimensions as dim,
)

from .base import ImageMethod, ImageSettings, Layer, W, keep_finite, total
from .light import LightSettings, LightTracing
from .path import Path, PathSettings

#: Added to the depth of a path after its last vertex, to mark what follows: the loop has no other field for it.
_AFTER = 1 << 24


@dataclass(frozen=True)
class _AmbientSettings:
    """Settings of both methods."""

    ambient: str = setting(
        "fuzzy",
        "ambient light: the same for all surfaces (classic), by the nearest of six axis directions (crisp), or by the "
        "squares of the components of the normal (fuzzy)",
        choices=AMBIENT_TERMS,
    )
    bounces: int = setting(
        1,
        "most reflections of a path; light reflected more often comes from the ambient term",
        minimum=1,
    )


@dataclass(frozen=True)
class AmbientPathSettings(_AmbientSettings, PathSettings):
    """Settings of ``ambient_path``."""


@dataclass(frozen=True)
class AmbientLightSettings(_AmbientSettings, LightSettings):
    """Settings of ``ambient_light``."""


class _Ambient(ImageMethod):
    """Finds the ambient light before the first pass."""

    #: Least number of reflections of the ambient light, ``reflected`` of :meth:`AmbientScene.irradiance`.
    reflected: int = 1

    @property
    def has_ambient(self) -> bool:
        """Whether there is light for the ambient term: none if ``max_depth`` ends all paths within ``bounces``."""
        return not 0 <= self.settings.max_depth <= self.settings.bounces + 1

    def max_edges(self) -> int:
        """See :class:`ImageMethod`; no limit for paths that end in the term, which contains all further reflections."""
        return 1 << 30 if self.has_ambient else super().max_edges()

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`; walks from the camera measure the ambient light."""
        super().prepare(problem, seed)
        if not self.has_ambient:
            return
        source = IndependentSource(dr.arange(mi.UInt32, AMBIENT_WALKS), seed, "ambient", 0)
        pixel = mi.UInt32(source.next_1d(0, dim.LENGTH) * self.camera.pixels)
        ray, _, _ = self.camera.primary(dr.minimum(pixel, self.camera.pixels - 1), source)
        walker = Walker(visibility=self.visibility, lights=self.lights, max_edges=self.edges, rr_depth=1 << 30)
        self.found: AmbientScene = ambient_scene(walker, ray, source, self.settings.ambient)
        self.ambient = AmbientTable(self.settings.ambient, self.found.irradiance(self.reflected))


class AmbientPath(_Ambient, Path):
    """Path tracing that ends in an ambient term after a given number of reflections."""

    name: ClassVar[str] = "ambient_path"
    plugin: ClassVar[str | None] = None
    Settings: ClassVar[type[ImageSettings]] = AmbientPathSettings
    settings: AmbientPathSettings
    spectral: ClassVar[bool] = False
    measures: ClassVar[bool] = False
    citations: ClassVar[tuple[str, ...]] = ("Castro2002", "Kajiya1986")
    media: ClassVar[str | None] = None

    def walker(self, kind: type[W], **own: Any) -> W:
        """See :class:`ImageMethod`; paths end early."""
        if not self.has_ambient:
            return super().walker(kind, **own)
        ends = {"ambient": self.ambient, "bounces": self.settings.bounces}
        walker: Any = super().walker(_EndingWalker, **ends, **own)
        return walker


class AmbientLight(_Ambient, LightTracing):
    """Light tracing that ends after a given number of reflections, with an ambient term at the surfaces seen."""

    name: ClassVar[str] = "ambient_light"
    Settings: ClassVar[type[ImageSettings]] = AmbientLightSettings
    settings: AmbientLightSettings
    spectral: ClassVar[bool] = False
    citations: ClassVar[tuple[str, ...]] = ("Castro2002", "Arvo1986")
    media: ClassVar[str | None] = None

    @property
    def reflected(self) -> int:  # type: ignore[override]
        """See :class:`_Ambient`."""
        return int(self.settings.bounces)

    def walker(self, kind: type[W], **own: Any) -> W:
        """See :class:`ImageMethod`; light paths end early."""
        if kind is not LightWalk or not self.has_ambient:
            return super().walker(kind, **own)
        walker: Any = super().walker(_EndingLightWalk, bounces=self.settings.bounces, **own)
        return walker

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        layers, counters = super().render_pass(iteration, seed, samples)
        if not self.has_ambient:
            return layers, counters
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.camera_numbers(lanes, samples, seed, iteration)
        ray, importance, _ = self.camera.primary(lanes // samples, source)
        walker = self.walker(Walker)
        path = CameraPath.start(ray, walker.max_edges, hidden=self.visibility.hidden)
        path = walker.walk(path, lambda s: _seen(s, walker, self.ambient, source), "ambient")
        radiance, bad = keep_finite(path.radiance * importance)
        dr.eval(radiance, path.rays, bad)
        counters["rays"] += total(path.rays)
        counters["nonfinite"] += total(bad)
        ambient = self.image(radiance, seed, iteration)
        if self.settings.components:
            layers["indirect"] = layers["indirect"] + ambient
            return layers, counters
        return {"ambient": ambient} | layers, counters


def _seen(s: CameraPath, walker: Walker, ambient: AmbientTable, source: SampleSource) -> CameraPath:
    """Ambient light at the surfaces that the camera sees, directly, in mirrors or through glass."""
    vertex = walker.arrive(s)
    s.active &= vertex.valid & (s.depth < walker.max_edges)
    scattered, _ = vertex.sample(source, s.active)
    s.radiance += reflected(s, vertex, scattered, ambient)
    walker.advance(s, vertex, scattered, source)
    s.active &= scattered.is_delta
    return s


def reflected(s: CameraPath, vertex: WalkVertex, scattered: Scattered, ambient: AmbientTable) -> mi.Spectrum:
    """Ambient light that a vertex reflects along the path; 0 where the path continues by specular scattering."""
    ends = scattered.active & ~scattered.is_delta
    return (s.throughput * scattered.weight * ambient.at(vertex, ends)) & ends


@dataclass(kw_only=True)
class _EndingWalker(Walker):
    """Paths add ambient light at the vertex with the number ``bounces``, or at the first one after it whose scattering
    is not specular. They then continue only to hit lights, also through mirrors and glass, which the weights of the
    light points of that vertex assume."""

    ambient: AmbientTable
    bounces: int

    def light_point(
        self,
        vertex: WalkVertex,
        source: SampleSource,
        active: mi.Bool,
        index: int = 0,
        lights: LightTable | LocalLights | None = None,
    ) -> DirectSample:
        """See :class:`Walker`."""
        return super().light_point(vertex, source, active & (vertex.number < _AFTER), index, lights)

    def advance(
        self,
        s: SubPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        roulette_by: tuple[mi.Spectrum, mi.Float] | None = None,
    ) -> mi.Float:
        """See :class:`Walker`."""
        assert isinstance(s, CameraPath)
        is_after = vertex.number >= _AFTER
        is_last = ~scattered.is_delta & ~is_after & (vertex.number >= self.bounces)
        s.add(reflected(s, vertex, scattered, self.ambient), is_last, Component.INDIRECT)
        factor = super().advance(s, vertex, scattered, source, roulette_by)
        s.active &= scattered.is_delta | ~is_after
        s.depth += dr.select(is_last, mi.UInt32(_AFTER), 0)
        return factor


@dataclass(kw_only=True)
class _EndingLightWalk(LightWalk):
    """Light paths end at vertex number ``bounces``, or at the first one after it whose scattering is not specular."""

    bounces: int

    def begin(self, paths: int, source: SampleSource, numbered: bool = False, **own: Any) -> LightPath:
        """See :class:`LightWalk`. Vertices are counted without null surfaces, as reflections of ambient light are."""
        return super().begin(paths, source, True, **own)

    def advance(
        self,
        s: SubPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        roulette_by: tuple[mi.Spectrum, mi.Float] | None = None,
    ) -> mi.Float:
        """See :class:`Walker`."""
        factor = super().advance(s, vertex, scattered, source, roulette_by)
        assert isinstance(s, LightPath) and s.vertex is not None
        number = s.vertex - 1 if self.visibility.transparent else vertex.number  # the vertex is counted already
        s.active &= scattered.is_delta | (number < self.bounces)
        return factor
