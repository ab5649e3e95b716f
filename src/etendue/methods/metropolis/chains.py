r"""Many short Markov chains over primary samples, one in each lane, which splat what they find.

A step proposes a path x' for the path x of a chain, by a large or a small step (:mod:`etendue.integration.primary`),
and accepts it with the probability a = min(1, t(x') / t(x)) for a target t > 0, the luminance of the path's
contributions times a factor by film position, at most ``cap`` (:func:`largest_target`). Both paths are splatted by
their expected weights [Veach 1997, sec. 11.3.2]. All chains make a large step at the same time, in a share p of the
steps of a pass. The proposals of these steps are independent samples as well, of density 1, while the states have the
density t / b with b the integral of t; the two are combined by the balance heuristic [Kelemen 2002, sec. 6]:

.. math:: I = \frac{1}{n} \sum_{steps} \left( \kappa \frac{b}{b_0} \left( (1 - a) \frac{c(x)}{q(x)}
   + a \frac{c(x')}{q(x')} \right) + \ell \, \frac{c(x')}{q(x')} \right), \qquad q = \kappa t / b_0 + p

where l is 1 in large steps, else 0, b_0 is the estimate of b by the bootstrap, and kappa < 1 is the weight of a step of
a chain, whose neighbours are correlated. The weights are exact for any fixed b_0 and kappa. Large steps tell b, but
badly where they find light rarely: the two terms are kept apart, and b is left to :mod:`.blend`.

The chains and the samples of the bootstrap are two independent *halves*, so the difference of their pictures measures
the error, whatever the correlation along chains.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, Frozen, IndependentSource, SampleSource, SceneError, logger, seed_key
from etendue.integration import Move, PrimarySource
from etendue.points import OwenSobolSource
from etendue.transport import Splats

from ..base import total
from .blend import luminance
from .film import BrightnessMap
from .states import HALF_BIT, ChainStates, PassResult, Progressed, drawn, numbers_of
from .targets import Contribution, Target, Traced, largest_target

#: Weight of a step of a chain relative to that of an independent sample, because neighbours of a chain are correlated.
CORRELATED = 0.25
#: The bootstrap ends with this many samples that find light, or when it has grown by this factor; by the second one as
#: long as only one of the halves has found light.
_ENOUGH_LIT, _MOST_GROWTH, _ONE_SIDED_GROWTH = 1 << 12, 8, 64
#: Groups of the chains of a half, whose pictures are apart.
_GROUPS = 2
#: Images of the splats of a component: of the chains and of large steps, for each half and group.
_LARGE = 2 * _GROUPS
IMAGES = 2 * _LARGE
#: Bytes of a sample of the bootstrap on the host: a contribution, and the target.
_CONTRIBUTION_BYTES, _TARGET_BYTES = 12, 24
#: Most samples of the bootstrap that are traced together.
_BATCH = 1 << 16
_WORD = 0xFFFFFFFF


@dataclass
class Runner:
    """Starts and moves the chains of a target.

    Attributes
    ----------
    chains: a multiple of four.
    bootstrap: samples that chains start from, at least.
    sampler: of the bootstrap and of large steps, ``owen`` or ``independent``.
    room: bytes that the bootstrap may take on the host.
    """

    target: Target
    size: tuple[int, int]
    chains: int
    bootstrap: int
    sampler: str
    equalise: bool
    room: float = math.inf
    #: Called with all that is splatted: whether by large steps as independent samples, contributions, weight.
    record: Callable[[bool, Sequence[Contribution], mi.Float], None] | None = None
    _numbers: mi.UInt32 = field(init=False)
    _frozen: Frozen[Traced] = field(init=False)

    def __post_init__(self) -> None:
        self._numbers = numbers_of(self.chains)
        self._group = dr.arange(mi.UInt32, self.chains) // dr.opaque(mi.UInt32, self.chains // (2 * _GROUPS))
        dr.eval(self._group)
        self.release()

    def release(self) -> None:
        """Forget the kernels of steps, which keep the scene in memory."""
        self._frozen = Frozen(self._proposals, self.target.reads)

    # ------------------------------------------------------------------ random numbers

    def independent(self, name: str, seed: int, first: int) -> Callable[[mi.UInt32], SampleSource]:
        """Numbers of independent samples, from the number ``first`` of each half on, as a function of
        :func:`numbers_of` samples."""

        def fresh(number: mi.UInt32) -> SampleSource:
            half = number >> HALF_BIT
            start = dr.opaque(mi.UInt32, first & _WORD)
            index = (number & ((1 << HALF_BIT) - 1)) + start
            high = dr.select(index < start, mi.UInt32(1), mi.UInt32(0)) + dr.opaque(mi.UInt32, first >> 32)
            if self.sampler == "owen":
                return OwenSobolSource(half, index, seed, f"large {name}", high)
            return IndependentSource(index, seed, f"large {name}", 0, 2 * high + half)

        return fresh

    def _small(self, name: str, seed: int, step: int) -> Callable[[mi.UInt32], SampleSource]:
        """Numbers that move the states."""
        return lambda number: IndependentSource(number, seed, f"small {name}", step)

    def _moves(self, seed: int, first: int) -> dict[str, Move]:
        return {name: Move(self.independent(name, seed, first)) for name in self.target.layouts}

    def _trace(self, moves: Mapping[str, Move], numbers: mi.UInt32, states: ChainStates | None) -> Traced:
        """The proposals of a move, not yet evaluated if they are not those of a step: ``states`` is ``None`` for
        samples of the bootstrap."""
        fresh = {name: move.fresh(numbers) for name, move in moves.items()}
        size = next(iter(moves.values())).size
        lanes = dr.width(numbers)
        while True:
            if states is None:
                traced = self._proposals(fresh, None, None, lanes)
            else:
                traced = self._frozen(fresh, None if size is None else states.numbers, size, lanes)
            if traced.stored is None or self.target.held(int(traced.stored[0]), lanes):
                return traced
            self.release()

    def _proposals(
        self,
        fresh: Mapping[str, SampleSource],
        numbers: Mapping[str, mi.Float] | None,
        size: mi.Float | None,
        lanes: int,
    ) -> Traced:
        """Paths by fresh numbers, or by those of the states moved with them, by small steps of a ``size``."""
        lane = dr.arange(mi.UInt32, lanes)
        sources = {
            name: PrimarySource(layout, fresh[name], lane, lanes, None if numbers is None else numbers[name], size)
            for name, layout in self.target.layouts.items()
        }
        return self.target.trace(sources, lanes)

    # ------------------------------------------------------------------ start

    def start(self, seed: int) -> Progressed:
        """Draw the first states from independent samples in proportion to the target.

        Raises :class:`SceneError` if a half finds no light. The distribution of a first state differs from the target
        by about (1 + v) / N in total variation, for N samples of relative variance v; the mean picture times
        the mean target of the same N samples has no such bias [Veach 1997, sec. 11.3.1].
        """
        lanes = min(_BATCH, self.bootstrap + self.bootstrap % 2)
        wanted = -(-self.bootstrap // lanes)
        wanted += max(1, wanted // 4) if self.equalise else 0
        parts: list[NDArray[np.float32]] = []  # (x y luminance, contribution, sample)
        lit = np.zeros((0, 2), int)
        while self._goes_on(len(parts), wanted, lit[self._for_the_map(len(parts)) :].sum(axis=0), lanes, parts):
            traced = self._trace(self._moves(seed, len(parts) * (lanes // 2)), numbers_of(lanes), None)
            parts.append(_on_host(traced.contributions))
            lit = np.append(lit, [(parts[-1][2].sum(axis=0) > 0.0).reshape(2, -1).sum(axis=1)], axis=0)
        used = self._for_the_map(len(parts))
        lit, samples = lit[used:].sum(axis=0), (len(parts) - used) * (lanes // 2)
        if not lit.all():
            raise SceneError(
                f"the bootstrap found no light: {2 * samples - lit.sum()} of {2 * samples} paths are black; use a "
                "method or an estimator that finds some, or raise bootstrap"
            )
        flat = BrightnessMap.flat(self.size)
        factors = BrightnessMap.measured(parts[:used] or parts, self.size) if self.equalise else flat
        targets = _by_half([(luminance * factors.on_host(x, y)).sum(axis=0) for x, y, luminance in parts[used:]])
        cap = largest_target(targets)
        targets = np.minimum(targets, cap)
        found = np.stack([np.full(2, samples), targets.sum(axis=1), np.square(targets).sum(axis=1)], axis=1)
        states = self._first_states(seed, used * (lanes // 2), targets, factors, cap)
        return Progressed(states, factors, float(targets.mean()), cap, found, large=len(parts) * (lanes // 2))

    def _for_the_map(self, batches: int) -> int:
        """How many of the batches, the first ones, tell the factors by film position. No states are drawn from these:
        where a sample is bright, the factor is small, and the picture of states among the same samples too bright."""
        return max(1, batches // 5) if self.equalise and batches > 1 else 0

    def _goes_on(self, batches: int, wanted: int, lit: Array, lanes: int, parts: Sequence[NDArray[np.float32]]) -> bool:
        """Whether the bootstrap needs a further batch."""
        growth = _ONE_SIDED_GROWTH if lit.any() and not lit.all() else _MOST_GROWTH
        if batches >= wanted and ((lit.sum() >= _ENOUGH_LIT and lit.all()) or batches >= wanted * growth):
            return False
        bytes_each = lanes * (_CONTRIBUTION_BYTES * len(parts[0][0]) + _TARGET_BYTES) if parts else 0.0
        if (batches + 1) * bytes_each <= self.room:
            return True
        if batches < wanted:
            logger.info("a bootstrap of %d samples: limited by memory", batches * lanes)
        return False

    def _first_states(self, seed: int, first: int, targets: Array, factors: BrightnessMap, cap: float) -> ChainStates:
        half = self.chains // 2
        chosen = np.empty((2, half), np.uint32)
        for index, row in enumerate(targets):
            chosen[index] = drawn(row, half, _offset(seed, "start", index, 0)) + (index << HALF_BIT)
        numbers, moves = mi.UInt32(chosen.ravel()), self._moves(seed, first)
        traced = self._trace(moves, numbers, None)
        target = self._target(traced.contributions, factors, cap)
        dr.eval(traced.contributions, target)
        kept = {
            name: moves[name].write(layout, dr.zeros(mi.Float, layout.size * self.chains), None, numbers, self.chains)
            for name, layout in self.target.layouts.items()
        }
        return ChainStates(kept, traced.contributions, target, dr.zeros(mi.UInt32, self.chains))

    def renewed(self, carried: Progressed, first: int, targets: Array, seed: int) -> ChainStates:
        """The states after some chains have begun anew: at proposals of large steps, drawn in proportion to the target,
        as many as if all first states had been drawn from all independent samples so far.

        ``targets``: of the proposals, those numbered from ``first`` on in each half, (halves, proposals).
        """
        half, sums = self.chains // 2, targets.sum(axis=1)
        u = np.array(IndependentSource(self._numbers, seed, "renew", carried.steps).next_1d(0, 0)).reshape(2, half)
        begins = u < (sums / np.maximum(carried.found[:, 1], 1e-300))[:, None]
        counts = begins.sum(axis=1)
        if not counts.any():
            return carried.states
        chosen = [
            drawn(row, count, _offset(seed, "renew", index, carried.steps)) + (index << HALF_BIT)
            for index, (row, count) in enumerate(zip(targets, counts, strict=True))
            if count
        ]
        numbers, at = mi.UInt32(np.concatenate(chosen).astype(np.uint32)), mi.UInt32(np.flatnonzero(begins))
        moves, old = self._moves(seed, first), carried.states
        traced = self._trace(moves, numbers, None)
        target = self._target(traced.contributions, carried.factors, carried.cap)
        dr.eval(traced.contributions, target)
        # A copy of all states, in which those of some chains are replaced.
        kept = [
            Contribution(mi.Point2f(one.position), mi.Color3f(one.value), one.component) for one in old.contributions
        ]
        states = ChainStates(
            {
                name: moves[name].write(layout, old.numbers[name], None, numbers, self.chains, at)
                for name, layout in self.target.layouts.items()
            },
            kept,
            mi.Float(old.target),
            mi.UInt32(old.rejected),
        )
        for mine, new in zip(kept, traced.contributions, strict=True):
            dr.scatter(mine.position, new.position, at)
            dr.scatter(mine.value, new.value, at)
        dr.scatter(states.target, target, at)
        dr.scatter(states.rejected, mi.UInt32(0), at)
        dr.eval(states.contributions, states.target, states.rejected)
        return states

    @staticmethod
    def _target(contributions: Sequence[Contribution], factors: BrightnessMap, cap: float) -> mi.Float:
        result = mi.Float(0.0)
        for one in contributions:
            result = result + dr.maximum(mi.luminance(one.value), 0.0) * factors.at(one.position)
        return dr.minimum(result, dr.opaque(mi.Float, cap))

    # ------------------------------------------------------------------ steps

    def run(self, carried: Progressed, steps: int, seed: int, splats: Splats | None) -> tuple[Progressed, PassResult]:
        """``steps`` steps of all chains. ``splats``: :data:`IMAGES` empty images, or so many for each component;
        ``None`` if only :attr:`record` is wanted."""
        owed = carried.owed + carried.share * steps
        large_steps = min(int(owed + 1e-9), steps)
        carried = replace(carried, owed=owed - large_steps)
        # The weights are exact for the share of this pass, and only on average for that of all passes.
        walk = _Walk(self, carried, splats, large_steps / steps, dr.zeros(mi.Float, self.chains))
        for index in range(steps):
            walk.step(seed, (index + 1) * large_steps // steps > index * large_steps // steps)
        return walk.finish(steps, seed)


def _offset(seed: int, purpose: str, half: int, step: int) -> float:
    """A random number in [0, 1)."""
    return float((seed_key(seed, f"{purpose} {half}", step)[0] + 0.5) / 2.0**32)


def _by_half(parts: Sequence[Array]) -> Array:
    """Values of the samples of some batches, (halves, samples)."""
    return np.concatenate([part.reshape(2, -1) for part in parts], axis=1)


def _on_host(contributions: Sequence[Contribution]) -> NDArray[np.float32]:
    """(x y luminance, contributions, samples)."""
    found = [(one.position.x, one.position.y, dr.maximum(mi.luminance(one.value), 0.0)) for one in contributions]
    dr.eval(found)
    return np.array([[np.array(row[i]) for row in found] for i in range(3)], np.float32)


@dataclass
class _Walk:
    """The chains during a pass."""

    runner: Runner
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
            number_of = self.runner._group + (image + IMAGES * one.component)
            self.splats.add_to(number_of, place, value, place.on_film & ~dr.all(value == 0.0))

    def step(self, seed: int, is_large: bool) -> None:
        """Move all chains."""
        runner, carried, old = self.runner, self.carried, self.carried.states
        if is_large:
            moves = runner._moves(seed, carried.large)
        else:
            size = dr.opaque(mi.Float, carried.size)
            moves = {name: Move(runner._small(name, seed, carried.steps), size) for name in runner.target.layouts}
        traced = runner._trace(moves, runner._numbers, old)
        target = runner._target(traced.contributions, carried.factors, carried.cap)
        dr.eval(traced.contributions, target, traced.rays, traced.nonfinite)

        decisions = IndependentSource(runner._numbers, seed, "accept", carried.steps)
        chance = dr.select(target < old.target, target / old.target, 1.0)
        accepted = decisions.next_1d(0, 0) < chance
        # Not those that decide: contributions would move on the film by whether they are accepted.
        places = IndependentSource(runner._numbers, seed, "filter", carried.steps)
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
            name: moves[name].write(layout, old.numbers[name], accepted, runner._numbers, runner.chains)
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
        places = IndependentSource(runner._numbers, seed, "last filter", carried.steps)
        self._splat(0, carried.states.contributions, self.waiting, places)
        targets = _by_half([np.zeros(0), *(np.array(target, np.float64) for target in self._proposed)])
        new = [np.full(2, targets.shape[1]), targets.sum(axis=1), np.square(targets).sum(axis=1)]
        found = carried.found + np.stack(new, axis=1)
        mean = found[:, 1] / found[:, 0]
        factors = CORRELATED * mean / carried.unit
        chained = large = contrast = None
        if self.splats is not None:
            sums = self.splats.sums()
            sums = sums.reshape(-1, 2, 2, _GROUPS, *sums.shape[1:])  # by component, kind, half and group
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
