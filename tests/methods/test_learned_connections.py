"""Connections that learn which light vertices matter: how they are drawn, and pictures that this must not change."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, replicas
from support.statistics import assert_agree

from etendue.core import CheckpointError, IndependentSource
from etendue.scene import load
from etendue.transport import CLASSES, ConnectionGuide, ConnectionSums, LearnedConnections

LEARNS = {"guide_connections": True}


def sums(classes: list[int]) -> ConnectionSums:
    """Of connections between some classes, of which one pair contributes a hundred times as much as the others."""
    made = ConnectionSums.zero()
    made.vertices[classes] = 100 * (1 + np.arange(len(classes)))
    for camera in classes:
        for light in classes:
            made.count[camera * CLASSES + light] = 1000
            made.square[camera * CLASSES + light] = 1e6 if (camera, light) == tuple(classes[:2]) else 100 + camera
    return made


def test_draws_have_the_probabilities_that_they_state():
    """Each class is drawn as often as the stated ratios say, whatever a pass holds; and the class that contributes is
    drawn most, where it does."""
    guide, classes = ConnectionGuide([0, 0, 0], [1, 1, 1]), [3, 70, 161]
    guide.learn(sums(classes))
    lanes = 1 << 18
    source = IndependentSource(dr.arange(mi.UInt32, lanes), 1, "test", 0)
    held = np.zeros(CLASSES, int)
    held[classes] = 500, 20, 100  # not what was expected
    count = held.sum()
    for camera in (*classes, 5):
        every, chosen = guide.draw(mi.UInt32(camera), source.next_1d(1, camera % 8), mi.Bool(True))
        every, chosen = np.array(every), np.array(chosen)
        drawn = np.bincount(chosen[~every], minlength=CLASSES) / lanes
        for light in classes:
            share, _ = guide.pair(mi.UInt32(camera), mi.UInt32(light))
            stated = guide.ratio(share, mi.UInt32(int(held[light])), mi.UInt32(int(count)))[0] * held[light] / count
            found = every.mean() * held[light] / count + drawn[light]
            assert found == pytest.approx(stated, abs=5.0 * np.sqrt(stated / lanes)), (camera, light)
        if camera == classes[0]:
            assert drawn[classes[1]] > 0.7
    # Expected ratios times expected shares are probabilities.
    ratios = [guide.pair(mi.UInt32(classes[0]), mi.UInt32(light))[1][0] for light in classes]
    assert np.dot(ratios, np.array([1, 2, 3]) / 6) == pytest.approx(1.0, abs=1e-5)


def test_before_it_has_learned_the_choice_is_uniform():
    guide = ConnectionGuide([0, 0, 0], [1, 1, 1])
    every, _ = guide.draw(mi.UInt32([0, 1, 160]), mi.Float([0.0, 0.5, 0.999]), mi.Bool(True))
    share, ratio = guide.pair(mi.UInt32([0, 1]), mi.UInt32([5, 161]))
    assert dr.all(every) and dr.all(share == 0.0) and dr.all(ratio == 1.0)
    guide.learn(ConnectionSums.zero())  # nothing was found
    assert dr.all(guide.pair(mi.UInt32([0, 1]), mi.UInt32([5, 161]))[1] == 1.0)


def test_classes_are_cells_and_facings():
    guide = ConnectionGuide([-1, 0, 0], [2, 3, 3])
    si = dr.zeros(mi.SurfaceInteraction3f, 4)
    si.p = mi.Point3f([-0.5, 1.5, 9.0, -9.0], [0.5, 1.5, 2.9, 0.0], [0.5, 0.5, 2.9, 1.5])
    si.n = mi.Normal3f([1, -0.8, 0.1, 0], [0, 0.6, -0.9, 0], [0, 0, 0.1, -1])
    cells = (0, 2 * 9 + 3, 2 * 9 + 2 * 3 + 2, 1)
    expected = [6 * cell + facing for cell, facing in zip(cells, (0, 1, 3, 5), strict=True)]
    assert np.array(guide.classify(si)).tolist() == expected


# ---------------------------------------------------------------------------------------------------- pictures


def ajar() -> Any:
    return load("ajar", size=(24, 18))


METHODS: dict[str, dict[str, Any]] = {
    "bpt": {},
    "vcm": {"radius": 0.002, "connections": 2},
    "bpt power": {"heuristic": "power", "connections": 3, "next_events": 2},
    "bpt emission": {"guide_emission": "on"},
}


@lru_cache(maxsize=1)
def reference() -> np.ndarray:
    return replicas(ajar(), "bpt", runs=8, passes=8, samples=64, seed=500)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_learning_does_not_change_the_picture_of_64_seeds(name):
    images = replicas(ajar(), name.split()[0], runs=64, passes=8, samples=16, **LEARNS, **METHODS[name])
    assert_agree(images, reference(), name, precision=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("material", ["transparent", "wrapped", "rough"])
def test_other_materials(material):
    """Null surfaces, vertices that are computed again, transmission."""
    problem = scenes.room("sphere", material)
    guided, plain = (
        replicas(problem, "bpt", runs=8, passes=8, samples=64, seed=seed, guide_connections=learns)
        for seed, learns in ((1, True), (500, False))
    )
    assert_agree(guided, plain, material, precision=0.03)


@pytest.mark.slow
def test_a_guide_that_has_learned_what_is_wrong():
    """It draws from classes at random: the mean is the same."""
    images = []
    for seed in range(8):
        runner = prepared(ajar(), "bpt", seed, samples_per_pass=32, **LEARNS)
        state, random = runner.state(), np.random.default_rng(seed)
        wrong = {"slots": random.integers(0, CLASSES, (CLASSES, 256)), "expected": random.random(CLASSES)}
        runner.restore({**state, "connections": state["connections"] | {"guide": wrong}})
        images.append(go(runner, 6, seed).mean)
    assert_agree(np.stack(images), reference(), "wrong", precision=0.1)


def test_it_learns_where_light_comes_from():
    """In a room that is lit through a door, most light vertices are behind the door."""
    problem, errors = load("ajar", size=(96, 72)), {}
    for learns in (True, False):
        runner = prepared(problem, "bpt", samples_per_pass=4, guide_connections=learns)
        go(runner, 15)
        images = go(runner, 8, first=15).images
        pixels = (images.var(axis=0) / (images.mean(axis=0) ** 2 + 0.01)).mean(-1).ravel()
        errors[learns] = np.sort(pixels)[: int(0.98 * len(pixels))].mean()
    assert errors[True] < 0.5 * errors[False]


def test_what_was_learned_is_restored():
    learned = LearnedConnections([0, 0, 0], [1, 1, 1], (20, 10))
    learned.guide.learn(sums([3, 70, 161]))
    other = LearnedConnections([0, 0, 0], [1, 1, 1], (20, 10))
    other.restore(learned.state())
    pair = mi.UInt32([3, 3, 70]), mi.UInt32([70, 161, 3])
    for a, b in zip(learned.guide.pair(*pair), other.guide.pair(*pair), strict=True):
        np.testing.assert_array_equal(np.array(a), np.array(b))
    damaged = learned.state()
    damaged["guide"] = damaged["guide"] | {"slots": damaged["guide"]["slots"] + CLASSES}
    with pytest.raises(CheckpointError, match="the guide of connections in the checkpoint is damaged"):
        other.restore(damaged)
    with pytest.raises(CheckpointError, match="of another picture"):
        LearnedConnections([0, 0, 0], [1, 1, 1], (200, 10)).restore(learned.state())
