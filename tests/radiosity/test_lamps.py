"""The light of lamps that are no patches, against closed forms."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.luminaires import ies

import etendue
from etendue.core import OptionError, SceneError, UnsupportedError
from etendue.radiosity import lamp_light, scene_patches, solve
from etendue.scene import load


def place():
    return mi.ScalarTransform4f()


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


def room(reflectance=0.5, **lamps):
    """A cube of side 2, without a camera."""
    walls = {"type": "cube", "flip_normals": True, "bsdf": {"type": "diffuse", "reflectance": rgb(*[reflectance] * 3)}}
    return {"type": "scene", "walls": walls, **lamps}


def floor(**lamps):
    ground = {
        "type": "rectangle",
        "to_world": place().scale(4),
        "bsdf": {"type": "diffuse", "reflectance": rgb(0, 0, 0)},
    }
    return {"type": "scene", "floor": ground, **lamps}


POINT = {"type": "point", "position": [0.3, -0.2, 0.5], "intensity": rgb(1, 2, 3)}


def direct(scene, max_area=0.1, **more):
    problem = load(scene, sensor=None)
    patches = scene_patches(problem, max_area=max_area, lamps_apart=True)
    return patches, lamp_light(problem, patches, **more)


def test_all_light_of_a_point_arrives():
    patches, light = direct(room(point=POINT))
    assert np.allclose(light.sent, 4 * np.pi * np.array([1, 2, 3]), rtol=2e-3)
    away = patches.centres - POINT["position"]
    square = (away**2).sum(axis=1)
    expected = -(away * patches.normals).sum(axis=1) / square**1.5
    # The mean over a patch is not the value at its middle, but nearly so where the lamp is far.
    far = square > 1.0
    assert np.allclose(light.irradiance[far, 0], expected[far], rtol=0.05)


def test_errors_are_those_of_repeated_shots():
    runs = [direct(room(point=POINT), rays=1, seed=seed)[1] for seed in range(24)]
    spread = np.var([run.irradiance[:, 1] for run in runs], axis=0, ddof=1)
    estimated = np.mean([run.error[:, 1] ** 2 for run in runs], axis=0)
    assert 0.7 < spread.sum() / estimated.sum() < 1.4  # some hundred patches


def test_the_sun_on_a_floor():
    sun = {"type": "directional", "direction": [1, 0, -1], "irradiance": rgb(2, 2, 2)}
    _, light = direct(floor(sun=sun))
    assert np.allclose(light.irradiance, 2 / np.sqrt(2), rtol=1e-5)


@pytest.mark.parametrize("solver", ["lines", "multipath"])
def test_a_closed_room(solver):
    # Each wall reflects rho of what arrives: P / (1 - rho) arrives in all.
    limits = {"bundles": 256} if solver == "lines" else {"points": 1 << 17}
    found = etendue.solve_radiosity(room(0.6, point=POINT), solver, max_area=0.1, **limits)
    power, areas = found.solution.power, found.patches.areas[:, None]
    whole = 4 * np.pi * np.array([1, 2, 3]) / (1 - 0.6)
    assert np.allclose((areas * found.solution.irradiance).sum(axis=0), whole, rtol=0.01)
    assert np.allclose(power["emitted"], 4 * np.pi * np.array([1, 2, 3]), rtol=2e-3)
    assert np.allclose(power["absorbed"], power["emitted"], rtol=0.01) and found.is_balanced
    assert found.solution.imbalance < 0.01


def test_solutions_agree_with_meters():
    scene = room(0.5, point=POINT, box={"type": "cube", "to_world": place().translate([0.3, 0.2, -0.6]).scale(0.3)})
    found = etendue.solve_radiosity(scene, max_area=0.05, bundles=512)
    patches = found.patches
    chosen = np.random.default_rng(0).choice(len(patches), 200, replace=False)
    meters = etendue.measure(scene, patches.centres[chosen], patches.normals[chosen], spp=2048)
    areas = patches.areas[chosen, None]
    read, solved = ((areas * v).sum() for v in (meters.values, found.solution.irradiance[chosen]))
    assert abs(read / solved - 1) < 0.02  # middles of patches stand for them


def test_an_environment_is_a_sky():
    # A white bitmap against a constant light, over a floor with a box.
    box = {"type": "cube", "to_world": place().translate([0, 0, 0.5]).scale(0.5)}
    white = {"type": "envmap", "bitmap": mi.Bitmap(np.full((8, 16, 3), 0.7, np.float32))}
    constant = {"type": "constant", "radiance": rgb(0.7, 0.7, 0.7)}
    lamp, sky = (
        etendue.solve_radiosity(floor(box=box, light=light), max_area=0.5, bundles=1024) for light in (white, constant)
    )
    error = np.hypot(lamp.irradiance_error, sky.irradiance_error)
    z = (lamp.solution.irradiance - sky.solution.irradiance)[:, 0] / np.maximum(error[:, 0], 1e-6)
    assert np.mean(z**2) < 1.5 and np.abs(z).max() < 6


def test_a_luminaire_and_a_sky_of_the_profession(tmp_path):
    path = tmp_path / "lamp.ies"
    path.write_text(ies(lambda c, gamma: np.full(c.shape, 100.0)))
    lamp = {"type": "luminaire", "filename": str(path), "to_world": place().translate([0, 0, 2])}
    patches, light = direct(floor(lamp=lamp))
    square = (patches.centres**2).sum(axis=1) + 4.0
    lux = 683.0 * light.irradiance @ [0.2126, 0.7152, 0.0722]
    assert np.allclose(lux, 100.0 * 2.0 / square**1.5, rtol=0.02)  # the middle stands for the patch
    sky = {"type": "sky", "kind": 1, "diffuse_illuminance": 10_000.0}
    patches, light = direct(floor(sky=sky), max_area=16.0)
    lux = 683.0 * light.irradiance @ [0.2126, 0.7152, 0.0722]
    assert np.allclose(lux, 10_000.0, rtol=2e-3)


@pytest.mark.slow
def test_workers_have_the_light():
    here, there = (
        etendue.solve_radiosity(room(point=POINT), "multipath", max_area=0.5, points=1 << 14, workers=n)
        for n in (None, 1)
    )
    assert np.allclose(here.solution.irradiance, there.solution.irradiance)


def test_what_has_no_such_light(tmp_path):
    scene = room(point=POINT)
    with pytest.raises(UnsupportedError, match="method 'boxes' has no light of emitter 'point'"):
        etendue.solve_radiosity(scene, "boxes", passes=1)
    with pytest.raises(OptionError, match="without lines there is no light of lamps"):
        etendue.solve_radiosity(scene, ambient="fuzzy")
    with pytest.raises(UnsupportedError, match="lamps_apart"):
        scene_patches(load(scene, sensor=None))
    with pytest.raises(OptionError, match="a picture needs a scene with a camera"):
        etendue.solve_radiosity(scene, bundles=8, save=tmp_path / "a.png")
    dark = {"type": "point", "position": [5, 5, 5], "intensity": rgb(1, 1, 1)}
    with pytest.raises(SceneError, match="no light"):
        etendue.solve_radiosity(room(point=dark), bundles=8)


def test_a_solution_in_the_library():
    problem = load(room(0.6, point=POINT), sensor=None)
    patches = scene_patches(problem, max_area=0.2, lamps_apart=True)
    lines = etendue.radiosity.ABuffer(patches).cast(64)
    solution = solve(patches, lines, "conjugate-gradient", shot=lamp_light(problem, patches))
    assert np.allclose(
        (patches.areas[:, None] * solution.irradiance).sum(axis=0), 10 * np.pi * np.array([1, 2, 3]), rtol=0.01
    )
