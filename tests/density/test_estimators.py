"""Estimators against sums over all pairs in double precision, and what all of them promise."""

from __future__ import annotations

import itertools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue.core import EtendueError
from etendue.density import (
    KERNELS,
    AdaptiveKernel,
    BinnedKernel,
    DensityError,
    FixedKernel,
    Histogram,
    Naive,
    NearestNeighbours,
    SampleBandwidths,
    Samples,
    Surface,
    VariableKernel,
)

SMOOTH = [name for name in KERNELS if name != "uniform"]


def cloud(coordinates: int, n: int = 400, seed: int = 3) -> np.ndarray:
    """A peak on an even ground; three coordinates are on two faces of the unit cube."""
    random = np.random.default_rng(seed)
    x = random.uniform(0, 1, (n, min(coordinates, 2)))
    x[::3] = np.clip(random.normal(0.4, 0.05, x[::3].shape), 0, 1)
    if coordinates == 3:
        flat = np.zeros(n)
        side = np.arange(n) % 2 == 0
        return np.where(side[:, None], np.c_[x, flat], np.c_[flat, x])
    return x[:, 0] if coordinates == 1 else x


def distances(x: np.ndarray, samples: np.ndarray) -> np.ndarray:
    a, b = (np.reshape(v, (len(v), -1)) for v in (x, samples))
    return np.sqrt(np.sum((a[:, None] - b[None]) ** 2, axis=-1))


def pairs(x, samples, h, kernel, weights=None) -> np.ndarray:
    """Sum over all pairs; ``h`` one number, one for each sample, or one for each point as (m, 1)."""
    d = 1 if np.ndim(samples) == 1 else 2
    w = np.full(len(samples), 1 / len(samples)) if weights is None else weights / weights.sum()
    return np.sum(w * KERNELS[kernel].value(distances(x, samples) / h, d) / h**d, axis=1)


@pytest.mark.parametrize("coordinates", [1, 2, 3])
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_fixed_kernel_is_the_sum_over_all_pairs(kernel, coordinates):
    samples, x = cloud(coordinates), cloud(coordinates, 60, seed=8)
    weights = np.random.default_rng(1).uniform(0, 2, len(samples))
    estimate = FixedKernel(Samples(samples, weights, mass=2.5), 0.07, kernel)(x)
    # Single precision may take a sample at the very rim of the uniform kernel the other way.
    rim = 2.5 * 2 / 400 / 0.07**2 if kernel == "uniform" else 0.0
    assert estimate == pytest.approx(2.5 * pairs(x, samples, 0.07, kernel, weights), rel=2e-5, abs=1e-5 + rim)
    assert estimate.shape == (60,)


def test_the_naive_estimate_counts():
    samples, x = cloud(1), np.array([0.2, 0.4, 2.0])
    expected = [np.sum(np.abs(samples - v) <= 0.05) / (2 * 0.05 * len(samples)) for v in x]
    assert Naive(samples, 0.05)(x) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("coordinates", [1, 2, 3])
@pytest.mark.parametrize(("kernel", "k"), [("uniform", 1), ("uniform", 17), ("cone", 40), ("gaussian", 9)])
def test_nearest_neighbours_are_those_of_all_pairs(kernel, k, coordinates):
    samples, x = cloud(coordinates), cloud(coordinates, 60, seed=8)
    distance = np.sort(distances(x, samples), axis=1)[:, k - 1 : k]
    expected = pairs(x, samples, distance * (1 + 1e-12), kernel)
    assert NearestNeighbours(samples, k, kernel)(x) == pytest.approx(expected, rel=1e-3)
    d = min(coordinates, 2)
    last = KERNELS[kernel].value(1.0, d) / len(samples) / distance[:, 0] ** d
    without = NearestNeighbours(samples, k, kernel, count_last=False)(x)
    assert without == pytest.approx(expected - last, rel=1e-3, abs=1e-4 * expected.max())


@pytest.mark.parametrize("coordinates", [1, 2, 3])
def test_weights_mass_and_units_count_in_every_estimator(coordinates):
    samples, x = 7.0 * cloud(coordinates), 7.0 * cloud(coordinates, 60, seed=8)
    weights = np.random.default_rng(1).uniform(0, 2, len(samples))
    weighed = Samples(samples, weights, mass=2.5)
    near = np.sort(distances(x, samples), axis=1)[:, 39:40] * (1 + 1e-12)
    own = np.sort(distances(samples, samples), axis=1)[:, 12]
    for estimate, h in (
        (FixedKernel(weighed, 0.5, "cone"), 0.5),
        (NearestNeighbours(weighed, 40, "cone"), near),
        (VariableKernel(weighed, 12, kernel="cone"), own),
    ):
        expected = 2.5 * pairs(x, samples, h, "cone", weights)
        assert estimate(x) == pytest.approx(expected, rel=1e-3, abs=1e-4 * expected.max())


def test_without_the_last_neighbour_the_mean_is_right():
    """``(k - 1) / (n pi d^2)`` has the mean of the density where that is even."""
    random = np.random.default_rng(4)
    x = np.array(list(itertools.product((-0.6, 0.0, 0.6), repeat=2)))  # further apart than five neighbours
    found = {True: [], False: []}
    for _ in range(20):
        samples = random.uniform(-1, 1, (400, 2))
        for counted in found:
            found[counted].append(NearestNeighbours(samples, 5, count_last=counted)(x).mean())
    mean, error = np.mean(found[False]), np.std(found[False], ddof=1) / np.sqrt(20)
    assert mean == pytest.approx(0.25, abs=4 * error)
    assert np.mean(found[True]) == pytest.approx(mean * 5 / 4, rel=1e-4)


@pytest.mark.parametrize("coordinates", [1, 2, 3])
@pytest.mark.parametrize("kernel", SMOOTH)
def test_a_variable_kernel_is_the_sum_over_all_pairs(kernel, coordinates):
    samples, x = cloud(coordinates), cloud(coordinates, 60, seed=8)
    distance = np.sort(distances(samples, samples), axis=1)[:, 12]  # the first is the sample itself
    expected = pairs(x, samples, 0.8 * distance, kernel)
    estimate = VariableKernel(samples, 12, 0.8, kernel)
    assert estimate.bandwidths == pytest.approx(0.8 * distance, rel=1e-4)
    assert estimate(x) == pytest.approx(expected, rel=1e-3, abs=1e-4 * expected.max())


def test_an_adaptive_kernel_widens_in_the_dark():
    samples, x = cloud(2), cloud(2, 60, seed=8)
    pilot = pairs(samples, samples, 0.1, "biweight")
    widths = 0.1 * (pilot / np.exp(np.mean(np.log(pilot)))) ** -0.5
    estimate = AdaptiveKernel(samples, 0.1, kernel="biweight")
    assert estimate.bandwidths == pytest.approx(widths, rel=1e-3)
    assert estimate(x) == pytest.approx(pairs(x, samples, widths, "biweight"), rel=1e-3, abs=1e-3)
    fixed = AdaptiveKernel(samples, 0.1, Histogram(samples, 5), alpha=0, kernel="biweight")
    assert fixed(x) == pytest.approx(pairs(x, samples, 0.1, "biweight"), rel=1e-4, abs=1e-4)


def test_a_histogram_counts():
    samples = cloud(2)
    estimate = Histogram(samples, (7, 4), [(0, 1), (0, 2)])
    expected, *edges = np.histogram2d(*samples.T, (7, 4), [(0, 1), (0, 2)], density=True)
    assert estimate.values == pytest.approx(expected)
    for mine, theirs in zip(estimate.edges, edges, strict=True):
        assert mine == pytest.approx(theirs)
    centres = np.stack(np.meshgrid((np.arange(7) + 0.5) / 7, (np.arange(4) + 0.5) / 2, indexing="ij"), axis=-1)
    assert estimate(centres.reshape(-1, 2)) == pytest.approx(expected.ravel(), rel=1e-5)
    line = Histogram(cloud(1), 9)
    assert line.values == pytest.approx(np.histogram(cloud(1), 9, density=True)[0])


def test_texels_of_a_surface_have_areas():
    """u of a disc's polar parameters: a texel's area grows with the radius."""
    random = np.random.default_rng(2)
    uv = np.stack([np.sqrt(random.uniform(0, 1, 60_000)), random.uniform(0, 1, 60_000)], axis=1)
    edges = np.linspace(0, 1, 7)
    areas = np.repeat((np.pi * np.diff(edges**2) / 5)[:, None], 5, axis=1)
    estimate = Histogram(uv, (6, 5), [(0, 1), (0, 1)], areas)
    deviation = np.sqrt(1 / (np.pi * areas * 60_000))
    assert (np.abs(estimate.values - 1 / np.pi) < 4.5 * deviation).all()
    assert np.sum(estimate.values * areas) == pytest.approx(1)


def test_neighbours_and_a_histogram_agree_away_from_edges():
    random = np.random.default_rng(13)
    uv = random.uniform(0, 1, (150_000, 2))
    uv = uv[random.uniform(0, 1.5, len(uv)) < 1 + 0.5 * np.sin(6 * uv[:, 0]) * uv[:, 1]]
    histogram = Histogram(uv, 10, [(0, 1), (0, 1)])
    inner = np.stack(np.meshgrid(np.arange(1, 9), np.arange(1, 9), indexing="ij"), axis=-1).reshape(-1, 2)
    k = 800
    nearest = NearestNeighbours(uv, k)((inner + 0.5) / 10)
    ratio = nearest / histogram.values[inner[:, 0], inner[:, 1]]
    deviation = np.sqrt(1 / k + 1 / (0.01 * len(uv) * nearest))
    # A disc is narrower than a bin: the density's curvature differs by some 1e-2 between the two.
    assert (np.abs(ratio - 1) < 4 * deviation + 0.02).all()
    assert ratio.mean() == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("boundary", ["none", "reflect", "renormalise"])
@pytest.mark.parametrize("coordinates", [1, 2])
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_binned_kernel_is_near_the_exact_one(kernel, coordinates, boundary):
    samples, x = cloud(coordinates), cloud(coordinates, 200, seed=8)
    x[:20] = np.round(x[:20])  # corners
    arguments = (samples, 0.06, kernel, [(0, 1)] * coordinates, boundary)
    exact = FixedKernel(*arguments)(x)
    error = BinnedKernel(*arguments, steps=20)(x) - exact
    bound = 0.2 if kernel == "uniform" else 0.02 if kernel == "cone" else 0.01
    assert np.max(np.abs(error)) < bound * exact.max()
    assert np.sqrt(np.mean(error**2)) < 0.2 * bound * exact.max()


@pytest.mark.parametrize("kind", ["fixed", "renormalise", "reflect", "binned", "nearest", "variable", "histogram"])
def test_the_density_of_even_samples_is_even(kind):
    """Up to the border, and in corners: without a correction a quarter would be left there."""
    side = (np.arange(80) + 0.5) / 80
    samples = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) * [2, 1]
    domain = [(0, 2), (0, 1)]
    x = np.array([[0, 0], [2, 1], [0.02, 0.01], [1, 0.5], [2, 0.4], [1, 0.05]])
    made = {
        "fixed": lambda: FixedKernel(samples, 0.1, "biweight"),
        "renormalise": lambda: FixedKernel(samples, 0.1, "biweight", domain, "renormalise"),
        "reflect": lambda: FixedKernel(samples, 0.1, "biweight", domain, "reflect"),
        "binned": lambda: BinnedKernel(samples, 0.1, "biweight", domain, "renormalise"),
        "nearest": lambda: NearestNeighbours(samples, 200, "cone", domain, "renormalise"),
        "variable": lambda: VariableKernel(samples, 100, 1.5, "biweight", domain, "reflect"),
        "histogram": lambda: Histogram(samples, 8, domain),
    }[kind]()
    estimate = made(x)
    expected = [0.125, 0.125, np.nan, 0.5, 0.25, np.nan] if kind == "fixed" else [0.5] * 6
    known = np.isfinite(expected)
    tolerance = 0.04 if kind == "nearest" else 0.02
    assert estimate[known] == pytest.approx(np.array(expected)[known], rel=tolerance)
    if kind != "fixed":  # the one without a domain
        assert made(np.array([[2.1, 0.5], [1, -0.1]])).tolist() == [0, 0]


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("coordinates", [1, 2])
def test_what_is_reflected_integrates_to_one(kernel, coordinates):
    samples = np.clip(np.random.default_rng(6).normal(0, 0.2, (300, coordinates)), 0, 1)
    samples = samples[:, 0] if coordinates == 1 else samples
    n = 100
    axis = (np.arange(n) + 0.5) / n
    x = axis if coordinates == 1 else np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    estimate = FixedKernel(samples, 0.15, kernel, [(0, 1)] * coordinates, "reflect")(x)
    assert estimate.mean() == pytest.approx(1, abs=0.01 if kernel == "uniform" else 2e-3)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_share_of_a_kernel_in_a_rectangle(kernel):
    """Renormalising divides by it: compared with a fine sum over the rectangle."""
    domain, h = [(0, 0.5), (0, 0.3)], 0.08
    x = np.array([[0, 0], [0.25, 0.15], [0.01, 0.1], [0.03, 0.02], [0.5, 0.29], [0.45, 0.0]])
    plain = FixedKernel(np.repeat(x, 3, axis=0), h, kernel, domain)(x)
    share = plain / FixedKernel(np.repeat(x, 3, axis=0), h, kernel, domain, "renormalise")(x)
    n = 600
    grid = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n * b for _, b in domain]), axis=-1).reshape(-1, 2)
    cell = 0.5 * 0.3 / n**2
    expected = [np.sum(KERNELS[kernel].value(distances(v[None], grid) / h, 2)) / h**2 * cell for v in x]
    assert share == pytest.approx(expected, abs=1e-3)


def test_a_surface_is_even_at_its_edges():
    """Two faces that meet at a right angle: near the fold a ball holds more area than a disc, at a rim less."""
    side = (np.arange(60) + 0.5) / 60
    face = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    flat = np.zeros(len(face))
    points = np.concatenate([np.c_[face, flat], np.c_[flat, face]])
    surface = Surface(points, 1 / 3600)
    random = np.random.default_rng(5)
    uv, where = random.uniform(0, 1, (200_000, 2)), random.integers(2, size=200_000)
    samples = np.where(where[:, None] == 0, np.c_[uv, np.zeros(len(uv))], np.c_[np.zeros(len(uv)), uv])
    x = np.array([[0, 0, 0], [1, 1, 0], [0.5, 0.5, 0], [0, 0.5, 0.02], [0.03, 0.5, 0], [0, 0.5, 1]])
    for estimate in (
        FixedKernel(samples, 0.1, "epanechnikov", surface=surface),
        NearestNeighbours(samples, 3000, "epanechnikov", surface=surface),
    ):
        assert estimate(x) == pytest.approx(np.full(6, 0.5), rel=0.08)
    assert FixedKernel(samples, 0.1, "epanechnikov")(x[1]) == pytest.approx(0.125, rel=0.08)


@pytest.mark.parametrize("kind", ["fixed", "binned", "histogram", "nearest", "variable"])
def test_on_the_device_in_a_loop_it_is_the_same(kind):
    samples, x = cloud(2), cloud(2, 40, seed=8)
    estimate = {
        "fixed": lambda: FixedKernel(samples, 0.1, "biweight", [(0, 1), (0, 1)], "renormalise"),
        "binned": lambda: BinnedKernel(samples, 0.1, "biweight"),
        "histogram": lambda: Histogram(samples, 6),
        "nearest": lambda: NearestNeighbours(samples, 10, "cone"),
        "variable": lambda: VariableKernel(samples, 10, 1.0, "cone"),
    }[kind]()
    expected = estimate(x)
    points = mi.Point2f(*(mi.Float(side) for side in x.T.astype(np.float32, order="C")))
    assert np.array(estimate(points)) == pytest.approx(expected, rel=1e-3, abs=1e-3 * expected.max())

    def step(i, total):
        return i + 1, total + estimate(points)

    lane = dr.arange(mi.UInt32, 40)
    _, total = dr.while_loop((mi.UInt32(0), mi.Float(0)), lambda i, _: i < lane % 3, step)
    assert np.array(total) == pytest.approx(expected * (np.arange(40) % 3), rel=2e-3, abs=2e-3 * expected.max())


def test_samples_of_the_device():
    samples = cloud(2)
    lanes = mi.Point2f(*(mi.Float(side) for side in samples.T.astype(np.float32, order="C")))
    assert FixedKernel(lanes, 0.1)(samples[:9]) == pytest.approx(FixedKernel(samples, 0.1)(samples[:9]), rel=1e-4)
    assert FixedKernel(lanes.x, 0.1)(0.5) == pytest.approx(FixedKernel(samples[:, 0], 0.1)(0.5), rel=1e-4)


@pytest.mark.parametrize(("scale", "origin"), [(1e-9, 0.0), (1e9, 0.0), (1.0, 1e6), (1e-3, -40.0)])
def test_units_and_places_do_not_matter(scale, origin):
    samples, x = cloud(2), cloud(2, 30, seed=8)
    for make in (
        lambda s, k: FixedKernel(s, 0.1 * k, "biweight"),
        lambda s, k: BinnedKernel(s, 0.1 * k, "biweight"),
        lambda s, k: NearestNeighbours(s, 10, "cone"),
        lambda s, k: VariableKernel(s, 10, 1.0, "cone"),
    ):
        here, there = make(samples, 1.0)(x), make(samples * scale + origin, scale)(x * scale + origin)
        assert there * scale**2 == pytest.approx(here, rel=2e-3, abs=2e-3 * here.max())


def test_outliers_take_no_places_from_the_rest():
    random = np.random.default_rng(12)
    samples = np.append(random.normal(size=2000), [-3e4, 2e4])
    x = random.normal(size=40)
    for estimate in (FixedKernel(samples, 0.2), VariableKernel(samples, 30, 1.0)):
        h = getattr(estimate, "bandwidths", 0.2)
        expected = pairs(x, samples, h, "gaussian")
        assert estimate(x) == pytest.approx(expected, rel=1e-3)


def test_many_samples_stay_exact_where_few_are_near():
    random = np.random.default_rng(9)
    samples, x = random.uniform(0, 1, (200_000, 2)), random.uniform(0.1, 0.9, (16, 2))
    expected = pairs(x, samples, 0.004, "epanechnikov")
    assert FixedKernel(samples, 0.004, "epanechnikov")(x) == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_shapes_and_single_points():
    estimate = FixedKernel(cloud(1), 0.1)
    assert np.shape(estimate(0.3)) == () and estimate(0.3) == pytest.approx(float(estimate([0.3])[0]))
    assert estimate([]).shape == (0,)
    assert np.isnan(estimate([np.nan, 0.5])).tolist() == [True, False]
    assert estimate([1e30]) == 0
    assert FixedKernel([0.5], 0.1)(0.5) == pytest.approx(3.989423, rel=1e-5)  # one sample
    assert np.isinf(NearestNeighbours([0.5, 0.5], 2)(0.5))


def test_samples_that_are_not_finite_are_counted_and_left_out(caplog):
    samples = np.append(cloud(1), [np.nan, np.inf])
    checked = Samples(samples)
    assert checked.rejected == 2 and "2 of 402 samples are not finite" in caplog.text
    assert FixedKernel(checked, 0.1)(0.5) == pytest.approx(FixedKernel(cloud(1), 0.1)(0.5))
    assert Samples([1.0, 2.0], [1.0, np.nan]).rejected == 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FixedKernel([], 0.1), "no samples"),
        (lambda: FixedKernel([np.nan, np.nan], 0.1), "none of 2 samples has a finite"),
        (lambda: FixedKernel([0.0], 0.0), "bandwidth must be a number above zero, not 0.0"),
        (lambda: FixedKernel([0.0], -1.0), "bandwidth must be"),
        (lambda: FixedKernel([0.0], np.nan), "bandwidth must be"),
        (lambda: FixedKernel([0.0], "wide"), "bandwidth must be"),
        (lambda: FixedKernel([0.0, 1.0], 1e-8), "too small for single precision"),
        (lambda: FixedKernel([0.0], 1, domain=[(1, 1)]), "empty or infinite domain"),
        (lambda: FixedKernel([0.0], 1, domain=[(2, 1)]), "empty or infinite domain"),
        (lambda: FixedKernel([0.0, 5.0], 1, domain=[(0, 1)]), "1 of 2 samples lie outside the domain"),
        (lambda: FixedKernel([0.0], 1, domain=[(0, 1), (0, 1)]), "2 dimensions, the samples have 1"),
        (lambda: FixedKernel([0.0], 1, boundary="reflect"), "needs the domain"),
        (lambda: FixedKernel([0.0], 1, domain=1, boundary="mirror"), "this estimator has none, reflect, renormalise"),
        (lambda: NearestNeighbours([0.0], 1, domain=1, boundary="reflect"), "this estimator has none, renormalise"),
        (lambda: FixedKernel(np.zeros((4, 3)), 1, domain=3, boundary="reflect"), "a domain is for samples on a line"),
        (lambda: FixedKernel(np.zeros((4, 5)), 1), "not \\(4, 5\\)"),
        (lambda: FixedKernel(["a"], 1), "array of numbers"),
        (lambda: FixedKernel([0.0], 1)([[1.0, 2.0]]), "samples have 1 coordinates"),
        (lambda: FixedKernel([0.0], 1)(mi.Point2f(0)), "samples have 1 coordinates"),
        (lambda: FixedKernel([0.0], 1, surface=Surface(np.zeros((3, 3)), 1)), "three coordinates"),
        (lambda: NearestNeighbours([0.0, 1.0], 3), "from 1 to 2 for 2 samples, not 3"),
        (lambda: NearestNeighbours([0.0, 1.0], 0), "from 1 to 2"),
        (lambda: VariableKernel([0.0, 1.0], 2), "from 1 to 1"),
        (lambda: VariableKernel([0.0, 0.0, 1.0], 1), "2 samples have 1 others at their place"),
        (lambda: SampleBandwidths([0.0, 1.0], [1.0]), "as many bandwidths"),
        (lambda: SampleBandwidths([0.0, 1.0], [1.0, 0.0]), "all above zero"),
        (lambda: AdaptiveKernel([0.0, 1.0], 1, alpha=2), "alpha must be from 0 to 1"),
        (lambda: AdaptiveKernel([0.0, 1.0], 1, FixedKernel([9.0], 0.1)), "finite and above zero at every sample"),
        (lambda: Histogram([0.0, 0.0], 3), "their box is empty"),
        (lambda: Histogram([0.0, 1.0], 0), "bins are a whole number"),
        (lambda: Histogram([0.0, 1.0], (2, 2)), "bins are a whole number"),
        (lambda: Histogram([0.0, 1.0], 2, areas=[1.0]), "areas of bins"),
        (lambda: Histogram(np.zeros((4, 3)), 2), "give surfaces by"),
        (lambda: BinnedKernel([0.0, 1.0], 1e-9), "nodes, the limit is"),
        (lambda: Samples([0.0], [1.0, 2.0]), "as many weights"),
        (lambda: Samples([0.0, 1.0], [-1.0, 2.0]), "must not be negative"),
        (lambda: Samples([0.0], [0.0]), "not all zero"),
        (lambda: Samples([0.0], mass=0), "positive number"),
        (lambda: Surface(np.zeros((0, 3)), 1), "points in space"),
        (lambda: Surface(np.zeros((2, 3)), 0), "areas positive"),
    ],
)
def test_bad_input_is_an_error_of_one_line(make, message):
    with pytest.raises(EtendueError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_errors_are_of_this_room():
    with pytest.raises(DensityError):
        Samples([])
