"""Metropolis-Hastings: points distributed as any non-negative function, which need not be normalised.

From x a proposal x' is accepted with ``min(1, f(x') A(x' -> x) / (f(x) A(x -> x')))``, else x is **repeated**
[Metropolis 1953; Hastings 1970]. Chains run side by side, one in each lane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from etendue.core import Array, logger

from .backend import Backend, Mask, Numbers, Points
from .chains import ChainDiagnosis, burn_in, diagnose
from .errors import IntegrationError
from .estimate import Work
from .functions import Box, Integrand

#: Points tried per chain to find one where the target is not zero, and number of attempts.
_TRIES = 64


class Proposal(Protocol):
    """A proposal distribution of a chain in the unit cube."""

    def numbers(self, dimension: int) -> int:
        """Number of random numbers per step."""
        ...

    def propose(self, backend: Backend, x: list[Numbers], u: Points) -> tuple[list[Numbers], Numbers]:
        """The point proposed from ``x`` by numbers ``u``, and ``A(x' -> x) / A(x -> x')``. The chain rejects points
        outside the cube."""
        ...


@dataclass(frozen=True)
class UniformStep:
    """``x' = x + (2u - 1) size`` in every coordinate, ``size`` in sides of the domain: symmetric."""

    size: float = 0.1

    def numbers(self, dimension: int) -> int:
        """See :class:`Proposal`."""
        return dimension

    def propose(self, backend: Backend, x: list[Numbers], u: Points) -> tuple[list[Numbers], Numbers]:
        """See :class:`Proposal`."""
        return [v + (2.0 * n - 1.0) * self.size for v, n in zip(x, u, strict=True)], 1.0


@dataclass(frozen=True)
class Independent:
    """Uniform in the domain, independent of the state: a large step, which can leave any peak."""

    def numbers(self, dimension: int) -> int:
        """See :class:`Proposal`."""
        return dimension

    def propose(self, backend: Backend, x: list[Numbers], u: Points) -> tuple[list[Numbers], Numbers]:
        """See :class:`Proposal`."""
        return [n + 0.0 for n in u], 1.0


@dataclass(frozen=True)
class ScaledStep:
    """``x' = x exp((2u - 1) size)``: steps proportional to the distance from the lower ends, for peaks there. Not
    symmetric: ``A(x' -> x) / A(x -> x')`` is the product of x'/x."""

    size: float = 0.5

    def numbers(self, dimension: int) -> int:
        """See :class:`Proposal`."""
        return dimension

    def propose(self, backend: Backend, x: list[Numbers], u: Points) -> tuple[list[Numbers], Numbers]:
        """See :class:`Proposal`."""
        ratio: Numbers | float = 1.0
        moved = []
        for v, n in zip(x, u, strict=True):
            factor = backend.exp((2.0 * n - 1.0) * self.size)
            moved.append(v * factor)
            ratio = ratio * factor
        return moved, ratio


@dataclass(frozen=True)
class Mixture:
    """``second`` with probability ``share``, else ``first``, such as small steps with an occasional large one."""

    first: Proposal
    second: Proposal
    share: float = 0.1

    def numbers(self, dimension: int) -> int:
        """See :class:`Proposal`."""
        return 1 + max(self.first.numbers(dimension), self.second.numbers(dimension))

    def propose(self, backend: Backend, x: list[Numbers], u: Points) -> tuple[list[Numbers], Numbers]:
        """See :class:`Proposal`."""
        d = len(x)
        a, ratio_a = self.first.propose(backend, x, list(u[1 : 1 + self.first.numbers(d)]))
        b, ratio_b = self.second.propose(backend, x, list(u[1 : 1 + self.second.numbers(d)]))
        large = u[0] < self.share
        return [backend.where(large, q, p) for p, q in zip(a, b, strict=True)], backend.where(large, ratio_b, ratio_a)


@dataclass(frozen=True)
class Chains:
    """The states of chains.

    Attributes
    ----------
    domain: of the target.
    points: (d, chains, steps), repeats included.
    target: (chains, steps), the target at the points.
    acceptance: share of the proposals that were accepted.
    discarded: steps left out at the beginning.
    rejected: evaluations of the target that were not finite; taken as zero, so never accepted.
    """

    domain: Box
    points: Array
    target: Array
    acceptance: float
    discarded: int
    rejected: int

    def __len__(self) -> int:
        return int(self.target.size)

    @property
    def diagnosis(self) -> tuple[ChainDiagnosis, ...]:
        """Diagnosis of each coordinate."""
        return tuple(diagnose(x) for x in self.points)

    @property
    def effective_samples(self) -> float:
        """Number of effective samples of the worst coordinate."""
        return min(d.effective_samples for d in self.diagnosis)

    @property
    def r_hat(self) -> float:
        """Split R-hat of the worst coordinate."""
        return max(d.r_hat for d in self.diagnosis)

    def expectation(self, g: Integrand) -> ChainDiagnosis:
        """Mean of ``g`` under the normalised target, with its standard error and diagnosis. ``g`` takes host arrays."""
        if g.dimension != self.domain.dimension or g.on == "device":
            raise IntegrationError(f"the mean is of a function of {self.domain.dimension} parameters on the host")
        x = self.points.reshape(len(self.points), -1)
        return diagnose(np.broadcast_to(g.evaluate(x), x.shape[1:]).reshape(self.target.shape))


class Metropolis:
    """Samples points in proportion to a function.

    Parameters
    ----------
    proposal: by default small uniform steps, and one step in ten uniform in the domain.
    chains: number of parallel chains.
    burn_in: number of first steps to discard; ``None`` determines it by the MSER rule.
    """

    def __init__(self, proposal: Proposal | None = None, chains: int = 64, burn_in: int | None = None) -> None:
        if chains < 1 or (burn_in is not None and burn_in < 0):
            raise IntegrationError(f"chains ({chains}) must be 1 or more, burn_in ({burn_in}) not negative")
        self.proposal: Proposal = Mixture(UniformStep(0.2), Independent()) if proposal is None else proposal
        self.chains, self.burn_in = chains, burn_in

    def sample(self, target: Integrand, samples: int, seed: int = 0) -> Chains:
        """``samples`` states in all, burn-in and repeats included, of chains distributed as ``target``.

        Raises :class:`IntegrationError` if the target is negative somewhere, or zero at all tried starting points. A
        warning is given if the chains do not agree (split R-hat above 1.1).
        """
        steps = samples // self.chains
        kept = steps - (self.burn_in or 0)
        if kept < 4:
            raise IntegrationError(
                f"{samples} samples leave {self.chains} chains {kept} steps after burn-in: each needs 4"
            )
        work = Work(target, seed)
        x, f = self._begin(work)
        points, values = np.empty((work.dimension, self.chains, steps)), np.empty((self.chains, steps))
        accepted = lowest = 0.0
        for step in range(steps):
            x, f, moved, there = self._step(work, x, f)
            work.backend.compute(x, f, moved, there)
            for row, coordinate in zip(points, work.box.from_unit(x), strict=True):
                row[:, step] = work.backend.host(coordinate)
            values[:, step] = work.backend.host(f)
            accepted += float(work.backend.host(moved).sum())
            lowest = min(lowest, float(work.backend.host(there).min()))
        if lowest < 0:
            raise IntegrationError("the target of a chain is negative somewhere: it is no density")
        first = burn_in(values) if self.burn_in is None else self.burn_in
        rejected = work.backend.rejected()
        if rejected:
            logger.warning("%d values of the target were not finite; they count as zero", rejected)
        share = accepted / (steps * self.chains)
        chains = Chains(work.box, points[:, :, first:], values[:, first:], share, first, rejected)
        if chains.r_hat > 1.1:
            logger.warning("chains do not agree yet (split R-hat %.2f): more steps, or larger ones", chains.r_hat)
        return chains

    def _begin(self, work: Work) -> tuple[list[Numbers], Numbers]:
        """Initial states with a non-zero target, sampled from a few uniform points in proportion to the target."""
        backend = work.backend
        u = np.stack([backend.host(v) for v in backend.uniform(self.chains * _TRIES, work.dimension)])
        values = backend.host(work.values(backend.points(u)))
        if values.min() < 0:
            raise IntegrationError("the target of a chain is negative somewhere: it is no density")
        tries = values.reshape(self.chains, _TRIES)
        # A chain that finds no point above zero starts at the point of another chain.
        total = tries.sum(axis=1)
        found = np.flatnonzero(total > 0)
        if not len(found):
            raise IntegrationError(
                f"the target is zero at {tries.size} points of {work.box}: it cannot be normalised; narrow the domain"
            )
        reached = np.cumsum(tries, axis=1)
        threshold = backend.host(backend.uniform(self.chains, 1)[0]) * total
        chosen = np.minimum((reached <= threshold[:, None]).sum(axis=1), _TRIES - 1)
        row = np.arange(self.chains)
        place = row * _TRIES + chosen
        place = np.where(total > 0, place, place[found[row % len(found)]])
        return list(backend.points(u[:, place])), backend.points(values[None, place])[0]

    def _step(self, work: Work, x: list[Numbers], f: Numbers) -> tuple[list[Numbers], Numbers, Numbers, Numbers]:
        """One step of every chain: state, target there, 1 where the proposal was accepted, target of the proposal."""
        backend, need = work.backend, self.proposal.numbers(work.dimension)
        u = list(backend.uniform(self.chains, need + 1))
        moved, ratio = self.proposal.propose(backend, x, u[:need])
        inside: Mask = moved[0] >= 0.0
        for coordinate in moved:
            inside = inside & (coordinate >= 0.0) & (coordinate <= 1.0)
        # Outside the domain the target is not evaluated; the current state is used instead.
        at = [backend.where(inside, new, old) for new, old in zip(moved, x, strict=True)]
        there = work.values(at)
        accept = inside & (u[need] * f < there * ratio)
        x = [backend.where(accept, new, old) for new, old in zip(moved, x, strict=True)]
        return x, backend.where(accept, there, f), backend.where(accept, 1.0, backend.broadcast(0.0, x)), there
