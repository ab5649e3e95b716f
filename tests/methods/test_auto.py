"""The probe's arithmetic, and that what it chose is what renders."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support import scenes
from support.running import go, prepared

from etendue.core import Iterations, Measurement, Pass
from etendue.methods import auto
from etendue.methods.auto import CANDIDATES, choose, costs

SIZE = (16, 16, 3)


def measured(pictures, first=0):
    """Measurements of some passes, each given as a picture."""
    return [
        Measurement({"image": p.copy()}, {"image": 1.0}, Iterations.single(i), {"image": np.square(p)})
        for i, p in enumerate(pictures, first)
    ]


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


class Clock:
    """Time that passes only where a candidate is prepared or steps: seconds by name, (start, pass)."""

    def __init__(self, monkeypatch, taking):
        self.now, self.steps, self._taking = 0.0, [], taking
        monkeypatch.setattr(auto, "time", SimpleNamespace(perf_counter=lambda: self.now))
        monkeypatch.setattr(auto.Auto, "_method", lambda _, name: self.candidate(name))

    def candidate(self, name):
        clock, (start, seconds) = self, self._taking[name]
        noise = {"path": 0.3, "bpt": 0.2, "bpt with 6 connections": 0.15, "vcm": 0.02}[name]

        class Candidate:
            def prepare(self, problem, seed):
                clock.now += start

            def start(self):
                return {}

            def step(self, iteration, seed, state):
                clock.now += seconds
                clock.steps.append((name, iteration))
                random = np.random.default_rng((iteration, seed))
                return Pass(measured([np.ones(SIZE) + noise * random.standard_normal(SIZE)], iteration)[0], state)

        return Candidate()


#: Seconds of preparation and of a pass, on a small film and on a large one.
TAKES = {"path": (0.1, 0.1), "bpt": (0.5, 0.2), "vcm": (0.6, 0.3), "bpt with 6 connections": (0.8, 0.35)}
LARGE = {name: (start, 10.0 * seconds) for name, (start, seconds) in TAKES.items()}
COLD = {name: (8.0 * start, seconds) for name, (start, seconds) in TAKES.items()}


def planned(seconds=None, passes=None, error=None, problem=None, **settings):
    runner = prepared(problem or scenes.room("sphere", "specular"), "auto", samples_per_pass=4, **settings)
    runner.plan(seconds, passes, error)
    return runner


@pytest.mark.parametrize("takes", [TAKES, LARGE, COLD], ids=["small", "large", "cold"])
@pytest.mark.parametrize("seconds", [5.0, 12.0, 30.0, 120.0])
def test_a_fifth_of_the_time_at_most_is_for_probing(takes, seconds, monkeypatch):
    """What is lost is all that is neither a pass of the picture nor what the choice takes to begin."""
    clock = Clock(monkeypatch, takes)
    runner = planned(seconds)
    passes = 0
    while not passes or clock.now < seconds:
        runner.step(passes, 1)
        passes += 1
    start, per_pass = takes[runner.state()["choice"]]
    assert clock.now - start - passes * per_pass <= 0.2 * seconds
    assert passes >= 0.7 * (seconds - start) / per_pass
    if seconds < 6.0:
        assert {name for name, _ in clock.steps} == {"path"}


def test_the_best_is_found_where_there_is_time(monkeypatch):
    Clock(monkeypatch, TAKES)
    runner = planned(60.0)
    runner.step(0, 1)
    state = runner.state()
    assert state["choice"] == "vcm"
    assert {"path", "bpt", "vcm"} <= state["costs"].keys()


def test_passes_of_the_probe_are_those_of_the_picture(monkeypatch):
    """Each pass of the choice is made once, and given out as the pass that it is."""
    clock = Clock(monkeypatch, TAKES)
    runner = planned(60.0)
    total = runner.step(0, 1)
    for iteration in range(1, 12):
        total += runner.step(iteration, 1)
    own = [iteration for name, iteration in clock.steps if name == "vcm"]
    assert own == list(range(12))
    assert len(total.iterations) == 12


def test_without_seconds_the_probe_is_bounded_by_the_work_predicted(monkeypatch):
    for budget, probes in (
        ({"passes": 20}, False),  # two seconds of path
        ({"passes": 1000}, True),
        ({"error": 0.02}, False),  # 0.09 / 1.01 a pass: five passes
        ({"error": 1e-4}, True),
        ({"passes": 50}, False),
    ):
        clock = Clock(monkeypatch, TAKES)
        planned(**budget).step(0, 1)
        assert ({name for name, _ in clock.steps} != {"path"}) == probes, budget


@pytest.mark.parametrize(
    ("lamp", "material", "choice"),
    [("point", "specular", "bpt"), ("point", ("roughconductor",), "path"), ("rectangle", "specular", "path")],
)
def test_what_only_light_paths_find_is_not_left_to_path(lamp, material, choice, monkeypatch):
    """A point light and glass: path tracing sees no caustic, however long it runs."""
    Clock(monkeypatch, TAKES)
    runner = planned(5.0, problem=scenes.room(lamp, material))
    runner.step(0, 1)
    assert runner.state()["choice"] == choice


@pytest.mark.parametrize(
    ("lamp", "material", "choice"),
    [("rectangle", "specular", "vcm"), ("rectangle", "rough", "path"), ("constant", "specular", "path")],
)
def test_caustics_are_expected_where_nothing_can_be_compared(lamp, material, choice, monkeypatch):
    """Cold kernels: vcm would take longer than a probe may."""
    Clock(monkeypatch, COLD)
    runner = planned(15.0, problem=scenes.room(lamp, material))
    runner.step(0, 1)
    assert runner.state()["choice"] == choice
    assert not runner.state()["costs"]


def test_a_film_whose_passes_would_fill_the_memory_is_not_probed(monkeypatch):
    clock = Clock(monkeypatch, TAKES)
    runner = planned(60.0)
    runner.problem.memory = 600 * runner.camera.pixels - 1
    runner.step(0, 1)
    assert set(clock.steps) == {("path", 0)}


def test_the_probe_and_its_state(monkeypatch):
    monkeypatch.setattr(auto, "_LEAST", 0.0)
    problem = scenes.room("sphere", "specular")
    runner = planned(1000.0, problem=problem, probe_passes=2)
    first = runner.step(0, 1)
    state = dict(runner.state())
    assert state["choice"] in CANDIDATES
    assert {"path", "bpt", "vcm"} <= set(state["costs"]) <= set(CANDIDATES)
    assert all(cost > 0 for cost in state["costs"].values())
    metadata = runner.develop(first).metadata
    assert metadata["chosen"] == state["choice"]
    cls, settings = CANDIDATES[state["choice"]]
    own = go(prepared(problem, cls.name, samples_per_pass=4, **settings), 3)
    probed = go(runner, 2, first=1).measurement + first
    np.testing.assert_allclose(probed.mean(), own.mean, rtol=1e-4, atol=1e-6)
    other = "vcm" if state["choice"] != "vcm" else "path"
    resumed = prepared(problem, "auto", samples_per_pass=4)
    resumed.restore(state | {"choice": other, "chosen": {}})  # no probe of its own
    assert resumed.step(1, 1).sums.keys() == first.sums.keys()
    assert resumed.state()["choice"] == other
