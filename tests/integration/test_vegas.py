"""The VEGAS-derived integrator: bins that move, densities that integrate to 1, and what they are good for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from support.integrals import assert_honest, assert_unbiased, runs, spread, two_peaks
from support.tables import crossed, thinned

from etendue.integration import (
    AxisBins,
    Box,
    CellGrid,
    HostBackend,
    Importance,
    Integrand,
    MeanSample,
    PlaneBins,
    ProductDensity,
    Vegas,
    array_namespace,
    combine,
    damp,
    rebin,
    smooth,
)

SINE = Integrand(lambda x: array_namespace(x[0]).sin(x[0]), [(0, math.pi)])
GROUPS = {
    "axes": [[0], [1], [2]],
    "plane and axis": [[0, 2], [1]],
    "cells": [[0, 1, 2]],
    "one of three": [[1]],
}


def bell(x):
    return array_namespace(x[0]).exp(-20.0 * sum((v - 0.3) * (v - 0.3) for v in x))


def learned(groups, mode="importance", domain=3):
    f = Integrand(bell, domain)
    return Vegas(groups, mode, iterations=5, warm_up=4).integrate(f, 40_000, seed=1).details["density"]


# Bins -----------------------------------------------------------------------------------------------------------------


def test_rebinning_keeps_ends_and_order_and_shares_the_values():
    random = np.random.default_rng(0)
    for _ in range(50):
        edges = np.concatenate([[2.0], np.sort(random.uniform(2, 5, 9)), [5.0]])
        values = random.exponential(size=10) * (random.random(10) > 0.2)
        moved = rebin(edges, values)
        assert moved[0] == 2.0 and moved[-1] == 5.0 and (np.diff(moved) >= 0).all()
        reached = np.interp(moved, edges, np.concatenate([[0], np.cumsum(values)]))
        assert np.diff(reached) == pytest.approx(np.full(10, values.sum() / 10), abs=1e-9)


def test_rebinning_as_the_loop_of_the_source():
    """Fig. 5.18, repaired: walk through the bins, and place a border wherever an average bin's worth is full."""
    edges, d = np.array([0.0, 1.0, 3.0, 4.0, 8.0]), np.array([4.0, 1.0, 0.5, 2.5])
    average, s, j, borders = d.sum() / 4, 0.0, -1, [0.0]
    for _ in range(3):
        while s < average:
            j += 1
            s += d[j]
        s -= average
        borders.append(edges[j + 1] - s / d[j] * (edges[j + 1] - edges[j]))
    assert rebin(edges, d) == pytest.approx([*borders, 8.0])


def test_rebinning_nothing_moves_nothing():
    edges = np.array([0.0, 0.3, 1.0])
    assert rebin(edges, np.zeros(2)) == pytest.approx(edges)
    assert rebin(edges, np.array([1e-310, 1e-310])) == pytest.approx(edges)
    assert rebin(np.stack([edges, edges]), np.array([[1.0, 1.0], [0.0, 0.0]])).shape == (2, 3)


def test_smoothing_and_damping():
    assert smooth(np.array([0.0, 8.0, 0.0, 16.0])) == pytest.approx([1.0, 6.0, 3.0, 14.0])
    assert smooth(np.array([5.0])) == pytest.approx([5.0])
    d = np.array([0.7, 0.2, 0.1])
    assert damp(d, 1.5) == pytest.approx(((1 - d) / np.log(1 / d)) ** 1.5)
    assert damp(10 * d, 1.5) == pytest.approx(damp(d, 1.5))
    assert damp(np.array([0.0, 4.0]), 1.5) == pytest.approx([0.0, 1.0])
    assert damp(d, 0.0) == pytest.approx(np.ones(3))


# Densities ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["importance", "stratified"])
@pytest.mark.parametrize("name", sorted(GROUPS))
def test_a_learned_density_integrates_to_one(name, mode):
    density = learned(GROUPS[name], mode, [(0, 1), (-1, 1), (0, 2)])
    p = Integrand(lambda x: density.pdf(HostBackend(0), x), density.domain)
    found = runs(MeanSample(), p, 20_000, 20)
    assert_unbiased(found, 1.0, name)
    assert spread(found) < 0.05**2


@pytest.mark.parametrize("name", thinned(sorted(GROUPS), ("plane and axis",)))
def test_samples_of_a_learned_density_match_it(name):
    """Chi-square over 8^3 cells; the expected counts by the density's integral over each cell."""
    density = learned(GROUPS[name])
    x, p = density.draw(100_000, seed=3)
    assert density.pdf(HostBackend(0), x) == pytest.approx(p, rel=1e-9)
    fine = 64
    grid = (np.arange(fine) + 0.5) / fine
    # Cells of eight points in each axis: the density is stepwise, so many points give its integral nearly.
    random = np.random.default_rng(1)
    axes = np.stack([a.ravel() for a in np.meshgrid(grid, grid, grid, indexing="ij")])
    jittered = axes + (random.random(axes.shape) - 0.5) / fine
    mass = density.pdf(HostBackend(0), jittered).reshape(8, 8, 8, 8, 8, 8).mean(axis=(1, 3, 5)) / 8**3
    number = np.ravel_multi_index(tuple((x * 8).astype(int)), (8, 8, 8))
    counts = np.bincount(number, minlength=512)
    expected = mass.ravel() * 100_000
    enough = expected > 50
    # The expectation is known to a per cent or so: its own variance is part of the statistic.
    error = expected * (1 + expected * (0.03 / 8) ** 2)
    statistic = ((counts - expected) ** 2 / error)[enough].sum()
    assert stats.chi2.sf(statistic, enough.sum()) > 1e-5, statistic / enough.sum()
    assert expected[enough].sum() > 0.8 * 100_000


def test_each_bin_is_as_likely_as_its_share():
    random = np.random.default_rng(5)
    edges = np.concatenate([[0], np.sort(random.random(7)), [1]])
    inner = np.stack([np.concatenate([[0], np.sort(random.random(4)), [1]]) for _ in range(6)])
    factors = [
        AxisBins(edges),
        PlaneBins(np.concatenate([[0], np.sort(random.random(5)), [1]]), inner),
        CellGrid(random.exponential(size=(3, 3, 3))),
    ]
    for on in ("host", "device"):
        for factor in factors:
            from etendue.integration import DeviceBackend

            backend = HostBackend(1) if on == "host" else DeviceBackend(1)
            x, weight, place = factor.warp(backend, list(backend.uniform(50_000, factor.dimension)))
            counts = np.bincount(np.array(place, dtype=int), minlength=factor.bins)
            expected = np.broadcast_to(factor.shares, factor.bins) * 50_000
            assert stats.chi2.sf(((counts - expected) ** 2 / expected).sum(), factor.bins - 1) > 1e-5
            # In its bin, the point is where the density says it is, and is not elsewhere.
            p = backend.host(factor.pdf(backend, x))
            assert np.median(np.abs(p * backend.host(weight) - 1)) < 1e-5
            assert np.mean(np.abs(p * backend.host(weight) - 1) > 1e-3) < 1e-3  # single precision at borders


def test_a_density_on_a_box_and_a_cell_that_was_never_hit():
    density = ProductDensity([(1, 3), (0, 1)], [[0]], [AxisBins(np.array([0.0, 0.1, 1.0]))])
    x, p = density.draw(10_000)
    assert (x[0] >= 1).all() and (x[0] <= 3).all()
    assert p[x[0] < 1.2] == pytest.approx(0.5 / 0.2) and p[x[0] > 1.2] == pytest.approx(0.5 / 1.8)
    grid = CellGrid.even(2, 3).adapted(np.array([1.0] + [0.0] * 7), False, None, 1.0)
    assert grid.probability.min() > 0.005 and grid.probability.sum() == pytest.approx(1)
    half = CellGrid.even(2, 3).adapted(np.array([1.0] + [0.0] * 7), False, None, 0.5)
    assert half.probability[0, 0, 0] == pytest.approx(0.5 * 0.125 + 0.5)
    assert CellGrid.even(2, 3).adapted(np.zeros(8), True, 1.0, 0.5).probability == pytest.approx(
        np.full((2, 2, 2), 0.125)
    )


def test_bins_of_the_second_parameter_follow_those_of_the_first():
    """Row 0 holds three times as much as row 1, so the border moves to 1/3: the new second row has a quarter of the old
    first one, and three quarters of the old second one."""
    a, b = np.array([0.0, 0.2, 1.0]), np.array([0.0, 0.6, 1.0])
    moved = PlaneBins(np.array([0.0, 0.5, 1.0]), np.stack([a, b])).adapted(
        np.array([3.0, 3.0, 1.0, 1.0]), False, None, 1.0
    )
    assert moved.edges == pytest.approx([0, 1 / 3, 1])
    assert moved.inner == pytest.approx(np.stack([a, 0.25 * a + 0.75 * b]))


@pytest.mark.parametrize("mode", ["importance", "stratified"])
def test_cells_take_the_share_that_they_contribute(mode):
    """From any grid, the probabilities become those of the root mean square of f in a cell, or of its deviation."""
    random = np.random.default_rng(3)
    start = CellGrid(random.uniform(0.5, 2.0, (2, 2, 2)))
    height, ripple = random.uniform(0.5, 2.0, (2, 2, 2)), random.uniform(0.5, 2.0, (2, 2, 2))

    def f(x):
        cell = tuple((v * 2).astype(int) for v in x)
        return height[cell] + ripple[cell] * np.where((x[0] * 64).astype(int) % 2 == 0, 1.0, -1.0)

    density = ProductDensity(3, [[0, 1, 2]], [start])
    integrator = Vegas(mode=mode, iterations=1, strata=1, smoothing=False, inertia=1.0, density=density)
    found = integrator.integrate(Integrand(f, 3), 200_000).details["density"].factors[0].probability
    expected = np.sqrt(height**2 + ripple**2) if mode == "importance" else ripple
    assert found == pytest.approx(expected / expected.sum(), rel=0.02)


def test_a_plane_of_bins_learns_what_two_axes_cannot():
    """A diagonal ridge is no product of functions of one parameter."""
    ridge = Integrand(lambda x: array_namespace(x[0]).exp(-200.0 * (x[0] - x[1]) * (x[0] - x[1])), 2)
    axes, plane = (
        spread(runs(Vegas(g, iterations=6, warm_up=4, strata=1), ridge, 30_000, 30)) for g in ([[0], [1]], [[0, 1]])
    )
    assert plane < axes / 4


# The integrator -------------------------------------------------------------------------------------------------------


def true_variance(density):
    """N times the variance of the sine's estimate with the bins of ``density``, by quadrature."""
    edges = density.factors[0].edges * math.pi
    x = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(200) + 0.5) / 200
    w = np.sin(x) * np.diff(edges)[:, None] * (len(edges) - 1)
    return float((w**2).mean() - w.mean() ** 2)


def sine_demo(smoothing, damping, samples=1000, iterations=5, **options):
    """Variance with the bins that iteration 5 uses, averaged over seeds: the density that 4 have left."""
    integrator = Vegas(bins=10, strata=1, iterations=iterations - 1, smoothing=smoothing, damping=damping, **options)
    return np.mean(
        [
            true_variance(integrator.integrate(SINE, samples * (iterations - 1), seed=s).details["density"])
            for s in range(100)
        ]
    )


def test_the_demonstration_of_the_sine():
    """Check 5 of the framework's list: K = 10, iterations of 1000; uniform bins have N var = 0.935."""
    even = ProductDensity(SINE.domain, [[0]], [AxisBins.even(10)])
    assert true_variance(even) == pytest.approx(math.pi**2 / 2 - 4, abs=1e-3)
    raw, smoothed, damped, both = (
        sine_demo(*options) for options in ((False, None), (True, None), (False, 1.5), (True, 1.5))
    )
    assert both < 0.35 * 0.935
    result = Vegas(bins=10, strata=1, iterations=5, damping=1.5).integrate(SINE, 5000, seed=1)
    assert abs(result.value - 2.0) < 3 * result.standard_error < 0.1
    # The source's own figures, but for smoothing alone, which is by linear interpolation here and by thirds there.
    assert [raw, smoothed, damped, both] == pytest.approx([0.78, 0.49, 0.23, 0.23], abs=0.03)


def test_stabilised_bins_jump_less():
    """From iteration to iteration, raw bins move further than damped ones."""

    def jumps(damping):
        moved = []
        for seed in range(20):
            density = None
            for n in range(8):
                integrator = Vegas(bins=10, strata=1, iterations=1, smoothing=False, damping=damping, density=density)
                after = integrator.integrate(SINE, 300, seed=100 * seed + n).details["density"]
                if n > 3:
                    moved.append(np.abs(after.factors[0].edges - density.factors[0].edges).mean())
                density = after
        return np.mean(moved)

    assert jumps(None) > 1.5 * jumps(1.5)


def test_with_many_samples_switching_smoothing_off_helps():
    """Smoothing stalls near the optimum, which for the sine has a variance of 0.223."""

    def last(stabilise):
        integrator = Vegas(bins=10, strata=1, iterations=12, damping=None, stabilise=stabilise)
        return np.mean(
            [true_variance(integrator.integrate(SINE, 600_000, seed=s).details["density"]) for s in range(5)]
        )

    on, off = last(None), last(6)
    assert off < 0.95 * on and off == pytest.approx(0.223, abs=0.005)


@pytest.mark.parametrize(("mode", "strata"), crossed(["importance", "stratified"], [None, 1], 2))
@pytest.mark.parametrize("name", sorted(GROUPS))
def test_every_density_and_mode_is_unbiased_and_honest(name, mode, strata):
    f = Integrand(bell, 3)
    one = math.sqrt(math.pi / 20) / 2 * (math.erf(math.sqrt(20) * 0.3) + math.erf(math.sqrt(20) * 0.7))
    found = runs(Vegas(GROUPS[name], mode, iterations=5, warm_up=2, strata=strata), f, 20_000, 60)
    assert_unbiased(found, one**3, name)
    assert_honest(found, one**3, name)


@pytest.mark.parametrize("name", sorted(GROUPS))
def test_learning_lowers_the_variance(name):
    f = Integrand(bell, 3)
    plain = spread(runs(MeanSample(), f, 4000, 60))
    density = learned(GROUPS[name])
    assert spread(runs(Importance(density), f, 4000, 60)) < plain / (1.5 if name == "one of three" else 4)


def test_a_density_is_taken_up_again():
    f, _ = two_peaks(narrow=200.0)
    first = Vegas([[0, 1]], iterations=5, strata=1).integrate(f, 50_000, seed=1)
    again = Vegas(iterations=1, strata=1, density=first.details["density"]).integrate(f, 10_000, seed=2)
    assert again.standard_error < 0.5 * first.details["iterations"][0].standard_error


def test_iterations_that_disagree_are_averaged_and_reported(caplog):
    """Few samples miss a narrow peak, find it later, and their variances say nothing of it: the mean by inverse
    variances is far too small, the plain one unbiased."""
    f, integral = two_peaks(narrow=20_000.0)
    found = [e for e in runs(Vegas(iterations=10), f, 5000, 200) if e.details["chi2"] > 9 + 5 * math.sqrt(18)]
    assert len(found) > 20 and caplog.text.count("iterations disagree") == len(found)
    for estimate in found:
        values = [e.value for e in estimate.details["iterations"]]
        assert estimate.value == pytest.approx(np.mean(values))
        assert estimate.standard_error >= 0.999 * np.std(values, ddof=1) / math.sqrt(10)
        assert estimate.details["degrees"] == 9
    by_variance = [combine(e.details["iterations"]).value for e in found]
    assert np.mean(by_variance) < 0.5 * integral < np.mean([e.value for e in found])


def test_samples_used_and_iterations():
    result = Vegas(iterations=4, warm_up=1).integrate(Integrand(bell, 3), 10_000)
    iterations = result.details["iterations"]
    assert len(iterations) == 4 and result.samples == sum(e.samples for e in iterations) <= 10_000
    assert result.samples > 9000
    assert result.details["degrees"] == 2
    weights = [1 / e.variance for e in iterations[1:]]
    assert result.value == pytest.approx(np.average([e.value for e in iterations[1:]], weights=weights))


def test_a_density_of_another_domain_is_refused():
    from etendue.integration import IntegrationError

    density = learned(GROUPS["axes"])
    with pytest.raises(IntegrationError, match="the density is on"):
        Vegas(density=density).integrate(Integrand(bell, Box.of([(0, 2)] * 3)), 1000)
