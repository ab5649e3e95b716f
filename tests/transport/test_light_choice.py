"""Lights picked by place, and by what they brought to a cell: as often as is claimed, and never not at all."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes

from etendue.scene import LightTable
from etendue.scene.lamps.places import ANYWHERE
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
    assert choice.shares.sum(axis=1) == pytest.approx([1.0, 0.0, 1.0])


def yard(lamps: int) -> Any:
    """A sky, a sun, and lamps of every kind around a floor."""
    look = scenes.transform().look_at([0, 3, 0], [1, 0, 0], [0, 0, 1])
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera(),
        "floor": scenes.plate([0, 0, 0], 20.0, up=True),
        "sky": {"type": "constant", "radiance": 0.01},
        "sun": {"type": "directional", "direction": [0, -1, 0], "irradiance": 0.2},
        "spot": {"type": "spot", "to_world": look, "intensity": 9.0, "cutoff_angle": 25.0},
        "square": scenes.lamp([-3, 2, 0], 0.3, 30.0),
        "dark": {"type": "point", "position": [1, 1, 1], "intensity": {"type": "rgb", "value": [0, 0, 0]}},
    }
    for number in range(lamps):
        x, z = 9.0 * np.cos(0.7 * number), 9.0 * np.sin(0.9 * number)
        scene[f"lamp-{number}"] = {"type": "point", "position": [x, 1.5, z], "intensity": 1.0 + number % 3}
    return scene


@pytest.mark.parametrize("lamps", [4, 40])
def test_picks_at_a_place_have_the_probability_that_is_claimed(lamps):
    """The number that picks is divided evenly; every light that is lit keeps half of an equal share,
    in groups a fifth of it."""
    lights = LightTable(scenes.load(yard(lamps)).scene)
    n, lit = 1 << 18, lights.probabilities > 0.0
    u = (np.arange(n) + 0.5) / n
    for place in ([1.0, 0.0, 0.1], [-3.0, 0.5, 0.2], [-60.0, 3.0, 50.0]):
        at = lights.at(mi.Point3f(*place))
        picked = at.pick(mi.Float(u.astype(np.float32)))
        chance = np.array(at.row(mi.UInt32(np.arange(lights.count))).pick, np.float64)
        assert chance.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(np.bincount(picked.row, minlength=lights.count) / n, chance, atol=3e-5)
        np.testing.assert_allclose(picked.pick, chance[np.array(picked.row)], rtol=1e-5)
        assert (chance[lit] > 0.4 / lit.sum()).all() if lights.count <= 16 else (chance[lit] > 0.1 / lit.sum()).all()
        assert (chance[~lit] == 0.0).all()


def test_near_lamps_are_picked_most():
    """By intensity over squared distance: beside each other, and beside the fluence of a sky."""
    scene = {"type": "scene", "sensor": scenes.camera(), "floor": scenes.plate([0, 0, 0], 500.0, up=True)}
    pair = {f"lamp-{x}": {"type": "point", "position": [x, 1, 0], "intensity": 1.0 + x / 4.0} for x in (0, 4)}
    lights = LightTable(scenes.load(scene | pair).scene)
    two = np.array(lights.at(mi.Point3f(1, 1, 0)).row(mi.UInt32([0, 1])).pick)
    fluence = np.array([1.0, 2.0 / 9.0])
    np.testing.assert_allclose(two, 0.5 * ANYWHERE + (1 - ANYWHERE) * fluence / fluence.sum(), rtol=1e-4)
    sky = {"sky": {"type": "constant", "radiance": 1.0 / (4.0 * np.pi)}, "lamp": pair["lamp-0"]}
    lights = LightTable(scenes.load(scene | sky).scene)
    beside = np.array(lights.at(mi.Point3f(0, 1, 2)).row(mi.UInt32([0, 1])).pick)
    np.testing.assert_allclose(beside, 0.5 * ANYWHERE + (1 - ANYWHERE) * np.array([0.8, 0.2]), rtol=1e-2)


def test_lamps_that_shine_elsewhere_are_picked_less():
    """A spot light outside of its cone, a square lamp behind it."""
    scene = scenes.load(yard(0)).scene
    lights, emitters = LightTable(scene), scene.emitters()
    spot = [e.class_name() == "SpotLight" for e in emitters].index(True)
    square = [e.get_shape() is not None for e in emitters].index(True)
    least = ANYWHERE / 4.0
    for row, lit, unlit in ((spot, [1, 0, 0], [-3, 0, 0]), (square, [-3, 0, 0], [-3, 4, 0])):
        inside, outside = (np.array(lights.at(mi.Point3f(*p)).row(mi.UInt32(row)).pick)[0] for p in (lit, unlit))
        assert inside > 0.4
        assert outside == pytest.approx(least)
