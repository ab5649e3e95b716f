"""Discrepancies against known values and brute force; and the demonstrations of what goes wrong."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from scipy.stats import qmc

from etendue.points import (
    ExactPiPowers,
    FaureBlockHalton,
    FaureHalton,
    Halton,
    Hammersley,
    Independent,
    OwenSobol,
    PiPowers,
    PointSetError,
    Sobol,
    Weyl,
    consecutive,
    l2_discrepancy,
    net_parameter,
    star_discrepancy,
    star_discrepancy_bounds,
    uniformity_score,
)


def brute_force(points: np.ndarray) -> float:
    """All boxes whose upper corner has coordinates of the points, or 1."""
    n, d = points.shape
    worst = 0.0
    for corner in itertools.product(*(np.append(points[:, j], 1.0) for j in range(d))):
        volume = np.prod(corner)
        closed, inside = (points <= corner).all(1).sum() / n, (points < corner).all(1).sum() / n
        worst = max(worst, closed - volume, volume - inside)
    return worst


@pytest.mark.parametrize(("n", "d"), [(1, 1), (9, 1), (12, 2), (7, 3), (5, 4)])
@pytest.mark.parametrize("grid", [0, 4])
def test_star_discrepancy_by_brute_force(n, d, grid):
    """Also where coordinates are equal."""
    for seed in range(4):
        points = np.random.default_rng(seed).random((n, d))
        points = np.floor(points * grid) / grid if grid else points
        assert star_discrepancy(points) == pytest.approx(brute_force(points), abs=1e-12)


def test_star_discrepancies_that_are_known():
    assert star_discrepancy([[0.5, 0.5]]) == 0.75
    assert star_discrepancy([[0.0, 0.0, 0.0]]) == 1.0
    assert star_discrepancy([[1.0, 1.0]]) == 1.0
    n = 20
    assert star_discrepancy((np.arange(n) + 0.5) / n) == pytest.approx(1 / (2 * n))
    assert star_discrepancy(np.arange(n) / n) == pytest.approx(1 / n)
    assert star_discrepancy(Halton(1).block(2**10)) == pytest.approx(2.0**-10)


@pytest.mark.parametrize(("n", "d"), [(300, 1), (200, 2), (60, 3)])
def test_bounds_hold(n, d):
    for points in (Independent(d, 1).block(n), Sobol(d).block(n)):
        exact = star_discrepancy(points)
        low, high = star_discrepancy_bounds(points)
        assert low - 1e-12 <= exact <= high + 1e-12
        rough = star_discrepancy_bounds(points, cells=6**d)
        assert rough[0] - 1e-12 <= exact <= rough[1] + 1e-12
        assert high - low <= rough[1] - rough[0]


def test_bounds_of_many_points_are_close():
    low, high = star_discrepancy_bounds(Halton(2).block(100_000))
    assert 1e-4 < low < high < low + 0.0015


@pytest.mark.parametrize(
    ("kind", "theirs", "square"),
    [("star", "L2-star", False), ("centered", "CD", True), ("wrap", "WD", True), ("mixture", "MD", True)],
)
@pytest.mark.parametrize(("n", "d"), [(1, 1), (40, 1), (1000, 3), (64, 8)])
def test_l2_discrepancies_are_those_of_scipy(kind, theirs, square, n, d):
    for points in (Independent(d, 2).block(n), OwenSobol(d, 2).block(n)):
        expected = qmc.discrepancy(points, method=theirs)
        # What is left of sums near (19/12)^d.
        assert l2_discrepancy(points, kind) ** 2 == pytest.approx(expected if square else expected**2, abs=1e-12)


def test_l2_star_discrepancy_of_independent_points():
    """Its square is (2^-d - 3^-d) / n on average."""
    n, d = 50, 2
    squares = [l2_discrepancy(Independent(d, seed).block(n), "star") ** 2 for seed in range(400)]
    expected = (2.0**-d - 3.0**-d) / n
    assert abs(np.mean(squares) - expected) < 4 * np.std(squares) / np.sqrt(len(squares))


def test_low_discrepancy():
    """Lower than that of independent points, and falling nearly as 1/n in two dimensions."""
    numbers = (64, 256, 1024)
    plain = [np.mean([star_discrepancy(Independent(2, s).block(n)) for s in range(5)]) for n in numbers]
    for points in (Halton(2), FaureHalton(2), FaureBlockHalton(2), Sobol(2), Weyl(2), OwenSobol(2, 1)):
        found = [star_discrepancy(points.block(n)) for n in numbers]
        assert all(ours < 0.6 * theirs for ours, theirs in zip(found, plain, strict=True))
        assert np.log(found[2] / found[0]) / np.log(16) < -0.7
    assert -0.65 < np.log(plain[2] / plain[0]) / np.log(16) < -0.35


@pytest.mark.slow
def test_points_of_lines_are_more_even_than_independent_ones():
    """4096 points of four dimensions: each pair of dimensions exactly, all four by the mean square over all boxes."""
    n, pairs = 4096, list(itertools.combinations(range(4), 2))

    def uneven(points):
        return [star_discrepancy(points[:, pair]) for pair in pairs], l2_discrepancy(points, "star")

    plain = [uneven(Independent(4, seed).block(n)) for seed in range(2)]
    least, least_all = np.min([slices for slices, _ in plain], axis=0), min(whole for _, whole in plain)
    for points in (Halton(4), Sobol(4), Weyl(4)):
        slices, whole = uneven(points.block(n))
        assert (slices < 0.6 * least).all() and whole < 0.5 * least_all, points


def test_pairs_of_large_primes_are_correlated_and_scrambling_cures_it():
    """100 points of dimensions 10 and 11, of which the thesis has a figure, and the far worse 30 and 31."""
    first, late, later = (0, 1), (10, 11), (30, 31)

    def uneven(points, pair):
        return star_discrepancy(points[:, pair])

    halton, scrambled = Halton(32).block(100), FaureHalton(32).block(100)
    assert uneven(halton, late) > 2 * uneven(halton, first)
    assert uneven(scrambled, late) < 0.7 * uneven(halton, late)
    assert uneven(scrambled, later) < 0.5 * uneven(halton, later)
    many = Halton(32).block(1000)
    assert np.corrcoef(many[:, 30], many[:, 31])[0, 1] > 0.4
    for cured in (FaureHalton(32), FaureBlockHalton(32), OwenSobol(32, 1)):
        assert abs(np.corrcoef(cured.block(1000)[:, later].T)[0, 1]) < 0.1


@pytest.mark.parametrize("points", [Halton(2), Sobol(2), Weyl(2)], ids=lambda p: p.name)
def test_consecutive_points_of_the_square_are_no_points_in_four_dimensions(points):
    """Two successive points of a 2-D sequence as the two ends of a line: each lies far from the one before."""
    n = 20_000
    stream = consecutive(points.block(2 * n), 4)
    assert stream.shape == (n, 4)
    assert uniformity_score(stream) > 50
    distance = np.linalg.norm(stream[:, :2] - stream[:, 2:], axis=1)
    assert distance.mean() > 0.54  # 0.5214 of independent points in a square
    proper = type(points)(4).block(n)
    assert uniformity_score(proper) < -5
    assert star_discrepancy_bounds(stream)[0] > 2 * star_discrepancy_bounds(proper)[0]


def test_a_mean_over_lines_is_wrong_by_consecutive_points():
    """The mean squared distance of two points of the square is 1/3; no number of points repairs it."""
    for n in (1000, 100_000):
        ends = consecutive(Halton(2).block(2 * n), 4)
        wrong = ((ends[:, :2] - ends[:, 2:]) ** 2).sum(1).mean()
        points = Halton(4).block(n)
        right = ((points[:, :2] - points[:, 2:]) ** 2).sum(1).mean()
        assert abs(wrong - 1 / 3) > 0.02 and abs(right - 1 / 3) < 5 / n


def test_uniformity_of_streams():
    """Independent numbers are k-uniform; U/2 and (1 + V)/2 in turn are 1-uniform only, and Halton's are not even that
    way 2-uniform."""
    n = 40_000
    stream = Independent(1, 5).block(n)
    for k in (1, 2, 3, 4):
        assert abs(uniformity_score(consecutive(stream, k))) < 4
        assert abs(uniformity_score(consecutive(Independent(2, 6).block(n), k))) < 4
    woven = np.stack([stream[: n // 2, 0] / 2, (1 + stream[n // 2 :, 0]) / 2], axis=1).ravel()
    assert abs(uniformity_score(consecutive(woven, 1))) < 4
    assert uniformity_score(consecutive(woven, 2)) > 50
    assert uniformity_score(consecutive(Halton(1).block(n), 1)) < -5
    assert uniformity_score(consecutive(Halton(1).block(n), 2)) > 50


def test_powers_of_pi():
    """With all their digits they pass for independent numbers in several dimensions, in doubles they are all one."""
    exact = ExactPiPowers(1, 4096).block(4096)
    for k in (1, 2, 3):
        assert abs(uniformity_score(consecutive(exact, k))) < 4
    assert star_discrepancy(ExactPiPowers(2, 4096).block(1024)) > 4 * star_discrepancy(Sobol(2).block(1024))
    assert star_discrepancy(PiPowers(2).block(1024)) > 0.9


def test_nets():
    assert net_parameter(Sobol(1).block(64)) == 0
    assert net_parameter(Halton(2).block(81)[:, 1:], base=3) == 0
    assert net_parameter(FaureHalton(3).block(125)[:, 2:], base=5) == 0
    assert net_parameter(np.zeros((16, 2))) == 4
    lattice = np.stack(np.meshgrid(np.arange(4) / 4, np.arange(4) / 4), -1).reshape(-1, 2)
    assert net_parameter(lattice) == 2  # no strip of 1/16 holds just one


@pytest.mark.parametrize("n", [50, 128, 500])
def test_points_keep_apart(n):
    """At least 1/n for Hammersley's points, 1/(2 n) for Halton's [Castro 2002]."""
    for points, least in ((Hammersley(4, n), 1 / n), (Halton(4), 0.5 / n)):
        x = points.block(n)
        distance = np.linalg.norm(x[:, None] - x[None], axis=2)
        assert distance[~np.eye(n, dtype=bool)].min() >= least


def test_overlapping_windows():
    np.testing.assert_array_equal(consecutive([1, 2, 3, 4], 2), [[1, 2], [3, 4]])
    np.testing.assert_array_equal(consecutive([1, 2, 3], 2, overlapping=True), [[1, 2], [2, 3]])


BAD = [
    (lambda: star_discrepancy(np.zeros((1000, 4))), "star_discrepancy_bounds"),
    (lambda: star_discrepancy(np.zeros((0, 2))), "at least one"),
    (lambda: star_discrepancy([[0.5, 1.5]]), "some are outside"),
    (lambda: l2_discrepancy([[0.5, np.nan]]), "not finite"),
    (lambda: l2_discrepancy([[0.5]], "centred"), "did you mean 'centered'"),
    (lambda: star_discrepancy_bounds(np.zeros((5, 30))), "use an L2 discrepancy"),
    (lambda: net_parameter(np.zeros((10, 2))), "a power of 2 points, not 10"),
    (lambda: net_parameter(np.zeros(8)), "not one of shape"),
    (lambda: consecutive([0.5], 2), "from 1 to the 1 numbers of the stream, not 2"),
    (lambda: uniformity_score(np.zeros((9, 30)), 2), "2^30 cubes"),
]


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input(call, message):
    with pytest.raises(PointSetError, match=re.escape(message)):
        call()
