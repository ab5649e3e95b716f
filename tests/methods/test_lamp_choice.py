"""Which lamps are sampled how often: beside a sky, in a yard, and with the weights of a scene."""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_path, run
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue.scene import load

#: Methods whose next event picks one of the lamps.
METHODS = ("path", "guided", "bpt", "vcm", "auto")


def error(picture: np.ndarray, reference: np.ndarray) -> float:
    """relMSE, as it is defined in design.md."""
    return float(np.mean((picture - reference) ** 2 / (reference**2 + 0.01)))


def wall(half: float) -> dict[str, Any]:
    """A wall that is lit by a spot and by a dim sky."""
    forward = scenes.transform().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    place = scenes.transform().translate([0, 0, 1]).rotate([0, 1, 0], 180).scale([half, half, 1])
    return {
        "type": "scene",
        "sensor": scenes.camera((0, 0, 0), (0, 0, 1), 50.0, size=(32, 32)),
        "sky": {"type": "constant", "radiance": 0.1},
        "spot": {"type": "spot", "intensity": 5.0, "cutoff_angle": 20, "to_world": forward},
        "wall": {"type": "rectangle", "to_world": place, "bsdf": scenes.diffuse(0.8, 0.8, 0.8)},
    }


@lru_cache(1)
def reference() -> tuple[np.ndarray, float]:
    """A converged picture of the wall, and the error of 64 samples of Mitsuba's path; neither depends on its size."""
    problem = scenes.load(wall(1.0))
    converged = mitsuba_path(problem, 1, 8192, max_depth=3)[0]
    return converged, error(mitsuba_path(problem, 1, 64, seed=3, max_depth=3)[0], converged)


@pytest.mark.parametrize(
    ("method", "half"),
    thinned(product(METHODS, [1.0, 100.0]), [("path", 1.0), ("path", 100.0), ("bpt", 100.0), ("guided", 100.0)]),
)
def test_a_lamp_beside_a_sky_is_found_whatever_the_size_of_the_scene(method, half):
    converged, mitsubas = reference()
    picture = etendue.render(mi.load_dict(wall(half)), method, spp=64, max_depth=3).image
    assert error(np.asarray(picture)[..., :3], converged) < 1.2 * mitsubas


@lru_cache(1)
def yard() -> tuple[np.ndarray, float]:
    """A converged picture of the scene `yard`, and the error of 64 samples of Mitsuba's path."""
    problem = load("yard", size=(32, 24))
    converged = mitsuba_path(problem, 1, 4096, max_depth=3)[0]
    return converged, error(mitsuba_path(problem, 1, 64, seed=3, max_depth=3)[0], converged)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["path", "guided", "bpt"])
def test_near_lamps_of_a_yard_are_found(method):
    """Ten lamps, a sky and a sun, which Mitsuba picks evenly."""
    converged, mitsubas = yard()
    picture = etendue.render(load("yard", size=(32, 24)).scene, method, spp=64, max_depth=3).image
    assert error(np.asarray(picture)[..., :3], converged) < 0.5 * mitsubas


def weighted(kind: str, weight: float) -> Any:
    """A floor and a wall lit by a point light, and by another light with a weight."""
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 1.0, 2.6), (0.1, 0.2, 0.0), 30.0, size=(16, 16)),
        "floor": scenes.plate((0.0, 0.0, 0.0), 1.5, True),
        "point": {"type": "point", "position": [-0.5, 1.0, 0.5], "intensity": 1.0},
    }
    match kind:
        case "spot":
            look = scenes.transform().look_at([0.5, 1.5, 0.5], [0, 0, 0], [0, 1, 0])
            light = {"type": "spot", "to_world": look, "intensity": 5.0, "cutoff_angle": 40}
        case "constant":
            light = {"type": "constant", "radiance": 0.3}
        case _:
            light = scenes.lamp((0.5, 1.4, 0.0), 0.6, 2.0)
            scene["light"] = light | {"emitter": light["emitter"] | {"sampling_weight": weight}}
            return scenes.load(scene)
    return scenes.load(scene | {"light": light | {"sampling_weight": weight}})


@pytest.mark.parametrize("kind", thinned(["spot", "constant", "area"], ["spot"]))
def test_weights_of_a_scene_give_the_picture_of_mitsuba(kind):
    """A light of weight 0 that rays cannot hit gives none, others give all of their light."""
    for weight in (0.0, 0.2):
        problem = weighted(kind, weight)
        expected = mitsuba_path(problem, samples=1024, max_depth=3)
        for method in ("path", "light", "vcm"):
            got = run(problem, method, samples=256, max_depth=3).images
            if kind == "constant" and method == "light":  # splats leave out what the camera sees directly of a sky
                continue
            assert_agree(got, expected, (kind, weight, method), precision=0.05)


def many(lamps: int) -> Any:
    """A room without a roof, with lamps of every kind; all of them are near to something."""
    look = scenes.transform().look_at([0.9, 1.4, 0.6], [-0.2, 0, 0], [0, 1, 0])
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 1.0, 2.6), (0.1, 0.2, 0.0), 30.0, size=(16, 16)),
        "floor": scenes.plate((0.0, 0.0, 0.0), 1.5, True),
        "wall": {
            "type": "rectangle",
            "to_world": scenes.transform().translate([0.0, 1.0, -0.7]).scale(1.5),
            "bsdf": scenes.diffuse(0.4, 0.5, 0.6),
        },
        "box": {
            "type": "cube",
            "to_world": scenes.transform().translate([0.1, 0.2, 0.1]).scale(0.2),
            "bsdf": {"type": "roughplastic", "alpha": 0.2},
        },
        "sky": {"type": "constant", "radiance": 0.2},
        "sun": {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": 0.5},
        "spot": {"type": "spot", "to_world": look, "intensity": 2.0, "cutoff_angle": 30},
        "square": scenes.lamp((-0.5, 1.2, 0.0), 0.2, 4.0),
        "ball": {"type": "sphere", "center": [0.6, 0.5, -0.2], "radius": 0.1, "emitter": scenes._area(3, 2, 1)},
    }
    for number in range(lamps):
        place = [-0.8 + 0.1 * number, 0.3, -0.5 + 0.04 * number]
        scene[f"ball{number}"] = {"type": "sphere", "center": place, "radius": 0.03, "emitter": scenes._area(4, 3, 5)}
    return scenes.load(scene)


@pytest.mark.parametrize("lamps", thinned([0, 14], [0]))
def test_every_technique_knows_which_lamps_the_others_pick(lamps):
    """Lights picked by place, alone and in groups: pictures agree with those of paths that pick them evenly."""
    problem = many(lamps)
    expected = mitsuba_path(problem, samples=256, max_depth=4)
    for method, settings in (
        ("path", {}),
        ("guided", {"cell_samples": 500}),
        ("bpt", {"direct_light": "all", "guide_emission": "off"}),
        ("bpt", {"light_source": "path", "heuristic": "power", "next_events": 2}),
        ("pm", {}),
    ):
        got = run(problem, method, samples=128, max_depth=4, **settings).images
        assert_agree(got, expected, (lamps, method), precision=0.05)


@pytest.mark.parametrize("method", ["path", "guided"])
def test_lamps_that_change_need_no_other_kernels(method):
    """Brighter, dimmer, off and on again, a narrower spot, beside a sky."""
    scene = many(0).scene
    values, hashes = mi.traverse(scene), []
    (key,) = (key for key in values.keys() if "square" in key and key.endswith("radiance.value"))  # noqa: SIM118
    for radiance, angle in ((4.0, 30.0), (0.1, 20.0), (0.0, 12.0), (900.0, 35.0)):
        values[key], values["spot.cutoff_angle"] = mi.Color3f(radiance), angle
        values.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            etendue.render(scene, method, spp=1, max_depth=3)
            kernels = [one for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
        hashes.append({one["hash"] for one in kernels if one["operation_count"] > 500})
    assert hashes[0] and all(found == hashes[0] for found in hashes[1:])
