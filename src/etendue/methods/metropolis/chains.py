r"""Many short Markov chains over primary samples, one in each lane, which splat their contributions.

A step proposes a path x' for the path x of a chain, by a large or a small step (:mod:`etendue.integration.primary`),
and accepts it with the probability a = min(1, t(x') / t(x)) for a target t > 0, the luminance of the path's
contributions times a factor by film position, at most ``cap`` (:func:`largest_target`). Both paths are splatted by
their expected weights [Veach 1997, sec. 11.3.2]. All chains make a large step at the same time, in a share p of the
steps of a pass. The proposals of these steps are independent samples as well, of density 1, while the states have the
density t / b with b the integral of t; the two are combined by the balance heuristic [Kelemen 2002, sec. 6]:

.. math:: I = \frac{1}{n} \sum_{steps} \left( \kappa \frac{b}{b_0} \left( (1 - a) \frac{c(x)}{q(x)}
   + a \frac{c(x')}{q(x')} \right) + \ell \, \frac{c(x')}{q(x')} \right), \qquad q = \kappa t / b_0 + p

where l is 1 in large steps, else 0, b_0 is the estimate of b by the bootstrap, and kappa < 1 is the weight of a step of
a chain, whose neighbours are correlated. The weights are exact for any fixed b_0 and kappa. Large steps estimate b,
but badly where they find light rarely: the two terms are kept apart, and :mod:`.blend` determines b.

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

from etendue.core import Array, Frozen, IndependentSource, SampleSource, SceneError, copied_to_device, logger, seed_key
from etendue.integration import Move, PrimarySource
from etendue.points import OwenSobolSource
from etendue.transport import Splats

from .states import HALF_BIT, BrightnessMap, ChainStates, PassResult, Progressed, by_half, drawn, numbers_of
from .targets import Contribution, Target, Traced, brightness, largest_target
from .walk import GROUPS, Walk

#: The bootstrap ends with this many samples that find light, or when it has grown by this factor; by the second
#: factor as long as only one of the halves has found light. A small one is content with a share of its samples.
_ENOUGH_LIT, _MOST_GROWTH, _ONE_SIDED_GROWTH, _LIT = 1 << 12, 8, 64, 1 / 4
#: Bytes of a sample of the bootstrap on the host: a contribution, and the target.
_CONTRIBUTION_BYTES, _TARGET_BYTES = 12, 24
#: Most samples of the bootstrap that are traced together.
_BATCH = 1 << 16
_WORD = 0xFFFFFFFF


@dataclass
class Chains:
    """Starts and moves the chains of a target.

    Attributes
    ----------
    chains: a multiple of four.
    bootstrap: least number of samples that chains start from.
    sampler: of the bootstrap and of large steps, ``owen`` or ``independent``.
    room: bytes that the bootstrap may take on the host.
    usual: least number of samples of a run with large passes, where ``bootstrap`` is less because this one's are small:
        it grows as far where few samples find light, but is content with fewer that do; 0: ``bootstrap``.
    """

    target: Target
    size: tuple[int, int]
    chains: int
    bootstrap: int
    sampler: str
    equalise: bool
    room: float = math.inf
    usual: int = 0
    #: Called with all splats: whether they are of large steps as independent samples, contributions, weight.
    record: Callable[[bool, Sequence[Contribution], mi.Float], None] | None = None
    #: Numbers of the chains in sources (:func:`numbers_of`), and the group of each chain.
    numbers: mi.UInt32 = field(init=False)
    group: mi.UInt32 = field(init=False)
    _frozen: Frozen[Traced] = field(init=False)

    def __post_init__(self) -> None:
        self.numbers = numbers_of(self.chains)
        self.group = dr.arange(mi.UInt32, self.chains) // dr.opaque(mi.UInt32, self.chains // (2 * GROUPS))
        dr.eval(self.group)
        self.release()

    def release(self) -> None:
        """Forget the kernels of steps, which keep the scene in memory."""
        self._frozen = Frozen(self._proposals, self.target.reads)

    # ------------------------------------------------------------------ random numbers

    def independent(self, name: str, seed: int, first: int) -> Callable[[mi.UInt32], SampleSource]:
        """Random numbers of independent samples, which each half counts from ``first`` on, as a function of
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

    def small(self, name: str, seed: int, step: int) -> Callable[[mi.UInt32], SampleSource]:
        """Random numbers that move the states."""
        return lambda number: IndependentSource(number, seed, f"small {name}", step)

    def moves(self, seed: int, first: int) -> dict[str, Move]:
        """Large steps to independent samples, which each half counts from ``first`` on."""
        return {name: Move(self.independent(name, seed, first)) for name in self.target.layouts}

    def trace(self, moves: Mapping[str, Move], numbers: mi.UInt32, states: ChainStates | None) -> Traced:
        """The proposals of a move. With ``states`` the move is a step, whose kernels are frozen."""
        fresh = {name: move.fresh(numbers) for name, move in moves.items()}
        size = next(iter(moves.values())).size
        lanes = dr.width(numbers)
        while True:
            if states is None:
                traced = self._proposals(fresh, None, None, lanes)
            else:
                traced = self._frozen(fresh, None if size is None else states.numbers, size, lanes)
            if traced.wanted is None or self.target.had_room(int(traced.wanted[0]), lanes):
                return traced
            self.release()

    def _proposals(
        self,
        fresh: Mapping[str, SampleSource],
        numbers: Mapping[str, mi.Float] | None,
        size: mi.Float | None,
        lanes: int,
    ) -> Traced:
        """Paths by fresh numbers, or by those of the states, moved by small steps of a ``size``."""
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
            traced = self.trace(self.moves(seed, len(parts) * (lanes // 2)), numbers_of(lanes), None)
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
        targets = by_half([(luminance * factors.on_host(x, y)).sum(axis=0) for x, y, luminance in parts[used:]])
        cap = largest_target(targets)
        targets = np.minimum(targets, cap)
        found = np.stack([np.full(2, samples), targets.sum(axis=1), np.square(targets).sum(axis=1)], axis=1)
        states = self._first_states(seed, used * (lanes // 2), targets, factors, cap)
        return Progressed(states, factors, float(targets.mean()), cap, found, large=len(parts) * (lanes // 2))

    def _for_the_map(self, batches: int) -> int:
        """Number of the first batches, which determine the factors by film position. No states are drawn from these:
        where a sample is bright, the factor is small, and the picture of states among the same samples too bright."""
        return max(1, batches // 5) if self.equalise and batches > 1 else 0

    def _goes_on(self, batches: int, wanted: int, lit: Array, lanes: int, parts: Sequence[NDArray[np.float32]]) -> bool:
        """Whether the bootstrap needs a further batch."""
        growth = _ONE_SIDED_GROWTH if lit.any() and not lit.all() else _MOST_GROWTH
        usual = max(self.usual, self.bootstrap)
        most = growth * max(wanted, -(-usual // lanes))
        enough = _ENOUGH_LIT if usual == self.bootstrap else min(_ENOUGH_LIT, _LIT * self.bootstrap)
        if batches >= wanted and ((lit.all() and lit.sum() >= enough) or batches >= most):
            return False
        bytes_each = lanes * (_CONTRIBUTION_BYTES * len(parts[0][0]) + _TARGET_BYTES) if parts else 0.0
        if (batches + 1) * bytes_each <= self.room:
            return True
        if batches < wanted:
            logger.info("a bootstrap of %d samples: limited by memory", batches * lanes)
        return False

    def _first_states(self, seed: int, first: int, targets: Array, factors: BrightnessMap, cap: float) -> ChainStates:
        numbers = _drawn_numbers(targets, [self.chains // 2] * 2, seed, "start", 0)
        empty = {name: dr.zeros(mi.Float, layout.size * self.chains) for name, layout in self.target.layouts.items()}
        return self._states_at(numbers, self.moves(seed, first), factors, cap, empty, None)

    def renewed(self, carried: Progressed, first: int, targets: Array, seed: int) -> ChainStates:
        """The states after some chains have begun anew: at proposals of large steps, drawn in proportion to the target,
        as many as if all first states had been drawn from all independent samples so far.

        ``targets``: of the proposals, which each half counts from ``first`` on, (halves, proposals).
        """
        half, sums = self.chains // 2, targets.sum(axis=1)
        u = np.array(IndependentSource(self.numbers, seed, "renew", carried.steps).next_1d(0, 0)).reshape(2, half)
        begins = u < (sums / np.maximum(carried.found[:, 1], 1e-300))[:, None]
        if not begins.any():
            return carried.states
        numbers = _drawn_numbers(targets, begins.sum(axis=1), seed, "renew", carried.steps)
        at = copied_to_device(mi.UInt32, np.flatnonzero(begins).astype(np.uint32))
        old, moves = carried.states, self.moves(seed, first)
        return old.replaced(at, self._states_at(numbers, moves, carried.factors, carried.cap, old.numbers, at))

    def _states_at(
        self,
        numbers: mi.UInt32,
        moves: Mapping[str, Move],
        factors: BrightnessMap,
        cap: float,
        kept: Mapping[str, mi.Float],
        at: mi.UInt32 | None,
    ) -> ChainStates:
        """States at the independent samples ``numbers``. Their random numbers are written to the arrays ``kept`` of all
        chains, for the chains ``at`` or for all."""
        traced = self.trace(moves, numbers, None)
        target = self.value(traced.contributions, factors, cap)
        dr.eval(traced.contributions, target)
        written = {
            name: moves[name].write(layout, kept[name], None, numbers, self.chains, at)
            for name, layout in self.target.layouts.items()
        }
        return ChainStates(written, traced.contributions, target, dr.zeros(mi.UInt32, dr.width(numbers)))

    @staticmethod
    def value(contributions: Sequence[Contribution], factors: BrightnessMap, cap: float) -> mi.Float:
        """The target of paths."""
        result = mi.Float(0.0)
        for one in contributions:
            result = result + brightness(one.value) * factors.at(one.position)
        return dr.minimum(result, dr.opaque(mi.Float, cap))

    # ------------------------------------------------------------------ steps

    def run(self, carried: Progressed, steps: int, seed: int, splats: Splats | None) -> tuple[Progressed, PassResult]:
        """``steps`` steps of all chains. ``splats``: :data:`IMAGES` empty images, or that many for each component;
        ``None`` if only :attr:`record` is wanted."""
        owed = carried.owed + carried.share * steps
        large_steps = min(int(owed + 1e-9), steps)
        carried = replace(carried, owed=owed - large_steps)
        # The weights are exact for the share of this pass, and only on average for that of all passes.
        walk = Walk(self, carried, splats, large_steps / steps, dr.zeros(mi.Float, self.chains))
        for index in range(steps):
            walk.step(seed, (index + 1) * large_steps // steps > index * large_steps // steps)
        return walk.finish(steps, seed)


def bootstrap_within(paths: int, equalise: bool) -> int:
    """The largest :attr:`Chains.bootstrap` with which the bootstrap, together with what tells the factors by film
    position, has no more than ``paths`` samples where enough of them find light; but two at least."""
    batches = paths // _BATCH
    if batches < 1 + equalise:
        paths //= 1 + equalise
        return max(2, paths - paths % 2)
    return (batches - (-(-batches // 5) if equalise else 0)) * _BATCH


def _drawn_numbers(targets: Array, counts: Sequence[int], seed: int, purpose: str, step: int) -> mi.UInt32:
    """Numbers of samples (:func:`numbers_of`), ``counts`` of each half, drawn in proportion to their targets, (halves,
    samples)."""
    chosen = [
        drawn(row, count, _offset(seed, purpose, index, step)) + (index << HALF_BIT)
        for index, (row, count) in enumerate(zip(targets, counts, strict=True))
        if count
    ]
    return copied_to_device(mi.UInt32, np.concatenate(chosen).astype(np.uint32))


def _offset(seed: int, purpose: str, half: int, step: int) -> float:
    """A random number in [0, 1)."""
    return float((seed_key(seed, f"{purpose} {half}", step)[0] + 0.5) / 2.0**32)


def _on_host(contributions: Sequence[Contribution]) -> NDArray[np.float32]:
    """(x y luminance, contributions, samples)."""
    found = [(one.position.x, one.position.y, brightness(one.value)) for one in contributions]
    dr.eval(found)
    return np.array([[np.array(row[i]) for row in found] for i in range(3)], np.float32)
