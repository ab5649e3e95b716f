r"""Metropolis samples on the film, developed into pictures of any resolution afterwards.

Chains over camera paths leave samples on the film, a place and a colour each; a picture is the density of their
colours [Leeson 2001, sec. 5.7.5 to 5.7.8; see :mod:`etendue.film.developing`]. One family of chains samples the
luminance of paths, and a sample has the colour of its path: a path brings light of all channels, so chains for each
channel would need three times as many paths, and their independent noise would be coloured.

Chains are drawn to lights that the camera sees directly, whose pixels need few samples. Two cures [Leeson 2001, sec.
6.2.3]: this light is left out of the chains and painted later, from independent samples (``later``), or all samples in
the region of the film where lights are seen are independent ones (``split``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import CONTRAST, Iterations, Measurement, Record, Result, SampleSource, State, setting
from etendue.film import ESTIMATORS, FILM_COLUMNS, Development
from etendue.integration import Layout
from etendue.transport import CameraPath, DirectWeights, Walker
from etendue.transport import dimensions as dim

from ..base import ImageSettings, Lanes, keep_finite, light_numbers, total
from ..path import edge
from .method import MetropolisMethod, MetropolisSettings
from .targets import ROULETTE, Contribution, Target, Traced, camera_slots

Rows = NDArray[np.float32]

#: Name of the record of samples.
FILM = "film"
#: Independent samples of lights, per step of a chain.
_PAINTED = 0.25


@dataclass(frozen=True)
class FilmSettings(MetropolisSettings):
    """Settings of ``film_metropolis``."""

    equalise: bool = setting(
        False,
        "divide the target of the chains by the brightness of a coarse picture, so that dark parts of the picture get "
        "as many samples as bright ones; false: samples in proportion to luminance",
    )
    lights: str = setting(
        "later",
        "lights that the camera sees: left out of the chains and painted later from independent samples (later), all "
        "light in their region of the film by independent samples (split), or sampled by the chains (chain)",
        choices=("later", "split", "chain"),
    )
    margin: float = setting(
        0.02,
        "width of a margin around the picture in which there are samples, too, as a share of its width and height, so "
        "that pictures are not darker at the border",
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
        0.7, "standard deviation of kernel, and at the mean density of variable, in pixels", above=0.0, maximum=1000.0
    )
    neighbours: int = setting(50, "samples of nearest", minimum=1)


class _LeftOut(DirectWeights):
    """Weights of ``path`` without lights that are seen directly; a density of -1 marks edges from the camera."""

    def hit(self, pdf: mi.Float, direct_pdf: mi.Float) -> mi.Float:
        """See :class:`DirectWeights`."""
        return dr.select(pdf < 0.0, 0.0, super().hit(dr.maximum(pdf, 0.0), direct_pdf))


class FilmTarget:
    """Camera paths as of ``path``, through a film that is wider than the picture."""

    def __init__(self, method: FilmMetropolis) -> None:
        self._method = method
        end, inner = camera_slots(method)
        vertices = method.settings.vertices
        self.layouts: Mapping[str, Layout] = {"camera": Layout(end, [*inner, ROULETTE], vertices)}

    def place(self, source: SampleSource) -> mi.Point2f:
        """A film position in pixels, uniform over the picture and its margin."""
        method, u = self._method, source.next_2d(0, dim.FILM)
        margin = dr.opaque(mi.Float, method.settings.margin)
        x, y = (v * (1.0 + 2.0 * margin) - margin for v in u)
        return mi.Point2f(x * method.camera.width, y * method.camera.height)

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        method, source = self._method, sources["camera"]
        place = self.place(source)
        radiance, rays = self.radiance(place, source, method.settings.lights)
        radiance, bad = keep_finite(radiance)
        return Traced([Contribution(place, radiance)], rays, dr.select(bad, mi.UInt32(1), 0))

    def radiance(self, place: mi.Point2f, source: SampleSource, lights: str) -> tuple[mi.Color3f, mi.UInt32]:
        """(radiance of a path times the area of the film, rays). ``lights``: ``chain`` counts all light, ``later`` none
        of lights that are seen directly, ``split`` none where such a light is seen."""
        method = self._method
        ray, importance, _ = method.camera.through(place, source)
        walker = method.walker(Walker)
        weights = DirectWeights() if lights == "chain" else _LeftOut()
        start: dict[str, Any] = {} if lights == "chain" else {"pdf": mi.Float(-1.0)}
        if lights == "split":
            start["active"] = (walker.max_edges > 0) & ~self.sees_light(ray)
        path = CameraPath.start(ray, walker.max_edges, **start)
        path = walker.walk(path, lambda s: edge(s, walker, weights, source), "path to the film")
        area = (1.0 + 2.0 * method.settings.margin) ** 2
        return path.radiance * importance * dr.opaque(mi.Float, area), path.rays

    def sees_light(self, ray: mi.Ray3f) -> mi.Bool:
        """Whether the first surface on a ray emits towards it, or the environment is seen."""
        return dr.any(self._emitted(ray) > 0.0)

    def _emitted(self, ray: mi.Ray3f) -> mi.Color3f:
        si = self._method.scene.ray_intersect(ray)
        return si.emitter(self._method.scene).eval(si)

    def painted(self, source: SampleSource) -> tuple[mi.Point2f, mi.Color3f, mi.UInt32]:
        """(place, light that the chains leave out times the area of the film, rays)."""
        method, place = self._method, self.place(source)
        whole, rays = self.radiance(place, source, "chain")
        if method.settings.lights == "split":
            ray, _, _ = method.camera.through(place, source)
            return place, whole & self.sees_light(ray), rays
        rest, more = self.radiance(place, source, "later")
        return place, whole - rest, rays + more


class FilmMetropolis(MetropolisMethod):
    """Chains whose samples on the film are records, from which pictures of any size are developed."""

    name: ClassVar[str] = "film_metropolis"
    plugin: ClassVar[str | None] = ""
    Settings: ClassVar[type[ImageSettings]] = FilmSettings
    settings: FilmSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Kelemen2002", "Veach1997", "Abramson1982")

    def make_target(self, seed: int) -> Target:
        """See :class:`MetropolisMethod`."""
        self._film = FilmTarget(self)
        return self._film

    def _step(self, iteration: int, seed: int) -> Measurement:
        found: list[tuple[bool, mi.Point2f, mi.Color3f]] = []

        def record(independent: bool, contributions: Sequence[Contribution], weight: mi.Float) -> None:
            for one in contributions:
                place, value = mi.Point2f(one.position), one.value * weight
                dr.schedule(place, value)
                found.append((independent, place, value))

        self.runner.record = record
        try:
            self._carried, made = self.runner.run(self._carried, self._steps, seed, self.splats(seed, iteration, 4))
        finally:
            self.runner.record = None
        self._tune(made)
        self._passes += 1
        count = float(self._steps * self.runner.chains)
        halves: tuple[list[Rows], list[Rows]] = ([], [])
        for independent, place, value in found:
            rows = self._rows(place, value)
            for half, part in enumerate(np.split(rows, 2)):
                part[:, 2:] *= 1.0 if independent else made.factors[half]
                halves[half].append(part)
        if self.settings.lights != "chain":
            for half, part in enumerate(np.split(self._painted(iteration, seed, count, made.counters), 2)):
                halves[half].append(part)
        joined = [np.concatenate(parts) for parts in halves]
        kept = np.concatenate([rows[(rows[:, 2:] != 0.0).any(axis=1)] for rows in joined])
        size = Development((self.camera.width, self.camera.height))
        pictures = [size.picture([rows], 0.5 * count).astype(np.float64) for rows in joined]
        samples = float(self.samples_per_iteration)
        layers = {
            "image": 0.5 * samples * (pictures[0] + pictures[1]),
            "image" + CONTRAST: 0.5 * samples * (pictures[0] - pictures[1]),
        }
        if self.settings.aovs:
            first, bad = self._first_hits(iteration, seed, self.samples_per_iteration)
            layers |= {name: layer.astype(np.float64) for name, layer in first.items()}
            made.counters["nonfinite"] += bad
        return Measurement(
            sums=layers,
            weights=dict.fromkeys(layers, samples),
            iterations=Iterations.single(iteration),
            counters=made.counters | {"samples": samples, "film samples": count},
            records={FILM: Record.single(kept, iteration)},
        )

    def _painted(self, iteration: int, seed: int, count: float, counters: dict[str, float]) -> Rows:
        """Rows of independent samples of the light that chains leave out, weighted as samples of chains."""
        lanes = 2 * max(1, round(0.5 * _PAINTED * count))
        source = light_numbers(self.settings.sampler, Lanes(0, lanes), lanes, seed, iteration, "painted light")
        place, value, rays = self._film.painted(source)
        value, bad = keep_finite(value)
        dr.eval(place, value, rays, bad)
        counters["rays"] += total(rays)
        counters["nonfinite"] += total(bad)
        rows = self._rows(place, value)
        rows[:, 2:] *= count / lanes
        # Both halves are evenly spread.
        return np.concatenate([rows[0::2], rows[1::2]])

    def _rows(self, place: mi.Point2f, value: mi.Color3f) -> Rows:
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
