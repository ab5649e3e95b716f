"""Equal-time and equal-error tables are what the curves say, and nothing where they say nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from etendue.display import Series, convergence_plot
from etendue.display.report import Reached, equal_errors, equal_times, error_at, over_seeds, time_to


def power(name, scale, times, rate=1.0):
    return Series(name, [(t, scale * t**-rate) for t in times])


def test_between_points_errors_fall_by_a_power_of_time():
    curve = power("a", 8.0, (1.0, 4.0, 64.0), 0.7)
    for t in (1.0, 2.5, 17.0, 64.0):
        assert error_at(curve, t) == pytest.approx(8.0 * t**-0.7)
        reached = time_to(curve, 8.0 * t**-0.7)
        assert reached.seconds == pytest.approx(t)
    assert math.isnan(error_at(curve, 0.9)) and math.isnan(error_at(curve, 65.0))


def test_nothing_is_claimed_beyond_a_curve():
    curve = power("a", 1.0, (2.0, 8.0))
    assert time_to(curve, 0.1) == Reached(8.0, ">")
    assert time_to(curve, 0.9) == Reached(2.0, "<")
    assert time_to(Series("empty", [(0.0, 1.0), (1.0, float("nan"))]), 0.5) is None


def test_a_lucky_dip_is_not_an_error_reached():
    curve = Series("a", [(1.0, 1.0), (2.0, 0.01), (4.0, 0.5), (16.0, 0.125)])
    assert time_to(curve, 0.25).seconds == pytest.approx(8.0)


def test_tables_compare_where_all_curves_are():
    """An error of 1/t against one of 4/t: a quarter of the error at the same time, a quarter of the time."""
    fast, slow = power("fast", 1.0, (1.0, 10.0, 64.0)), power("slow", 4.0, (1.5, 9.0, 80.0))
    columns = equal_times([fast, slow])
    assert [c.heading for c in columns] == ["after 8.0 s", "after 16 s", "after 32 s", "after 64 s"]
    assert columns[-1].texts == ["0.0156", "0.0625"] and {c.best for c in columns} == {0}
    first, last = equal_errors([fast, slow])
    assert first.heading == "to 0.0500" and first.texts == ["20 s (×4.0)", "80 s"] and first.best == 0
    assert last.heading == "to 0.0156" and last.texts == ["64 s", "not in 80 s"]
    assert equal_times([fast]) == equal_errors([fast]) == []
    assert equal_times([fast, Series("none", [])]) == []


def test_seeds_give_a_mean_and_its_error():
    rng = np.random.default_rng(5)
    times = 2.0 ** np.arange(6)
    scales = rng.uniform(0.5, 1.5, 7)
    curves = [power(str(k), scale, times) for k, scale in enumerate(scales)]
    rows = over_seeds(curves)
    assert [t for t, _, _ in rows] == pytest.approx(times)
    for t, mean, error in rows:
        assert mean == pytest.approx(scales.mean() / t)
        assert error == pytest.approx(scales.std(ddof=1) / math.sqrt(7) / t)
    later = power("later", 1.0, (3.0, 36.0))
    assert [t for t, _, _ in over_seeds([curves[0], later])] == pytest.approx([4.0, 8.0, 16.0, 34.0])
    svg = convergence_plot([Series("mean", rows)])
    assert svg.count("<circle") == 6 and "± " in svg and 'stroke-opacity=".7"' in svg
