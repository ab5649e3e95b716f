"""Markov chains: distributed as their target, whatever moves them, and honest about how much they are worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import signal, stats

from etendue.integration import (
    Independent,
    Integrand,
    IntegrationError,
    Metropolis,
    Mixture,
    ScaledStep,
    UniformStep,
    array_namespace,
    autocorrelation,
    autocorrelation_time,
    diagnose,
    split_r_hat,
)
from etendue.integration.chains import burn_in

TARGET = Integrand(lambda x: array_namespace(x[0]).exp(-3.0 * x[0]) * x[1], [(0, 1), (0, 2)])
PROPOSALS = {
    "steps": UniformStep(0.3),
    "independent": Independent(),
    "mixture": Mixture(UniformStep(0.2), Independent(), 0.2),
    "scaled": ScaledStep(1.0),
    "scaled or anywhere": Mixture(ScaledStep(0.5), Independent(), 0.3),
}


def cell_probabilities(cells):
    """Of the target, over cells x cells."""
    edge = np.linspace(0, 1, cells + 1)
    first = np.diff(np.exp(-3 * edge)) / (math.exp(-3) - 1)
    return np.outer(first, np.diff(edge**2))


@pytest.mark.parametrize("on", ["host", "device"])
@pytest.mark.parametrize("name", sorted(PROPOSALS))
def test_the_histogram_is_the_target(name, on):
    """Chi-square by chains, which are independent: the scatter between them is the variance, however they move."""
    f = TARGET if on == "host" else Integrand(TARGET.function, TARGET.domain, on="device")
    count, steps = 2000, 120
    chains = Metropolis(PROPOSALS[name], count, burn_in=40).sample(f, count * steps, seed=4)
    x, y = chains.points
    cell = (x * 5).astype(int).clip(max=4) * 5 + (y * 2.5).astype(int).clip(max=4)
    counts = np.stack([np.bincount(row, minlength=25) for row in cell]) / cell.shape[1]
    expected = cell_probabilities(5).ravel()
    difference = (counts.mean(axis=0) - expected)[:-1]
    covariance = np.cov(counts[:, :-1].T) / count
    statistic = difference @ np.linalg.solve(covariance, difference)
    assert stats.chi2.sf(statistic, 24) > 1e-5, f"{name}: {statistic:.1f} for 24 degrees of freedom"
    assert chains.points.shape == (2, count, 80) and len(chains) == count * 80


def test_the_histogram_with_the_effective_sample_size():
    """A single quantity: the counts of a histogram, scaled to what the chain is worth, pass a chi-square."""
    chains = Metropolis(UniformStep(0.4), 50).sample(TARGET, 200_000, seed=2)
    inside = (chains.points[0] * 10).astype(int).clip(max=9)
    expected = cell_probabilities(10).sum(axis=1)
    worth = [diagnose((inside == b).astype(float)).effective_samples for b in range(10)]
    found = np.array([(inside == b).mean() for b in range(10)])
    z = (found - expected) / np.sqrt(expected * (1 - expected) / worth)
    assert stats.chi2.sf((z**2).sum(), 10) > 1e-5, z
    assert (z**2).sum() > 0.5  # nor too good to be true


def test_expectations_and_their_errors():
    g = Integrand(lambda x: x[0] + x[1], TARGET.domain)
    truth = (1 / 9 * (1 - 4 * math.exp(-3))) / ((1 - math.exp(-3)) / 3) + 4 / 3
    z = []
    for seed in range(40):
        found = Metropolis(chains=40, burn_in=50).sample(TARGET, 20_000, seed).expectation(g)
        z.append((found.mean - truth) / found.standard_error)
    assert abs(np.mean(z)) < 4.5 / math.sqrt(40) * np.std(z) and 0.7 < np.std(z) < 1.4


def test_pi_by_a_walk_that_repeats_where_it_cannot_go():
    """Check 3 of the framework's list: with repeats, the share of the disc is pi / 4; drawing anew at the border until
    inside, as one might, favours the middle."""
    flat = Integrand(lambda x: x[0] * 0.0 + 1.0, [(-1, 1), (-1, 1)])
    disc = Integrand(lambda x: (x[0] ** 2 + x[1] ** 2 < 1) * 4.0, flat.domain)
    found = Metropolis(UniformStep(0.3), 400, burn_in=100).sample(flat, 400 * 600, seed=1).expectation(disc)
    assert abs(found.mean - math.pi) < 3 * found.standard_error and found.standard_error < 0.05
    random = np.random.default_rng(0)
    x = random.uniform(-1, 1, (2, 4000))
    inside = 0.0
    for step in range(300):
        moved = np.full_like(x, 2.0)
        while (outside := (np.abs(moved) > 1).any(axis=0)).any():
            moved[:, outside] = x[:, outside] + random.uniform(-0.6, 0.6, (2, outside.sum()))
        x = moved
        inside += (step >= 100) * ((x**2).sum(axis=0) < 1).mean() / 200
    assert 4 * inside > math.pi + 0.05


class _Slide:
    """The blank of a sliding puzzle of 3 x 3: to one of four neighbours with probability 1/4 each."""

    def numbers(self, dimension):
        return 1

    def propose(self, backend, x, u):
        direction = (u[0] * 4).astype(int)
        return [v + np.choose(direction, c) / 3 for v, c in zip(x, ([1, -1, 0, 0], [0, 0, 1, -1]), strict=True)], 1.0


def test_the_blank_of_a_sliding_puzzle():
    """Uniform over the cells, because corners stay with probability 1/2 and edges with 1/4. Check 3."""
    board = Integrand(lambda x: x[0] * 0.0 + 1.0, 2)
    chains = Metropolis(_Slide(), 500, burn_in=50).sample(board, 500 * 250, seed=1)
    cell = (chains.points[0] * 3).astype(int) * 3 + (chains.points[1] * 3).astype(int)
    share = np.stack([(cell == c).mean(axis=1) for c in range(9)])
    z = (share.mean(axis=1) - 1 / 9) / (share.std(axis=1, ddof=1) / math.sqrt(500))
    assert np.abs(z).max() < 4.5
    stays = [(cell[:, :-1] == cell[:, 1:])[cell[:, :-1] == c].mean() for c in range(9)]
    expected = np.array([2, 1, 2, 1, 0, 1, 2, 1, 2]) / 4
    assert stays == pytest.approx(expected, abs=0.02)


def test_asymmetric_proposals_without_their_ratio_would_be_wrong(monkeypatch):
    """The histogram test can fail."""
    honest = ScaledStep.propose
    monkeypatch.setattr(ScaledStep, "propose", lambda *a: (honest(*a)[0], 1.0))
    with pytest.raises(AssertionError, match="24 degrees of freedom"):
        test_the_histogram_is_the_target("scaled", "host")


def test_acceptance_and_repeats():
    chains = Metropolis(UniformStep(0.3), 100, burn_in=0).sample(TARGET, 20_000, seed=3)
    repeats = np.all(np.diff(chains.points, axis=2) == 0, axis=0).mean()
    assert 1 - repeats == pytest.approx(chains.acceptance, abs=0.01)
    assert chains.discarded == 0 and chains.rejected == 0
    assert chains.target == pytest.approx(TARGET.evaluate(chains.points), rel=1e-9)
    small, large = (Metropolis(UniformStep(s), 100).sample(TARGET, 20_000).acceptance for s in (0.01, 0.9))
    assert small > 0.9 > 0.6 > large


def test_a_seed_decides_the_chains():
    one, same, other = (Metropolis(chains=10).sample(TARGET, 1000, seed=s).points for s in (1, 1, 2))
    assert (one == same).all() and one.shape == other.shape[:2] + one.shape[2:] and one[0, 0, 0] != other[0, 0, 0]


# Diagnosis ------------------------------------------------------------------------------------------------------------


def autoregressive(rho, chains, steps, seed=0):
    """x' = rho x + noise, of unit variance: its integrated autocorrelation time is (1 + rho) / (1 - rho)."""
    noise = np.random.default_rng(seed).normal(size=(chains, steps + 200)) * math.sqrt(1 - rho * rho)
    return signal.lfilter([1.0], [1.0, -rho], noise, axis=1)[:, 200:]


@pytest.mark.parametrize("rho", [-0.4, 0.0, 0.5, 0.9, 0.97])
def test_the_autocorrelation_time_of_a_known_chain(rho):
    times = [autocorrelation_time(autoregressive(rho, 8, 8000, seed)) for seed in range(10)]
    assert np.mean(times) == pytest.approx((1 + rho) / (1 - rho), rel=0.06)
    assert autocorrelation(autoregressive(rho, 8, 8000))[:4] == pytest.approx(rho ** np.arange(4.0), abs=0.05)


def test_errors_of_a_known_chain_cover_the_mean():
    z = [(d := diagnose(autoregressive(0.9, 4, 2000, seed))).mean / d.standard_error for seed in range(200)]
    assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.06)
    d = diagnose(autoregressive(0.9, 4, 20_000))
    assert d.effective_samples == pytest.approx(80_000 / 19, rel=0.15)


@pytest.mark.slow
def test_the_autocorrelation_time_falls_with_the_square_of_the_step():
    """Check 12's law for a walk in a box: T ~ (L / eps)^2."""
    flat = Integrand(lambda x: x[0] * 0.0 + 1.0, 1)
    steps = np.array([0.05, 0.1, 0.2])
    times = [
        autocorrelation_time(Metropolis(UniformStep(s), 64, burn_in=0).sample(flat, 64 * 8000, seed=1).points[0])
        for s in steps
    ]
    slope = np.polyfit(np.log(steps), np.log(times), 1)[0]
    assert slope == pytest.approx(-2.0, abs=0.2)


def test_split_r_hat_sees_chains_that_do_not_agree_or_drift():
    together = autoregressive(0.5, 8, 1000)
    assert split_r_hat(together) == pytest.approx(1.0, abs=0.01)
    assert split_r_hat(together + np.arange(8)[:, None]) > 1.5
    assert split_r_hat(together + np.linspace(0, 4, 1000)) > 1.3  # a drift that whole chains would hide
    assert split_r_hat(np.ones((3, 10))) == 1.0
    assert math.isinf(split_r_hat(np.repeat([[0.0], [1.0]], 10, axis=1)))


def test_stuck_chains_are_reported(caplog):
    """Two peaks far apart, and steps too small to go from one to the other."""
    peaks = Integrand(lambda x: np.exp(-2e4 * (x[0] - 0.2) ** 2) + np.exp(-2e4 * (x[0] - 0.8) ** 2), 1)
    stuck = Metropolis(UniformStep(0.02), 16).sample(peaks, 16 * 500)
    assert stuck.r_hat > 1.5 and "chains do not agree yet" in caplog.text
    assert stuck.effective_samples < 100
    free = Metropolis(Mixture(UniformStep(0.02), Independent(), 0.5), 64, burn_in=100).sample(peaks, 64 * 2000)
    assert free.r_hat < 1.1


def test_burn_in_ends_where_a_drift_does():
    values = autoregressive(0.5, 16, 1000)
    values[:, :200] += np.linspace(10, 0, 200)
    assert 120 <= burn_in(values) <= 230
    assert burn_in(autoregressive(0.5, 16, 1000)) < 100
    # A chain that begins far out in a tail: found by itself.
    tail = Integrand(lambda x: np.exp(-50.0 * x[0]) * np.exp(-50.0 * x[1]), [(0, 20), (0, 20)])
    chains = Metropolis(UniformStep(0.005), 32).sample(tail, 32 * 2000, seed=1)
    assert chains.discarded > 20


def test_what_is_not_finite_is_never_entered(caplog):
    f = Integrand(lambda x: np.log(x[0]), [(-1, 3)])
    with np.errstate(invalid="ignore"):
        chains = Metropolis(Mixture(UniformStep(0.2), Independent()), 32).sample(
            Integrand(lambda x: np.maximum(f.evaluate(x), 0.0), f.domain), 32 * 200
        )
    assert chains.rejected > 0 and "were not finite" in caplog.text
    assert chains.points[0].min() >= 1.0


def test_a_target_that_is_negative_where_no_chain_begins(monkeypatch):
    def begin(self, work):
        middle = np.full(self.chains, 0.5)
        return [middle, middle], middle - 0.25

    monkeypatch.setattr(Metropolis, "_begin", begin)
    with pytest.raises(IntegrationError, match="negative somewhere"):
        Metropolis(proposal=UniformStep(0.3)).sample(Integrand(lambda x: x[0] - 0.25, 2), 10_000)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Metropolis(chains=0), "must be 1 or more"),
        (lambda: Metropolis(burn_in=-1), "not negative"),
        (lambda: Metropolis(chains=100).sample(TARGET, 300), "3 steps after burn-in: each needs 4"),
        (lambda: Metropolis(chains=10, burn_in=97).sample(TARGET, 1000), "3 steps after burn-in"),
        (lambda: Metropolis().sample(Integrand(lambda x: x[0] * 0.0, 2), 10_000), "zero at 4096 points .* normalised"),
        (lambda: Metropolis().sample(Integrand(lambda x: x[0] - 0.5, 2), 10_000), "negative somewhere"),
        (lambda: Metropolis().sample(Integrand(lambda x: x[0] * math.nan, 2), 10_000), "cannot be normalised"),
        (lambda: Metropolis().sample(TARGET, 10_000).expectation(Integrand(lambda x: x[0], 3)), "of 2 parameters"),
        (lambda: autocorrelation_time(np.zeros((2, 2, 2))), "of shape"),
        (lambda: diagnose(np.array([[1.0, math.nan]])), "must be finite"),
        (lambda: split_r_hat(np.ones((2, 3))), "at least 4"),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with pytest.raises(IntegrationError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
