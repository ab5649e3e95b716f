"""Lines by the places that they pass: the density is that of the samples, and lines through a hole are recognised."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from etendue.density import LineCells, LineDensity, fit_lines

LOWER, UPPER = np.array([-1.0, 0.5, 2.0]), np.array([2.0, 1.5, 4.5])


def cells(seed: int = 1, shape: tuple[int, int, int] = (4, 3, 5)) -> LineCells:
    mass = np.random.default_rng(seed).exponential(size=shape) ** 2
    return LineCells(LOWER, UPPER, mass / mass.sum())


def directions(count: int, seed: int) -> np.ndarray:
    d = np.random.default_rng(seed).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def along(density: LineDensity, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    return np.array(density.along(mi.Point3f(o.T), mi.Vector3f(d.T), mi.Bool(True)), np.float64)


def brute_force(c: LineCells, o: np.ndarray, d: np.ndarray, reach: float = 12.0, steps: int = 20_000) -> np.ndarray:
    """Sums of the density of points at many points of each line."""
    counts, result = np.array(c.mass.shape), np.zeros(len(o))
    size = (c.upper - c.lower) / counts
    for t in (np.arange(steps) + 0.5) / steps * 2 * reach - reach:
        index = np.floor((o + t * d - c.lower) / size).astype(int)
        inside = ((index >= 0) & (index < counts)).all(axis=1)
        result[inside] += c.mass[tuple(index[inside].T)] / size.prod()
    return result * (2 * reach / steps)


def test_the_density_is_the_integral_along_the_line():
    random = np.random.default_rng(2)
    o = random.uniform(LOWER - 2.0, UPPER + 2.0, (200, 3))
    d = directions(200, 3)
    c = cells()
    expected = brute_force(c, o, d)
    assert (expected > 0).sum() > 30
    np.testing.assert_allclose(along(LineDensity(c), o, d), expected, rtol=5e-3, atol=2e-3 * expected.max())


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", (-1.0, 1.0))
@pytest.mark.parametrize("zero", (0.0, -0.0))
def test_lines_along_the_axes(axis, sign, zero):
    """Along an axis, the density of the line is the mass of a column over the area of its face, also on far lines."""
    c = cells()
    counts = np.array(c.mass.shape)
    size = (UPPER - LOWER) / counts
    others = [a for a in range(3) if a != axis]
    column = c.mass.sum(axis=axis)
    places = np.stack(np.meshgrid(*(np.arange(counts[a]) for a in others), indexing="ij"), -1).reshape(-1, 2)
    o = np.zeros((len(places), 3))
    o[:, others] = LOWER[others] + (places + 0.3) * size[others]
    o[:, axis] = 100.0
    d = np.full_like(o, zero)
    d[:, axis] = sign
    found = along(LineDensity(c), o, d)
    steps = 4 * 2.0**-23 / size[others].prod()  # masses are multiples of 2^-23
    np.testing.assert_allclose(found, column[tuple(places.T)] / size[others].prod(), rtol=1e-4, atol=steps)
    o[:, others[0]] = UPPER[others[0]] + 0.01
    assert not along(LineDensity(c), o, d).any()


@pytest.mark.parametrize("zero", (0.0, -0.0, 1e-20, -1e-20))
def test_lines_in_the_coordinate_planes(zero):
    d = np.array([[0.6, zero, 0.8], [zero, 0.6, -0.8], [-0.6, -0.8, zero], [zero, -1.0, zero]]).repeat(50, 0)
    o = np.random.default_rng(8).uniform(LOWER, UPPER, d.shape)
    c = cells()
    np.testing.assert_allclose(along(LineDensity(c), o, d), brute_force(c, o, d), rtol=1e-2, atol=1e-3)


def test_it_integrates_to_one_over_a_disc():
    c, count = cells(), 400
    for d in directions(4, 5):
        s = np.cross(d, [0.6, 0.8, 0.0])
        s /= np.linalg.norm(s)
        t = np.cross(d, s)
        x, y = (a.ravel()[:, None] for a in np.meshgrid(*[(np.arange(count) + 0.5) / count * 6 - 3] * 2))
        o = 0.5 * (LOWER + UPPER) + x * s + y * t
        total = along(LineDensity(c), o, np.broadcast_to(d, o.shape)).sum() * (6 / count) ** 2
        assert total == pytest.approx(1.0, abs=5e-3)


def test_samples_have_the_density():
    c, n = cells(), 1 << 18
    random = np.random.default_rng(7)
    numbers = [mi.Float(random.random(n, dtype=np.float32)) for _ in range(4)]
    p = np.array(LineDensity(c).sample(numbers[0], mi.Point3f(*numbers[1:]), mi.Bool(True))).T
    assert (p >= LOWER - 1e-5).all() and (p <= UPPER + 1e-5).all()
    # Twice as fine as the cells, so that the place in the cell is tested, too.
    counts = 2 * np.array(c.mass.shape)
    seen = np.histogramdd(p, bins=counts, range=list(zip(LOWER, UPPER, strict=True)))[0]
    expected = c.mass.repeat(2, 0).repeat(2, 1).repeat(2, 2) / 8
    assert stats.chisquare(seen.ravel(), expected.ravel() * n).pvalue > 1e-5


def through_hole(count: int, seed: int = 1, others: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Lines through a square of side 0.4 in the wall x = 0 of a box of side 20; a share of ``others`` anywhere."""
    random = np.random.default_rng(seed)
    d = directions(count, seed + 1)
    p = np.stack([np.zeros(count), *random.uniform(-0.2, 0.2, (2, count))], -1)
    anywhere = random.random(count) < others
    p[anywhere] = random.uniform(-10.0, 10.0, (anywhere.sum(), 3))
    return p + random.uniform(-3.0, 3.0, (count, 1)) * d, d


BOX = np.full(3, -10.0), np.full(3, 10.0)
EVEN = 1.0 / (np.pi * 300.0)  # on the disc around it


def test_a_hole_is_found():
    o, d = through_hole(4000)
    found, gain = fit_lines(o, d, np.ones(4000), *BOX, share=0.75, even=EVEN)
    assert (found.upper - found.lower).max() < 6.0  # it looks closer at the hole
    # Other lines through the hole have many times their even density, as it says of those that it has seen.
    o, d = through_hole(2000, seed=50)
    likelier = 0.75 * along(LineDensity(found), o, d) / EVEN + 0.25
    through = np.abs(o - d * (o[:, :1] / d[:, :1])).max(axis=1) < 0.2
    assert np.exp(np.log(likelier[through]).mean()) > 200.0
    assert np.log(likelier).mean() == pytest.approx(np.log(gain), abs=0.3)


def test_a_line_counts_by_its_weight():
    """Lines of two holes; those of the second have no weight."""
    o, d = through_hole(4000, others=0.0)
    second = np.arange(4000) % 4 >= 2
    o[second] += [6.0, 6.0, -6.0]
    found, _ = fit_lines(o, d, np.where(second, 0.0, 1.0), *BOX, share=0.75, even=EVEN)
    density = along(LineDensity(found), o, d)
    assert np.median(density[~second]) > 100.0 * np.median(density[second])


def test_nothing_is_found_where_nothing_is():
    random = np.random.default_rng(3)
    o, d = random.uniform(-10.0, 10.0, (4000, 3)), directions(4000, 4)
    _, gain = fit_lines(o, d, np.ones(4000), *BOX, share=0.75, even=EVEN)
    whole = along(LineDensity(LineCells(*BOX, np.ones((1, 1, 1)))), o, d)  # of the box, which is smaller than its disc
    assert gain == pytest.approx(np.exp(np.log(0.75 * whole / EVEN + 0.25).mean()), rel=0.03)


def test_few_lines_are_refused():
    for count, weight in ((100, 1.0), (4000, 0.0)):
        assert fit_lines(*through_hole(count), np.full(count, weight), *BOX, share=0.75, even=EVEN) is None


def test_another_density_needs_no_new_kernel():
    def kernels(density: LineDensity) -> set[str]:
        # Made anew: a loop leaves literals of its arguments as variables, which is another kernel.
        o, d = mi.Point3f(dr.opaque(mi.Float, 0.0, 101)), mi.Vector3f(dr.opaque(mi.Float, 0.6, 101), 0.0, 0.8)
        dr.kernel_history_clear()
        dr.eval(density.along(o, d, mi.Bool(True)))
        of_lines = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT and one["size"] == 101]
        return {one["hash"] for one in of_lines}

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        first = kernels(LineDensity(cells(1)))
        assert first and kernels(LineDensity(cells(2, (3, 7, 4)))) == first


def test_a_flat_box():
    """Lines through the points of a square."""
    random = np.random.default_rng(6)
    o, d = random.uniform(-1.0, 1.0, (2000, 3)) * [1.0, 1.0, 0.0], directions(2000, 7)
    lower, upper = np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 0.0])
    found, gain = fit_lines(o, d, np.ones(2000), lower, upper, share=0.75, even=1.0 / (np.pi * 2.0))
    assert np.isfinite(found.mass).all() and np.isfinite(gain)
    assert np.isfinite(along(LineDensity(found), o, d)).all()
