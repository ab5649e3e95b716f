r"""Irradiance caching: indirect light on diffuse surfaces is computed at few points and interpolated between them.

Estimator: that of ``path`` up to the first diffuse surface after ``map_after`` scatterings. There direct light is
sampled by light points, and the rest is

.. math:: \alpha \, \rho(z) \, E(z) / \pi

with the throughput alpha, the albedo rho, and E interpolated from records of the cache [Ward 1988; WardHeckbert 1992].
Where no record is valid one is made: a path in each of many strata of the hemisphere, without the light that is sampled
directly. Biased: records are used up to a distance that the accuracy allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Carrying, CheckpointError, IndependentSource, OptionError, SampleSource, State, setting
from etendue.film import Component
from etendue.integration import Integrand
from etendue.scene import Problem
from etendue.transport import (
    CacheMap,
    CameraPath,
    DirectWeights,
    EndingInIndirect,
    FirstHits,
    IrradianceCache,
    Walker,
)

from . import radius as radii
from .base import CameraSettings, ImageMethod, ImageSettings, Layer, W, total
from .path import Path, traced

#: Sectors of a hemisphere for each of its rings.
_SECTORS = 3
#: Density of the directions of a record beside those of light points: so small that a light which could be sampled at
#: the record counts nothing, and a light that could not counts fully.
_NO_DENSITY = 1e-20
#: Of functions of rays.
_RAYS = [(-1e30, 1e30)] * 6


@dataclass(frozen=True)
class CachingSettings(CameraSettings):
    """Settings of ``irradiance_cache``."""

    map_after: int = setting(
        0,
        "scatterings of a path before it ends at the next diffuse surface, not counting mirrors, glass and null "
        "surfaces; 0: the cache as the camera sees it, 1: final gather from it",
        minimum=0,
    )
    accuracy: float = setting(
        0.2,
        "error that records may have where they are used; half of it needs four times as many",
        above=0.0,
        maximum=1.0,
    )
    nearest: float = setting(
        3.0, "distance up to which a record is used at least, in widths of a pixel at its place", above=0.0
    )
    farthest: float = setting(60.0, "distance up to which a record is used at most, in the same unit", above=0.0)
    rays: int = setting(768, "paths into the hemisphere of a record", minimum=12)
    gradients: bool = setting(True, "extrapolate from records by the gradients of their irradiance; false: constant")


class IrradianceCaching(Carrying, Path):
    """Path tracing that ends in an irradiance cache."""

    name: ClassVar[str] = "irradiance_cache"
    plugin: ClassVar[str | None] = "irradiance_cache"
    Settings: ClassVar[type[ImageSettings]] = CachingSettings
    settings: Any
    spectral: ClassVar[bool] = False
    measures: ClassVar[bool] = False
    citations: ClassVar[tuple[str, ...]] = ("Ward1988", "WardHeckbert1992", *Path.citations)
    carries_on: ClassVar[bool] = True
    media: ClassVar[str | None] = None

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`ImageMethod`; the cache is empty."""
        o = self.settings
        if o.nearest > o.farthest:
            raise OptionError(f"records are used at least up to nearest={o.nearest:g}, above farthest={o.farthest:g}")
        self._forget_states()
        self.map = None
        super().prepare(problem, seed)
        self._seed, self._cast = seed, 0.0
        least = radii.first_radius(self, o.nearest, "pixel")
        shortest = least.largest / problem.space.scale
        rings = max(2, round(math.sqrt(o.rays / _SECTORS)))
        self._cache = IrradianceCache(
            (shortest, shortest * o.farthest / o.nearest), o.accuracy, (rings, _SECTORS * rings), o.gradients
        )
        self.notes = {}
        incident = Integrand(self._incident, _RAYS, on="device", values=3)
        distance = Integrand(self._distance, _RAYS, on="device")
        self.map = CacheMap(self._cache, incident, distance, problem.space, lambda p: dr.sqrt(least.share(p)))

    def walker(self, kind: type[W], **own: Any) -> W:
        """See :class:`ImageMethod`; paths end in the cache."""
        if self.map is None or kind is not Walker:
            return super().walker(kind, **own)
        ending: Any = super().walker(EndingInIndirect, after=self._after, **own)
        return ending

    def trace(self, ray: mi.Ray3f, source: SampleSource, first: FirstHits | None = None) -> CameraPath:
        """See :class:`Path`."""
        path = traced(ray, self.walker(Walker, first=first), DirectWeights(), source, **self.path_fields())
        light = self.light_of_map(path)
        assert light is not None
        path.add(light, mi.Bool(True), Component.INDIRECT)
        return path

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        self._cast = 0.0
        layers, counters = super().render_pass(iteration, seed, samples)
        return layers, counters | {"rays": counters["rays"] + self._cast}

    def _incident(self, x: list[mi.Float]) -> mi.Spectrum:
        """Radiance along rays, without light that is sampled at their origin."""
        lane = dr.arange(mi.UInt32, dr.width(x))
        source = IndependentSource(lane, self._seed, "irradiance cache", len(self._cache))
        # The surface that has the record is the first vertex, whose edge to the camera is not traced here.
        walker = ImageMethod.walker(self, Walker, max_edges=dr.maximum(self.edges, 1) - 1, rays=None)
        path = traced(_ray(x), walker, DirectWeights(), source, pdf=mi.Float(_NO_DENSITY))
        radiance, _ = self.kept(path.radiance)
        dr.eval(radiance, path.rays)
        self._cast += total(path.rays)
        return radiance

    def _distance(self, x: list[mi.Float]) -> mi.Float:
        return self.scene.ray_intersect_preliminary(_ray(x)).t

    def _left(self) -> State:
        return {"records": self._cache.records}

    def _take(self, state: State) -> None:
        records = np.asarray(state["records"], dtype=np.float64)
        if records.ndim != 2 or records.shape[1] != self._cache.records.shape[1]:
            raise CheckpointError("the irradiance cache in the checkpoint is damaged; start a new run")
        self._cache.records = records


def _ray(x: list[mi.Float]) -> mi.Ray3f:
    return mi.Ray3f(mi.Point3f(*x[:3]), mi.Vector3f(*x[3:6]))
