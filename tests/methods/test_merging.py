"""Merging is biased by its radius: the bias must go away with it. And the schedule by which the radius shrinks."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, run
from support.statistics import assert_agree, blocks, z_scores
from support.tables import thinned

from etendue import methods
from etendue.core import OptionError

RADII = (0.4, 0.2, 0.1)
#: Weights that extrapolate a + b r + c r^2, measured at radii 4h, 2h and h, to r = 0.
TO_ZERO = (1 / 3, -2.0, 8 / 3)


def three_radii(problem, method, **settings):
    """Extrapolated pictures, and the largest radius's, (passes, h, w, c)."""
    images = [
        run(problem, method, 8, 64, seed=10 + i, radius=r, radius_unit="absolute", alpha=1.0, **settings).images
        for i, r in enumerate(RADII)
    ]
    return sum(w * image for w, image in zip(TO_ZERO, images, strict=True)), images[0]


#: One row a merging method: name, method, settings, emitter.
ROWS = {
    "bpm": ("bpm", {}, "rectangle"),
    "vcm": ("vcm", {}, "sphere"),
    "vcm direct": ("vcm", {"direct_light": "all"}, "sphere"),
    "vcm path power": ("vcm", {"light_source": "path", "heuristic": "power"}, "constant"),
    "vcm late": ("vcm", {"merge_first": False}, "spot"),
    "bpm late": ("bpm", {"merge_first": False}, "mesh"),
    "vcm many light paths": ("vcm", {"light_paths": 3.0, "connections": 0}, "envmap"),
    "vcm discounted": ("vcm", {"eta_discount": 0.2}, "two"),
    "sppm": ("sppm", {}, "sphere"),
    "sppm photons": ("sppm", {"direct": "photons", "light_paths": 2.0}, "rectangle"),
    "sppm cone": ("sppm", {"direct": "photons", "kernel": "cone"}, "spot"),
    "sppm sky": ("sppm", {"kernel": "biweight"}, "envmap"),
    "vegas maps": ("vegas", {"maps": 1}, "sphere"),
    "stratified maps": ("stratified", {"maps": 2, "light_paths": 2.0}, "mixed"),
}
FAST = ("bpm",)


@pytest.mark.parametrize("name", [n if n in FAST else pytest.param(n, marks=pytest.mark.slow) for n in ROWS])
def test_three_radii_extrapolate_to_path(name):
    method, settings, emitter = ROWS[name]
    problem = scenes.room(emitter, scenes.FEW, size=(12, 8))
    reference = run(problem, "path", passes=8, samples=256).images
    extrapolated, widest = three_radii(problem, method, **settings)
    z = z_scores(extrapolated.mean(axis=(1, 2)), reference.mean(axis=(1, 2)))
    assert np.abs(z).max() < 3.0, z
    z = z_scores(blocks(extrapolated, 4), blocks(reference, 4))
    assert np.sqrt((z**2).mean()) < 1.8, z
    if name == "bpm":  # the test says something: there is a bias to take away
        assert np.abs(z_scores(blocks(widest, 4), blocks(reference, 4))).max() > 4.0


#: One row a way to use several radii: method and settings.
SEVERAL = {
    "vcm": ("vcm", {}),
    "vcm layers": ("vcm", {"split_layers": True, "merge_first": False, "heuristic": "power"}),
    "vcm path": ("vcm", {"light_source": "path", "connections": 2}),
    "bpm": ("bpm", {}),
}


@pytest.mark.parametrize("name", thinned(SEVERAL, ["vcm"]))
def test_several_radii_in_one_run_are_as_many_runs(name):
    """The same paths, so the same pictures up to rounding; roulette before shadow rays would decide by all radii."""
    method, settings = SEVERAL[name]
    settings = settings | {"radius_unit": "absolute", "shadow_roulette": 0.0, "samples_per_pass": 4}
    problem = scenes.room("mixed", scenes.FEW)
    together = go(prepared(problem, method, radius=0.2, radii="0.5, 2", **settings), 2)
    for layer, radius in (("image", 0.2), ("radius_0.5", 0.1), ("radius_2", 0.4)):
        alone = go(prepared(problem, method, radius=radius, **settings), 2).mean
        np.testing.assert_allclose(together.measurement.mean(layer), alone, rtol=2e-4, atol=1e-5, err_msg=layer)
    if "split_layers" in settings:
        parts = [together.measurement.mean(n) for n in ("emission", "next_event", "connection", "merge", "splat")]
        np.testing.assert_allclose(np.sum(parts, axis=0), together.mean, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("lights", [7, 8])
def test_direct_light_of_many_lights_is_found_by_all_techniques(lights):
    described = {"type": "scene", "sensor": scenes.camera(), "floor": {"type": "rectangle"}}
    for number in range(lights):
        described[f"lamp{number}"] = {"type": "point", "position": [number / lights, 0.0, 2.0]}
    problem = scenes.load(described)
    for direct_light, found in (("auto", lights == 8), ("all", True), ("next_event", False)):
        assert prepared(problem, "vcm", direct_light=direct_light).techniques.direct == found


@pytest.mark.slow
def test_several_radii_with_roulette_before_shadow_rays():
    """Roulette that all radii share is right for each: the same mean as without."""
    problem = scenes.room("mixed", scenes.FEW, size=(12, 8))
    settings = {"radius": 0.1, "radius_unit": "absolute", "radii": "3", "alpha": 1.0, "samples_per_pass": 64}
    runs = []
    for level, seed in ((0.0, 1), (1.0, 2)):
        runner = prepared(problem, "vcm", seed, shadow_roulette=level, **settings)
        runs.append(np.stack([runner.step(i, seed).mean("radius_3") for i in range(8)]))
    assert_agree(runs[1], runs[0], "roulette")


@pytest.mark.parametrize("text", ["x", "0.5,", "0", "-1", "1", "2,2", "2,2.0", "inf", "nan", "2,3,4,5,6"])
def test_bad_radii(text):
    with pytest.raises(OptionError, match="radii"):
        methods.get("vcm").Settings(radii=text)


def test_radii_without_merging():
    with pytest.raises(OptionError, match="merging"):
        methods.get("bpt").Settings(radii="2")


@pytest.mark.parametrize("alpha", [0.5, 2 / 3, 1.0])
@pytest.mark.parametrize("method", ["bpm", "vcm"])
def test_the_radius_schedule(method, alpha):
    """r_i = r_1 i^((alpha - 1) / 2), i from 1, for passes of one path per pixel; iterations count from 0. Passes of
    several have the radius of those after as many paths."""
    problem = scenes.field(0.5, 1.0)
    settings = {"alpha": alpha, "radius": 0.25, "radius_unit": "absolute"}
    runner = prepared(problem, method, samples_per_pass=1, **settings)
    larger = prepared(problem, method, samples_per_pass=4, **settings)
    for iteration in (0, 1, 2, 9, 99):
        expected = 0.25 * (iteration + 1) ** ((alpha - 1) / 2)
        assert runner.radius(iteration) == pytest.approx(expected, rel=1e-9)
        assert larger.radius(iteration) == pytest.approx(runner.radius(4 * iteration), rel=1e-9)


def test_radius_units():
    """A plane 2 x 2 seen from height 2: half its diagonal is sqrt(2), a pixel is 4 tan(20 degrees) / 8 wide."""
    problem = scenes.field(0.5, 1.0, size=(8, 8))
    assert prepared(problem, "vcm", radius=0.1, radius_unit="absolute").radius(0) == pytest.approx(0.1)
    assert prepared(problem, "vcm", radius=0.1, radius_unit="scene").radius(0) == pytest.approx(0.1 * 2**0.5, rel=1e-4)
    pixel = 4.0 * np.tan(np.deg2rad(20.0)) / 8
    assert prepared(problem, "vcm", radius=2.0, radius_unit="pixel").radius(0) == pytest.approx(2 * pixel, rel=0.1)


def still_life(ground: float = 2.0, sensor: Any = None, **more: Any) -> Any:
    """A cube under a lamp, on a ground of any size."""
    t = scenes.transform()
    return scenes.load(
        {
            "type": "scene",
            "sensor": sensor or scenes.camera((0.0, 1.5, 4.0), (0.0, 0.2, 0.0), 30.0, size=(32, 32)),
            "ground": {
                "type": "rectangle",
                "to_world": t.rotate([1, 0, 0], -90).scale(ground),
                "bsdf": scenes.diffuse(0.6, 0.5, 0.4),
            },
            "cube": {"type": "cube", "to_world": t.translate([0.7, 0.2, 0]).scale(0.2)},
            "lamp": scenes.lamp([0, 3, 0], 0.5, 10.0),
        }
        | more
    )


def radius_at(method: Any, *point: float) -> float:
    """Radius of the first pass at a point."""
    share = method._discs.share(mi.Point3f(*point))
    return float(method._discs.largest * np.sqrt(np.array(share).ravel()[0]) / method.problem.space.scale)


@pytest.mark.parametrize("name", thinned(["vcm", "bpm", "sppm", "ppm"], ["vcm", "ppm"]))
def test_the_radius_follows_what_pixels_see(name):
    """Not the size of the scene, nor anything far away, in view or not."""
    near = [0.0, 0.0, 0.0]
    pixel = 2.0 * np.tan(np.deg2rad(15.0)) / 32 * np.hypot(4.0, 1.5)
    expected = 2.0 * (32 * 32 / 256**2) ** (1 / 3) * pixel
    speck = {"type": "sphere", "center": [0, 900, 900], "radius": 1.0}
    for problem in (still_life(2.0), still_life(20.0), still_life(200.0), still_life(2.0, speck=speck)):
        assert radius_at(prepared(problem, name), *near) == pytest.approx(expected, rel=0.15)
    assert radius_at(prepared(still_life(200.0), name), 0.0, 0.0, 2.0) < 0.7 * expected
    twice = prepared(still_life(20.0), name, radius=2.0, radius_unit="pixel")
    assert radius_at(twice, *near) == pytest.approx(2.0 * pixel, rel=0.15)


@pytest.mark.slow
def test_the_radius_behind_mirrors_and_glass():
    """Of a pane before the lens and of a ball that fills the view, nothing depends on the distance."""
    t = scenes.transform()
    pane = {"type": "rectangle", "to_world": t.translate([0, 1.4, 3.7]).scale(0.2), "bsdf": {"type": "thindielectric"}}
    glass = {"type": "sphere", "center": [0.0, 1.5, 4.0], "radius": 0.05, "bsdf": {"type": "dielectric"}}
    plain = prepared(still_life(), "vcm")
    for more in ({"pane": pane}, {"glass": glass}):
        behind = prepared(still_life(**more), "vcm")
        assert radius_at(behind, 0, 0, 0) == pytest.approx(radius_at(plain, 0, 0, 0), rel=0.2)
        assert behind.radius(0) == pytest.approx(plain.radius(0), rel=0.5)


def test_the_radius_of_parallel_and_of_spherical_rays():
    size = {"size": (32, 16)}
    problem = still_life(200.0, sensor=scenes.camera(sensor="orthographic", **size))
    method = prepared(problem, "vcm")
    assert radius_at(method, 0, 0, 0) == radius_at(method, 0, 0, -100)
    noted = method.develop(method.step(0, 1)).metadata["merge_radius"]
    assert noted["scene_units"] == pytest.approx(radius_at(method, 0, 0, 0), rel=1e-3)
    around = prepared(still_life(200.0, sensor=scenes.camera(sensor="spherical", **size)), "vcm")
    pixel = np.sqrt(2.0 * np.pi**2 / (32 * 16))  # wide at the equator and at distance 1
    expected = 2.0 * (32 * 16 / 256**2) ** (1 / 3) * pixel
    assert 0.5 * expected < radius_at(around, 0, 0, 0) / np.linalg.norm([0.2, 1.0, 1.0]) < 2.0 * expected


@pytest.mark.parametrize("name", thinned(["vcm", "sppm", "pm", "auto", "vegas"], ["vcm", "sppm", "vegas"]))
def test_the_radius_is_in_the_metadata(name):
    settings = {"maps": 1} if name == "vegas" else {}
    method = prepared(still_life(), name, samples_per_pass=1, **settings)
    noted = method.develop(method.step(0, 1)).metadata["merge_radius"]
    pixel = 2.0 * np.tan(np.deg2rad(15.0)) / 32 * np.hypot(4.0, 1.5)
    assert noted["scene_units"] / noted["pixels"] == pytest.approx(pixel, rel=0.2)
    if name != "pm":
        assert noted["pixels"] == pytest.approx(2.0 * (32 * 32 / 256**2) ** (1 / 3), rel=0.01)


@pytest.mark.parametrize(
    "settings",
    [
        {"radius": -0.1},
        {"radius": "wide"},
        {"radius": float("nan")},
        {"alpha": 0},
        {"alpha": 1.5},
        {"radius_unit": "inch"},
        {"eta_discount": 0},
        {"eta_discount": 2},
        {"light_paths": 0},
        {"connections": -1},
        {"next_events": 100},
        {"max_depth": -2},
        {"heuristic": "maximum"},
        {"light_source": "cash"},
        {"samples_per_pass": -1},
        {"radiuss": 1},
    ],
    ids=str,
)
def test_bad_settings_are_refused(settings):
    (name,) = settings
    with pytest.raises(OptionError, match=name):
        methods.get("vcm").Settings.from_mapping(settings)


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("sppm", {"radius": -1}),
        ("sppm", {"alpha": 0}),
        ("sppm", {"alpha": 1.01}),
        ("ppm", {"light_paths": 0}),
        ("ppm", {"kernel": "box"}),
        ("ppm", {"direct": "both"}),
        ("pm", {"radius": -1}),
        ("pm", {"photons": 0}),
        ("pm", {"photons": 1.5}),
        ("pm", {"neighbours": 1}),
        ("pm", {"alpha": 0.5}),
    ],
    ids=str,
)
def test_bad_settings_of_photon_mapping_are_refused(method, settings):
    (name,) = settings
    with pytest.raises(OptionError, match=name):
        methods.get(method).Settings.from_mapping(settings)
