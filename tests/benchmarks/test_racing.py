"""Races: methods take turns, each for the same time or samples, and only their passes count."""

from __future__ import annotations

import importlib
import types

import numpy as np
import pytest


@pytest.fixture
def racing():
    return importlib.import_module("benchmarks.racing")


class Fake:
    """A method whose passes take a known time and show their number."""

    samples_per_iteration = 4

    def __init__(self, clock, cost):
        self.clock, self.cost, self.turns = clock, cost, []

    def start(self):
        return {}

    def step(self, iteration, seed, state):
        self.clock.now += self.cost
        self.turns.append(iteration)
        return types.SimpleNamespace(measurement=FakeMeasurement([iteration]), state=state)

    def develop(self, measurement, state):
        self.clock.now += 100.0  # looking at the picture is nobody's time
        return types.SimpleNamespace(image=np.full((2, 2, 3), float(len(measurement.iterations))))


class FakeMeasurement:
    def __init__(self, iterations):
        self.iterations = iterations

    def __add__(self, other):
        return FakeMeasurement(self.iterations + other.iterations)


@pytest.fixture
def fakes(racing, monkeypatch):
    clock = types.SimpleNamespace(now=0.0)
    monkeypatch.setattr(racing, "time", types.SimpleNamespace(perf_counter=lambda: clock.now))
    return {"slow": Fake(clock, 3.0), "quick": Fake(clock, 1.0)}


def entrants(fakes):
    return [types.SimpleNamespace(label=k, prepared=lambda problem, seed, v=v: v) for k, v in fakes.items()]


def test_a_race_gives_each_the_same_time(racing, fakes):
    tracks = racing.race(None, entrants(fakes), np.zeros((2, 2, 3)), [3.0, 6.0, 12.0])
    assert [p.seconds for p in tracks["slow"]] == [3.0, 6.0, 12.0] == [p.seconds for p in tracks["quick"]]
    assert [p.passes for p in tracks["slow"]] == [1, 2, 4]
    assert [p.rms for p in tracks["quick"]] == pytest.approx([3.0, 6.0, 12.0])
    assert fakes["slow"].turns == [0, 0, 1, 2, 3], "one pass to warm up, then each once"


def test_a_race_gives_each_the_same_samples(racing, fakes):
    seen = []

    def look(label, mark, image):
        seen.append((label, mark, float(image.mean())))

    tracks = racing.race(None, entrants(fakes), np.zeros((2, 2, 3)), [2, 4, 12], (0, 1), by="samples", look=look)
    for cost, points in zip((3.0, 1.0), tracks.values(), strict=True):
        assert [p.samples for p in points] == [4, 4, 12]
        assert [p.seconds for p in points] == [cost, cost, 3 * cost]
    expected = [("slow", 1, 1.0), ("quick", 1, 1.0), ("slow", 2, 3.0), ("quick", 2, 3.0)]
    assert seen == expected, "the first seed's pictures, at the last mark that a pass reaches"


def test_paths_are_as_long_as_the_scene_says(racing):
    from etendue import scene

    def depth(settings, source):
        entrant = racing.Entrant("path", "path", settings)
        return entrant.prepared(scene.load(source, size=(4, 4)), 0).settings.max_depth

    box = scene.bundled_scene("cornell-box").build()
    assert depth({}, box) == box["integrator"]["max_depth"] > 0, "as of api.render, which makes the references"
    assert depth({"max_depth": 2}, box) == 2
    del box["integrator"]
    assert depth({}, box) == -1


def test_seeds_are_averaged_and_ranked(racing):
    points = [racing.Point(1.0, 4.0, 0.3, 0.1), racing.Point(1.2, 6.0, 0.4, 0.2)]
    mean = racing._mean(points)
    assert (mean.seconds, mean.passes) == (pytest.approx(1.1), 5.0)
    assert mean.rms == pytest.approx(np.sqrt(0.125)) and mean.untrimmed == pytest.approx(np.sqrt(0.025))
    # Squares .09 and .16: their mean has a standard error of .035, and its root one of .035 / (2 sqrt(.125)).
    assert mean.error == pytest.approx(0.035 / (2.0 * np.sqrt(0.125)))
    assert (mean.text, points[0].text) == ("0.3536 ± 0.0495", "0.3000")
    tracks = {"a": points, "b": [points[1], points[0]], "c": [racing.Point(1.0, 1.0, 0.305, 0.5)] * 2}
    assert racing.order(tracks, 0) == "a ≈ c < b"


def test_the_order_says_only_what_the_seeds_can_tell(racing):
    def track(rms, error):
        return [racing.Point(1.0, 4.0, rms, rms, error=error)]

    tracks = {"a": track(0.30, 0.01), "b": track(0.32, 0.01), "c": track(0.36, 0.01)}
    assert racing.order(tracks, 0) == "a ≈ b < c", "twice the error of a difference is 0.028"


def test_marks_double(racing):
    assert racing.marks(16.0, 3) == [4.0, 8.0, 16.0]
