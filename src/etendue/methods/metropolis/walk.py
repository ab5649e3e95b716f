"""A pass of all chains: the steps, what they splat, and the images of the pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import IndependentSource, SampleSource
from etendue.integration import Move
from etendue.transport import Splats

from ..base import total
from .blend import luminance
from .states import ChainStates, PassResult, Progressed, by_half
from .targets import Contribution

if TYPE_CHECKING:
    from .chains import Chains

#: Weight of a step of a chain relative to that of an independent sample, because neighbours of a chain are correlated.
CORRELATED = 0.25
#: Groups of the chains of a half, with separate pictures.
GROUPS = 2
#: Images of the splats of a component: of the chains and of large steps, for each half and group.
_LARGE = 2 * GROUPS
IMAGES = 2 * _LARGE


@dataclass
class Walk:
    """The chains during a pass."""

    runner: Chains
    carried: Progressed
    splats: Splats | None
    share: float
    waiting: mi.Float  #: weight of the current paths that is not splatted yet

    def __post_init__(self) -> None:
        carried, chains = self.carried, self.runner.chains
        self._inverse_unit, self._share = (dr.opaque(mi.Float, v) for v in (1.0 / carried.unit, self.share))
        self._longest = dr.zeros(mi.UInt32, chains)
        self._accepted = {large: dr.zeros(mi.UInt32, chains) for large in (True, False)}
        self._tried = {True: 0, False: 0}
        self._proposed: list[mi.Float] = []  # targets of the proposals of large steps
        self._rays = self._bad = dr.zeros(mi.UInt32, chains)

    def _weight(self, target: mi.Float) -> mi.Float:
        """1 / q; 0 for a path that no kind of step of this pass samples."""
        density = target * (self._inverse_unit * CORRELATED) + self._share
        return dr.select(density > 0.0, dr.rcp(density), 0.0)

    def _splat(self, image: int, contributions: Sequence[Contribution], weight: mi.Float, number: SampleSource) -> None:
        if self.runner.record is not None:
            self.runner.record(image > 0, contributions, weight)
        if self.splats is None:
            return
        for index, one in enumerate(contributions):
            place = self.splats.at(one.position, number.next_2d(index, 0))
            value = one.value * (weight * place.weight)
            number_of = self.runner.group + (image + IMAGES * one.component)
            self.splats.add_to(number_of, place, value, place.on_film & ~dr.all(value == 0.0))

    def step(self, seed: int, is_large: bool) -> None:
        """Move all chains."""
        runner, carried, old = self.runner, self.carried, self.carried.states
        if is_large:
            moves = runner.moves(seed, carried.large)
        else:
            size = dr.opaque(mi.Float, carried.size)
            moves = {name: Move(runner.small(name, seed, carried.steps), size) for name in runner.target.layouts}
        traced = runner.trace(moves, runner.numbers, old)
        target = runner.value(traced.contributions, carried.factors, carried.cap)
        dr.eval(traced.contributions, target, traced.rays, traced.nonfinite)

        decisions = IndependentSource(runner.numbers, seed, "accept", carried.steps)
        chance = dr.select(target < old.target, target / old.target, 1.0)
        accepted = decisions.next_1d(0, 0) < chance
        # Other numbers than the decisions: the place of a contribution must not depend on whether it is accepted.
        places = IndependentSource(runner.numbers, seed, "filter", carried.steps)
        stay, go = (1.0 - chance) * self._weight(old.target), chance * self._weight(target)
        # One path is splatted now: the old one if it is left for good, or else the proposal.
        left = [a.where(accepted, b) for a, b in zip(old.contributions, traced.contributions, strict=True)]
        self._splat(0, left, dr.select(accepted, self.waiting + stay, go), places)
        self.waiting = dr.select(accepted, go, self.waiting + stay)
        if is_large:
            self._splat(_LARGE, traced.contributions, self._weight(target), places)
            self._proposed.append(target)
        self._accepted[is_large] = self._accepted[is_large] + dr.select(accepted, mi.UInt32(1), 0)
        self._tried[is_large] += 1
        rejected = dr.select(accepted, mi.UInt32(0), old.rejected + 1)
        self._longest = dr.maximum(self._longest, rejected)
        self._rays, self._bad = self._rays + traced.rays, self._bad + traced.nonfinite
        new = [b.where(accepted, a) for a, b in zip(old.contributions, traced.contributions, strict=True)]
        kept = dr.select(accepted, target, old.target)
        if self.splats is not None:
            dr.schedule(self.splats.array)
        dr.eval(self.waiting, new, kept, rejected, accepted, self._longest, self._accepted)
        dr.eval(self._rays, self._bad)
        numbers = {
            name: moves[name].write(layout, old.numbers[name], accepted, runner.numbers, runner.chains)
            for name, layout in runner.target.layouts.items()
        }
        self.carried = replace(
            carried,
            states=ChainStates(numbers, new, kept, rejected),
            steps=carried.steps + 1,
            large=carried.large + (runner.chains // 2 if is_large else 0),
        )

    def finish(self, steps: int, seed: int) -> tuple[Progressed, PassResult]:
        """Splat the current paths, and combine the images of the pass."""
        runner, carried = self.runner, self.carried
        places = IndependentSource(runner.numbers, seed, "last filter", carried.steps)
        self._splat(0, carried.states.contributions, self.waiting, places)
        targets = by_half([np.zeros(0), *(np.array(target, np.float64) for target in self._proposed)])
        new = [np.full(2, targets.shape[1]), targets.sum(axis=1), np.square(targets).sum(axis=1)]
        found = carried.found + np.stack(new, axis=1)
        mean = found[:, 1] / found[:, 0]
        factors = CORRELATED * mean / carried.unit
        chained = large = contrast = None
        if self.splats is not None:
            sums = self.splats.sums()
            sums = sums.reshape(-1, 2, 2, GROUPS, *sums.shape[1:])  # by component, kind, half and group
            scale = runner.size[0] * runner.size[1] / (steps * runner.chains / 2)
            images = scale * sums.sum(axis=3, dtype=np.float64)
            chained, large = images[:, 0], images[:, 1]
            first, second = np.moveaxis(luminance(sums.sum(axis=0)), 2, 0)
            contrast = scale * (first - second)
        counters = {
            "rays": total(self._rays),
            "paths": float(steps * runner.chains),
            "nonfinite": total(self._bad),
            "large steps": float(self._tried[True] * runner.chains),
            "large steps accepted": total(self._accepted[True]),
            "small steps": float(self._tried[False] * runner.chains),
            "small steps accepted": total(self._accepted[False]),
        }
        longest = max(carried.longest, int(np.array(self._longest).max()))
        carried = replace(carried, found=found, longest=longest)
        if targets.any():
            first = carried.large - targets.shape[1]
            carried = replace(carried, states=runner.renewed(carried, first, targets, seed))
        return carried, PassResult(chained, large, contrast, counters, factors)
