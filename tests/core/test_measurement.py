"""Measurements add like sums, refuse to count a pass twice, and know their own noise."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from etendue.core import CONTRAST, RELATIVE_EPSILON, EtendueError, Iterations, Measurement, SquaresOf


def one_pass(iteration, value, weight=1.0, replica=0):
    """A pass whose own estimate is ``value``: the sum is ``value * weight``."""
    value = np.asarray(value, dtype=np.float64)
    return Measurement(
        sums={"image": value * weight},
        weights={"image": weight},
        squares={"image": (value * weight) ** 2},
        iterations=Iterations.single(iteration, replica),
        counters={"rays": 10.0},
    )


@pytest.fixture
def passes():
    generator = np.random.default_rng(5)
    return generator.gamma(2.0, 0.5, size=(12, 4, 3, 3))


def test_addition_is_sums_over_weights(passes):
    total = one_pass(0, passes[0], weight=4.0)
    for i in range(1, len(passes)):
        total += one_pass(i, passes[i], weight=4.0)
    np.testing.assert_allclose(total.mean(), passes.mean(axis=0), rtol=1e-12)
    assert total.counters == {"rays": 120.0}
    assert len(total.iterations) == 12


def test_passes_of_unequal_weight_are_averaged_by_weight():
    total = one_pass(0, [1.0], weight=1.0) + one_pass(1, [4.0], weight=3.0)
    assert total.mean()[0] == pytest.approx((1.0 + 12.0) / 4.0)


def test_order_does_not_matter(passes):
    forward = sum((one_pass(i, passes[i]) for i in range(1, 12)), one_pass(0, passes[0]))
    order = [7, 2, 11, 0, 5, 1, 9, 10, 3, 8, 4, 6]
    shuffled = sum((one_pass(i, passes[i]) for i in order[1:]), one_pass(order[0], passes[order[0]]))
    np.testing.assert_allclose(shuffled.mean(), forward.mean(), rtol=1e-12)
    assert shuffled.iterations == forward.iterations


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_squares_that_are_made_when_asked_for(passes, order, kind):
    """Sums of a pass in any precision and order, one array under two names: nothing is lost, nothing else changes."""
    layers = [np.array(value, kind, order=order) for value in passes]

    def lazy(i):
        sums = {"image": layers[i], "other": layers[i]}
        weights = dict.fromkeys(sums, 2.0)
        return Measurement(sums, weights, Iterations.single(i), squares=SquaresOf(sums, ["image"]))

    total = lazy(0)
    assert total.has_error() and not total.has_error("other")
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(total)).squares["image"], np.square(layers[0], dtype=float))
    for i in range(1, len(layers)):
        total += lazy(i) if i % 2 else lazy(i).copy()
    exact = np.array(layers, np.float64)
    for name in ("image", "other"):
        np.testing.assert_allclose(total.sums[name], exact.sum(axis=0), rtol=1e-14)
    np.testing.assert_allclose(total.squares["image"], np.square(exact).sum(axis=0), rtol=1e-14)
    np.testing.assert_array_equal(np.array(layers), passes.astype(kind))
    one = lazy(3)
    one.scale(0.5)
    np.testing.assert_allclose([one.sums["image"], one.squares["image"]], [exact[3] / 2, exact[3] ** 2 / 4])
    np.testing.assert_array_equal(layers[3], passes[3].astype(kind))


def test_add_leaves_its_operands_alone():
    a, b = one_pass(0, [1.0]), one_pass(1, [2.0])
    c = a + b
    c.sums["image"][0] = 99.0
    c.counters["rays"] = 0.0
    assert (a.sums["image"][0], b.sums["image"][0], a.counters["rays"], len(a.iterations)) == (1.0, 2.0, 10.0, 1)


def test_the_same_pass_twice_is_refused_and_nothing_changes():
    total = one_pass(0, [1.0]) + one_pass(1, [2.0])
    with pytest.raises(EtendueError, match="iteration 1 of replica 0"):
        total += one_pass(1, [5.0])
    assert total.sums["image"][0] == 3.0
    total += one_pass(1, [5.0], replica=1)  # another replica is another run
    assert len(total.iterations) == 3


@pytest.mark.parametrize("change", ["layer", "square", "shape"])
def test_measurements_of_other_layers_are_refused_and_nothing_changes(change):
    total, other = one_pass(0, [1.0, 2.0]), one_pass(1, [1.0, 2.0])
    if change == "layer":
        other.sums["merge"], other.weights["merge"] = np.zeros(2), 1.0
    elif change == "square":
        other.squares.clear()
    else:
        other = one_pass(1, [[1.0], [2.0]])
    with pytest.raises(EtendueError, match="cannot be added"):
        total += other
    np.testing.assert_array_equal(total.sums["image"], [1.0, 2.0])
    assert total.weights["image"] == 1.0
    assert len(total.iterations) == 1


def test_relative_error_is_the_closed_form(passes):
    total = sum((one_pass(i, passes[i], weight=2.0) for i in range(1, 12)), one_pass(0, passes[0], weight=2.0))
    mean = passes.mean(axis=0)
    variance = passes.var(axis=0, ddof=1) / len(passes)
    np.testing.assert_allclose(total.variance_of_mean(), variance, rtol=1e-10)
    assert total.relative_error() == pytest.approx(np.mean(variance / (mean**2 + RELATIVE_EPSILON)), rel=1e-10)


def test_relative_error_predicts_the_squared_error():
    """Over many runs, the mean of the estimate is the true mean squared relative error."""
    generator = np.random.default_rng(11)
    estimated, actual = [], []
    for _ in range(200):
        values = generator.normal(3.0, 1.0, size=(20, 16))
        total = sum((one_pass(i, values[i]) for i in range(1, 20)), one_pass(0, values[0]))
        estimated.append(total.relative_error())
        actual.append(np.mean((total.mean() - 3.0) ** 2 / (9.0 + RELATIVE_EPSILON)))
    assert np.mean(estimated) == pytest.approx(np.mean(actual), rel=0.1)


#: As ``guided`` weighs its passes.
WEIGHTS = np.repeat([0.125, 0.25, 0.5, 1.0], [1, 2, 4, 5])


def test_variance_of_a_weighted_mean_is_the_closed_form(passes):
    """Whatever the order in which passes of different weights are added."""
    each = [one_pass(i, passes[i], weight=8.0 * WEIGHTS[i]) for i in range(12)]
    mean = np.average(passes, axis=0, weights=WEIGHTS)
    scatter = np.tensordot(WEIGHTS**2, (passes - mean) ** 2, axes=1)
    variance = scatter / (WEIGHTS.sum() ** 2 - (WEIGHTS**2).sum())
    parts = [sum(each[a + 1 : b], each[a]) for a, b in ((0, 3), (3, 7), (7, 10), (10, 12))]
    for total in (sum(each[1:], each[0]), sum(each[-2::-1], each[-1]), (parts[2] + parts[0]) + (parts[3] + parts[1])):
        np.testing.assert_allclose(total.mean(), mean, rtol=1e-12)
        np.testing.assert_allclose(total.variance_of_mean(), variance, rtol=1e-10)


def test_scaling_changes_neither_mean_nor_error(passes):
    plain = sum((one_pass(i, passes[i], WEIGHTS[i]) for i in range(1, 12)), one_pass(0, passes[0], WEIGHTS[0]))
    scaled = plain.copy()
    scaled.scale(3.0)
    assert scaled.weights["image"] == pytest.approx(3.0 * WEIGHTS.sum())
    np.testing.assert_allclose(scaled.mean(), plain.mean(), rtol=1e-12)
    np.testing.assert_allclose(scaled.variance_of_mean(), plain.variance_of_mean(), rtol=1e-9)


def test_equal_weights_keep_no_more_than_squares(passes):
    total = sum((one_pass(i, passes[i], weight=0.7) for i in range(1, 12)), one_pass(0, passes[0], weight=0.7))
    assert not total.products
    assert (total + one_pass(12, passes[0], weight=0.8)).products.keys() == {"image"}


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_variance_of_a_weighted_mean_over_many_runs(power):
    """Passes whose variance falls as a power of their weight: the mean of the estimate is the true variance if that
    power is 1, and within the twentieth part of it otherwise."""
    runs = 40_000
    deviations = 0.3 * WEIGHTS ** (-0.5 * power)
    values = 2.0 + np.random.default_rng(3).normal(0.0, 1.0, (len(WEIGHTS), runs)) * deviations[:, None]
    each = [one_pass(i, value, weight) for i, (value, weight) in enumerate(zip(values, WEIGHTS, strict=True))]
    total = sum(each[1:], each[0])
    truth = (WEIGHTS**2 * deviations**2).sum() / WEIGHTS.sum() ** 2
    estimates = total.variance_of_mean()
    error = estimates.std() / np.sqrt(runs)
    assert error < 0.01 * truth
    assert abs(estimates.mean() - truth) < 4.0 * error + (0.0 if power == 1.0 else 0.05) * truth


def test_the_contrast_of_two_halves_tells_the_error_of_dependent_passes():
    """All passes of a half have the same error, which their scatter does not show."""
    rng, found, reported = np.random.default_rng(5), [], []
    for _ in range(200):
        halves = 2.0 + rng.normal(0.0, 0.3, (2, 8))
        total = None
        for iteration in range(4):
            sums = {"image": halves.sum(0), "image" + CONTRAST: halves[0] - halves[1]}
            one = Measurement(sums, dict.fromkeys(sums, 2.0), Iterations.single(iteration))
            total = one if total is None else total + one
        assert total.has_error()
        total.scale(0.5)
        found.append(total.mean())
        reported.append(total.variance_of_mean())
    assert np.mean(reported) == pytest.approx(0.3**2 / 2.0, rel=0.1)
    assert np.var(found) == pytest.approx(0.3**2 / 2.0, rel=0.1)


def test_relative_error_of_one_pass_is_unknown():
    assert np.isnan(one_pass(0, [1.0]).relative_error())


def test_constant_passes_have_no_noise_in_spite_of_rounding():
    total = sum((one_pass(i, np.full(100, 0.1)) for i in range(1, 50)), one_pass(0, np.full(100, 0.1)))
    assert 0.0 <= total.relative_error() < 1e-12


def test_iterations_keep_intervals():
    done = Iterations()
    for i in (4, 0, 1, 3):
        done = done.union(Iterations.single(i))
    assert done.to_json() == [[0, 0, 2], [0, 3, 5]]
    assert list(done) == [(0, 0), (0, 1), (0, 3), (0, 4)]
    assert len(done) == 4
    assert 3 in done
    assert 2 not in done
    assert (1, 3) not in done
    assert done.next_iteration() == 5
    assert done.next_iteration(replica=1) == 0
    done = done.union(Iterations.single(2))
    assert done.to_json() == [[0, 0, 5]]


def test_iterations_survive_json():
    done = Iterations.single(3).union(Iterations.single(9)).union(Iterations.single(0, replica=2))
    assert Iterations.from_json(json.loads(json.dumps(done.to_json()))) == done


def test_iterations_from_unsorted_rows_are_the_same_set():
    assert Iterations.from_json([[0, 3, 5], [0, 0, 3]]) == Iterations({0: [(0, 5)]})
    with pytest.raises(EtendueError):
        Iterations.from_json([[0, 0, 3], [0, 2, 5]])
