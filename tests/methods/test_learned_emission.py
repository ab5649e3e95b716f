"""Emission that learns: its density, the weights of techniques with it, and pictures that it must not change."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.guides import taught
from support.running import go, mitsuba_path, prepared, replicas
from support.statistics import LEVEL, assert_agree

from etendue.core import IndependentSource
from etendue.scene import LightTable
from etendue.transport import (
    EmissionGuide,
    LearnedEmission,
    direction_of,
    emission_of_hit,
    emit,
    is_emissive,
    sample_direct,
    square_of,
)

LEARNS = {"guide_emission": "on"}
PATHS, SIDE = 1 << 18, 8


def lights() -> Any:
    """Every kind of light whose directions are learned, and one of the others."""
    look = scenes.transform().look_at([1.2, 2.6, 1.5], [0, 0, -0.2], [0, 1, 0])
    focused = {"type": "focusarea", "radiance": scenes.rgb(7, 6, 5), "exponent": 4.0}
    return scenes.load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "floor": scenes.plate([0, 0, 0], 2.0, up=True),
            "square": scenes.lamp([-0.8, 2.2, 0.3], 0.3, 30.0),
            "ball": scenes.EMITTERS["sphere"]()["light"],
            "mesh": scenes.EMITTERS["mesh"]()["light"],
            "point": scenes.EMITTERS["point"]()["light"],
            "spot": scenes.EMITTERS["spot"]()["light"] | {"to_world": look},
            "focused": {
                "type": "disk",
                "to_world": scenes.transform().translate([0.9, 2.0, 0]).rotate([1, 0, 0], 90).scale(0.2),
                "emitter": focused,
            },
            "sun": scenes.EMITTERS["directional"]()["light"],
        }
    )


def names_of_lights(problem: Any) -> list[str]:
    """Ids of the lights or of their shapes, by number."""
    return [e.get_shape().id() if e.get_shape() else e.id() for e in problem.scene.emitters()]


def test_lights_and_directions_are_drawn_as_often_as_the_density_says():
    """Chi-square of the lights, and for lights of one plane or point of their directions; below the horizon and outside
    of the cone there are no rays."""
    problem = lights()
    guide, lane = taught(problem), dr.arange(mi.UInt32, PATHS)
    emitted = emit(guide.lights, IndependentSource(lane, 3, "test", 0), mi.Bool(True), guide.departures)
    light, active, point = np.array(emitted.light), np.array(emitted.active), square_of(emitted.ray.d)
    counts = np.bincount(light, minlength=guide.count)
    assert stats.chisquare(counts, PATHS * guide.emitted).pvalue > LEVEL
    cell = (np.array(point.x) * SIDE).astype(int) + SIDE * (np.array(point.y) * SIDE).astype(int)
    fine = 512
    u, v = ((np.arange(fine**2) // n % fine + 0.5) / fine for n in (1, fine))
    direction = direction_of(mi.Point2f(mi.Float(u.astype(np.float32)), mi.Float(v.astype(np.float32))))
    names = names_of_lights(problem)
    for name, own in (
        ("square", lambda d: np.maximum(-d[1], 0.0) / np.pi),
        ("focused", lambda d: np.maximum(-d[1], 0.0) ** 5 * 6 / (2 * np.pi)),
        ("point", lambda d: np.full(d.shape[1], 0.25 / np.pi)),
    ):
        row = names.index(name)
        density = np.array(
            guide.departures.at(mi.UInt32(row), mi.Bool(True)).mixed(
                direction, mi.Float(own(np.array(direction))), True
            )
        )
        lit = own(np.array(direction)) > 0.0
        mass = np.where(lit, density, 0.0) * 4.0 * np.pi / fine**2
        expected = np.bincount((u * SIDE).astype(int) + SIDE * (v * SIDE).astype(int), mass, SIDE**2)
        mine = (light == row) & active
        found = np.append(np.bincount(cell[mine], minlength=SIDE**2), counts[row] - mine.sum())
        expected = np.append(expected, 1.0 - expected.sum()) * counts[row]
        many = expected > 5.0
        assert many.sum() > 8
        statistic = ((found - expected)[many] ** 2 / expected[many]).sum()
        assert stats.chi2.sf(statistic, many.sum() - 1) > LEVEL, name


def test_all_techniques_know_the_same_density_of_emission():
    """Of a ray that was emitted, of one that hits a light, and of a light point: from one place of the light along one
    direction."""
    problem = lights()
    guide, lane = taught(problem), dr.arange(mi.UInt32, 1 << 14)
    source = IndependentSource(lane, 3, "test", 0)
    emitted = emit(guide.lights, source, mi.Bool(True), guide.departures)
    si = problem.scene.ray_intersect(mi.Ray3f(emitted.ray.o + 0.02 * emitted.ray.d, -emitted.ray.d))
    # Rays begin a little off the light: at grazing angles, on a ball, opposite another point.
    met = emitted.active & si.is_valid() & is_emissive(problem.scene, si) & (si.t < 0.03) & (emitted.cos_light > 0.2)
    origin = si.p + si.t * si.to_world(si.wi)
    _, _, density = emission_of_hit(guide.lights, problem.scene, si, met, origin, departures=guide.departures)
    met = np.array(met)
    assert len(set(np.array(emitted.light)[met])) == 4  # all with a surface
    np.testing.assert_allclose(np.array(density)[met], np.array(emitted.emission_density)[met], rtol=0.02)

    floor = problem.scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, 0.5, 0.7), mi.Vector3f(0, -1, 0)))
    direct = sample_direct(guide.lights, floor, source, mi.UInt32(1), 0, mi.Bool(True), guide.departures)
    si = problem.scene.ray_intersect(floor.spawn_ray(direct.direction))
    met = direct.active & ~direct.is_delta & is_emissive(problem.scene, si)
    met &= dr.norm(si.p - direct.target) < 1e-3
    _, area, density = emission_of_hit(guide.lights, problem.scene, si, met, floor.p, departures=guide.departures)
    cos = mi.Frame3f.cos_theta(si.wi)
    met = np.array(met & (cos > 0.5))  # a hit on a ball is a little beside the sampled point
    assert met.sum() > 1000
    np.testing.assert_allclose(np.array(direct.light_ratio * direct.pdf * cos)[met], np.array(density)[met], rtol=2e-3)
    np.testing.assert_allclose(np.array(direct.pdf * cos / dr.square(si.t))[met], np.array(area)[met], rtol=2e-3)


def test_every_part_of_a_picture_teaches():
    """A quarter of the lanes of camera paths counts: in a picture whose rows are as long as their pattern, not the same
    columns in all rows."""
    problem, side = lights(), 64
    learning = LearnedEmission(LightTable(problem.scene), (side, side), False)
    learning.measure(1.0)
    lanes = dr.arange(mi.UInt32, side * side)
    counts = np.array(learning.fields(True, 0)["training"].worth_of_lane(lanes, lanes)).reshape(side, side) > 0.0
    assert (counts.mean(axis=0) == 0.25).all() and (counts.mean(axis=1) == 0.25).all()


# ---------------------------------------------------------------------------------------------------- pictures


def hidden_lamps(**view: Any) -> Any:
    """One lamp of five lights a floor and a glossy ball, a second one a mirror image; the others are walled in."""
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera(**view),
        "floor": scenes.plate([0, 0, 0], 2.0, up=True),
        "ceiling": scenes.plate([0, 2.3, 0], 6.0, up=False),
        "ball": {
            "type": "sphere",
            "center": [0.5, 0.4, 0],
            "radius": 0.4,
            "bsdf": scenes.MATERIALS["roughconductor"](),
        },
        "glass": {"type": "sphere", "center": [-0.6, 0.42, 0.2], "radius": 0.4, "bsdf": {"type": "dielectric"}},
        "lamp": scenes.lamp([-0.8, 2.2, 0.3], 0.15, 30.0),
        "point": {"type": "point", "position": [0.9, 1.5, 0.6], "intensity": scenes.rgb(0.5, 0.6, 0.9)},
    }
    for i in range(3):
        scene[f"above-{i}"] = scenes.lamp([0.4 * i - 1.4, 3.5, 0.0], 0.15, 60.0)
    return scenes.load(scene)


def reference(name: str = "bpt") -> np.ndarray:
    """Pictures without learning. `light` does not see what is behind the glass."""
    return unlearned("light" if name == "light" else "bpt")


@lru_cache(maxsize=2)
def unlearned(method: str) -> np.ndarray:
    return replicas(hidden_lamps(), method, runs=8, passes=2, samples=256, seed=500, guide_emission="off")


METHODS: dict[str, dict[str, Any]] = {
    "bpt": {},
    "bpt path": {"light_source": "path"},
    "vcm": {"radius": 0.002},
    "bpt power": {"heuristic": "power", "connections": 3, "next_events": 2},
    "light": {},
}


@pytest.mark.slow
def test_learning_does_not_change_the_picture():
    name = next(iter(METHODS))  # others: with more seeds, below
    images = replicas(hidden_lamps(), name.split()[0], runs=8, passes=7, samples=32, **LEARNS, **METHODS[name])
    assert_agree(images, reference(name), name, precision=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_learning_does_not_change_the_picture_of_64_seeds(name):
    images = replicas(hidden_lamps(), name.split()[0], runs=64, passes=7, samples=16, **LEARNS, **METHODS[name])
    assert_agree(images, reference(name), name, precision=0.02)


@pytest.mark.parametrize("emitter", [pytest.param(e, marks=pytest.mark.slow) for e in scenes.EMITTERS])
def test_every_kind_of_light(emitter):
    problem = scenes.room(emitter, scenes.FEW)
    images = replicas(problem, "bpt", runs=6, passes=7, samples=64, **LEARNS)
    assert_agree(images, mitsuba_path(problem, passes=6, samples=512), emitter, precision=0.03)


@pytest.mark.slow
def test_light_that_is_found_late():
    """A guide that has learned what is wrong gives each path of the lamp that matters a tenth of its chance, or less:
    the mean is the same, and it learns better."""
    problem = hidden_lamps()
    images, emitted = [], []
    for seed in range(6):
        runner = prepared(problem, "bpt", seed, samples_per_pass=32, **LEARNS)
        guide, state = EmissionGuide(LightTable(problem.scene)), runner.state()
        wrong = guide.state()
        power = wrong["emitted"]
        lamp = names_of_lights(problem).index("lamp")
        wanted = np.where(np.arange(len(power)) == lamp, 0.0, power)
        wrong["emitted"] = wrong["direct"] = 0.9 * wanted / wanted.sum() + 0.1 * power
        runner.restore({**state, "emission": state["emission"] | {"guide": wrong}})
        images.append(go(runner, 7, seed).mean)
        emitted.append(runner.state()["emission"]["guide"]["emitted"][lamp] / wrong["emitted"][lamp])
    assert min(emitted) > 3.0
    assert_agree(np.stack(images), reference(), "late", precision=0.05)


def test_it_learns_which_lamp_matters():
    """Lamps behind the ceiling get next to no light paths, and no light points; the noise shrinks."""
    problem = hidden_lamps()
    errors = {}
    for setting in ("on", "off"):
        runner = prepared(problem, "bpt", samples_per_pass=64, guide_emission=setting)
        go(runner, 7)
        images = go(runner, 8, first=7).images
        pixels = (images.var(axis=0) / (images.mean(axis=0) ** 2 + 0.01)).mean(-1).ravel()
        errors[setting] = np.sort(pixels)[: int(0.98 * len(pixels))].mean()
        if setting == "on":
            guide = runner.state()["emission"]["guide"]
            hidden = [i for i, name in enumerate(names_of_lights(problem)) if "above" in name]
            assert guide["emitted"][hidden].sum() < 0.15 and guide["direct"][hidden].sum() < 0.15
            assert guide["visible"][hidden].max() < 0.2
            assert guide["visible"][names_of_lights(problem).index("lamp")] > 0.5
    assert errors["on"] < 0.7 * errors["off"]
