"""The state of Markov chains over primary samples from pass to pass, how states are drawn, and a factor on their target
by which bright parts of the film get fewer samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, Array, on_device

from .targets import Contribution

#: Bit of the number of a sample or a chain that tells its half.
HALF_BIT = 31
#: Samples of the bootstrap in a cell of the map, and most cells along an axis.
_PER_CELL = 128
_MOST_CELLS = 64
#: Contributions are clipped to this many times the mean, so that one of them does not darken a cell.
_MOST_OVER_MEAN = 50.0


class BrightnessMap:
    """A factor on the target of the chains, by film position.

    A target in proportion to luminance gives bright pixels most samples, and dark ones relative errors that grow
    without limit. If the variance of a pixel of luminance L with n samples is in proportion to L^2 / n, the error
    measure ``mean(variance / (L^2 + 0.01))`` is the least with n in proportion to L / sqrt(L^2 + 0.01). The factor is
    therefore ``1 / sqrt(L^2 + 0.01)``, with L from a coarse picture, linear between its cells [Veach 1997, sec. 11.4;
    Hoberock 2010]. Any positive factor leaves the expectation of the picture unchanged.

    ``values``: (rows, columns), positive.
    """

    def __init__(self, values: NDArray[np.float32], size: tuple[int, int]) -> None:
        self.values, self._size = values, size
        self._device = on_device(mi.Float, np.ascontiguousarray(values).ravel())

    @classmethod
    def flat(cls, size: tuple[int, int]) -> BrightnessMap:
        """The factor 1."""
        return cls(np.ones((1, 1), np.float32), size)

    @classmethod
    def measured(cls, parts: Sequence[NDArray[np.float32]], size: tuple[int, int]) -> BrightnessMap:
        """The factor from contributions: each part is an array (3, contributions of a sample, samples) of x and y, in
        pixels, and luminance."""
        width, height = size
        samples = sum(part.shape[2] for part in parts)
        cells = max(1.0, min(samples / _PER_CELL, width * height / 4))
        columns = min(_MOST_CELLS, max(1, round(math.sqrt(cells * width / height))))
        rows = min(_MOST_CELLS, max(1, round(cells / columns)))
        mean = sum(part[2].sum(dtype=np.float64) for part in parts) / samples
        sums = np.zeros(rows * columns)
        for x, y, luminance in parts:
            column = np.clip(x.ravel() * (columns / width), 0, columns - 1).astype(np.int64)
            row = np.clip(y.ravel() * (rows / height), 0, rows - 1).astype(np.int64)
            kept = np.minimum(luminance.ravel(), _MOST_OVER_MEAN * mean)
            sums += np.bincount(row * columns + column, kept, rows * columns)
        found = np.asarray(sums * (rows * columns / samples), np.float64).reshape(rows, columns)
        return cls((1.0 / np.sqrt(_blurred(found) ** 2 + RELATIVE_EPSILON)).astype(np.float32), size)

    @cached_property
    def of_pixels(self) -> NDArray[np.float64]:
        """The factor at the centres of the pixels, (height, width)."""
        width, height = self._size
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        return self.on_host(x, y)

    def on_host(self, x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
        """The factor at film positions."""
        rows, columns = self.values.shape
        axes = zip((x, y), (columns, rows), self._size, strict=True)
        at = [np.clip(p * (n / size) - 0.5, 0.0, n - 1.0) for p, n, size in axes]
        low = [np.minimum(p.astype(np.int64), n - 1) for p, n in zip(at, (columns, rows), strict=True)]
        high = [np.minimum(p + 1, n - 1) for p, n in zip(low, (columns, rows), strict=True)]
        (tx, ty), values = (p - q for p, q in zip(at, low, strict=True)), self.values.astype(np.float64)
        above = values[low[1], low[0]] * (1.0 - tx) + values[low[1], high[0]] * tx
        below = values[high[1], low[0]] * (1.0 - tx) + values[high[1], high[0]] * tx
        result: NDArray[np.float64] = above * (1.0 - ty) + below * ty
        return result

    def at(self, position: mi.Point2f) -> mi.Float:
        """The factor at film positions."""
        rows, columns = self.values.shape
        if rows * columns == 1:
            return mi.Float(1.0)
        low, high, t = [], [], []
        for p, n, size in zip((position.x, position.y), (columns, rows), self._size, strict=True):
            p = dr.clip(p * (n / size) - 0.5, 0.0, n - 1.0)
            cell = dr.minimum(mi.UInt32(p), n - 1)
            low.append(cell)
            high.append(dr.minimum(cell + 1, n - 1))
            t.append(p - mi.Float(cell))

        def value(column: mi.UInt32, row: mi.UInt32) -> mi.Float:
            return dr.gather(mi.Float, self._device, row * columns + column)

        above = dr.lerp(value(low[0], low[1]), value(high[0], low[1]), t[0])
        below = dr.lerp(value(low[0], high[1]), value(high[0], high[1]), t[0])
        return dr.lerp(above, below, t[1])


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


def _blurred(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of 3 x 3 cells, the border repeated."""
    padded = np.pad(values, 1, mode="edge")
    rows, columns = values.shape
    shifted: Sequence[NDArray[np.float64]] = [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    result: NDArray[np.float64] = np.mean(shifted, axis=0)
    return result
