"""Lights picked by what they brought to a cell: as often as is claimed, and never not at all."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes

from etendue.scene import LightTable
from etendue.transport import LightChoice, is_emissive

N = 100_000
CELLS = 3


def lamps() -> Any:
    """Three lamps, each of another power."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera()}
    for i, radiance in enumerate((1.0, 3.0, 6.0)):
        scene[f"lamp-{i}"] = scenes.lamp([2.0 * i, 1.0, 0.0], 0.3, radiance)
    return scenes.load(scene).scene


def learned(lights: LightTable) -> LightChoice:
    choice = LightChoice(lights, 2)
    choice.learn(np.array([[10.0, 0.0, 30.0], [0.0, 0.0, 0.0]]), np.array([0, 1, 0]))
    return choice


def test_lights_are_picked_as_often_as_is_claimed():
    scene = lamps()
    lights = LightTable(scene)
    power = lights.probabilities
    cell = np.arange(N, dtype=np.uint32) % CELLS
    u = mi.Float(np.random.default_rng(1).random(N, dtype=np.float32))
    light = learned(lights).at(mi.UInt32(cell)).pick(u)
    row, pick = np.asarray(light.row), np.asarray(light.pick, np.float64)
    by_light = np.array([0.25, 0.0, 0.75])
    wanted = {0: 0.8 * by_light + 0.2 * power, 1: power, 2: 0.8 * by_light + 0.2 * power}
    for number, probabilities in wanted.items():
        mine = cell == number
        shares = np.bincount(row[mine], minlength=3) / mine.sum()
        np.testing.assert_allclose(shares, probabilities, atol=4.5 * 0.5 / np.sqrt(mine.sum()))
        np.testing.assert_allclose(pick[mine], probabilities[row[mine]], rtol=1e-5)
    assert power.min() > 0.0


def test_a_hit_knows_how_probable_the_light_was():
    scene = lamps()
    lights = LightTable(scene)
    ray = mi.Ray3f(mi.Point3f([0.0, 2.0, 4.0], 0.0, 0.0), mi.Vector3f(0.0, 1.0, 0.0))
    si = scene.ray_intersect(ray)
    assert np.asarray(is_emissive(scene, si)).all()
    seen = learned(lights).at(mi.UInt32([0, 0, 0])).of(si.emitter(scene))
    np.testing.assert_array_equal(np.asarray(seen.row), np.asarray(lights.of(si.emitter(scene)).row))
    np.testing.assert_allclose(
        np.asarray(seen.pick), (0.8 * np.array([0.25, 0.0, 0.75]) + 0.2 * lights.probabilities)[np.asarray(seen.row)],
        rtol=1e-5,
    )  # fmt: skip
    assert len(set(np.asarray(seen.row))) == 3


def test_probabilities_come_back():
    lights = LightTable(lamps())
    choice, again = learned(lights), LightChoice(lights, 1)
    again.restore(choice.shares)
    np.testing.assert_array_equal(again.shares, choice.shares)
    assert choice.shares.sum(axis=1) == pytest.approx(1.0)
