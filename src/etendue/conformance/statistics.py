"""Chi-square test of sampled directions against a reported density, over cells adapted to the samples.

Mitsuba's ``mi.chi2.ChiSquareTest`` integrates the density over a fixed grid, which is too coarse for narrow lobes and
small lights, and it writes to the terminal and to files. Here, the first samples determine a balanced k-d tree over the
sphere, so that the density changes little within a leaf. It is integrated over each leaf by stratified points, whose
error enters the statistic. The other samples are counted. Cells with fewer than five expected samples are pooled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Samples per leaf of the tree, largest number of leaves, strata per side of a leaf, leaves in one cell of the test.
_PER_LEAF, _MOST_LEAVES, _STRATA, _LEAVES_PER_CELL = 4, 1024, 6, 16
#: Smallest number of samples for a test.
_LEAST = 256
_LEAST_EXPECTED = 5.0


@dataclass(frozen=True)
class DensityFit:
    """Agreement of samples with their reported density."""

    p_value: float  #: of the chi-square statistic; small if samples and density disagree
    deviation: float  #: RMS over the samples of the relative difference of the densities, without noise
    integral: float  #: of the density over the sphere
    integral_error: float  #: its standard error
    share: float  #: share of the calls of the sampler that returned a direction


def fit_density(
    directions: Array, draws: int, density: Callable[[Array], Array], rng: np.random.Generator
) -> DensityFit | None:
    """Compare directions, (n, 3), with their density: ``density`` takes (m, 3) and returns (m,).

    ``draws`` is the number of calls of the sampler: the difference to ``n`` are rejected or delta samples, which the
    density does not include either. Returns ``None`` for too few directions.
    """
    directions = rng.permutation(directions.astype(np.float64))
    leaves = min(_MOST_LEAVES, 1 << max(0, int(math.log2(max(len(directions), 1) / (2 * _PER_LEAF)))))
    built = leaves * _PER_LEAF
    if len(directions) < _LEAST:
        return None
    frame = _frame(directions[:built].mean(0))
    tree = _Tree(_to_plane(directions[:built] @ frame.T), leaves)

    cells = max(leaves // _LEAVES_PER_CELL, 1)
    counted = directions[built:]
    observed = np.bincount(tree.leaf(_to_plane(counted @ frame.T)) * cells // leaves, minlength=cells)
    # The number of calls for the counted samples, which do not include those of the tree.
    rest = draws * len(counted) / len(directions)

    integral, variance = _integrate(tree, lambda points: density(_to_sphere(points) @ frame), rng)
    by_cell = integral.reshape(cells, -1).sum(1), variance.reshape(cells, -1).sum(1)
    expected, noise = rest * by_cell[0], rest**2 * by_cell[1]
    counts, expected, noise = _pool(observed.astype(np.float64), expected, noise)
    statistic = float(((counts - expected) ** 2 / np.maximum(expected + noise, 1e-30)).sum())
    freedom = len(counts)
    # The squared differences minus the variance of counts and integrals.
    excess = float((((counts - expected) ** 2 - expected - noise) / np.maximum(expected, 1.0)).sum())
    deviation = math.sqrt(max(excess, 0.0) / max(rest, 1.0))
    return DensityFit(
        p_value=chi_square_tail(statistic, freedom),
        deviation=deviation,
        integral=float(integral.sum()),
        integral_error=math.sqrt(float(variance.sum())),
        share=len(directions) / draws,
    )


def chi_square_tail(statistic: float, freedom: int) -> float:
    """Probability that a chi-square variable of that many degrees of freedom is at least ``statistic``."""
    import mitsuba as mi

    if not math.isfinite(statistic):
        return 0.0
    return max(0.0, 1.0 - float(mi.math_py.rlgamma(freedom / 2.0, statistic / 2.0)))


def _frame(towards: Array) -> Array:
    """Rows of an orthonormal frame whose first axis is ``towards``, where :func:`_to_plane` is least distorted."""
    length = np.linalg.norm(towards)
    x = towards / length if length > 1e-3 else np.array([1.0, 0.0, 0.0])
    z = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])


def _to_plane(d: Array) -> Array:
    """(n, 2) height and azimuth of unit vectors: an equal-area map of the sphere."""
    return np.stack([np.clip(d[:, 2], -1.0, 1.0), np.arctan2(d[:, 1], d[:, 0])], -1)


def _to_sphere(p: Array) -> Array:
    radius = np.sqrt(np.maximum(1.0 - p[..., 0] ** 2, 0.0))
    return np.stack([radius * np.cos(p[..., 1]), radius * np.sin(p[..., 1]), p[..., 0]], -1)


class _Tree:
    """Halves the rectangle [-1, 1] x [-pi, pi] recursively at the median of the samples, along the wider side."""

    def __init__(self, points: Array, leaves: int) -> None:
        groups = points.reshape(1, -1, 2)
        self.lower, self.upper = np.array([[-1.0, -math.pi]]), np.array([[1.0, math.pi]])
        self._levels: list[tuple[NDArray[np.int64], Array]] = []
        while len(groups) < leaves:
            axis = np.argmax(np.ptp(groups, axis=1), axis=1).astype(np.int64)
            key = np.take_along_axis(groups, axis[:, None, None], axis=2)[..., 0]
            groups = np.take_along_axis(groups, np.argsort(key, axis=1)[..., None], axis=1)
            half = groups.shape[1] // 2
            row = np.arange(len(groups))
            cut = 0.5 * (groups[row, half - 1, axis] + groups[row, half, axis])
            lower, upper = np.repeat(self.lower, 2, axis=0), np.repeat(self.upper, 2, axis=0)
            upper[2 * row, axis], lower[2 * row + 1, axis] = cut, cut
            self.lower, self.upper = lower, upper
            self._levels.append((axis, cut))
            groups = groups.reshape(2 * len(groups), half, 2)
        #: Centre and half extent of the samples of each leaf, which may be much smaller than the leaf.
        low, high = groups.min(1), groups.max(1)
        self.middle, self.scale = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-7)

    def leaf(self, points: Array) -> NDArray[np.int64]:
        """Number of the leaf that holds each point."""
        node = np.zeros(len(points), np.int64)
        row = np.arange(len(points))
        for axis, cut in self._levels:
            node = 2 * node + (points[row, axis[node]] > cut[node])
        return node


def _integrate(tree: _Tree, density: Callable[[Array], Array], rng: np.random.Generator) -> tuple[Array, Array]:
    """Integral of the density over each leaf, and the variance of that estimate from pairs of neighbouring strata.

    Points are sampled around the leaf's samples with a Cauchy density in each coordinate, truncated at the leaf's
    sides.
    """
    leaves = len(tree.lower)
    grid = np.stack(np.meshgrid(np.arange(_STRATA), np.arange(_STRATA), indexing="ij"), -1).reshape(1, -1, 2)
    u = (grid + rng.random((leaves, _STRATA**2, 2))) / _STRATA
    middle, scale = tree.middle[:, None, :], tree.scale[:, None, :]
    first, last = (np.arctan((side[:, None, :] - middle) / scale) for side in (tree.lower, tree.upper))
    slope = np.tan(first + u * (last - first))
    points = np.clip(middle + scale * slope, tree.lower[:, None, :], tree.upper[:, None, :])
    inverse = np.prod((last - first) * scale * (1.0 + slope**2), axis=2)
    value = density(points.reshape(-1, 2)).reshape(leaves, -1) * inverse
    pairs = np.diff(value.reshape(leaves, -1, 2), axis=2)[..., 0]
    return value.mean(1), (pairs**2).sum(1) / value.shape[1] ** 2


def _pool(observed: Array, expected: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Merge the cells with the smallest expectation until each expects enough samples."""
    order = np.argsort(expected)
    reached = np.cumsum(expected[order])
    small = int(np.searchsorted(np.maximum.accumulate(expected[order]), _LEAST_EXPECTED))
    if small:
        while small < len(order) and reached[small - 1] < _LEAST_EXPECTED:
            small += 1
        order_small, order_rest = order[:small], order[small:]
        return tuple(  # type: ignore[return-value]
            np.concatenate([[values[order_small].sum()], values[order_rest]]) for values in (observed, expected, noise)
        )
    return observed, expected, noise
