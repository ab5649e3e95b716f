"""Rules for bandwidths, and bias and variance: closed forms, sums over all pairs, scipy, repeated runs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from etendue.density import (
    KERNELS,
    AdaptiveKernel,
    DensityError,
    FixedKernel,
    Histogram,
    NearestNeighbours,
    Samples,
    VariableKernel,
    best_bandwidth,
    by_bootstrap,
    by_expansion,
    by_quadrature,
    by_repetition,
    cross_validation,
    normal_reference,
    silverman,
)

#: Of the standard normal density on a line and in the plane, the integral of the squared Laplacian.
CURVATURE = {1: 3 / (8 * math.sqrt(math.pi)), 2: 1 / (2 * math.pi)}


def normal(x):
    x = np.asarray(x)
    if x.ndim == 1:
        return np.exp(-0.5 * x**2) / math.sqrt(2 * math.pi)
    return np.exp(-0.5 * np.sum(x**2, axis=-1)) / (2 * math.pi)


def draw(dimension, n):
    return lambda random: random.normal(size=n if dimension == 1 else (n, 2))


@pytest.mark.parametrize("dimension", [1, 2])
def test_the_normal_reference_is_best_for_a_normal_density(dimension):
    samples = draw(dimension, 50_000)(np.random.default_rng(1))
    for kernel in KERNELS:
        best = best_bandwidth(kernel, CURVATURE[dimension], 50_000, dimension)
        assert normal_reference(samples, kernel) == pytest.approx(best, rel=0.01)


def test_silverman_by_hand():
    samples = np.arange(1.0, 10.0) ** 2
    low, high = np.interp((0.25, 0.75), (np.arange(9) + 0.5) / 9, samples)
    assert silverman(samples) == pytest.approx(0.9 * min(samples.std(ddof=1), (high - low) / 1.34) * 9**-0.2)
    doubled = Samples(np.repeat(samples, 2), np.tile([1.0, 0.0], 9))
    assert silverman(doubled) == pytest.approx(silverman(samples), rel=0.05)


def test_it_is_as_scipy_has_it():
    stats = pytest.importorskip("scipy.stats")
    samples, x = np.random.default_rng(2).normal(size=(500, 2)), np.random.default_rng(3).normal(size=(50, 2))
    weights = np.random.default_rng(4).uniform(size=500)
    theirs = stats.gaussian_kde(samples.T, bw_method=0.3, weights=weights)
    # scipy's kernel has the covariance of the samples; here it is round.
    root = np.linalg.cholesky(theirs.covariance / 0.3**2)
    white = Samples(np.linalg.solve(root, samples.T).T, weights)
    mine = FixedKernel(white, 0.3)(np.linalg.solve(root, x.T).T) / np.linalg.det(root)
    assert mine == pytest.approx(theirs(x.T), rel=1e-3, abs=1e-5)
    line = stats.gaussian_kde(samples[:, 0], bw_method="scott")
    h = math.sqrt(line.covariance[0, 0])
    assert FixedKernel(samples[:, 0], h)(x[:, 0]) == pytest.approx(line(x[:, 0]), rel=1e-3)
    assert normal_reference(samples[:, 0]) == pytest.approx(h * (4 / 3) ** 0.2)


@pytest.mark.parametrize("dimension", [1, 2])
def test_cross_validation_scores_are_sums_over_all_pairs(dimension):
    random = np.random.default_rng(5)
    samples = np.concatenate([random.normal(-2, 0.5, (150, dimension)), random.normal(2, 0.5, (150, dimension))])
    squared = np.sum((samples[:, None] - samples[None]) ** 2, axis=-1)
    best, tried, scores = cross_validation(samples[:, 0] if dimension == 1 else samples)
    assert len(tried) == len(scores) > 20

    def gauss(width):
        return np.exp(-0.5 * squared / width**2) / (2 * math.pi * width**2) ** (dimension / 2)

    expected = []
    for h in tried:
        others = (np.sum(gauss(h)) - np.trace(gauss(h))) / (300 * 299)
        expected.append(np.mean(gauss(math.sqrt(2) * h)) - 2 * others)
    assert scores == pytest.approx(expected, rel=1e-2, abs=2e-3 * np.ptp(expected))
    assert best == tried[np.argmin(scores)]
    # Two peaks: far narrower than the rule for one.
    assert best < 0.6 * normal_reference(samples[:, 0] if dimension == 1 else samples)


def test_cross_validation_is_near_the_best_and_translates():
    samples = draw(1, 20_000)(np.random.default_rng(6))
    h, *_ = cross_validation(samples)
    assert h == pytest.approx(best_bandwidth("gaussian", CURVATURE[1], 20_000), rel=0.35)
    assert cross_validation(samples, "cosine")[0] / h == pytest.approx(
        KERNELS["cosine"].canonical_bandwidth(1) / KERNELS["gaussian"].canonical_bandwidth(1)
    )
    assert cross_validation(samples, bandwidths=[0.1, 0.2, 0.9])[0] in (0.1, 0.2)


@pytest.mark.parametrize("dimension", [1, 2])
def test_the_expansion_is_the_limit_of_the_quadrature(dimension):
    x = np.linspace(-2, 2, 9) if dimension == 1 else np.stack([np.linspace(-2, 2, 9), np.zeros(9)], axis=1)
    r2 = x**2 if dimension == 1 else np.sum(x**2, axis=1)
    laplacian = normal(x) * (r2 - dimension)
    for kernel in ("epanechnikov", "gaussian", "cosine"):
        h = 0.02
        short = by_expansion(normal(x), laplacian, kernel, h, 1e4, dimension)
        exact = by_quadrature(normal, x, kernel, h, 1e4)
        cut_off = 1e-6 if kernel == "gaussian" else 1e-8
        assert short.bias == pytest.approx(exact.bias, rel=0.01, abs=cut_off)
        assert short.variance == pytest.approx(exact.variance, rel=0.12)  # h^d f, which is left out


def test_the_smoothed_normal_density_is_normal():
    x, h = np.linspace(-3, 3, 13), 0.7
    width = math.sqrt(1 + h * h)
    exact = by_quadrature(normal, x, "gaussian", h, 100)
    assert exact.mean == pytest.approx(normal(x / width) / width, rel=1e-5)
    assert exact.runs == 0 and (exact.bias_error == 0).all()


@pytest.mark.parametrize("dimension", [1, 2])
def test_repeated_runs_agree_with_the_formula(dimension):
    x = np.linspace(-2, 2, 17) if dimension == 1 else np.stack([np.linspace(-2, 2, 17), np.full(17, 0.3)], axis=1)
    formula = by_quadrature(normal, x, "biweight", 0.8, 500)
    runs = by_repetition(lambda s: FixedKernel(s, 0.8, "biweight"), draw(dimension, 500), normal, x, 200, seed=3)
    z = (runs.mean - formula.mean) / np.sqrt(formula.variance / 200)
    assert np.abs(z).max() < 4
    # A variance of 200 runs scatters by a tenth; the mean of 17, which are correlated, by less.
    assert np.mean(runs.variance / formula.variance) == pytest.approx(1, abs=0.15)
    bias, variance, total = runs.integrated(0.25)
    expected = formula.integrated(0.25)
    assert (bias, variance, total) == pytest.approx(expected, rel=0.25)
    assert total == pytest.approx(bias + variance)


def test_a_wider_kernel_has_more_bias_and_less_variance():
    x = np.linspace(-3, 3, 61)
    found = [by_quadrature(normal, x, "gaussian", h, 1000).integrated(0.1) for h in (0.1, 0.27, 0.8)]
    assert found[0][0] < found[1][0] < found[2][0]
    assert found[0][1] > found[1][1] > found[2][1]
    assert found[1][2] < min(found[0][2], found[2][2])  # best_bandwidth: 0.266
    assert best_bandwidth("gaussian", CURVATURE[1], 1000) == pytest.approx(0.266, abs=0.001)


def test_the_bootstrap_has_the_variance_of_the_estimate():
    samples, x = draw(1, 800)(np.random.default_rng(7)), np.linspace(-1, 1, 9)
    again = by_bootstrap(lambda s: FixedKernel(s, 0.4, "biweight"), samples, x, 100)
    formula = by_quadrature(normal, x, "biweight", 0.4, 800)
    assert np.mean(again.variance / formula.variance) == pytest.approx(1, abs=0.2)
    assert np.abs(again.bias / again.bias_error).max() < 4  # of the estimate it knows nothing of smoothing
    known = by_bootstrap(lambda s: FixedKernel(s, 0.4, "biweight"), samples, x, 20, normal)
    assert known.truth == pytest.approx(normal(x))


def test_variable_kernels_are_better_in_the_dark_and_no_worse_at_the_peak():
    """A caustic on dim ground: two passes beat the histogram in the dark, and a fixed kernel of their mean width at the
    peak [Leeson 2001, sec. 5.7.2]."""
    wide, narrow, share = 1.0, 0.02, 0.5

    def density(x):
        g = [normal(x / s) / s**2 for s in (wide, narrow)]
        return (1 - share) * g[0] + share * g[1]

    def sample(random):
        width = np.where(random.random((1500, 1)) < share, narrow, wide)
        return random.normal(size=(1500, 2)) * width

    dark, peak = np.stack([np.linspace(-1, 1, 8), np.full(8, 0.8)], axis=1), np.zeros((1, 2))
    both = np.concatenate([dark, peak])
    widths = []

    def variable(samples):
        estimate = VariableKernel(samples, 40, 1.2, "epanechnikov")
        widths.append(estimate.bandwidths.mean())
        return estimate

    def rms(make):
        found = np.sqrt(by_repetition(make, sample, density, both, 12, seed=1).mse)
        return np.mean(found[:8]), found[8]

    two_pass = rms(variable)
    adaptive = rms(lambda s: AdaptiveKernel(s, 0.1, kernel="epanechnikov"))
    binned = rms(lambda s: Histogram(s, 60, [(-6, 6), (-6, 6)]))
    fixed = rms(lambda s: FixedKernel(s, np.mean(widths), "epanechnikov"))
    for dark_error, peak_error in (two_pass, adaptive):
        assert dark_error < 0.7 * binned[0]
        assert peak_error < 0.5 * fixed[1]


def test_what_has_no_bandwidth():
    for rule in (silverman, normal_reference, cross_validation):
        with pytest.raises(DensityError, match="coincide"):
            rule([1.0, 1.0])
        with pytest.raises(DensityError, match="one sample"):
            rule([1.0])
        with pytest.raises(DensityError, match="not on surfaces"):
            rule(np.zeros((4, 3)))
    with pytest.raises(DensityError, match="too small for the extent"):
        cross_validation([0.0, 1.0, 1e6], bandwidths=[0.1])
    with pytest.raises(DensityError, match="above zero"):
        cross_validation([0.0, 1.0], bandwidths=[0.0])
    with pytest.raises(DensityError, match="at least 2, not 1"):
        by_bootstrap(lambda s: NearestNeighbours(s, 1), [0.0], np.zeros(1), 1)
