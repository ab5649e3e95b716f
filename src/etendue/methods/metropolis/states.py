"""The state of Markov chains over primary samples from pass to pass, and how states are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from .film import BrightnessMap
from .targets import Contribution

#: Bit of the number of a sample or a chain that tells its half.
HALF_BIT = 31


@dataclass(frozen=True)
class ChainStates:
    """The current paths, one lane a chain; replaced by every step, never modified."""

    numbers: dict[str, mi.Float]  #: by sub-path, row by row
    contributions: list[Contribution]
    target: mi.Float
    rejected: mi.UInt32  #: proposals rejected in a row

    def replaced(self, at: mi.UInt32, new: ChainStates) -> ChainStates:
        """A copy in which the chains ``at`` are ``new``, one lane each; ``new.numbers`` are those of all chains."""
        kept = [Contribution(mi.Point2f(c.position), mi.Color3f(c.value), c.component) for c in self.contributions]
        copy = ChainStates(new.numbers, kept, mi.Float(self.target), mi.UInt32(self.rejected))
        for mine, its in zip(kept, new.contributions, strict=True):
            dr.scatter(mine.position, its.position, at)
            dr.scatter(mine.value, its.value, at)
        dr.scatter(copy.target, new.target, at)
        dr.scatter(copy.rejected, new.rejected, at)
        dr.eval(copy.contributions, copy.target, copy.rejected)
        return copy


@dataclass(frozen=True)
class Progressed:
    """All that chains carry from pass to pass."""

    states: ChainStates
    factors: BrightnessMap
    unit: float  #: b_0
    cap: float
    #: For each half: samples of the bootstrap and of large steps, and the sums of the target and of its square.
    found: Array
    steps: int = 0  #: steps so far
    large: int = 0  #: independent samples of a half so far: of the bootstrap, and proposals of large steps
    longest: int = 0  #: most proposals that a chain has rejected in a row
    size: float = 1.0 / 64.0  #: of small steps
    share: float = 0.25  #: of large steps
    owed: float = 0.0  #: share of a large step that is left for later passes, because they make whole steps


@dataclass
class PassResult:
    """A pass of all chains.

    ``chained``, ``large``: pictures, (parts, 2, height, width, 3), of each component of light, or of all light, and of
    the two halves: of the chains without the factor kappa b / b_0, and of the large steps as independent samples.
    ``contrast``: half differences of the luminance of both between the groups of each half, (2, 2, height, width).
    ``None`` without splats. ``factors``: an estimate of that factor by the bootstrap and all large steps, of each half.
    """

    chained: NDArray[np.float64] | None
    large: NDArray[np.float64] | None
    contrast: NDArray[np.float64] | None
    counters: dict[str, float]
    factors: Array


def numbers_of(lanes: int) -> mi.UInt32:
    """The numbers of ``lanes`` chains or samples in sources, half of them in each half: the half in the upper bit, and
    the number in the half."""
    lane, half = dr.arange(mi.UInt32, lanes), dr.opaque(mi.UInt32, lanes // 2)
    second = lane >= half
    numbers = dr.select(second, (lane - half) + mi.UInt32(1 << HALF_BIT), lane)
    dr.eval(numbers)
    return numbers


def drawn(targets: Array, count: int, offset: float) -> NDArray[np.int64]:
    """``count`` indices in proportion to ``targets``, which are not all 0, in order: systematic sampling with an
    ``offset`` in [0, 1)."""
    reached = np.cumsum(targets, dtype=np.float64)
    place = np.searchsorted(reached, (np.arange(count) + offset) / count * reached[-1], side="right")
    return np.minimum(place, np.flatnonzero(targets)[-1])


def by_half(parts: Sequence[Array]) -> Array:
    """Values of the samples of some batches, (halves, samples)."""
    return np.concatenate([part.reshape(2, -1) for part in parts], axis=1)
