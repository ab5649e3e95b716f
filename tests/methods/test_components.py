"""Emission, direct light, caustics and indirect light: the same of every method, and their sum is the picture."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import prepared, run
from support.statistics import assert_agree
from support.tables import thinned

from etendue.core import OptionError
from etendue.film import COMPONENTS, is_variance, variance_of
from etendue.methods import base, get, guided

PASSES, SAMPLES = 6, 256
#: Density estimation with a radius whose bias is far below the noise.
_SMALL = {"radius": 0.02, "radius_unit": "absolute"}
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "path": ("path", {}),
    "path next event": ("path", {"mode": "next_event"}),
    "guided": ("guided", {"cell_samples": 500}),
    "vegas": ("vegas", {}),
    "vegas one path": ("vegas", {"one_path": True}),
    "vegas photons": ("vegas", {"maps": 1, **_SMALL, "alpha": 1.0, "light_paths": 4.0}),
    "stratified": ("stratified", {}),
    "light": ("light", {"light_paths": 4.0}),
    "bpt": ("bpt", {}),
    "bpt path": ("bpt", {"light_source": "path"}),
    "bpm": ("bpm", {**_SMALL, "alpha": 1.0}),
    "vcm": ("vcm", {**_SMALL, "alpha": 1.0}),
    "vcm late": ("vcm", {**_SMALL, "alpha": 1.0, "merge_first": False, "radii": "0.5,2"}),
    "pm": ("pm", {"photons": 100_000, "neighbours": 10}),
    "pm photons": ("pm", {"photons": 100_000, "neighbours": 10, "direct": "photons"}),
    "pm final gather": ("pm", {"photons": 100_000, "neighbours": 10, "final_gather": True}),
    "ppm": ("ppm", _SMALL),
    "sppm": ("sppm", _SMALL),
    "sppm photons": ("sppm", {**_SMALL, "direct": "photons"}),
    "pssmlt": ("pssmlt", {"bootstrap": 1 << 14}),
    "pssmlt bidirectional": ("pssmlt", {"bootstrap": 1 << 14, "estimator": "bidirectional"}),
    "mmlt": ("mmlt", {"bootstrap": 1 << 14}),
    "auto": ("auto", {"radius": 0.001, "probe_passes": 1}),
}
#: Their ambient light is exact in a furnace only.
AMBIENT: dict[str, tuple[str, dict[str, Any]]] = {
    "ambient_path": ("ambient_path", {"bounces": 2}),
    "ambient_light": ("ambient_light", {"bounces": 2}),
}
#: Methods whose passes depend on each other, or share their camera rays: independent runs have the variance.
DEPENDENT = ("guided", "vegas", "pssmlt", "mmlt", "ppm", "auto", *AMBIENT)
FAST = ("path", "light", "bpt", "sppm")


def parts(method: str, problem: Any, seed: int = 1, samples: int = SAMPLES, **settings: Any) -> dict[str, np.ndarray]:
    """(passes, h, w, 3) of each component, whose sum has been checked against the picture."""
    settings = {"components": True} | settings
    if method in DEPENDENT:
        measured = [run(problem, method, 2, samples, seed + i, **settings).measurement for i in range(PASSES)]
    else:
        runner = prepared(problem, method, seed, samples_per_pass=samples, **settings)
        measured = [runner.step(i, seed) for i in range(PASSES)]
    layers = {name: np.stack([m.mean(name) for m in measured]) for name in COMPONENTS}
    image = np.stack([m.mean() for m in measured])
    np.testing.assert_allclose(sum(layers.values()), image, rtol=1e-5, atol=1e-6)
    return layers


@pytest.mark.parametrize("name", thinned(METHODS | AMBIENT, (*FAST, *AMBIENT)))
def test_components_in_a_furnace(name):
    """Inside a sphere of emission L and albedo a: L, a L, nothing, and a^2 L / (1 - a) in every pixel."""
    method, settings = (METHODS | AMBIENT)[name]
    radiance, albedo = 0.8, 0.5
    layers = parts(method, scenes.furnace("sphere", radiance, albedo), **settings)
    expected = {
        "emission": radiance,
        "direct": albedo * radiance,
        "caustic": 0.0,
        "indirect": albedo**2 * radiance / (1.0 - albedo),
    }
    for layer, value in expected.items():
        means = layers[layer].mean(axis=(1, 2, 3))
        error = means.std(ddof=1) / len(means) ** 0.5  # next to nothing where a weight makes contributions equal
        assert abs(means.mean() - value) <= 5.0 * error + 2e-4 * value, (name, layer, means)
        assert error <= 0.01, (name, layer)


def hall() -> Any:
    """A floor and a wall under a ball of light, seen directly and in a mirror, with a ball of glass."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera(), **scenes.EMITTERS["sphere"]()}
    place = scenes.transform().translate([0.0, 1.5, -1.3]).scale([2.0, 1.5, 1.0])
    scene["wall"] = {"type": "rectangle", "to_world": place, "bsdf": scenes.diffuse(0.4, 0.5, 0.6)}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 2.0, up=True)
    turned = scenes.transform().translate([-1.0, 0.6, -0.3]).rotate([0, 1, 0], 60).scale([0.5, 0.6, 1.0])
    mirror = {"type": "twosided", "inner": {"type": "conductor", "material": "none"}}
    scene["mirror"] = {"type": "rectangle", "to_world": turned, "bsdf": mirror}
    scene["glass"] = {"type": "sphere", "center": [0.6, 0.45, 0.3], "radius": 0.35, "bsdf": {"type": "dielectric"}}
    return scenes.load(scene)


def sees_mirrors(problem: Any) -> np.ndarray:
    """Pixels from which a ray meets the mirror or the glass."""
    width, height = problem.size
    lane = np.arange(width * height * 64)
    x, y = lane // 64 % width + (lane % 8 + 0.5) / 8, lane // 64 // width + (lane // 8 % 8 + 0.5) / 8
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(x / width, y / height), mi.Point2f(0.5))
    si = problem.scene.ray_intersect(ray)
    specular = si.is_valid() & ~mi.has_flag(si.bsdf(ray).flags(), mi.BSDFFlags.Smooth)
    return np.array(specular).reshape(height, width, 64).any(-1)


@lru_cache(maxsize=1)
def reference() -> dict[str, np.ndarray]:
    return parts("path", hall(), seed=100, samples=1024)


@pytest.mark.parametrize("name", thinned(METHODS, FAST[1:]))
def test_components_of_all_methods_agree(name):
    """By a Z-test with the measured variance, layer by layer. ``light`` does not see anything in mirrors and glass."""
    method, settings = METHODS[name]
    problem = hall()
    found, expected = parts(method, problem, **settings), reference()
    hidden = sees_mirrors(problem)[..., None] & (method == "light")
    for layer in COMPONENTS:
        a, b = (np.where(hidden, 0.0, layers[layer]) for layers in (found, expected))
        # A caustic of a lamp is light that path finds rarely.
        assert_agree(a, b, (name, layer), precision=0.15 if layer == "caustic" else 0.03)


def test_a_mirror_shows_the_components_of_what_is_in_it():
    """A black lamp above a floor, both seen in a mirror, which also lights the floor. There is no other light."""
    scene = {
        "type": "scene",
        "sensor": scenes.camera((0.0, 0.5, 0.0), (0.0, 0.5, -1.0), 60.0),
        "mirror": {
            "type": "rectangle",
            "to_world": scenes.transform().translate([0.0, 0.5, -1.0]).scale(2.0),
            "bsdf": {"type": "conductor", "material": "none"},
        },
        "lamp": scenes.lamp((0.0, 1.0, 1.5), 0.4, 5.0) | {"bsdf": scenes.diffuse(0.0, 0.0, 0.0)},
        "floor": scenes.plate((0.0, 0.0, 1.5), 2.0, up=True),
    }
    layers = parts("path", scenes.load(scene), samples=64)
    assert min(layers[name].mean() for name in ("emission", "direct", "caustic")) > 1e-4
    assert not layers["indirect"].any()


def test_the_picture_does_not_depend_on_the_layers():
    problem = hall()
    whole = run(problem, "path", passes=2, samples=16, clamp=2.0, components=True)
    plain = run(problem, "path", passes=2, samples=16, clamp=2.0)
    np.testing.assert_allclose(whole.mean, plain.mean, rtol=1e-4, atol=1e-6)
    total = sum(whole.measurement.mean(name) for name in COMPONENTS)
    np.testing.assert_allclose(total, whole.mean, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", thinned(("path", "bpt", "sppm", "ppm", "guided", "vegas", "auto"), ("path", "ppm")))
def test_first_hits_are_recorded_by_the_walk(name, monkeypatch):
    """The layers of rays that the walk traces are those of rays traced for them alone; the emission is what paths of
    one edge find."""
    runner = prepared(hall(), name, samples_per_pass=8, aovs=True, max_depth=1)
    with monkeypatch.context() as patch:
        patch.setattr(base, "Walker", lambda **_: pytest.fail("rays were traced for the layers alone"))
        measured = runner.step(0, 1)
    traced, _ = runner.first_layers(0, 1, 8)
    assert sorted(traced) == ["albedo", "depth", "emitted", "normal", "seen_albedo", "seen_normal", "seen_share"]
    for layer, expected in traced.items():
        np.testing.assert_allclose(measured.mean(layer), expected / 8.0, rtol=1e-6, err_msg=layer)
    np.testing.assert_allclose(measured.mean("emitted"), measured.mean(), rtol=1e-5, atol=1e-6)
    assert measured.mean().any()


def test_first_hits_are_recorded_by_every_part_of_a_pass_in_which_a_guide_learns(monkeypatch):
    monkeypatch.setattr(guided, "STEP_LANES", 2 * 16 * 12)
    runner = prepared(hall(), "guided", samples_per_pass=8, aovs=True, max_depth=2)
    measured, (traced, _) = runner.step(0, 1), runner.first_layers(0, 1, 8)
    for layer, expected in traced.items():
        np.testing.assert_allclose(measured.mean(layer), expected / 8.0, rtol=1e-6, err_msg=layer)


@pytest.mark.parametrize("name", thinned(("path", "bpt", "sppm", "guided", "vegas", "stratified"), ("path", "bpt")))
@pytest.mark.parametrize("reconstruction", ["neighbours", "independent"])
def test_of_many_camera_paths_of_a_pixel_the_first_ones_tell_the_first_hits(name, reconstruction):
    """A camera path has the same numbers in a pass of 8 per pixel and in one of 16."""
    settings = {"aovs": True, "sampler": "owen", "reconstruction": reconstruction}
    few, many = (prepared(hall(), name, samples_per_pass=n, **settings).step(0, 1) for n in (8, 16))
    assert np.abs(few.mean() - many.mean()).max() > 1e-3
    for layer in ("albedo", "normal", "depth", "emitted"):
        np.testing.assert_allclose(many.mean(layer), few.mean(layer), rtol=1e-4, atol=1e-5, err_msg=layer)


SEEN = ("path", "bpt", "vcm", "sppm", "guided", "vegas", "stratified", "light", "pssmlt", "auto")


def wall_behind(pane: dict[str, Any]) -> Any:
    """A wall of albedo (0.2, 0.4, 0.6) behind the camera and one before it, which a pane hides; and a lamp."""
    wall = scenes.diffuse(0.2, 0.4, 0.6)
    turned = scenes.transform().translate([0.0, 0.5, 3.0]).rotate([0, 1, 0], 180).scale(9.0)
    return scenes.load(
        {
            "type": "scene",
            "sensor": scenes.camera((0.0, 0.5, 0.0), (0.0, 0.5, -1.0), 60.0),
            "pane": pane,
            "before": {
                "type": "rectangle",
                "to_world": scenes.transform().translate([0.0, 0.5, -3.0]).scale(9.0),
                "bsdf": wall,
            },
            "behind": {"type": "rectangle", "to_world": turned, "bsdf": wall},
            "lamp": scenes.lamp((0.0, 3.0, 0.0), 0.4, 5.0) | {"bsdf": scenes.diffuse(0.0, 0.0, 0.0)},
        }
    )


@pytest.mark.parametrize("name", thinned(SEEN, ("path", "bpt", "light")))
def test_what_is_seen_in_a_mirror(name):
    """The wall behind the camera, in all pixels, as dark as the mirror shows it."""
    place = scenes.transform().translate([0.0, 0.5, -1.0]).scale(4.0)
    grey = {"type": "conductor", "material": "none", "specular_reflectance": scenes.rgb(0.5, 0.5, 0.5)}
    problem = wall_behind({"type": "rectangle", "to_world": place, "bsdf": grey})
    layers = first_layers(problem, name)
    np.testing.assert_allclose(layers["seen_albedo"], np.broadcast_to((0.1, 0.2, 0.3), (12, 16, 3)), rtol=1e-4)
    np.testing.assert_allclose(layers["seen_normal"], np.broadcast_to((0.0, 0.0, -1.0), (12, 16, 3)), atol=1e-3)
    assert not layers["albedo"].any() and (layers["normal"][:, :, 2] > 0.99).all()
    assert "seen_share" not in layers


@pytest.mark.parametrize("name", thinned(SEEN, ("path", "bpt", "light")))
def test_what_is_seen_through_glass_is_not_noisy(name):
    """The few paths that the pane reflects, to another wall, do not count, nor do those that roulette ends."""
    pane = {
        "type": "cube",
        "to_world": scenes.transform().translate([0.0, 0.5, -1.5]).scale([4.0, 4.0, 0.05]),
        "bsdf": {"type": "dielectric"},
    }
    layers = first_layers(wall_behind(pane), name)
    near = np.s_[3:-3, 3:-3]  # further away, glass reflects more
    normal = layers["seen_normal"][near]
    np.testing.assert_allclose(normal, np.broadcast_to((0.0, 0.0, 1.0), normal.shape), atol=1e-3)
    hue = layers["seen_albedo"][near] / layers["seen_albedo"][near][:, :, 2:]
    np.testing.assert_allclose(hue, np.broadcast_to((1 / 3, 2 / 3, 1.0), hue.shape), rtol=1e-4)


def first_layers(problem: Any, name: str) -> dict[str, np.ndarray]:
    """Layers of two passes of two camera rays per pixel."""
    runner = prepared(problem, name, samples_per_pass=2, aovs=True)
    measured = runner.step(0, 1)
    measured += runner.step(1, 1)
    return runner.develop(measured).layers


@pytest.mark.parametrize("name", ["path", "bpt", "light"])
def test_without_mirrors_there_is_no_layer_of_what_is_seen_in_them(name):
    floor = scenes.plate((0.0, 0.0, 0.0), 0.5, up=True)
    problem = scenes.load({"type": "scene", "sensor": scenes.camera(), "floor": floor, **scenes.EMITTERS["sphere"]()})
    layers = first_layers(problem, name)
    assert layers["albedo"].any() and not [layer for layer in layers if layer.startswith("seen_")]


def test_what_is_seen_directly_is_the_first_surface():
    """Also where there is none. The mirror is out of sight."""
    floor = scenes.plate((0.0, 0.0, 0.0), 0.5, up=True)
    mirror = {"type": "sphere", "center": [0.0, 50.0, 0.0], "radius": 1.0, "bsdf": {"type": "conductor"}}
    scene = {"type": "scene", "sensor": scenes.camera(), "floor": floor, "mirror": mirror}
    layers = first_layers(scenes.load(scene | scenes.EMITTERS["sphere"]()), "path")
    lit = layers["albedo"].max(axis=2)
    assert (lit == 0.0).any() and (lit > 0.0).any()
    for what in ("albedo", "normal"):
        np.testing.assert_allclose(layers[f"seen_{what}"], layers[what], atol=1e-6)


@pytest.mark.parametrize("settings", [{"components": True}, {"split_layers": True}, {}])
def test_the_variance_of_each_part(settings):
    """That between the passes, over their number."""
    runner = prepared(hall(), "bpt", samples_per_pass=4, aovs=True, **settings)
    passes = [runner.step(i, 1) for i in range(4)]
    parts = [name for name in passes[0].sums if name in base.PARTS]
    means = {name: np.stack([m.mean(name) for m in passes]) for name in ("image", *parts)}
    total = passes[0]
    for more in passes[1:]:
        total += more
    layers = runner.develop(total).layers
    assert len(parts) == (4 if settings else 0)
    assert sorted(filter(is_variance, layers)) == sorted(map(variance_of, ("image", *parts)))
    for name, values in means.items():
        expected = values.var(axis=0, ddof=1) / len(passes)
        np.testing.assert_allclose(layers[variance_of(name)], expected, rtol=1e-3, atol=1e-9)


def test_chains_have_the_variance_of_components():
    runner = prepared(hall(), "pssmlt", samples_per_pass=4, aovs=True, components=True, bootstrap=1 << 12)
    measured = runner.step(0, 1)
    measured += runner.step(1, 1)
    layers = runner.develop(measured).layers
    for name in COMPONENTS:
        assert (layers[variance_of(name)] >= 0.0).all()
    assert layers[variance_of("indirect")].any()


def test_the_shape_in_the_middle_of_each_pixel():
    problem = hall()
    result = prepared(problem, "path", samples_per_pass=1, aovs=True).develop(run(problem, "path", 1, 1).measurement)
    shapes, names = result.layers["shape"], result.metadata["shapes"]
    assert shapes.shape == (12, 16, 1)
    assert {"light", "wall", "floor", "mirror", "glass"} == {names[int(n) - 1] for n in np.unique(shapes) if n}
    assert not (
        sees_mirrors(problem)[..., None] < np.isin(shapes, [1 + names.index(n) for n in ("mirror", "glass")])
    ).any()


@pytest.mark.parametrize(
    ("method", "settings", "message"),
    [
        ("bpt", {"split_layers": True}, "leave out one of them"),
        ("film_metropolis", {}, "use pssmlt"),
    ],
)
def test_what_has_no_components_says_so(method, settings, message):
    with pytest.raises(OptionError, match=message):
        get(method).Settings.from_mapping({"components": True, **settings})
