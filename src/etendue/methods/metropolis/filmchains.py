r"""Metropolis samples on the film, developed into pictures of any resolution afterwards.

Chains over camera paths, light paths or pairs of both (:mod:`.film`) leave samples on the film, a place and a colour
each; a picture is the density of their colours [Leeson 2001, sec. 5.7.5 to 5.7.8; see :mod:`etendue.film.developing`].
One family of chains samples the luminance of paths, and a sample has the colour of its path: a path brings light of all
channels, so chains for each channel would need three times as many paths, and their independent noise would be
coloured.

Chains make many samples of lights that the camera sees directly, whose pixels need few. Two remedies [Leeson 2001, sec.
6.2.3]: this light is left out of the chains and painted later, from independent samples (``later``), or all samples in
the region of the film where lights are seen are independent ones (``split``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import (
    Array,
    IndependentSource,
    Measurement,
    OptionError,
    Record,
    Result,
    SceneError,
    State,
    logger,
    setting,
)
from etendue.film import ESTIMATORS, FILM_COLUMNS, Development, PixelFilter
from etendue.scene import Problem

from ..base import ImageMethod, ImageSettings, keep_finite, total
from ..bidirectional import Bpt
from ..light import LightTracing, require_splats
from ..path import DirectionSettings
from .blend import Blend, brightness, luminance
from .film import FILM_TARGETS
from .method import MetropolisMethod, MetropolisSettings, beside_paths
from .states import PassResult, numbers_of
from .targets import Contribution, Target

Rows = NDArray[np.float32]

#: Name of the record of samples.
FILM = "film"
#: Independent samples of lights, per step of a chain.
_PAINTED = 0.25
#: Paths of a pixel that search for lights.
_PILOT = 16


@dataclass(frozen=True)
class FilmSettings(DirectionSettings, MetropolisSettings):
    """Settings of ``film_metropolis``."""

    equalise: bool = setting(
        False,
        "divide the target of the chains by the brightness of a coarse picture, so that dark parts of the picture get "
        "as many samples as bright ones; false: samples in proportion to luminance",
    )
    paths: str = setting(
        "camera",
        "paths that the chains mutate: camera paths as of path (camera), light paths as of light, each vertex of which "
        "is connected to the camera (light), or pairs of both, all of whose vertices are connected with each other "
        "(bidirectional)",
        choices=tuple(FILM_TARGETS),
    )
    lights: str = setting(
        "later",
        "lights that the camera sees: left out of the chains and painted later from independent samples (later), all "
        "light in their region of the film by independent samples (split), or sampled by the chains (chain)",
        choices=("later", "split", "chain"),
    )
    margin: float = setting(
        0.02,
        "with paths=camera: width of a margin around the picture in which there are samples, too, as a share of its "
        "width and height, so that pictures are not darker at the border",
        minimum=0.0,
        maximum=0.5,
    )
    estimator: str = setting(
        "histogram",
        "how samples become the picture: sums of pixels (histogram), Gaussians of one width (kernel) or of a width by "
        "the density (variable), or the nearest samples (nearest)",
        choices=ESTIMATORS,
    )
    bandwidth: float = setting(
        0.7,
        "standard deviation of the Gaussians in pixels; of variable, at the mean density of samples",
        above=0.0,
        maximum=1000.0,
    )
    neighbours: int = setting(50, "number of samples in an estimate by nearest", minimum=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.components:
            raise OptionError(
                "film_metropolis keeps whole paths, not components, which for_denoising turns on; use pssmlt"
            )
        if self.paths != "camera":
            if self.lights == "split":
                raise OptionError(f"lights=split needs paths=camera, not paths={self.paths}; use lights=later")
            if not self.bsdf_sampling:
                raise OptionError(f"bsdf_sampling=false needs paths=camera, not paths={self.paths}; leave one out")


class FilmMetropolis(MetropolisMethod):
    """Chains whose samples on the film are records, from which pictures of any size are developed."""

    name: ClassVar[str] = "film_metropolis"
    plugin: ClassVar[str | None] = ""
    Settings: ClassVar[type[ImageSettings]] = FilmSettings
    settings: FilmSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Kelemen2002", "Veach1997", "Abramson1982")

    def make_target(self, seed: int) -> Target:
        """See :class:`MetropolisMethod`."""
        if self.settings.paths == "light":
            require_splats(self.camera, self.name + " with paths=light")
        self._film = FILM_TARGETS[self.settings.paths](self)
        return self._film

    @property
    def margin(self) -> float:
        """Width of the margin, as a share of the picture's. Points beyond the film cannot be connected to sensors."""
        return self.settings.margin if self.settings.paths == "camera" else 0.0

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`MetropolisMethod`. If all light comes directly from lights that are seen, chains sample it."""
        #: How lights that are seen are sampled.
        self.seen_lights = self.settings.lights
        try:
            super().prepare(problem, seed)
        except SceneError:
            if self.seen_lights == "chain":
                raise
            self.seen_lights = "chain"
            super().prepare(problem, seed)
            logger.info("no light but that of lights that are seen: lights=chain instead of %s", self.settings.lights)

    def beside(self) -> type[ImageMethod]:
        """See :class:`MetropolisMethod`."""
        if self.settings.paths == "camera":
            return beside_paths(self)
        return LightTracing if self.settings.paths == "light" else Bpt

    def _begin_blend(self) -> None:
        """See :class:`MetropolisMethod`. The independent estimator determines the scale only: the picture is made of
        samples. The pixel filter of the estimator is that of their histogram."""
        super()._begin_blend()
        self._blend = Blend.empty(0, 0)
        camera = self._beside.method.camera
        camera.filter = PixelFilter(mi.load_dict({"type": "box"}), camera.width, camera.height)
        camera.independent = True
        self._dim = self._without_lights()

    def _without_lights(self) -> Array:
        """(height, width): 1 for pixels in and around which a few paths see no painted light. Only these determine the
        scale: the noise of a lamp would hide the light of the chains. Any choice made before the passes is valid."""
        width, height = self.camera.width, self.camera.height
        every = np.ones((height, width))
        if self.seen_lights == "chain":
            return every
        lane = dr.arange(mi.UInt32, _PILOT * width * height)
        place, value, _ = self._film.painted(IndependentSource(lane, 0, "seen lights", 0))
        lit = np.array(dr.any(value > 0.0))
        column, row = (np.floor(np.array(p)[lit]).astype(int) for p in (place.x, place.y))
        bright = np.zeros((height + 2, width + 2), bool)  # with a border
        inside = (column >= -1) & (column <= width) & (row >= -1) & (row <= height)
        bright[row[inside] + 1, column[inside] + 1] = True
        around = [bright[i : i + height, j : j + width] for i in range(3) for j in range(3)]
        dim_places = every * ~np.any(around, axis=0)
        return dim_places if dim_places.any() else every

    def _plan(self) -> int:
        """See :class:`MetropolisMethod`."""
        return self._steps

    def _run(self, iteration: int, seed: int, steps: int) -> PassResult:
        """See :class:`MetropolisMethod`. Samples are kept, and nothing is splatted."""
        self._found: list[tuple[bool, mi.Point2f, mi.Spectrum]] = []

        def record(independent: bool, contributions: Sequence[Contribution], weight: mi.Float) -> None:
            for one in contributions:
                place, value = mi.Point2f(one.position), one.value * weight
                dr.schedule(place, value)
                self._found.append((independent, place, value))

        self.runner.record = record
        try:
            self._carried, made = self.runner.run(self._carried, steps, seed, None)
        finally:
            self.runner.record = None
        return made

    def _pictures(
        self, iteration: int, seed: int, made: PassResult, independent: Array, steps: int
    ) -> tuple[Array, dict[str, Record]]:
        """See :class:`MetropolisMethod`. Samples have the scale that is known when they are made."""
        count = float(steps * self.runner.chains)
        made.counters["film samples"] = count
        parts: dict[bool, list[Rows]] = {True: [], False: []}  # whether they are independent
        for kind, place, value in self._found:
            parts[kind].append(self._rows(place, value))
        del self._found
        if self.seen_lights != "chain":
            parts[True].append(self._painted(iteration, seed, count, made.counters))
        halves = {kind: self._by_half(rows) for kind, rows in parts.items()}
        size = Development((self.camera.width, self.camera.height))
        chained, others = (
            np.stack([size.picture([rows], 0.5 * count).astype(np.float64) for rows in halves[kind]])
            for kind in (False, True)
        )
        factors = self._carried.factors.of_pixels * self._dim
        sums = np.stack([brightness(p, factors) for p in (chained, others, independent[0])], axis=1)
        scale = self._blend.scale.after(sums, luminance(independent[0]).mean(axis=(1, 2)), made.factors)
        self._blend = replace(self._blend, scale=scale)
        for half, rows in enumerate(halves[False]):
            rows[:, 2:] *= scale.scale[half]
        kept = np.concatenate([rows for kind in halves for rows in halves[kind]])
        picture = chained * scale.scale[:, None, None, None] + others
        return picture[None], {FILM: Record.single(kept, iteration)}

    @staticmethod
    def _by_half(parts: Sequence[Rows]) -> list[Rows]:
        """The rows of each half that are not black; the first part of each array belongs to the first half."""
        halves: list[list[Rows]] = [[np.zeros((0, FILM_COLUMNS), np.float32)] for _ in range(2)]
        for rows in parts:
            for half, own in zip(halves, np.split(rows, 2), strict=True):
                half.append(own[(own[:, 2:] != 0.0).any(axis=1)])
        return [np.concatenate(half) for half in halves]

    def _painted(self, iteration: int, seed: int, count: float, counters: dict[str, float]) -> Rows:
        """Rows of independent samples of the light that chains leave out, weighted as samples of chains; each half
        has its own stratified numbers."""
        lanes = 2 * max(1, round(0.5 * _PAINTED * count))
        source = self.runner.independent("painted", seed, iteration * (lanes // 2))(numbers_of(lanes))
        place, value, rays = self._film.painted(source)
        value, bad = keep_finite(value)
        dr.eval(place, value, rays, bad)
        counters["rays"] += total(rays)
        counters["nonfinite"] += total(bad)
        rows = self._rows(place, value)
        rows[:, 2:] *= count / lanes
        return rows

    def _rows(self, place: mi.Point2f, value: mi.Spectrum) -> Rows:
        rows = np.empty((dr.width(place), FILM_COLUMNS), np.float32)
        rows[:, 0] = np.array(place.x) / self.camera.width
        rows[:, 1] = np.array(place.y) / self.camera.height
        for channel in range(3):
            rows[:, 2 + channel] = np.array(value[channel])
        return rows

    def develop(self, measurement: Measurement, state: State) -> Result:
        """The picture at the size of the scene's film, by the estimator of the settings."""
        result = super().develop(measurement, state)
        o = self.settings
        if o.estimator != "histogram":
            size = self.camera.width, self.camera.height
            how = Development(size, o.estimator, o.bandwidth, o.neighbours)
            result.layers["image"] = self.picture(measurement, how)
        return result

    @staticmethod
    def picture(measurement: Measurement, how: Development) -> NDArray[np.float32]:
        """A picture of the samples of a measurement, of any size."""
        return how.picture(measurement.records[FILM], measurement.counters["film samples"])
