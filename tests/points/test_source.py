"""Radical inverses as random numbers of paths: the sequence, its randomisations, and where it ends."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from etendue.points import Halton, RadicalSource
from etendue.points.radical import primes
from etendue.transport import dimensions as dim

MAP = dim.CAMERA_COORDINATES
#: Vertex, component and coordinate: film, light choice and point, directions; the last of the eighth vertex.
PLACES = ((0, 0, 0), (0, 1, 1), (1, dim.NEXT_EVENT, 6), (1, dim.NEXT_EVENT + 2, 8), (3, 1, 19), (8, 2, 45))


def number(source, vertex, component):
    vertex = vertex if vertex == 0 else mi.UInt32(vertex)  # on the device, as in a walk
    return np.broadcast_to(np.array(source.next_1d(vertex, component), dtype=float), (COUNT,))


COUNT = 4096


@pytest.mark.parametrize("first", [0, (1 << 32) - 7000])
def test_a_shift_of_the_sequence(first):
    """The coordinate of the map, by NumPy, plus a constant."""
    index = dr.arange(mi.UInt32, COUNT) + mi.UInt32(first)
    source = RadicalSource(mi.UInt32(0), index, 1, "test", MAP, digits=False)
    for vertex, component, place in PLACES:
        exact = Halton(46).coordinate(np.array(index), place)
        shift = (number(source, vertex, component) - exact) % 1
        assert abs((shift - shift[0] + 0.5) % 1 - 0.5).max() < 1e-6


@pytest.mark.parametrize("digits", [False, True])
def test_strata(digits):
    """b^k consecutive points have one in each of b^k intervals, by maps of digits; by a shift up to the border."""
    source = RadicalSource(mi.UInt32(3), dr.arange(mi.UInt32, COUNT), 2, "test", MAP, digits=digits)
    for vertex, component, place in PLACES:
        base = primes(46)[place]
        cells = max(base**k for k in range(1, 13) if base**k <= COUNT)
        x = number(source, vertex, component)[:cells]
        counts = np.bincount((x * cells + 1e-3).astype(int) % cells, minlength=cells)
        assert (counts == 1).all() if digits else counts.max() <= 2
        assert x.min() >= 0 and x.max() < 1


@pytest.mark.parametrize("digits", [False, True])
def test_every_number_is_uniform_over_pixels_and_seeds(digits):
    """Two points of many pixels: each is uniform, so that pictures are unbiased."""
    for index in (0, 5):
        source = RadicalSource(
            dr.arange(mi.UInt32, COUNT), dr.full(mi.UInt32, index, COUNT), 4, "test", MAP, digits=digits
        )
        for vertex, component, _ in PLACES:
            assert stats.kstest(number(source, vertex, component), "uniform").pvalue > 1e-4
    one = [
        number(RadicalSource(mi.UInt32(0), mi.UInt32(5), seed, "test", MAP, digits=digits), 1, 1)[0]
        for seed in range(50)
    ]
    assert stats.kstest(one, "uniform").pvalue > 1e-4


def test_hammersley_has_even_points_and_the_primes_move_on():
    index = dr.arange(mi.UInt32, 1000)
    source = RadicalSource(mi.UInt32(0), index, 1, "test", MAP, digits=False, size=1000)
    x = np.sort(np.array(source.next_1d(0, 0), dtype=float))
    np.testing.assert_allclose(np.diff(x), 1e-3, atol=2e-7)
    exact = Halton(1).coordinate(np.array(index), 0)
    shift = (np.array(source.next_1d(0, 1), dtype=float) - exact) % 1
    assert abs((shift - shift[0] + 0.5) % 1 - 0.5).max() < 1e-6


def test_beyond_the_map_numbers_are_independent():
    """Decisions, other components, and vertices from the ninth on."""
    source = RadicalSource(mi.UInt32(0), dr.arange(mi.UInt32, COUNT), 1, "test", MAP)
    for vertex, component in ((9, 1), (9, dim.NEXT_EVENT), (1, dim.NEXT_EVENT + 4)):
        x = number(source, vertex, component)
        np.testing.assert_array_equal(x, np.array(source.decide(mi.UInt32(vertex), component), dtype=float))
        counts = np.bincount((x * 64).astype(int), minlength=64)
        assert 1e-4 < stats.chisquare(counts).pvalue < 1 - 1e-4
    u, v = (np.array(x) for x in source.next_2d(mi.UInt32(9), 1))
    assert abs(np.corrcoef(u, v)[0, 1]) < 4 / np.sqrt(COUNT)
