"""The probe's arithmetic, and that what it chose is what renders."""

from __future__ import annotations

import numpy as np
import pytest
from support import scenes
from support.running import go, prepared

from etendue.core import Iterations, Measurement
from etendue.methods.auto import CANDIDATES, choose, costs

SIZE = (16, 16, 3)


def measured(pictures):
    """A measurement of some passes, each given as a picture."""
    total = None
    for iteration, picture in enumerate(pictures):
        one = Measurement(
            {"image": picture.copy()}, {"image": 1.0}, Iterations.single(iteration), {"image": np.square(picture)}
        )
        total = one if total is None else total + one
    return total


def noisy(mean, deviation, seed, passes=6):
    random = np.random.default_rng(seed)
    return measured([mean + deviation * random.standard_normal(SIZE) for _ in range(passes)])


def test_cost_is_time_times_error():
    flat = np.ones(SIZE)
    passes = {"slow": noisy(flat, 0.1, 1), "fast": noisy(flat, 0.1, 2), "exact": noisy(flat, 0.02, 3)}
    cost = costs({"slow": 2.0, "fast": 1.0, "exact": 4.0}, passes)
    # Error of a pass: variance / (mean^2 + 0.01); the estimate of a variance from 768 x 6 numbers is good to 3 %.
    assert cost["slow"] == pytest.approx(2.0 * 0.01 / 1.01, rel=0.15)
    assert cost["fast"] == pytest.approx(1.0 * 0.01 / 1.01, rel=0.15)
    assert cost["exact"] == pytest.approx(4.0 * 0.0004 / 1.01, rel=0.15)


def test_light_that_was_missed_counts():
    """A quarter of the picture has a caustic that one candidate has not found: a long run will not find it either."""
    lit = np.ones(SIZE)
    lit[:8, :8] += 3.0
    cost = costs({"blind": 1.0, "seeing": 1.0}, {"blind": noisy(np.ones(SIZE), 0.01, 1), "seeing": noisy(lit, 0.3, 2)})
    assert cost["blind"] == pytest.approx(64 * 0.25 * 9 / 16, rel=0.05)
    assert cost["seeing"] < 0.02 * cost["blind"]


def test_one_bright_sample_is_not_missed_light():
    flat = np.ones(SIZE)
    firefly = [flat.copy() for _ in range(6)]
    firefly[2][5, 5] = 500.0
    cost = costs({"plain": 1.0, "speckled": 1.0}, {"plain": noisy(flat, 0.1, 1), "speckled": measured(firefly)})
    assert cost["plain"] == pytest.approx(0.01 / 1.01, rel=0.15)
    assert cost["speckled"] > 10 * cost["plain"]


def test_the_simpler_one_unless_it_is_worth_it():
    assert choose({"path": 1.0, "bpt": 0.95, "vcm": 0.92}) == "path"
    assert choose({"path": 1.0, "bpt": 0.85, "vcm": 0.8}) == "bpt"
    assert choose({"path": 1.0, "bpt": 0.85, "vcm": 0.1}) == "vcm"


@pytest.mark.parametrize("name", CANDIDATES)
def test_what_was_chosen_is_what_renders(name):
    problem = scenes.room("rectangle", "rough")
    cls, settings = CANDIDATES[name]
    auto = go(prepared(problem, "auto", choice=name, samples_per_pass=4), 2)
    own = go(prepared(problem, cls.name, samples_per_pass=4, **settings), 2)
    np.testing.assert_allclose(auto.mean, own.mean, rtol=1e-5, atol=1e-7)


def test_the_probe_and_its_state():
    problem = scenes.room("sphere", "specular")
    runner = prepared(problem, "auto", samples_per_pass=4)
    first = runner.step(0, 1)
    state = dict(runner.state())
    assert state["choice"] in CANDIDATES
    assert {"path", "bpt", "vcm"} <= set(state["costs"]) <= set(CANDIDATES)
    assert all(cost > 0 for cost in state["costs"].values())
    metadata = runner.develop(first).metadata
    assert metadata["chosen"] == state["choice"]
    other = "vcm" if state["choice"] != "vcm" else "path"
    resumed = prepared(problem, "auto", samples_per_pass=4)
    resumed.restore(state | {"choice": other})  # no probe of its own
    assert resumed.step(1, 1).sums.keys() == first.sums.keys()
    assert resumed.state()["choice"] == other
