r"""Path tracing with recursive stratified sampling of its random numbers.

Every few passes, the hypercube of the named random numbers is explored by paths through random pixels and divided
recursively, along the dimension in which the luminance varies most. By default the exploration of a region uses three
tenths of its share of the paths of a pass. A region i of volume :math:`V_i` that is not divided further gets a share
:math:`q_i` of the pass's paths,

.. math:: L = \frac 1 N \sum_i \sum_{u \in i} \frac{V_i}{q_i} f(u), \qquad q_i \sim
   \left( V_i^2 \mathrm{Var}_i \right)^{1/(1+a)}

and the low-discrepancy numbers of each pixel select regions, in the order of the regions, so that each pixel has its
share of paths in each part of the hypercube. Paths of the exploration are not used in the picture, so a pass is
unbiased. The subdivision (the *plan*) depends only on the seed and the number of the group of passes that share it.

[Press 1990; Leeson 2001, sec. 5.6]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, cast

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, OptionError, SampleSource, seed_key, setting
from etendue.integration import Integrand, RecursiveStratified, Regions
from etendue.scene import Problem

from ..base import ImageSettings, Layer, total
from ..path import Path
from .dimensions import AdaptiveSource, NumberedSource, check_merge, groups
from .path import AdaptivePath, AdaptiveSettings

#: Surface points whose random numbers can be named.
_VERTICES = 16


@dataclass(frozen=True)
class StratifiedSettings(AdaptiveSettings):
    """Settings of ``stratified``."""

    parameters: str = setting(
        "light1",
        "names of the random numbers that are stratified: film, lens, and with the number of a vertex light1, bounce1, "
        "lobe1, ...",
    )
    metric: str = setting(
        "variance",
        "measure of variation in a region: (max - min)^2 (range), max^2 (maximum), or the variance (variance)",
        choices=("range", "maximum", "variance"),
    )
    divisions: int = setting(2, "number of parts into which a region is divided", minimum=2)
    weights: str = setting(
        "", "weights of the random numbers; regions are divided more often along larger ones; empty: equal weights"
    )
    initial_depth: int = setting(0, "levels that are divided by the weights alone, without exploration", minimum=0)
    dither: float = setting(
        0.0,
        "random offset of the borders between parts, relative to the width of a part, with borders=equal",
        minimum=0.0,
        maximum=0.99,
    )
    borders: str = setting(
        "equal",
        "borders between the parts of a region: parts of equal width (equal), or of equal metric, as in VEGAS (vegas)",
        choices=("equal", "vegas"),
    )
    exploration: float = setting(
        0.3, "share of a region's paths that explore it; more: better plans, more time", above=0.0, maximum=0.9
    )
    exponent: float = setting(
        2.0, "exponent a of the shares of paths, q ~ (V^2 Var)^(1/(1+a)); larger: more even shares", above=0.0
    )
    minimum: int = setting(4096, "least number of paths of a region that is divided", minimum=8)
    depth: int = setting(12, "largest number of levels of division", minimum=0, maximum=40)
    update: int = setting(8, "number of consecutive passes that share a plan", minimum=1)


class StratifiedPath(AdaptivePath):
    """Path tracing with recursive stratified sampling of its random numbers."""

    name: ClassVar[str] = "stratified"
    plugin: ClassVar[str | None] = "stratified_path"  # Mitsuba has a sampler 'stratified'
    Settings: ClassVar[type[ImageSettings]] = StratifiedSettings
    settings: StratifiedSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Press1990", *Path.citations)

    def __init__(self, settings: ImageSettings | None = None) -> None:
        super().__init__(settings)
        o = self.settings  # checked here, so that errors are raised before the scene is loaded
        check_merge(o.parameters, o.merge)
        named = groups(o.parameters, _VERTICES)
        if len(named) > 1 or any(len(group.draws) != 1 for group in named):
            raise OptionError(
                f"option 'parameters' must be one group of names with vertex numbers such as 'light1 bounce1', not "
                f"'{o.parameters}'"
            )
        try:
            weights = [float(word) for word in o.weights.replace(",", " ").split()] or None
        except ValueError:
            raise OptionError(f"option 'weights' must be numbers such as 1,2, not '{o.weights}'") from None
        self._integrator = RecursiveStratified(
            cast(Literal["range", "maximum", "variance"], o.metric),
            o.divisions,
            weights,
            o.initial_depth,
            o.dither,
            cast(Literal["equal", "vegas"], o.borders),
            o.exploration,
            exponent=o.exponent,
            minimum=o.minimum,
            depth=o.depth,
        )

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`AdaptivePath`. Numbers without effect in this scene are left out."""
        super().prepare(problem, seed)
        self._groups = groups(self.settings.parameters, _VERTICES, self.constant_numbers())
        self.draw_film(self._groups)
        self._planned: tuple[tuple[int, int, int], Regions] | None = None

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        self._explored = 0.0
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.numbers(lanes, samples, iteration, seed)
        mapping_rays = self.map_light(iteration, seed)
        state = self.trace(lanes // samples, source, first=self.first_hits(lanes, iteration))
        radiance, bad = self.kept_layers(state)
        dr.eval(radiance, state.rays, bad)
        counters = {
            "rays": total(state.rays) + self._explored + mapping_rays,
            "paths": float(len(lanes)),
            "nonfinite": total(bad),
            "regions": float(len(self._planned[1]) if self._planned else 0),
        }
        return self.images(radiance, seed, iteration), counters

    def numbers(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> AdaptiveSource:
        """See :class:`AdaptivePath`; with the plan of a pass."""
        regions = [[self._regions(iteration, seed, self.samples_per_iteration)]] if self._groups else []
        base = self._even_choice(self.camera_numbers(lanes, samples, seed, iteration), lanes, samples)
        return AdaptiveSource(base, self._groups, regions, mi.UInt32(0), self.left_by_pick())

    def _even_choice(self, base: SampleSource, lanes: mi.UInt32, samples: int) -> SampleSource:
        """Random numbers of which the one that selects a region is stratified over the samples of a pixel. With
        ``sampler=independent``, sample j of n gets a number in [j / n, (j + 1) / n)."""
        if not self._groups or self.settings.sampler != "independent":
            return base
        (draws,) = self._groups[0].draws
        vertex, component = draws[0]
        source = NumberedSource(base, {})
        number = mi.Float(lanes % samples) + base.next_1d(vertex, component)
        source.give([draws[0]], [number / samples], None)
        return source

    def _regions(self, iteration: int, seed: int, samples: int) -> Regions:
        """The plan of a pass, shared by ``update`` passes."""
        wanted = iteration // self.settings.update, seed, samples
        if self._planned is None or self._planned[0] != wanted:
            self.take_wavelengths(wanted[0] * self.settings.update, seed)
            self._planned = wanted, self._plan(*wanted)
            self.take_wavelengths(iteration, seed)
        return self._planned[1]

    def _plan(self, number: int, seed: int, samples: int) -> Regions:
        """The regions of plan ``number``, from the luminance of paths through random pixels."""
        # With the photons of the first pass of the group, also if a resumed run starts in the middle of the group.
        self._explored += self.map_light(number * self.settings.update, seed)
        calls = 0
        (draws,) = self._groups[0].draws

        def luminance(x: Sequence[mi.Float]) -> mi.Float:
            nonlocal calls
            calls += 1
            lanes = dr.arange(mi.UInt32, dr.width(x[0]))
            base = IndependentSource(lanes, seed, f"explore {calls}", number)
            u = IndependentSource(lanes, seed, f"explore pixel {calls}", number).next_1d(0, 0)
            source = NumberedSource(base, {})
            source.give(draws, x, self.left_by_pick())
            state = self.trace(dr.minimum(mi.UInt32(u * self.camera.pixels), self.camera.pixels - 1), source)
            radiance, _ = self.kept(state.radiance)
            value = mi.luminance(radiance) if self.bands is None else dr.mean(radiance)
            dr.eval(value, state.rays)
            self._explored += total(state.rays)
            return value

        f = Integrand(luminance, len(draws), on="device")
        plan_seed, _ = seed_key(seed, "plan", number)
        return self._integrator.plan(f, self.camera.pixels * samples, plan_seed)
