"""The points are Sobol's, scrambled as nets must be, and independent from draw to draw."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from etendue.core import IndependentSource
from etendue.points import OwenSobolSource, sobol_2d


def square(n: int, component: int = 5, sequence: int = 3, first: int = 0, seed: int = 1) -> np.ndarray:
    """``n`` points of one draw, (n, 2)."""
    index = dr.arange(mi.UInt32, n) + first
    source = OwenSobolSource(mi.UInt32(sequence), index, seed, "test")
    return np.stack([np.asarray(u, np.float64) for u in source.next_2d(mi.UInt32(2), component)], -1)


def line(n: int, component: int = 5, first: int = 0) -> np.ndarray:
    source = OwenSobolSource(mi.UInt32(3), dr.arange(mi.UInt32, n) + first, 1, "test")
    return np.asarray(source.next_1d(mi.UInt32(2), component), np.float64)


def test_the_second_dimension_is_that_of_sobol():
    ours = np.asarray(sobol_2d(dr.brev(dr.arange(mi.UInt32, 256))), np.float64) / 2**32
    theirs = qmc.Sobol(2, scramble=False).random(256)  # in the order of Gray's code
    gray = np.arange(256) ^ (np.arange(256) >> 1)
    np.testing.assert_array_equal(ours[gray], theirs[:, 1])


@pytest.mark.parametrize("first", [0, 256, 3 * 256])
def test_every_elementary_interval_holds_one_point(first):
    """A (0, 8, 2)-net, at any aligned place of the sequence."""
    points = square(256, first=first)
    for across in range(9):
        cells = np.floor(points * [2**across, 2 ** (8 - across)]).astype(int)
        assert len(np.unique(cells[:, 0] * 1024 + cells[:, 1])) == 256
    assert len(np.unique(np.floor(line(256, first=first) * 256))) == 256


def test_single_numbers_are_uniform():
    """Over the scrambles, each point is uniform."""
    sequence = dr.arange(mi.UInt32, 20_000)
    for index in (0, 1, 77):
        source = OwenSobolSource(sequence, mi.UInt32(index), 1, "test")
        for u in (*source.next_2d(mi.UInt32(1), 0), source.next_1d(mi.UInt32(1), 3)):
            assert stats.kstest(np.asarray(u), "uniform").pvalue > 1e-4


def test_draws_and_sequences_are_independent():
    """Padding: the pair (draw a, draw b) is as even as independent numbers, no more and no less."""
    n = 4096
    a = square(n)
    for other in (square(n, component=7), square(n, sequence=4), square(n, seed=2)):
        for x in (0, 1):
            for y in (0, 1):
                assert abs(np.corrcoef(a[:, x], other[:, y])[0, 1]) < 4.5 / np.sqrt(n)
                counts, _, _ = np.histogram2d(a[:, x], other[:, y], bins=16, range=[[0, 1], [0, 1]])
                assert stats.chisquare(counts.ravel()).pvalue > 1e-4


def test_a_smooth_integral_is_estimated_better_than_by_independent_numbers():
    """Mean squared error over scrambles: ~1/n^3 for a smooth function against 1/n."""
    n, repeats = 64, 200
    lane = dr.arange(mi.UInt32, n * repeats)

    def error(source):
        u, v = (np.asarray(x, np.float64).reshape(repeats, n) for x in source.next_2d(mi.UInt32(1), 0))
        return ((np.sin(np.pi * u) * np.exp(v)).mean(1) - 2 / np.pi * (np.e - 1)).std()

    owen = error(OwenSobolSource(lane // n, lane % n, 1, "test"))
    plain = error(IndependentSource(lane, 1, "test", 0))
    assert owen < 0.1 * plain


def test_a_component_beyond_the_last():
    with pytest.raises(ValueError, match="component 64"):
        square(4, component=64)
