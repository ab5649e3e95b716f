"""Errors of density estimates: bias, variance and mean squared error, by formula and by repetition.

``MSE = bias^2 + variance``: a wide kernel has bias, a narrow one variance [Silverman 1986, ch. 3; Leeson 2001,
sec. 3.5]. Formulas are for kernel estimators with one bandwidth; repetition works for any estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, is_whole

from .errors import DensityError
from .estimator import Estimator, positive
from .kernels import Kernel, kernel_of
from .samples import Points, Samples

#: A known density: takes positions, (m,) or (m, 2), returns the density there, (m,).
Known = Callable[[Array], ArrayLike]


@dataclass(frozen=True)
class Diagnosis:
    """Errors of an estimator at points.

    Attributes
    ----------
    truth, mean, variance: (m,), the density, the expected estimate and its variance.
    runs: number of estimates behind ``mean`` and ``variance``; 0 for formulas.
    """

    truth: Array
    mean: Array
    variance: Array
    runs: int = 0

    @property
    def bias(self) -> Array:
        """Expected estimate minus density."""
        return self.mean - self.truth

    @property
    def bias_error(self) -> Array:
        """Standard error of :attr:`bias`; zero if it is by formula."""
        return np.sqrt(self.variance / self.runs) if self.runs else np.zeros_like(self.variance)

    @property
    def squared_bias(self) -> Array:
        """Corrected for the contribution of the variance; may be negative by chance."""
        return self.bias**2 - self.bias_error**2

    @property
    def mse(self) -> Array:
        """Mean squared error: :attr:`squared_bias` plus ``variance``."""
        return self.squared_bias + self.variance

    def integrated(self, volume: ArrayLike) -> tuple[float, float, float]:
        """Integrals of squared bias, variance and mean squared error.

        volume: the volume that each point represents, (m,), or one number.
        """
        share = np.asarray(volume, dtype=np.float64)
        parts = [float(np.sum(values * share)) for values in (self.squared_bias, self.variance)]
        return parts[0], parts[1], sum(parts)


def by_expansion(
    density: ArrayLike, laplacian: ArrayLike, kernel: Kernel | str, bandwidth: float, count: float, dimension: int = 1
) -> Diagnosis:
    """Errors for small bandwidths: bias ``h^2 m / 2`` times the Laplacian, variance ``f R / (n h^d)``.

    density, laplacian: (m,), at the points. count: number of samples of equal weight (``Samples.effective``). The
    kernel's ``second_moment`` is m, its ``roughness`` R [Silverman 1986, sec. 3.3.1 and 4.3].
    """
    shape, h, n = kernel_of(kernel), positive("the bandwidth", bandwidth), positive("the number of samples", count)
    f = np.atleast_1d(np.asarray(density, dtype=np.float64))
    bias = 0.5 * h * h * shape.second_moment(dimension) * np.atleast_1d(np.asarray(laplacian, dtype=np.float64))
    return Diagnosis(f, f + bias, f * shape.roughness(dimension) / (n * h**dimension))


def by_quadrature(density: Known, x: Array, kernel: Kernel | str, bandwidth: float, count: float) -> Diagnosis:
    """Errors for any bandwidth, integrated over the density around each point; without borders.

    The mean is the density smoothed by the kernel; the variance is that of the kernel at a random sample, divided by
    ``count``. x: (m,) or (m, 2).
    """
    points = np.asarray(x, dtype=np.float64)
    dimension = 1 if points.ndim == 1 else 2
    shape, h, n = kernel_of(kernel), positive("the bandwidth", bandwidth), positive("the number of samples", count)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    radius, weights = 0.5 * shape.reach * (nodes + 1), 0.5 * shape.reach * weights
    if dimension == 1:
        directions = np.array([-1.0, 1.0])
    else:
        angle = (np.arange(64) + 0.5) * (2 * np.pi / 64)
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        weights = weights * radius * (2 * np.pi / 64)
    value = shape.value(radius, dimension)
    mean, square = np.zeros(len(points)), np.zeros(len(points))
    for r, weight, k in zip(radius, weights, value, strict=True):
        around = sum(np.asarray(density(points + h * r * direction), dtype=np.float64) for direction in directions)
        mean += weight * k * around
        square += weight * k * k * around / h**dimension
    return Diagnosis(np.asarray(density(points), dtype=np.float64), mean, np.maximum(square - mean**2, 0.0) / n)


def best_bandwidth(kernel: Kernel | str, curvature: float, count: float, dimension: int = 1) -> float:
    """The bandwidth of least integrated error by the expansion: ``(d R / (n m^2 C))^(1 / (d + 4))``.

    curvature: C, the integral of the squared Laplacian of the density [Silverman 1986, eq. 3.21 and 4.13].
    """
    shape, n = kernel_of(kernel), positive("the number of samples", count)
    c = positive("the integral of the squared Laplacian", curvature)
    ratio = dimension * shape.roughness(dimension) / (n * shape.second_moment(dimension) ** 2 * c)
    return float(ratio ** (1 / (dimension + 4)))


def by_repetition(
    make: Callable[[Samples | Points], Estimator],
    draw: Callable[[np.random.Generator], Samples | Points],
    density: Known,
    x: Array,
    runs: int,
    seed: int = 0,
) -> Diagnosis:
    """Errors of an estimator from ``runs`` independent sets of samples of a known density.

    make: returns the estimator of a set of samples, such as ``lambda samples: FixedKernel(samples, 0.1)``. draw:
    returns a set of samples from a random generator. x: the points, (m,) or (m, 2).
    """
    random = _generators(runs, seed)
    return _scatter((make(draw(generator))(x) for generator in random), np.asarray(density(x)), runs)


def by_bootstrap(
    make: Callable[[Samples | Points], Estimator],
    samples: Samples | Points,
    x: Array,
    runs: int,
    density: Known | None = None,
    seed: int = 0,
) -> Diagnosis:
    """Variance of an estimator from ``runs`` sets resampled from the samples with replacement.

    The mean over these sets is near the estimate from all samples, not near its expectation. Without a known
    ``density`` the truth is this estimate, so the bias does not include smoothing; with a known density, the bias is
    the error of this estimate.
    """
    checked = Samples.of(samples)
    truth = make(checked)(x) if density is None else np.asarray(density(x))
    drawn = (make(checked.chosen(r.integers(len(checked), size=len(checked)))) for r in _generators(runs, seed))
    return _scatter((estimator(x) for estimator in drawn), truth, runs)


def _generators(runs: int, seed: int) -> list[np.random.Generator]:
    if not is_whole(runs) or runs < 2:
        raise DensityError(f"a variance needs a whole number of runs, at least 2, not {runs!r}")
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(int(runs))]


def _scatter(estimates: Iterable[Array], truth: Array, runs: int) -> Diagnosis:
    values = np.array(list(estimates), dtype=np.float64)
    return Diagnosis(np.asarray(truth, dtype=np.float64), values.mean(axis=0), values.var(axis=0, ddof=1), runs)
