"""Rejection sampling: independent points, distributed as the target, however they are proposed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from etendue.integration import HostBackend, Integrand, IntegrationError, ProductDensity, Rejection, array_namespace

BOX = [(0, 1), (0, 2)]
TARGET = Integrand(lambda x: array_namespace(x[0]).exp(-3.0 * x[0]) * x[1], BOX)
INTEGRAL = (1 - math.exp(-3)) / 3 * 2  # of the target


def near():
    """A density like the target in its first parameter."""
    table = ProductDensity.tabulated(Integrand(lambda x: np.exp(-3.0 * x[0]), [(0, 1)]), 16)
    return ProductDensity(BOX, [[0]], table.factors)


SAMPLERS = {
    "bound given": (Rejection(bound=4.0), INTEGRAL / 4),
    "bound found": (Rejection(), INTEGRAL / 4),
    "density": (Rejection(near()), None),
}


@pytest.mark.parametrize("on", ["host", "device"])
@pytest.mark.parametrize("name", sorted(SAMPLERS))
def test_the_histogram_is_the_target(name, on):
    """Chi-square of 5 x 5 cells, neither too large nor too small; acceptance is the integral over the bound."""
    sampler, share = SAMPLERS[name]
    found = sampler.sample(Integrand(TARGET.function, BOX, on=on), 20_000, seed=3)
    x, y = found.points
    assert found.points.shape == (2, 20_000) and (x >= 0).all() and (x <= 1).all() and (y <= 2).all()
    cell = (x * 5).astype(int).clip(max=4) * 5 + (y * 2.5).astype(int).clip(max=4)
    edge = np.linspace(0, 1, 6)
    expected = np.outer(np.diff(np.exp(-3 * edge)) / (math.exp(-3) - 1), np.diff(edge**2)).ravel()
    statistic = ((np.bincount(cell, minlength=25) - 20_000 * expected) ** 2 / (20_000 * expected)).sum()
    assert 1e-5 < stats.chi2.sf(statistic, 24) < 1 - 1e-5, f"{name}: {statistic:.1f} for 24 degrees of freedom"
    # Neighbours in the sequence are independent.
    assert abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 4 / math.sqrt(20_000)
    integral = found.acceptance * found.bound
    assert integral == pytest.approx(INTEGRAL, rel=4 * math.sqrt((1 - found.acceptance) / 20_000) + 1e-9)
    if share is not None:
        assert found.acceptance == pytest.approx(share, rel=0.03)
    else:
        assert found.acceptance > 1.5 * INTEGRAL / 4


@pytest.mark.slow
def test_a_bound_that_grows_judges_all_points_alike(monkeypatch):
    """A narrow peak is found late, after many points were accepted: the result is that of the final bound."""
    monkeypatch.setattr(HostBackend, "batch", 64)
    width, height = 2e-3, 20.0
    f = Integrand(lambda x: np.where(np.abs(x[0] - 0.5) < width / 2, height, 1.0), 1)
    inside = 0
    for seed in range(8):
        found, given = (Rejection(bound=b).sample(f, 4000, seed) for b in (None, height))
        np.testing.assert_array_equal(found.points, given.points)
        assert (found.bound, found.acceptance, found.tried) == (height, given.acceptance, given.tried)
        inside += int((np.abs(found.points[0] - 0.5) < width / 2).sum())
    mass = width * height / (1 - width + width * height)
    assert inside == pytest.approx(8 * 4000 * mass, rel=4 / math.sqrt(8 * 4000 * mass))


def test_the_bound_of_the_range_is_used():
    found = Rejection().sample(Integrand(lambda x: x[0], [(0, 2)], range=(0, 4)), 1000)
    assert found.bound == 8.0 and found.acceptance == pytest.approx(0.25, rel=0.12)


def test_what_is_refused():
    f = Integrand(lambda x: x[0], [(0, 2)])
    with pytest.raises(IntegrationError, match=r"reaches .*, above the bound 1: raise the bound"):
        Rejection(bound=1.0).sample(f, 100)
    with pytest.raises(IntegrationError, match="negative"):
        Rejection().sample(f - 1.0, 100)
    with pytest.raises(IntegrationError, match="0 of 1000 points were accepted"):
        Rejection(tries=10).sample(f * 0.0, 100)
    with pytest.raises(IntegrationError, match="bound of a rejection sampler"):
        Rejection(bound=math.inf)
    with pytest.raises(IntegrationError, match="the density is on"):
        Rejection(near()).sample(f, 10)


def test_values_that_are_not_finite_are_never_accepted():
    f = Integrand(lambda x: np.where(x[0] < 0.5, np.nan, 1.0), 1)
    found = Rejection().sample(f, 1000, seed=1)
    assert found.points.min() >= 0.5 and found.rejected > 0
