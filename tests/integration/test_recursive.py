"""Recursive stratified sampling: every option unbiased, and what each is for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.integrals import assert_honest, assert_unbiased, known, runs, spread, two_peaks
from support.tables import thinned

from etendue.integration import (
    Box,
    HostBackend,
    Integrand,
    IntegrationError,
    MeanSample,
    RecursiveStratified,
    array_namespace,
    warp_rows,
)

OPTIONS = {
    "default": {},
    "range": {"metric": "range"},
    "maximum": {"metric": "maximum"},
    "four parts": {"divisions": 4},
    "three parts, dithered": {"divisions": 3, "dither": 0.7},
    "bins of VEGAS": {"borders": "vegas"},
    "bins of VEGAS, four parts, range": {"borders": "vegas", "divisions": 4, "metric": "range"},
    "weights": {"weights": [2.0, 1.0]},
    "blind at first": {"initial_depth": 4},
    "blind and dithered": {"initial_depth": 2, "dither": 0.5},
    "much exploration": {"exploration": 0.3},
    "one level's exponent": {"exponent": 1.0},
    "small regions": {"minimum": 8},
    "few levels": {"depth": 3},
    "nearly all exploration": {"exploration": 0.9, "minimum": 8},
}


@pytest.mark.parametrize("name", thinned(sorted(OPTIONS), ["default", "weights", "nearly all exploration"]))
def test_every_option_is_unbiased_and_honest(name):
    f, integral = known("decay")
    found = runs(RecursiveStratified(**OPTIONS[name]), f, 3000, 120)
    assert_unbiased(found, integral, name)
    assert_honest(found, integral, name)
    assert all(e.samples == 3000 for e in found)


#: The other one spends nine tenths of each level on exploration, which no peak pays back.
FINDING = sorted(OPTIONS.keys() - {"nearly all exploration"})


@pytest.mark.parametrize("name", thinned(FINDING, FINDING[3:4]))
def test_two_narrow_peaks(name):
    """Check 7 of the framework's list: a fifth of the variance of plain Monte Carlo at 10^4 samples, or less. Options
    that waste samples here are only asked to win."""
    f, integral = two_peaks(narrow=500.0)
    found = runs(RecursiveStratified(**OPTIONS[name]), f, 10_000, 80)
    plain = MeanSample().integrate(f, 10_000).variance
    assert_unbiased(found, integral, name)
    weak = ("few levels", "weights", "blind at first", "blind and dithered", "much exploration")
    factor = 1.5 if name in weak else 5.0
    assert spread(found) * factor < plain, f"{name}: {plain / spread(found):.1f} times less variance"


@pytest.mark.slow
def test_reuse_of_exploration_is_biased_and_less_with_more_samples():
    f, integral = two_peaks(narrow=500.0)
    bias = []
    for samples, count in ((1000, 200), (16_000, 50)):
        values = np.array([e.value for e in runs(RecursiveStratified(reuse=True), f, samples, count)]) / integral - 1
        bias.append((abs(values.mean()), values.std(ddof=1) / math.sqrt(count)))
    (few, error), (many, _) = bias
    assert few > 5 * error and many < few / 2, bias


@pytest.mark.slow
def test_reuse_helps_few_samples():
    f, integral = known("decay")
    alone, reused = (runs(RecursiveStratified(reuse=r, exploration=0.4), f, 200, 400) for r in (False, True))
    rms = [math.sqrt(np.mean([(e.value - integral) ** 2 for e in found])) for found in (alone, reused)]
    assert rms[1] < rms[0]


def test_the_dimension_that_varies_is_divided():
    """Along a direction in which nothing varies, a division is wasted: weights can forbid or force it."""
    f = Integrand(lambda x: array_namespace(x[0]).exp(-3.0 * x[1]), 2)
    seeing, forbidden = (spread(runs(RecursiveStratified(weights=w), f, 2000, 60)) for w in ([1, 1], [1, 0]))
    assert seeing < forbidden / 20
    blind = {"initial_depth": 4, "minimum": 10**9}
    right, wrong = (spread(runs(RecursiveStratified(weights=w, **blind), f, 2000, 60)) for w in ([0, 1], [1, 0]))
    assert right < wrong / 50


def test_ties_are_broken_by_weights():
    """On a function that is constant, any dimension is as good: the heavier one is divided."""
    seen = []

    def f(x):
        seen.append(x)
        return x[0] * 0.0 + 2.0

    result = RecursiveStratified(weights=[1.0, 3.0, 2.0], depth=2, divisions=4).integrate(Integrand(f, 3), 4000)
    assert result.value == pytest.approx(2.0) and result.standard_error == 0.0
    # The leaves, the last batch, come region by region: 16 of them, all divided along dimension 1.
    leaves = seen[-1]
    order = (leaves[1] * 16).astype(int)
    assert (np.diff(order) >= 0).all() and len(set(order)) == 16
    assert np.ptp(leaves[0][order == 3]) > 0.9


def test_samples_go_where_the_function_varies():
    """sigma_1 = 10 sigma_2 in the halves: with N_i ~ sigma_i, ten elevenths of the samples go to the first."""
    f = Integrand(lambda x: np.where(x[0] < 0.5, 1.0, 0.1) * np.where(np.floor(x[1] * 64) % 2 > 0, 1.0, -1.0), 2)
    share = {}
    for exponent, expected in ((1.0, 10 / 11), (2.0, 10 ** (2 / 3) / (10 ** (2 / 3) + 1))):
        seen = []

        def counted(x, seen=seen):
            seen.append(x[0] < 0.5)
            return f.evaluate(x)

        method = RecursiveStratified(weights=[1, 0], depth=1, exponent=exponent)
        method.integrate(Integrand(counted, 2), 20_000)
        share[exponent] = seen[-1].mean()
        # A tenth of the samples is shared evenly, against what exploration has missed.
        assert share[exponent] == pytest.approx(0.9 * expected + 0.05, abs=0.02)


def test_dear_regions_get_fewer_samples():
    """N_i is divided by the root of the cost: at four times the cost, half the samples."""

    def place(cost):
        seen = []

        def f(x):
            seen.append(x[0] < 0.5)
            return np.where(np.floor(x[1] * 64) % 2 > 0, 1.0, -1.0)

        method = RecursiveStratified(weights=[1, 0], depth=1)
        result = method.integrate(Integrand(f, 2, cost=cost), 20_000)
        return seen[-1].mean(), result.details.get("cost")

    even, none = place(None)
    dear, total = place(lambda x: np.where(x[0] < 0.5, 4.0, 1.0))
    assert even == pytest.approx(0.5, abs=0.02) and none is None
    assert dear == pytest.approx(0.9 / 3 + 0.05, abs=0.02)
    assert total == pytest.approx(20_000 * (0.1 * 2.5 + 0.9 * (4 * dear + (1 - dear))), rel=0.02)


def test_dither_moves_borders_and_bins_of_vegas_go_to_the_variation():
    def first_border(**options):
        """Where [0, 1] is divided, from the leaves: those of the lower part come first."""
        seen = []

        def f(x):
            seen.append(x[0])
            return array_namespace(x[0]).exp(-400.0 * (x[0] - 0.2) * (x[0] - 0.2))

        RecursiveStratified(depth=1, **options).integrate(Integrand(f, 1), 4000)
        leaves = seen[-1]
        return max(leaves[:n].max() for n in range(1, len(leaves)) if leaves[:n].max() < leaves[n:].min())

    assert first_border() == pytest.approx(0.5, abs=0.02)
    assert 0.02 < abs(first_border(dither=0.8) - 0.5) < 0.2
    assert first_border(borders="vegas") < 0.35


def test_a_box_is_divided_as_the_cube_is():
    f, integral = known("plane")
    assert_unbiased(runs(RecursiveStratified(), f, 2000, 50), integral)
    assert f.domain == Box.of([(0, 1), (1, 3)])
    result = RecursiveStratified().integrate(f, 2000)
    assert result.details["regions"] > 20 and 3 <= result.details["depth"] <= 40


def test_few_samples_are_plain_monte_carlo():
    f, integral = known("decay")
    result = RecursiveStratified().integrate(f, 10)
    assert result.details["regions"] == 1 and result.samples == 10
    assert_unbiased(runs(RecursiveStratified(), f, 10, 300), integral)


def test_blind_levels_need_samples():
    f, _ = known("decay")
    assert RecursiveStratified(initial_depth=6).integrate(f, 2 * 2**6).details["regions"] == 64
    with pytest.raises(IntegrationError, match="at least 128"):
        RecursiveStratified(initial_depth=6).integrate(f, 127)


def test_host_and_device_divide_alike():
    f, integral = two_peaks(narrow=200.0)
    on_device, _ = two_peaks("device", 200.0)
    host, device = (runs(RecursiveStratified(), g, 5000, 40) for g in (f, on_device))
    assert_unbiased(device, integral)
    assert 0.5 < math.sqrt(spread(device) / spread(host)) < 2.0


def test_a_plan_is_the_regions_and_their_shares():
    """Boxes that fill the cube, more of the samples where the function varies, drawn with the density they say."""
    options = RecursiveStratified(minimum=64)
    plan = options.plan(Integrand(lambda x: np.where(x[0] < 0.25, np.sin(40 * x[1]), 0.1), 2), 20_000, seed=3)
    assert len(plan) > 50
    assert plan.volume.sum() == pytest.approx(1.0)
    assert plan.shares.sum() == pytest.approx(1.0)
    lively = plan.low[:, 0] < 0.25
    assert plan.shares[lively].sum() > 0.6
    backend = HostBackend(1)
    n = 1 << 16
    x, weight, place = warp_rows(backend, [plan, plan], backend.uniform(n, 2), np.arange(n) % 2)
    low, side = plan.low[place].T, plan.side[place].T
    assert ((np.stack(x) >= low) & (np.stack(x) <= low + side)).all()
    np.testing.assert_allclose(weight, plan.volume[place] / plan.shares[place])
    values = weight * (1 + x[0] * x[1] ** 2)
    assert values.mean() == pytest.approx(1 + 1 / 6, abs=4.5 * values.std() / n**0.5)
