r"""Path tracing by recursive stratification of its random numbers.

Every few passes begin with exploration: paths start in pixels anywhere, three tenths of a region's share of a pass at
each level by default, and the hypercube of the numbers that were named is divided, again and again, along the dimension
in which the luminance varies most. A region i of volume :math:`V_i` that is not divided on gets a share :math:`q_i` of
the pass's paths,

.. math:: L = \frac 1 N \sum_i \sum_{u \in i} \frac{V_i}{q_i} f(u), \qquad q_i \sim
   \left( V_i^2 \mathrm{Var}_i \right)^{1/(1+a)}

and the even numbers of each pixel choose among the regions in their order, so that each pixel has its share of paths in
each part of the hypercube. Exploration only plans, so a pass is unbiased. A plan depends on nothing but the number of
the group of passes that share it.

[Press 1990; Leeson 2001, sec. 5.6]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, OptionError, seed_key, setting
from etendue.integration import Integrand, RecursiveStratified, Regions
from etendue.scene import Problem

from ..base import ImageSettings, Layer, total
from ..path import Path
from .dimensions import AdaptiveSource, NumberedSource, check_merge, groups
from .path import AdaptivePath, AdaptiveSettings

#: Surface points whose numbers may be named.
_VERTICES = 16


@dataclass(frozen=True)
class StratifiedSettings(AdaptiveSettings):
    """Settings of ``stratified``."""

    parameters: str = setting(
        "light1", "numbers whose hypercube is divided, in words: film, lens, and light1, bounce1, lobe1, … of vertices"
    )
    metric: str = setting(
        "variance",
        "how variation is judged: (max - min)^2, max^2, or mean square less squared mean",
        choices=("range", "maximum", "variance"),
    )
    divisions: int = setting(2, "parts that a region is divided into", minimum=2)
    weights: str = setting("", "a weight for each number, larger where regions shall be divided more; none: all alike")
    initial_depth: int = setting(0, "levels that are divided without looking, by weight", minimum=0)
    dither: float = setting(
        0.0, "share of a part by which equal borders are moved at random", minimum=0.0, maximum=0.99
    )
    borders: str = setting("equal", "equal parts, or parts of equal metric as VEGAS has", choices=("equal", "vegas"))
    exploration: float = setting(0.3, "share of a region's paths that explores it", above=0.0, maximum=0.9)
    exponent: float = setting(2.0, "a in q ~ (V^2 Var)^(1/(1+a))", above=0.0)
    minimum: int = setting(4096, "paths of a region that is divided, at least", minimum=8)
    depth: int = setting(12, "most levels", minimum=0, maximum=40)
    update: int = setting(8, "passes that share a plan", minimum=1)


class StratifiedPath(AdaptivePath):
    """Path tracing whose random numbers are stratified recursively, where light varies."""

    name: ClassVar[str] = "stratified"
    plugin: ClassVar[str | None] = "stratified_path"  # Mitsuba has a sampler 'stratified'
    Settings: ClassVar[type[ImageSettings]] = StratifiedSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Press1990", *Path.citations)

    def __init__(self, settings: ImageSettings | None = None) -> None:
        super().__init__(settings)
        o = self.settings  # complaints come before the scene is loaded
        check_merge(o.parameters, o.merge)
        named = groups(o.parameters, _VERTICES)
        if len(named) > 1 or any(len(group.draws) != 1 for group in named):
            raise OptionError(f"'{o.parameters}': parameters are one group, of numbered vertices, as 'light1 bounce1'")
        try:
            weights = [float(word) for word in o.weights.replace(",", " ").split()] or None
        except ValueError:
            raise OptionError(f"weights are numbers, not '{o.weights}'") from None
        self._integrator = RecursiveStratified(
            o.metric,
            o.divisions,
            weights,
            o.initial_depth,
            o.dither,
            o.borders,
            o.exploration,
            exponent=o.exponent,
            minimum=o.minimum,
            depth=o.depth,
        )

    def prepare(self, problem: Problem, seed: int) -> None:
        """Which numbers there are in this scene."""
        super().prepare(problem, seed)
        self._groups = groups(self.settings.parameters, _VERTICES, self.constant_numbers())
        self.draw_film(self._groups)
        self._planned: tuple[tuple[int, int, int], Regions] | None = None

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        self._explored = 0.0
        regions = [self._regions(iteration, seed, samples)] if self._groups else []
        mapping_rays = self.map_light(iteration, seed)
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        base = self._even_choice(self.camera_numbers(lanes, samples, seed, iteration), lanes, samples)
        source = AdaptiveSource(base, self._groups, [[r] for r in regions], mi.UInt32(0), self.left_by_pick())
        state = self.trace(lanes // samples, source)
        radiance, bad = self.kept(state.radiance)
        dr.eval(radiance, state.rays, bad)
        counters = {
            "rays": total(state.rays) + self._explored + mapping_rays,
            "paths": float(len(lanes)),
            "nonfinite": total(bad),
            "regions": float(sum(map(len, regions))),
        }
        return {"image": self.image(radiance, seed, iteration)}, counters

    def _even_choice(self, base: Any, lanes: Any, samples: int) -> Any:
        """Numbers of which the one that chooses a region is even over the samples of a pixel, as the sampler's own are
        unless it is independent: then sample j of n gets one in [j / n, (j + 1) / n)."""
        if not self._groups or self.settings.sampler != "independent":
            return base
        (draws,) = self._groups[0].draws
        vertex, component = draws[0]
        source = NumberedSource(base, {})
        number = mi.Float(lanes % samples) + base.next_1d(vertex, component)
        source.give([draws[0]], [number / samples], None)
        return source

    def _regions(self, iteration: int, seed: int, samples: int) -> Regions:
        """The plan of a pass, which the passes around it share."""
        wanted = iteration // self.settings.update, seed, samples
        if self._planned is None or self._planned[0] != wanted:
            self._planned = wanted, self._plan(*wanted)
        return self._planned[1]

    def _plan(self, number: int, seed: int, samples: int) -> Regions:
        """The regions of plan ``number``, by luminance in pixels anywhere."""
        # With the photons of the group's first pass, also where a resumed run comes into the group later.
        self._explored += self.map_light(number * self.settings.update, seed)
        calls = 0
        (draws,) = self._groups[0].draws

        def luminance(x: Any) -> Any:
            nonlocal calls
            calls += 1
            lanes = dr.arange(mi.UInt32, dr.width(x[0]))
            base = IndependentSource(lanes, seed, f"explore {calls}", number)
            where = IndependentSource(lanes, seed, f"explore pixel {calls}", number).next_1d(0, 0)
            source = NumberedSource(base, {})
            source.give(draws, x, self.left_by_pick())
            state = self.trace(dr.minimum(mi.UInt32(where * self.camera.pixels), self.camera.pixels - 1), source)
            radiance, _ = self.kept(state.radiance)
            value = mi.luminance(radiance)
            dr.eval(value, state.rays)
            self._explored += total(state.rays)
            return value

        f = Integrand(luminance, len(draws), on="device")
        plan_seed, _ = seed_key(seed, "plan", number)
        return self._integrator.plan(f, self.camera.pixels * samples, plan_seed)
