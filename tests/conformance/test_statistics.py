"""The chi-square test itself: right densities pass, however narrow; wrong ones are found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from etendue.conformance import fit_density
from etendue.conformance.statistics import chi_square_tail

N = 32768
AXIS = np.array([0.48, -0.6, 0.64])


def lobe(concentration: float, rng: np.random.Generator, count: int = N) -> np.ndarray:
    """Directions of a von Mises-Fisher density around ``AXIS``."""
    u = rng.random(count)
    cos = 1.0 + np.log(u + (1.0 - u) * np.exp(-2.0 * concentration)) / concentration
    phi, sin = rng.random(count) * 2 * np.pi, np.sqrt(np.maximum(1.0 - cos**2, 0.0))
    x = np.cross(AXIS, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return (sin * np.cos(phi))[:, None] * x + (sin * np.sin(phi))[:, None] * np.cross(AXIS, x) + cos[:, None] * AXIS


def lobe_pdf(concentration: float, d: np.ndarray) -> np.ndarray:
    # 1 - cos from the distance: a cosine near 1 has no digits left.
    away = 0.5 * ((d - AXIS) ** 2).sum(1)
    return concentration / (2 * np.pi * (1.0 - np.exp(-2.0 * concentration))) * np.exp(-concentration * away)


@pytest.mark.parametrize("concentration", [0.01, 3.0, 100.0, 1e4, 1e7])
def test_a_right_density_passes(concentration):
    rng = np.random.default_rng(1)
    fit = fit_density(lobe(concentration, rng), N, lambda d: lobe_pdf(concentration, d), rng)
    assert fit.p_value > 1e-3
    assert abs(fit.integral - 1.0) < 5 * fit.integral_error + 1e-6
    assert fit.integral_error < 0.01
    assert fit.share == 1.0


def test_p_values_are_uniform_or_above():
    """Over many seeds: the statistic may be conservative, never the other way."""
    values = []
    for seed in range(60):
        rng = np.random.default_rng([7, seed])
        values.append(fit_density(lobe(30.0, rng, 8192), 8192, lambda d: lobe_pdf(30.0, d), rng).p_value)
    assert stats.kstest(values, "uniform", alternative="greater").pvalue > 1e-3
    assert min(values) < 0.3


@pytest.mark.parametrize("factor", [1.1, 0.9])
def test_a_density_that_is_scaled_is_found(factor):
    rng = np.random.default_rng(2)
    fit = fit_density(lobe(50.0, rng), N, lambda d: factor * lobe_pdf(50.0, d), rng)
    assert fit.p_value < 1e-6
    assert abs(fit.integral - factor) < 5 * fit.integral_error
    assert abs(fit.deviation - 0.1) < 0.03


def test_a_lobe_of_another_width_is_found():
    rng = np.random.default_rng(3)
    fit = fit_density(lobe(1000.0, rng), N, lambda d: lobe_pdf(1150.0, d), rng)
    assert fit.p_value < 1e-6


def test_draws_that_were_given_up_are_counted():
    """A sampler that rejects a half, and a density that says so; and one that does not."""
    rng = np.random.default_rng(4)
    d = lobe(2.0, rng)
    upper = d[d[:, 2] > 0]
    honest = fit_density(upper, N, lambda d: lobe_pdf(2.0, d) * (d[:, 2] > 0), rng)
    assert honest.p_value > 1e-3
    assert honest.share == pytest.approx(honest.integral, abs=0.01)
    share = len(upper) / N
    assert fit_density(upper, N, lambda d: lobe_pdf(2.0, d) * (d[:, 2] > 0) / share, rng).p_value < 1e-6


def test_too_few_directions_say_nothing():
    rng = np.random.default_rng(5)
    assert fit_density(lobe(2.0, rng, 100), 100, lambda d: lobe_pdf(2.0, d), rng) is None


@pytest.mark.parametrize(("statistic", "freedom"), [(3.0, 5), (64.0, 64), (140.0, 64)])
def test_the_tail_of_chi_square(statistic, freedom):
    assert chi_square_tail(statistic, freedom) == pytest.approx(stats.chi2.sf(statistic, freedom), rel=1e-4)
    assert chi_square_tail(float("nan"), freedom) == 0.0
