r"""The picture of chains and that of an independent estimator as one.

Chains determine how light is distributed on the film, not how much there is. Each pass also has a picture P of an
independent, unbiased estimator, which determines the scale and is part of the result. With the pictures of pass i, C of
the chains without their scale, L of the large steps as independent samples, and a weight a for each pixel, the picture
of n passes is

.. math:: S_n = s_n D_n + R_n + B_n, \quad
   D_n = \sum_i (1 - a_i) C_i, \; R_n = \sum_i (1 - a_i) L_i, \; B_n = \sum_i a_i P_i,

divided by n, where the scale s_n makes the brightness of the picture that of the independent estimator,

.. math:: s_n = \frac{\Phi(\sum_i P_i) - \Phi(R_n) - \Phi(B_n)}{\Phi(D_n)}

with a weighted mean luminance Phi. A pass adds the difference of S_n and S_{n-1} to the sum of the run. Chains and
independent samples each have two independent halves; everything here is done for each half by itself, so that the
difference of the halves measures the error, including that of the scale.

The weights of a pass are those of least variance, a = v_C / (v_C + v_P), with variances estimated from earlier passes.
The chains of a half are in two groups, whose difference measures v_C. Each half is weighted by the variances of the
other half: a chain continues where it was, so weights a by its own past would be small where it has not found the
light, and the picture would lose this light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, Array, State, seed_key
from etendue.film import LUMINANCE
from etendue.scene import is_spectral

from ..base import ImageMethod

if TYPE_CHECKING:
    from .states import PassResult

#: Side of a cell in which variances are measured, in pixels, and the weight of the independent estimator before they
#: are known.
_CELL, _FIRST = 24, 0.5
#: Least and largest weight, so that both always contribute.
_LEAST, _MOST = 0.02, 0.98
Pictures = NDArray[np.floating[Any]]
#: The arrays of :class:`Blend`.
_ARRAYS = ("chained", "large", "contrast", "spread", "kept", "scatter")


@dataclass(frozen=True)
class Scale:
    """The scale of the chains of each half, and the sums that it is computed from.

    ``sums``: (halves, 3), brightness of D, of R + B and of the sum of P. ``scale``: (halves,). ``told``: number of the
    pictures P of all halves and passes, and sums of their mean luminance and of its square.
    """

    sums: Array
    scale: Array
    told: Array

    @classmethod
    def unknown(cls) -> Scale:
        """Before the first pass."""
        return cls(np.zeros((2, 3)), np.zeros(2), np.zeros(3))

    def after(self, brightness: Array, luminance: Array, otherwise: Array) -> Scale:
        """The scale with a further pass: ``brightness`` as ``sums``; ``luminance`` of P, (halves,). ``otherwise``: the
        scale of each half by the large steps, used where the sum of P is not brighter than R + B."""
        sums = self.sums + brightness
        rest = sums[:, 2] - sums[:, 1]
        known = (rest > 0.0) & (sums[:, 0] > 0.0)
        scale = np.where(known, rest / np.where(sums[:, 0] > 0.0, sums[:, 0], 1.0), otherwise)
        told = np.array([len(luminance), luminance.sum(), np.square(luminance).sum()])
        return Scale(sums, scale, self.told + told)

    def luminance(self) -> tuple[float, float]:
        """Mean luminance of the picture, and its standard error; NaN before the first pass."""
        count, total, squares = self.told
        if not count:
            return np.nan, np.nan
        mean = total / count
        return float(mean), float(np.sqrt(max(squares / count - mean * mean, 0.0) / (count - 1.0)))


class Grid:
    """Cells of a picture; values are interpolated linearly between their centres."""

    def __init__(self, width: int, height: int) -> None:
        self._columns, self._rows = _tents(width), _tents(height)
        self._area = np.outer(self._rows.sum(0), self._columns.sum(0))

    def means(self, values: Pictures) -> Array:
        """Means of (height, width) values around the centres of the cells."""
        result: Array = self._rows.T @ values @ self._columns / self._area
        return result

    def spread(self, cells: Array) -> Array:
        """(height, width) values interpolated between the cells."""
        result: Array = self._rows @ cells @ self._columns.T
        return result


def _tents(pixels: int) -> Array:
    """Shares of the cells in each pixel along an axis, (pixels, cells)."""
    count = max(1, round(pixels / _CELL))
    place = np.clip((np.arange(pixels) + 0.5) * (count / pixels) - 0.5, 0.0, count - 1.0)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(count)))


def luminance(pictures: Pictures) -> Array:
    """Luminance of (..., 3) linear RGB."""
    result: Array = np.asarray(pictures, np.float64) @ np.array(LUMINANCE)
    return result


def brightness(pictures: Pictures, factors: Array) -> Array:
    """Mean over the pixels of luminance times ``factors``, (height, width), of each of some pictures."""
    result: Array = np.tensordot(luminance(pictures), factors, 2) / factors.size
    return result


@dataclass(frozen=True)
class Blend:
    """The sums that are carried from pass to pass; arrays are replaced, never modified.

    ``chained``: D of each part and half, (parts, 2, height, width, 3); a picture is the sum of its parts, which are the
    components of light, or one. ``large``: R of each half. ``contrast``: half differences of the luminance of D and R
    between the groups of each half, (2, 2, height, width). ``spread``: sum over the passes of half the squared
    difference of the luminance of P between the halves, (height, width): the variance of a half. ``kept``, ``scatter``:
    sums of 1 - a, and of its square over the steps of the pass, (2, height, width).
    """

    scale: Scale
    chained: NDArray[np.float32]
    large: NDArray[np.float32]
    contrast: NDArray[np.float32]
    spread: NDArray[np.float32]
    kept: NDArray[np.float32]
    scatter: NDArray[np.float32]
    passes: int = 0

    @classmethod
    def empty(cls, width: int, height: int, parts: int = 1) -> Blend:
        """Before the first pass."""
        halves = np.zeros((parts, 2, height, width, 3), np.float32)
        one = np.zeros((2, 2, height, width), np.float32)
        return cls(Scale.unknown(), halves, halves[0], one, one[0, 0], one[0], one[0])

    @classmethod
    def of(cls, state: State) -> Blend:
        """The inverse of :meth:`left`."""
        scale = {name: np.asarray(values, np.float64) for name, values in state.get("scale", {}).items()}
        arrays = {name: np.asarray(state.get(name, ()), np.float32) for name in _ARRAYS}
        return cls(Scale(**scale) if scale else Scale.unknown(), **arrays, passes=int(state.get("passes", 0)))

    def left(self) -> State:
        """As a state."""
        return vars(self) | {"scale": dict(vars(self.scale))}

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the arrays."""
        return [getattr(self, name).shape for name in _ARRAYS]

    def variances(self, grid: Grid) -> tuple[Array, Array]:
        """Relative variance around each cell, of each half: of the chains' picture after one step, and of P after one
        pass."""
        chained, paths = [], []
        for half, scale in enumerate(self.scale.scale):
            picture = luminance(scale * self.chained[:, half].sum(axis=0) + self.large[half])
            inverse = 1.0 / (np.square(picture / self.kept[half]) + RELATIVE_EPSILON)
            difference = scale * self.contrast[0, half] + self.contrast[1, half]
            # A sum over passes of 1 - a times a picture, whose variance is that of one step over the number of steps.
            chained.append(grid.means(np.square(difference) / self.scatter[half] * inverse))
            paths.append(grid.means(self.spread / self.passes * inverse))
        return np.array(chained), np.array(paths)

    def weights(self, grid: Grid, steps: int) -> Array:
        """a of each half in the next pass, of ``steps`` steps; (2, height, width)."""
        if self.passes == 0:
            return np.full(self.kept.shape, _FIRST)
        by_chains, by_paths = (cells[::-1] for cells in self.variances(grid))  # those of the other half
        by_chains = by_chains / steps
        total = by_chains + by_paths
        cells = np.where(total > 0.0, by_chains / np.where(total > 0.0, total, 1.0), _FIRST)
        return np.stack([grid.spread(np.clip(one, _LEAST, _MOST)) for one in cells])

    def after(
        self, made: PassResult, independent: Pictures, weights: Array, factors: Array, steps: int
    ) -> tuple[Blend, Array]:
        """(the sums after a pass of chains and the picture P, the contribution of the pass to the picture). Pictures
        are (parts, 2, height, width, 3); ``factors``: of the brightness."""
        assert made.chained is not None and made.large is not None and made.contrast is not None
        keep = 1.0 - weights
        kept = keep[:, :, :, None]
        chained, large, blended = kept * made.chained, kept * made.large, weights[:, :, :, None] * independent
        wholes = (chained.sum(axis=0), (large + blended).sum(axis=0), independent.sum(axis=0))
        sums = np.stack([brightness(p, factors) for p in wholes], axis=1)
        lit = luminance(wholes[2])
        scale = self.scale.after(sums, lit.mean(axis=(1, 2)), made.factors)
        new, old = (v[:, None, None, None] for v in (scale.scale, self.scale.scale))
        added = new * chained + (new - old) * self.chained + large + blended
        return replace(
            self,
            scale=scale,
            chained=(self.chained + chained).astype(np.float32),
            large=(self.large + large.sum(axis=0)).astype(np.float32),
            contrast=(self.contrast + keep * made.contrast).astype(np.float32),
            spread=(self.spread + 0.5 * np.square(lit[0] - lit[1])).astype(np.float32),
            kept=(self.kept + keep).astype(np.float32),
            scatter=(self.scatter + np.square(keep) / steps).astype(np.float32),
            passes=self.passes + 1,
        ), added


class Beside:
    """A prepared independent estimator beside the chains, with passes of its own for each half. ``parts``: layers of
    its pictures.

    Under a spectral variant a pass has the tint w of its wavelengths, 1 in the mean over passes. A multiple of the tint
    is subtracted, P_i - M_i (w_i - 1), with the ratio M_i of all P and all w so far: nothing is left of it in white
    light, and of the bias of such a ratio ever less with more passes.
    """

    def __init__(self, method: ImageMethod, parts: Sequence[str]) -> None:
        self.method, self._parts = method, parts

    def start(self) -> list[State]:
        """The state of each half."""
        return [{"own": self.method.start(), "pictures": 0.0, "tints": 0.0}] * 2

    def step(
        self, iteration: int, seed: int, states: list[State]
    ) -> tuple[NDArray[np.float64], list[State], Mapping[str, float]]:
        """(pictures of a pass, (parts, 2, height, width, 3), states after it, counts)."""
        pictures: list[Array] = []
        left: list[State] = []
        counters = {"rays": 0.0, "nonfinite": 0.0}
        for half, state in enumerate(states):
            high, low = seed_key(seed, "beside", half)
            made = self.method.step(iteration, (high << 32 | low) & 0x7FFFFFFFFFFFFFFF, state["own"])
            picture = np.array([made.measurement.mean(name) for name in self._parts], np.float64)
            after: dict[str, Any] = {"own": made.state, "pictures": 0.0, "tints": 0.0}
            if is_spectral():
                tint = self.method.packet.white
                picture *= tint  # the mean is over the tint of the pass
                after["pictures"], after["tints"] = state["pictures"] + picture, state["tints"] + tint
                picture -= after["pictures"] / after["tints"] * (tint - 1.0)
            pictures.append(picture)
            left.append(after)
            counters = {name: count + made.measurement.counters[name] for name, count in counters.items()}
        return np.stack(pictures, axis=1), left, counters
