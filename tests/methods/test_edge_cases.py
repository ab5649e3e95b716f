"""Scenes at the edge of what a method expects, and the names the package promises."""

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import run
from support.tables import thinned

from etendue import methods, scene
from etendue.core import Replica

CAMERA = {
    "type": "perspective",
    "fov": 50,
    "to_world": None,
    "film": {"type": "hdrfilm", "width": 16, "height": 12, "pixel_format": "rgb"},
}


def _scene(**elements):
    sensor = CAMERA | {"to_world": mi.ScalarTransform4f().look_at([0, -4, 1.5], [0, 0, 0.7], [0, 0, 1])}
    return scene.load({"type": "scene", "sensor": sensor, **elements})


def _mean(problem, name, **settings):
    cls = methods.get(name)
    method = cls(cls.Settings(max_depth=6, samples_per_pass=16, **settings))
    method.prepare(problem, 0)
    return Replica(method, 0).step(0).mean()


@pytest.mark.parametrize("name", ["path", "light", "bpt"])
def test_a_ball_that_emits_inwards_is_black_from_outside(name):
    """Also at its rim, where the surface that faces the camera is just behind the other one."""
    ball = {"type": "sphere", "flip_normals": True, "bsdf": {"type": "conductor"}}
    problem = _scene(ball=ball | {"emitter": {"type": "area", "radiance": 1.0}})
    settings = {"light_paths": 64.0} if name == "light" else {}
    assert _mean(problem, name, **settings).max() == 0.0


@pytest.mark.parametrize(
    "name", thinned(["path", "pm", "ppm", "sppm", "bpt", "bpt path", "bpm", "vcm"], ["pm", "sppm", "vcm"])
)
def test_no_surface_to_store_a_vertex_on(name):
    """Only a lamp: no light path ever hits a surface that can be connected to."""
    problem = _scene(lamp={"type": "sphere", "emitter": {"type": "area", "radiance": 1.0}})
    method, *source = name.split()
    image = _mean(problem, method, **({"light_source": source[0]} if source else {}))
    assert image[8, 8] == pytest.approx(1.0, abs=1e-5)
    assert image[0, 0] == pytest.approx(0.0, abs=1e-5)


BIDIRECTIONAL = [(name, {"light_source": source}) for name in ("bpt", "bpm", "vcm") for source in ("cache", "path")]


@pytest.mark.parametrize(
    ("name", "settings"), [("path", {}), ("pm", {"final_gather": True}), ("ppm", {}), ("sppm", {}), *BIDIRECTIONAL]
)
def test_only_mirrors(name, settings):
    """A mirror in a white furnace: every pixel is 1, and no technique but emission contributes."""
    problem = _scene(sky={"type": "constant"}, ball={"type": "sphere", "bsdf": {"type": "conductor"}})
    assert np.allclose(_mean(problem, name, **settings), 1.0, atol=1e-4)


@pytest.mark.parametrize("method", thinned(["bpt", "vcm"], ["vcm"]))
def test_power_heuristic_in_millimetres(method):
    """Weights hold squared distances by the power of two, over squared densities of glossy tails."""
    scale = mi.ScalarTransform4f().scale(1e4)
    box = mi.cornell_box()
    for part in box.values():
        if isinstance(part, dict) and "to_world" in part:
            part["to_world"] = scale @ part["to_world"]
    look = mi.ScalarTransform4f().look_at(origin=[0, 0, 3.9e4], target=[0, 0, 0], up=[0, 1, 0])
    box["sensor"] |= {"near_clip": 10.0, "far_clip": 1e6, "to_world": look}
    box["sensor"]["film"] |= {"width": 16, "height": 16}
    box["large-box"]["bsdf"] = {"type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.05}
    measured = run(scene.load(box), method, passes=2, samples=256, heuristic="power").measurement
    assert measured.counters["nonfinite"] == 0
    assert measured.mean().mean() == pytest.approx(0.148, rel=0.03)  # as of the box of size 1


@pytest.mark.parametrize("method", thinned(["path", "sppm", "bpm", "guided"], ["path", "sppm"]))
def test_a_clamp_bounds_what_a_path_brings(method):
    """One path a pixel: no pixel is brighter than the clamp, those below it stay as they are, colours too."""
    problem = scene.load("cornell-box", size=(16, 16))
    alone = {"passes": 1, "samples": 1, "reconstruction": "independent"}
    free, clamped = (run(problem, method, clamp=c, **alone).mean for c in (0.0, 0.4))
    brightest = free.max(axis=-1, keepdims=True)
    expected = free * np.minimum(1.0, 0.4 / np.maximum(brightest, 1e-9))
    assert (brightest > 0.4).any() and (brightest < 0.4).any()
    np.testing.assert_allclose(clamped, expected, rtol=1e-4, atol=1e-6)


def test_a_clamp_bounds_negative_weights_of_a_filter():
    problem = scenes.room("sphere", scenes.FEW, rfilter="mitchell")
    alone = {"passes": 1, "samples": 1, "reconstruction": "independent"}
    free, clamped = (run(problem, "path", seed=2, clamp=c, **alone).mean for c in (0.0, 0.1))
    assert free.min() < -0.1
    assert np.abs(clamped).max() <= 0.1 * (1 + 1e-5)
