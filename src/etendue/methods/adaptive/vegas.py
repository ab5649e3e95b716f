r"""Path tracing with learned densities of its random numbers, after VEGAS.

The random numbers of a path are a point u of a hypercube, and its contribution is a function f(u). Groups of numbers
are sampled from the density :math:`p(u) = \prod_g p_g(u_g)`, a product of one density for each group:

.. math:: L = \frac 1 N \sum_i \frac{f(u_i)}{p(u_i)}

After 1, 2, 4, … passes the bins of every :math:`p_g` are adapted towards equal sums of :math:`(f / p)^2`, where f is
the luminance. A contribution is divided only by the densities of the numbers on which it depends; direct light at the
first vertex, for example, does not depend on the second direction. Groups of one and two numbers have bins with movable
edges, larger groups a grid of cells. All pixels of the image, or of a tile, share the densities [Lepage 1978;
Leeson 2001, sec. 5.5].

A pass is unbiased for any densities, and all passes have the same weight: weights by inverse variance would be
correlated with the pictures, which would become too dark.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, Carrying, CheckpointError, OptionError, State, setting
from etendue.integration import AxisBins, CellGrid, Factor, PlaneBins, bin_values
from etendue.scene import Problem

from ..base import STEP_LANES, ImageSettings, Layer, total
from ..path import Path
from .dimensions import LENGTH, AdaptiveSource, check_merge, groups
from .path import AdaptivePath, AdaptiveSettings

#: Uniform part of a density, relative to the learned one: light that was missed so far can be found, and weights are at
#: most about the inverse.
_EVEN = 0.1
#: The arrays that define a density, by its class.
_FIELDS: dict[type[Factor], tuple[str, ...]] = {
    AxisBins: ("edges",),
    PlaneBins: ("edges", "inner"),
    CellGrid: ("probability",),
}


@dataclass(frozen=True)
class VegasSettings(AdaptiveSettings):
    """Settings of ``vegas``."""

    groups: str = setting(
        "light; bounce1; bounce2",
        "random numbers with a learned density, in groups separated by semicolons: film, lens, and, with or without "
        "the number of a vertex, light, lobe, bounce, roulette",
    )
    bounces: int = setting(
        2,
        "number of surface points of a path whose random numbers may be in a group; later ones do not adapt",
        minimum=1,
    )
    learning: str = setting(
        "importance",
        "quantity that is made equal in all bins: sum of squared contributions (importance), or standard "
        "deviation (stratified)",
        choices=("importance", "stratified"),
    )
    bins: int = setting(
        0, "number of bins on each axis of a group; 0: chosen by the number of samples of a pass", minimum=0
    )
    tile: int = setting(
        0, "width in pixels of square tiles with densities of their own; 0: one density for the image", minimum=0
    )
    update: int = setting(
        0, "passes between two changes of the densities; 0: they change after 1, 2, 4, 8, … passes", minimum=0
    )
    smoothing: bool = setting(True, "average the sums of neighbouring bins before the densities change")
    damping: float = setting(
        0.75, "exponent of the damping of changes, as in VEGAS; larger: faster changes; 0: no damping", minimum=0.0
    )
    inertia: float = setting(
        0.5, "share of the new density in a grid of cells, mixed with the old one", above=0.0, maximum=1.0
    )
    stabilise: int = setting(
        0, "passes after which smoothing, damping and inertia are switched off; 0: never", minimum=0
    )
    one_path: bool = setting(
        False, "use one path of a sampled number of edges, instead of paths of all lengths; more noise"
    )
    lengths: int = setting(
        6, "with one_path: largest number of edges that is sampled, which includes all longer paths", minimum=1
    )


class VegasPath(Carrying, AdaptivePath):
    """Path tracing with random numbers sampled from learned densities, after VEGAS."""

    name: ClassVar[str] = "vegas"
    Settings: ClassVar[type[ImageSettings]] = VegasSettings
    settings: VegasSettings
    citations: ClassVar[tuple[str, ...]] = ("Leeson2001", "Lepage1978", *Path.citations)
    carries_on: ClassVar[bool] = True

    def __init__(self, settings: ImageSettings | None = None) -> None:
        super().__init__(settings)
        o = self.settings  # checked here, so that errors are raised before the scene is loaded
        groups(o.groups, o.bounces)
        check_merge(o.groups, o.merge)
        if o.one_path and (o.maps or o.map):
            raise OptionError(
                "one_path=true cannot be combined with maps, whose light has any length; set maps=0 and leave out map"
            )

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`AdaptivePath`; the densities are uniform."""
        self._forget_states()
        super().prepare(problem, seed)
        o = self.settings
        self._groups = groups(o.groups, o.bounces, self.constant_numbers())
        self.draw_film(self._groups)
        width, height = problem.size
        side = o.tile or max(width, height)
        self._tiles = -(-width // side), -(-height // side)
        rows = self._tiles[0] * self._tiles[1]
        samples = min(side, width) * min(side, height) * self.samples_per_iteration
        even = [g.even(o.bins, samples) for g in self._groups]
        if o.one_path:
            longest = o.lengths if o.max_depth < 0 else max(1, min(o.lengths, o.max_depth))
            self._groups, even = [*self._groups, LENGTH], [*even, CellGrid.even(longest, 1)]
        self._densities: list[list[Factor]] = [[factor] * rows for factor in even]
        self._saved: list[dict[str, Array]] | None = None  # the densities as arrays, until they change
        self._passes = 0
        self._clear_sums()

    def full_lanes(self) -> int:
        """See :class:`ImageMethod`."""
        return STEP_LANES

    def _clear_sums(self) -> None:
        kinds = 3 if self.settings.learning == "stratified" else 1
        self._sums: list[Array] = [np.zeros((kinds, len(d) * d[0].bins)) for d in self._densities]

    # ------------------------------------------------------------------ a pass

    def render_pass(self, iteration: int, seed: int, samples: int) -> tuple[dict[str, Layer], dict[str, float]]:
        """See :class:`ImageMethod`."""
        mapping_rays = self.map_light(iteration, seed)
        lanes = dr.arange(mi.UInt32, self.camera.pixels * samples)
        source = self.numbers(lanes, samples, iteration, seed)
        state = self.trace(lanes // samples, source, learning=True, first=self.first_hits(lanes, iteration))
        radiance, bad = self.kept_layers(state)
        parts = [dr.select(dr.isfinite(part), part, 0.0) for part in state.parts]
        found = [(drawn.group, drawn.bin, part) for drawn, part in zip(source.drawn, parts, strict=True)]
        dr.eval(radiance, state.rays, bad, found)
        self._learn(found)
        counters = {"rays": total(state.rays) + mapping_rays, "paths": float(len(lanes)), "nonfinite": total(bad)}
        return self.images(radiance, seed, iteration), counters

    def numbers(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> AdaptiveSource:
        """See :class:`AdaptivePath`."""
        base, row = self.camera_numbers(lanes, samples, seed, iteration), self._row(lanes // samples)
        return AdaptiveSource(base, self._groups, self._densities, row, self.left_by_pick())

    def _row(self, pixel: mi.UInt32) -> mi.UInt32:
        """Number of a pixel's tile."""
        if self._tiles == (1, 1):
            return mi.UInt32(0)
        y = pixel // self.camera.width
        x = pixel - y * self.camera.width
        return y // self.settings.tile * self._tiles[0] + x // self.settings.tile

    # ------------------------------------------------------------------ learning

    def _learn(self, found: list[tuple[int, mi.UInt32, mi.Float]]) -> None:
        """Add the contributions of a pass to the sums of the bins, and adapt the densities after the last pass of an
        update. ``found``: for each ``Drawn`` (group, bins, luminance of the contributions).

        The sums are computed on the host, because the order of atomic additions on the device differs between runs, and
        rounding errors of the bins would change the paths.
        """
        for group, bins, values in found:
            place, value = np.asarray(bins), np.asarray(values, np.float64)
            sums = self._sums[group].copy()
            for row, weight in zip(sums, (np.square(value), value, None), strict=False):
                row += np.bincount(place, weight, len(row))
            self._sums[group] = sums
        self._passes += 1
        o = self.settings
        if self._passes % o.update if o.update else self._passes & (self._passes - 1):
            return
        steady = bool(o.stabilise) and self._passes > o.stabilise
        how = (False, None, 1.0) if steady else (o.smoothing, o.damping or None, o.inertia)
        for number, densities in enumerate(self._densities):
            sums = self._sums[number].reshape(-1, len(densities), densities[0].bins)
            for row, factor in enumerate(densities):
                values = bin_values(factor, sums[:, row], 1, o.learning, steady)
                if (mean := values.mean()) > 0.0:
                    even = _EVEN * mean * factor.volume * factor.bins
                    densities[row] = factor.adapted(values + even, *how)
        self._saved = None
        self._clear_sums()

    def _left(self) -> State:
        """The densities, and the sums since their last change."""
        if self._saved is None:
            self._saved = [
                {name: np.stack([getattr(factor, name) for factor in rows]) for name in _FIELDS[type(rows[0])]}
                for rows in self._densities
            ]
        return {"passes": self._passes, "densities": self._saved, "found": list(self._sums), **AdaptivePath.start(self)}

    def _take(self, state: State) -> None:
        AdaptivePath.enter(self, state)
        found = [np.array(sums, float) for sums in state["found"]]
        fields = [_FIELDS[type(rows[0])] for rows in self._densities]
        saved = [
            [np.asarray(arrays.get(name, ()), float) for name in names]
            for names, arrays in zip(fields, state["densities"], strict=False)
        ]
        here = [
            [(len(rows), *getattr(rows[0], name).shape) for name in names]
            for names, rows in zip(fields, self._densities, strict=True)
        ]
        same = [[a.shape for a in arrays] for arrays in saved] == here
        if not same or [sums.shape for sums in found] != [sums.shape for sums in self._sums]:
            raise CheckpointError(
                "the densities in the checkpoint do not fit this picture and these settings; start a new run"
            )
        for rows, arrays in zip(self._densities, saved, strict=True):
            rows[:] = [type(rows[0])(*parts) for parts in zip(*arrays, strict=True)]
        self._passes, self._sums, self._saved = int(state["passes"]), found, None
