"""The random numbers of chains: what is proposed, what is kept, and that uniform numbers stay uniform."""

from __future__ import annotations

from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from etendue.core import IndependentSource
from etendue.integration import Layout, Move, Slot
from etendue.integration.primary import STEP_RATIO, moved

CHAINS, VERTICES = 4096, 3
END = [Slot(0, 2), Slot(4, still=True)]
INNER = [Slot(0, decided=True), Slot(1, 2)]


@pytest.fixture
def layout():
    return Layout(END, INNER, VERTICES)


def move(step: int, size: float | None) -> Move:
    return Move(
        lambda number: IndependentSource(number, 1, "test", step), None if size is None else dr.opaque(mi.Float, size)
    )


def lanes():
    return dr.arange(mi.UInt32, CHAINS)


def written(layout, state, step, size, accepted=None):
    return move(step, size).write(layout, state, accepted, lanes(), CHAINS)


def test_rows(layout):
    assert layout.size == 3 + 3 * VERTICES
    rows = [layout.find(*key).row for key in ((True, 0), (True, 1), (True, 4), (False, 0), (False, 1), (False, 2))]
    assert rows == [0, 1, 2, 3, 3 + VERTICES, 3 + 2 * VERTICES]
    assert layout.find(True, 2) is None and layout.find(False, 3) is None


@pytest.mark.parametrize("size", [None, 0.1], ids=("large", "small"))
def test_the_kept_numbers_are_those_of_the_source(layout, size):
    """By a path tracer that asks for each of them twice, at vertices that differ from lane to lane."""
    state = written(layout, dr.zeros(mi.Float, layout.size * CHAINS), 0, None)
    after = np.array(written(layout, state, 1, size)).reshape(layout.size, CHAINS)
    source = move(1, size).source(layout, state, lanes(), CHAINS)
    vertex = lanes() % VERTICES + 1
    number = np.arange(CHAINS) % VERTICES
    for _ in range(2):
        np.testing.assert_array_equal(np.array(source.next_2d(0, 0)), after[:2])
        np.testing.assert_array_equal(np.array(source.next_1d(0, 4)), after[2])
        np.testing.assert_array_equal(np.array(source.decide(vertex, 0)), after[3 + number, np.arange(CHAINS)])
        second = after[3 + 2 * VERTICES + number, np.arange(CHAINS)]
        np.testing.assert_array_equal(np.array(source.next_2d(vertex, 1)[1]), second)
        np.testing.assert_array_equal(np.array(source.next_1d(vertex, 2)), second)


def test_numbers_without_a_place_are_fresh(layout):
    state = written(layout, dr.zeros(mi.Float, layout.size * CHAINS), 0, None)
    small, large = (move(1, size).source(layout, state, lanes(), CHAINS) for size in (0.01, None))
    for vertex, component in ((mi.UInt32(VERTICES + 1), 1), (mi.UInt32(1), 7), (0, 2)):
        np.testing.assert_array_equal(
            np.array(small.next_1d(vertex, component)), np.array(large.next_1d(vertex, component))
        )


def test_a_rejected_step_changes_nothing(layout):
    state = written(layout, dr.zeros(mi.Float, layout.size * CHAINS), 0, None)
    before = np.array(state).reshape(layout.size, CHAINS)
    accepted = lanes() % 2 == 0
    after = np.array(written(layout, state, 1, 0.1, accepted)).reshape(layout.size, CHAINS)
    np.testing.assert_array_equal(np.array(state).reshape(layout.size, CHAINS), before)
    np.testing.assert_array_equal(after[:, 1::2], before[:, 1::2])
    still = layout.find(True, 4).row
    np.testing.assert_array_equal(after[still], before[still])
    others = np.delete(np.arange(layout.size), still)
    assert (after[others][:, ::2] != before[others][:, ::2]).mean() > 0.99


def test_small_steps_are_symmetric_and_of_the_stated_lengths():
    u = (np.arange(1 << 16) + 0.5) / (1 << 16)
    step = np.array(moved(mi.Float(0.5), mi.Float(u), 0.2)) - 0.5
    np.testing.assert_allclose(np.sort(step[step > 0]), np.sort(-step[step < 0]), atol=1e-6)
    assert np.abs(step).max() == pytest.approx(0.2, rel=1e-3)
    assert np.abs(step).min() == pytest.approx(0.2 / STEP_RATIO, rel=1e-2)
    # The logarithm of the length is uniform.
    place = np.log(np.abs(step) / 0.2 * STEP_RATIO) / np.log(STEP_RATIO)
    np.testing.assert_allclose(np.quantile(place, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.01)


def test_uniform_numbers_stay_uniform(layout):
    """Under a constant target every proposal is accepted. From numbers in a corner, chi-square of each number alone and
    of pairs, after steps of which some are large."""
    state = dr.zeros(mi.Float, layout.size * CHAINS)
    for step in range(12):
        state = written(layout, state, step, None if step % 4 == 0 else 0.25)
    x = np.array(state).reshape(layout.size, CHAINS)
    assert x.min() >= 0.0 and x.max() < 1.0
    p = [stats.chisquare(np.histogram(row, 32, (0, 1))[0]).pvalue for row in x]
    p += [stats.chisquare(np.histogram2d(a, b, 8, [[0, 1]] * 2)[0].ravel()).pvalue for a, b in pairwise(x)]
    assert min(p) > 1e-4
