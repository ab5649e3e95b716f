"""Re-weighting of fireflies, on passes from known distributions."""

import numpy as np
import pytest

from etendue.film import without_fireflies


def moments(passes):
    """(mean over passes (n, height, width, 3), variance of this mean)."""
    return passes.mean(axis=0), passes.var(axis=0, ddof=1) / len(passes)


def reweighted(passes, reach=2):
    mean, variance = moments(passes)
    return without_fireflies({"image": mean.astype(np.float32)}, variance, reach)["image"]


def noise(seed, passes=8, height=48, width=64, spread=0.2):
    """Gamma-distributed passes of mean 1 and standard deviation ``spread``."""
    shape = 1 / spread**2
    return np.random.default_rng(seed).gamma(shape, 1 / shape, (passes, height, width, 1)) * np.ones(3)


def test_a_pixel_that_one_pass_makes_bright_gets_the_mean_of_the_others():
    passes = np.full((10, 12, 16, 3), [0.5, 0.25, 1.0])
    passes[:, 5, 7] = [0.6, 0.3, 1.0]
    expected = passes.mean(axis=0)
    passes[4, 5, 7] += [9000.0, 400.0, 20.0]
    np.testing.assert_allclose(reweighted(passes), expected, rtol=1e-4)


@pytest.mark.parametrize("reach", [1, 2, 3])
def test_a_firefly_that_the_filter_spreads_is_removed_whole(reach):
    """Near the border, too, and although the pixels of the firefly are as noisy as each other."""
    for row, column in ((20, 30), (0, 1), (47, 63)):
        passes = noise(1)
        expected = moments(passes)[0]
        y, x = np.mgrid[0:48, 0:64]
        distance = np.maximum(abs(y - row + 0.4), abs(x - column - 0.3))
        passes[2] += (5000 * np.exp(-2 * ((y - row + 0.4) ** 2 + (x - column - 0.3) ** 2)) * (distance < reach))[
            ..., None
        ]
        assert moments(passes)[0].max() > 100
        assert np.abs(reweighted(passes, reach) - expected).max() < 0.5


def test_the_mean_of_a_heavy_tail_converges():
    """Rare finds: 1, or 1 + 1000 with probability 0.0005, so the mean is 1.5. With few passes the error is far smaller
    than without re-weighting, with many there is no bias."""
    rng = np.random.default_rng(2)
    before, bias = [], []
    for count in (20, 2000, 200_000):
        finds = rng.binomial(count, 0.0005, (200, 200, 1)) * np.ones(3)
        mean = 1 + 1000 * finds / count
        variance = 1e6 * (finds / count - (finds / count) ** 2) / (count - 1)
        after = without_fireflies({"image": mean.astype(np.float32)}, variance, 1)["image"]
        before.append((np.square(mean - 1.5).mean(), np.square(after - 1.5).mean()))
        bias.append(after.mean() / 1.5 - 1)
    (raw, few), _, (converged, many) = before
    assert few < 0.1 * raw
    assert many == pytest.approx(converged, rel=1e-3)
    assert bias[0] < -0.2  # biased, while each find is alone
    assert abs(bias[2]) < 1e-3 and abs(bias[2]) < abs(bias[1]) < abs(bias[0])


@pytest.mark.parametrize(
    ("spread", "passes", "loss"), [(0.2, 2, 3e-4), (1.0, 2, 0.003), (1.0, 16, 1e-4), (3.0, 16, 0.004)]
)
def test_noise_that_is_the_same_everywhere_stays(spread, passes, loss):
    """Also if it has a long tail: among its neighbours a bright pixel is not alone."""
    values = noise(3, passes, spread=spread)
    assert reweighted(values).mean() == pytest.approx(values.mean(), rel=loss)


def test_lamps_edges_and_lines_stay():
    """Sharp features whose pixels are noisy because each pass sees either side."""
    rng = np.random.default_rng(4)
    passes = np.full((16, 40, 40, 3), 0.01)
    passes[:, 10:20, 10:20] = 50.0  # a lamp
    passes[:, 9, 10:20] = 50.0 * (rng.random((16, 10)) < 0.5)[..., None]  # its edge
    passes[:, 3:37, 30] = 20.0 * (rng.random((16, 34)) < 0.5)[..., None]  # a line, one pixel wide
    before, after = moments(passes)[0], reweighted(passes, reach=1)
    np.testing.assert_array_equal(after[10:20], before.astype(np.float32)[10:20])
    assert after[9].sum() == pytest.approx(before[9].sum(), rel=0.03)
    assert after[3:37, 30].sum() == pytest.approx(before[3:37, 30].sum(), rel=0.03)


def test_at_most_the_standard_error_is_removed_and_nothing_added():
    values = np.random.default_rng(5).pareto(1.1, (6, 40, 50, 3))
    mean, variance = moments(values)
    removed = mean - reweighted(values)
    assert removed.max() > 1
    assert removed.min() > -1e-4 * mean.max()
    assert (removed <= np.sqrt(variance) * (1 + 1e-4) + 1e-5 * mean).all()


def test_parts_keep_their_own_light():
    """What is removed comes from the part that has the firefly, and the parts add up to the picture."""
    parts = {"emission": noise(6) * [0.0, 0.0, 0.1], "direct": noise(7), "indirect": 0.3 * noise(8)}
    expected = {name: values.mean(axis=0) for name, values in parts.items()}
    parts["emission"][3, 20, 30] += [800.0, 500.0, 10.0]
    mean, variance = moments(sum(parts.values()))
    before = {name: values.mean(axis=0).astype(np.float32) for name, values in parts.items()}
    kept = {name: values.copy() for name, values in before.items()}
    after = without_fireflies(before, variance, 2)
    for name, values in expected.items():
        np.testing.assert_allclose(after[name], values, atol=0.5 if name == "emission" else 0.1)
        np.testing.assert_array_equal(before[name], kept[name])
    whole = without_fireflies({"image": mean.astype(np.float32)}, variance, 2)["image"]
    np.testing.assert_allclose(sum(after.values()), whole, rtol=0.05, atol=0.1)


def test_negative_lobes_of_a_filter_are_removed_with_their_firefly():
    passes = noise(9, spread=0.05)
    expected = moments(passes)[0]
    passes[1, 20, 30] += 4000.0
    passes[1, 18:23:2, 30] -= 300.0
    assert np.abs(reweighted(passes) - expected).max() < 1.0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("unit", [1e-25, 1e25])
def test_the_unit_of_light_does_not_matter(unit):
    """In very bright and very dark scenes, and where the mean is 0."""
    passes = noise(10)
    passes[2, 20, 30] += 500.0
    passes[:, :10] = 0.0
    passes[0, 3, 3] = 100.0
    mean, variance = moments(passes)
    mean[5, 50], variance[5, 50] = 0.0, 1.0
    scaled = without_fireflies({"image": (mean * unit).astype(np.float32)}, variance * unit**2, 2)["image"]
    plain = without_fireflies({"image": mean.astype(np.float32)}, variance, 2)["image"]
    assert plain.max() < 5.0
    np.testing.assert_allclose(scaled / np.float32(unit), plain, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (3, 2)])
def test_tiny_pictures(size):
    passes = np.ones((4, *size, 3))
    passes[0, 0, 0] = 1000.0
    after = reweighted(passes)
    assert after.shape == (*size, 3)
    assert np.isfinite(after).all() and after.min() >= 0.9
