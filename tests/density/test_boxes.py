"""Rays by the boxes that they pass: the density is that of the samples, and rays through windows are recognised."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support.statistics import assert_mean

from etendue.density import BoxDensity, Boxes, fit_boxes

#: Beside each other, one in another, and thin ones.
BOXES = Boxes(
    np.array([[-1.0, 0.5, 2.0], [-0.5, 0.8, 2.5], [1.0, 1.0, 1.0], [-2.0, -1.0, 0.0]]),
    np.array([[2.0, 1.5, 4.5], [0.5, 1.2, 3.0], [1.01, 2.0, 3.0], [2.0, 1.0, 0.02]]),
    np.array([0.4, 0.1, 0.2, 0.3]),
)


def directions(count: int, seed: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def towards(density: BoxDensity, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    o, d = np.broadcast_arrays(o, d)
    return np.array(density.towards(mi.Point3f(o.T), mi.Vector3f(d.T)), np.float64)


def sampled(density: BoxDensity, count: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    u, v, depth = (mi.Float(random.random(count, dtype=np.float32)) for _ in range(3))
    return np.array(density.sample(mi.Point2f(u, v), depth, mi.Bool(True)), np.float64).T


def brute_force(o: np.ndarray, d: np.ndarray, reach: float = 12.0, steps: int = 40_000) -> np.ndarray:
    """Sums of the density of points at many points of each ray."""
    result = np.zeros(len(o))
    for t in (np.arange(steps) + 0.5) / steps * reach:
        p = o + t * d
        for lower, upper, mass in zip(BOXES.lower, BOXES.upper, BOXES.mass, strict=True):
            result[((p >= lower) & (p < upper)).all(axis=1)] += t**2 * mass / (upper - lower).prod()
    return result * (reach / steps)


def test_the_density_is_the_integral_along_the_ray():
    """From outside, from inside, and along the axes."""
    o = np.random.default_rng(2).uniform(-3.0, 5.0, (300, 3))
    d = directions(300, 3)
    d[:60] = np.eye(3)[np.arange(60) % 3] * np.where(np.arange(60) % 2, 1.0, -1.0)[:, None]
    o[100:150] = [0.1, 1.0, 2.7]
    expected = brute_force(o, d)
    assert (expected > 0).sum() > 60
    np.testing.assert_allclose(towards(BoxDensity(BOXES), o, d), expected, rtol=2e-2, atol=2e-3)


@pytest.mark.parametrize("o", [(0.1, 1.0, 2.7), (5.0, -2.0, 1.0), (0.0, 0.0, -1.0)])
def test_rays_towards_samples_have_the_density(o):
    """Means over samples of smooth functions of the direction, against their integrals over the sphere."""
    density, even = BoxDensity(BOXES), directions(1 << 19, 5)
    w = sampled(density, 1 << 17, 6) - o
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    found = 4.0 * np.pi * towards(density, np.array(o), even)
    assert_mean(found, 1.0, o)
    for axis in directions(4, 7):
        integral = found * np.exp(3.0 * even @ axis)
        own = np.exp(3.0 * w @ axis)
        error = np.hypot(integral.std() / len(integral) ** 0.5, own.std() / len(own) ** 0.5)
        assert abs(integral.mean() - own.mean()) < 4.5 * error, (o, axis)


def test_samples_are_even_in_their_box():
    density, count = BoxDensity(Boxes(BOXES.lower[2:], BOXES.upper[2:], np.array([0.25, 0.75]))), 1 << 17
    p = sampled(density, count, 8)
    first = p[:, 0] >= 0.999
    first &= p[:, 1] >= 1.0
    assert stats.binomtest(int(first.sum()), count, 0.25).pvalue > 1e-5
    for own, box in ((p[first], 2), (p[~first], 3)):
        place = (own - BOXES.lower[box]) / (BOXES.upper[box] - BOXES.lower[box])
        assert (place > -1e-3).all() and (place < 1.001).all()
        seen = np.histogramdd(place, bins=(4, 4, 4), range=[(0.0, 1.0)] * 3)[0]
        assert stats.chisquare(seen.ravel()).pvalue > 1e-5


LOWER, UPPER = np.full(3, -10.0), np.full(3, 10.0)
EVEN = 1.0 / (4.0 * np.pi)
#: A square window in the wall x = 10, and a tall one in z = -10: (lower, upper) corners.
WINDOWS = np.array([[[10.0, -1.0, -1.0], [10.0, 1.0, 1.0]], [[2.0, 0.0, -10.0], [3.0, 4.0, -10.0]]])


def through(windows: np.ndarray, count: int, seed: int, others: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Rays from places in a room through points of windows, alike many for each; a share of ``others`` anywhere."""
    random = np.random.default_rng(seed)
    o = random.uniform(-9.0, 9.0, (count, 3))
    lower, upper = windows[random.integers(len(windows), size=count)].transpose(1, 0, 2)
    d = random.uniform(lower, upper) - o
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    anywhere = random.random(count) < others
    d[anywhere] = directions(int(anywhere.sum()), seed + 1)
    return o, d


def fitted(o: np.ndarray, d: np.ndarray, weight: np.ndarray | None = None) -> tuple[Boxes, float]:
    count = len(o)
    densities = {"replaced": np.full(count, EVEN), "kept": np.zeros(count), "most": 0.75}
    found = fit_boxes(o, d, np.ones(count) if weight is None else weight, LOWER, UPPER, **densities)
    assert found is not None
    return found


#: A hundredth of the first in area.
SMALL = np.array([[[10.0, 3.0, 3.0], [10.0, 3.2, 3.2]]])


def mean_gain(boxes: Boxes, o: np.ndarray, d: np.ndarray) -> float:
    """Mean logarithm of the factor by which rays are likelier with the boxes than evenly."""
    return float(np.log(boxes.share * towards(BoxDensity(boxes), o, d) / EVEN + 1.0 - boxes.share).mean())


@pytest.mark.parametrize("windows", [WINDOWS[:1], WINDOWS, SMALL], ids=["one", "two", "small"])
def test_windows_are_found(windows):
    """Rays that it has not seen are about as likely as by the windows themselves, and as it says."""
    found, gain = fitted(*through(windows, 4000, 1))
    o, d = through(windows, 4000, 50)
    exact = Boxes(windows[:, 0] - 1e-3, windows[:, 1] + 1e-3, np.full(len(windows), 0.75 / len(windows)))
    mine, best = (mean_gain(x, o, d) for x in (found, exact))
    assert mine == pytest.approx(np.log(gain), abs=0.1)
    assert mine > best - 0.5


def test_a_ray_counts_by_its_weight():
    o, d = through(WINDOWS, 4000, 1, others=0.0)
    first = d[:, 0] > 0.0
    first &= (np.abs(o + d * ((10.0 - o[:, :1]) / d[:, :1]))[:, 1:] <= 1.0).all(axis=1)
    density = towards(BoxDensity(fitted(o, d, np.where(first, 1.0, 0.0))[0]), o, d)
    assert np.median(density[first]) > 100.0 * np.median(density[~first])


def test_nothing_is_gained_where_there_are_no_windows():
    random = np.random.default_rng(4)
    _, gain = fitted(random.uniform(-9.0, 9.0, (4000, 3)), directions(4000, 9))
    assert gain < 1.05


@pytest.mark.parametrize("share", (0.2, 0.4, 0.6))
def test_the_boxes_have_the_share_of_the_rays_that_pass_windows(share):
    o, d = through(WINDOWS[:1], 8000, 5, others=1.0 - share)
    assert fitted(o, d)[0].share == pytest.approx(share, abs=0.04)


def test_rays_that_others_find_need_no_windows():
    o, d = through(WINDOWS[:1], 4000, 5)
    kept = np.where(d[:, 0] > 0.5, 100.0, EVEN)
    _, gain = fit_boxes(o, d, np.ones(4000), LOWER, UPPER, replaced=np.full(4000, EVEN), kept=kept, most=0.75)
    assert gain < fitted(o, d)[1] ** 0.7


def test_too_few_rays_give_nothing():
    o, d = through(WINDOWS, 400, 1)
    densities = {"kept": np.zeros(400), "most": 0.75}
    assert fit_boxes(o, d, np.ones(400), LOWER, UPPER, replaced=np.full(400, EVEN), **densities) is None
    o, d = (np.concatenate([x, x]) for x in (o, d))
    densities = {"kept": np.zeros(800), "most": 0.75}
    assert fit_boxes(o, d, np.zeros(800), LOWER, UPPER, replaced=np.full(800, EVEN), **densities) is None
