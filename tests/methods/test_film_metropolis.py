"""Samples on the film: pictures of any resolution, borders, lights that are painted later, and the mean."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support import scenes
from support.running import Run, go, prepared, replicas, run
from support.statistics import assert_agree
from support.tables import thinned

from etendue.core import OptionError, UnsupportedError
from etendue.film import Development, block_average
from etendue.methods import FilmMetropolis
from etendue.scene import Problem, load

SMALL = {"samples_per_pass": 64, "bootstrap": 1 << 13}
XYZ = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])


def rendered(problem: Problem, passes: int = 4, seed: int = 1, **settings: Any) -> tuple[Any, Run]:
    method = prepared(problem, "film_metropolis", seed, **(SMALL | settings))
    return method, go(method, passes, seed)


def developed(method: Any, made: Run, size: tuple[int, int], **how: Any) -> np.ndarray:
    return np.asarray(method.picture(made.measurement, Development(size, **how)))


@pytest.mark.slow
def test_one_run_renders_at_two_resolutions():
    """A histogram of twice the resolution has the same samples; so has a kernel's, but for its width in the film."""
    method, made = rendered(scenes.room("rectangle", scenes.FEW))
    width, height = scenes.SIZE
    coarse = developed(method, made, (width, height))
    fine = developed(method, made, (2 * width, 2 * height))
    np.testing.assert_allclose(block_average(fine, 2), coarse, rtol=1e-4, atol=1e-6)
    smooth = [developed(method, made, (n * width, n * height), estimator="kernel", bandwidth=0.7 * n) for n in (1, 2)]
    np.testing.assert_allclose(smooth[1].mean(), smooth[0].mean(), rtol=0.01)


@pytest.mark.parametrize("estimator", ["kernel", "variable", "nearest"])
def test_estimators_keep_the_light(estimator):
    method, made = rendered(scenes.room("rectangle", scenes.FEW))
    picture = developed(method, made, scenes.SIZE, estimator=estimator)
    assert picture.min() >= 0.0
    np.testing.assert_allclose(picture.mean(), made.mean.mean(), rtol=0.05)


@pytest.mark.parametrize("lights", thinned(["later", "split", "chain"], ["split"]))
def test_the_mean_of_each_channel_is_that_of_path(lights):
    """CIE XYZ, with lights in every way; runs of 16 seeds against passes."""
    problem = scenes.room("rectangle", scenes.FEW)
    path = run(problem, "path", passes=8, samples=256).images.mean(axis=(1, 2)) @ XYZ.T
    means = [rendered(problem, 1, seed, lights=lights)[1].mean.mean(axis=(0, 1)) for seed in range(1, 17)]
    found = np.array(means) @ XYZ.T
    error = np.hypot(found.std(0, ddof=1) / 4.0, path.std(0, ddof=1) / np.sqrt(8))
    assert (error < 0.02 * path.mean(0)).all()
    np.testing.assert_array_less(np.abs(found.mean(0) - path.mean(0)), 4.5 * error)


def lamp_and_mirror() -> Problem:
    """A lamp that is seen twice: by itself, and in a mirror on the floor."""
    scene = {"type": "scene", "sensor": scenes.camera((0.0, 1.0, 4.0), (0.0, 0.5, 0.0), 45.0)}
    scene["floor"] = scenes.plate((0, 0, 0), 2.0, True)
    scene["mirror"] = scenes.plate((0, 0.01, 1.5), 0.3, True) | {"bsdf": {"type": "conductor"}}
    scene["lamp"] = {
        "type": "rectangle",
        "to_world": scenes.transform().translate([0, 1.2, -1]).scale(0.5),
        "bsdf": scenes.diffuse(0.5, 0.5, 0.5),
        "emitter": {"type": "area", "radiance": 2.0},
    }
    return load(scene)


#: Settings, and the method that makes the same picture.
OTHER_PATHS: dict[str, tuple[dict[str, Any], str]] = {
    "light": ({"paths": "light"}, "light"),
    "pairs": ({"paths": "bidirectional"}, "path"),
    "uniform": ({"bsdf_sampling": False}, "path"),
    "light, lamps by chains": ({"paths": "light", "lights": "chain"}, "light"),
    "pairs, lamps by chains": ({"paths": "bidirectional", "lights": "chain"}, "path"),
    "light, few numbers": ({"paths": "light", "vertices": 1}, "light"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHER_PATHS)
def test_other_paths_make_the_picture_of_another_method(name):
    settings, other = OTHER_PATHS[name]
    problem = lamp_and_mirror()
    images = replicas(problem, "film_metropolis", 8, 2, 128, **settings)
    assert_agree(images, run(problem, other, passes=8, samples=256).images, settings)


@pytest.mark.parametrize(
    ("emitter", "group"), thinned([("rectangle", "rough"), ("point", "specular"), ("envmap", "transparent")], [])
)
@pytest.mark.parametrize("paths", ["light", "bidirectional"])
def test_other_paths_among_materials(emitter, group, paths):
    """Caustics of a point light among them, which camera paths do not find."""
    problem = scenes.room(emitter, group)
    images = replicas(problem, "film_metropolis", 8, 2, 256, paths=paths)
    other = "light" if paths == "light" else "bpt"
    assert_agree(images, run(problem, other, passes=8, samples=1024).images, (emitter, group, paths))


@pytest.mark.slow
def test_light_paths_find_caustics_that_camera_paths_do_not():
    """Of a point light under a ball of glass."""
    problem = scenes.room("point", ("dielectric",))
    camera, both = (replicas(problem, "film_metropolis", 8, 2, 128, paths=p) for p in ("camera", "bidirectional"))
    assert_agree(both, run(problem, "bpt", passes=8, samples=512).images)
    error = np.hypot(*(images.mean(axis=(1, 2)).std(0, ddof=1) / 8**0.5 for images in (camera, both)))
    assert (both.mean(axis=(0, 1, 2)) - camera.mean(axis=(0, 1, 2)) > 5.0 * error).all()


@pytest.mark.slow
def test_an_independent_estimator_of_the_same_light_is_beside():
    """It determines the scale. One that finds more light, or samples what chains may not, would be no comparison."""
    problem = scenes.room("rectangle", scenes.FEW)
    beside = {
        str(o): prepared(problem, "film_metropolis", **SMALL, **o)._beside.method
        for o in ({}, {"paths": "light"}, {"paths": "bidirectional"}, {"bsdf_sampling": False})
    }
    assert [m.name for m in beside.values()] == ["bpt", "light", "bpt", "path"]
    uniform = prepared(problem, "pssmlt", **SMALL, bsdf_sampling=False)._beside.method
    for method in (beside["{'bsdf_sampling': False}"], uniform):
        assert method.name == "path" and not method.settings.bsdf_sampling


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"paths": "light", "lights": "split"}, "lights=split needs paths=camera, not paths=light; use lights=later"),
        ({"paths": "bidirectional", "bsdf_sampling": False}, "bsdf_sampling=false needs paths=camera"),
    ],
)
def test_settings_that_exclude_each_other(settings, message):
    with pytest.raises(OptionError, match=message):
        FilmMetropolis.Settings(**settings)


def test_light_paths_need_a_sensor_that_points_can_be_connected_to():
    problem = scenes.room("rectangle", scenes.FEW, sensor="orthographic")
    with pytest.raises(UnsupportedError, match="'film_metropolis with paths=light' would render a black picture"):
        prepared(problem, "film_metropolis", **SMALL, paths="light")
    prepared(problem, "film_metropolis", **SMALL, paths="bidirectional")


@pytest.mark.slow
@pytest.mark.parametrize("lights", ["later", "split"])
def test_a_lamp_behind_a_thin_screen(lights):
    """Light that is seen through null surfaces is painted, or left to the chains, but not lost."""
    problem = load(
        {
            "type": "scene",
            "sensor": scenes.camera((0.0, 1.0, 4.0), (0.0, 1.0, 0.0), 30.0, size=(6, 6)),
            "lamp": {
                "type": "rectangle",
                "to_world": scenes.transform().translate([0, 1, -1]).scale(0.5),
                "emitter": {"type": "area", "radiance": 1.0},
            },
            "floor": scenes.plate((0.0, 0.3, -0.5), 0.4, True),
            "screen": {
                "type": "rectangle",
                "to_world": scenes.transform().translate([0, 1, 0]).scale(1.5),
                "bsdf": {"type": "mask", "opacity": 0.1, "nested": scenes.diffuse(0.5, 0.5, 0.5)},
            },
        }
    )
    reference = run(problem, "path", passes=4, samples=1024).mean
    found = rendered(problem, 2, samples_per_pass=1024, lights=lights)[1].mean
    assert 0.85 < reference[2:4, 2:4].mean() < 0.95
    np.testing.assert_allclose(found[2:4, 2:4], reference[2:4, 2:4], rtol=0.05)


def test_a_picture_of_lights_alone():
    """Chains without light of their own sample what is seen, as the picture's only light."""
    scene = {"type": "scene", "sensor": scenes.camera((0.0, 1.0, 4.0), (0.0, 1.0, 0.0), 30.0)}
    scene["lamp"] = {
        "type": "rectangle",
        "to_world": scenes.transform().translate([0, 1, 0]).scale(0.5),
        "emitter": {"type": "area", "radiance": 2.0},
    }
    problem = load(scene)
    reference = run(problem, "path", passes=1, samples=256).mean
    method, made = rendered(problem)
    assert method.seen_lights == "chain" and method.settings.lights == "later"
    assert made.mean.mean() == pytest.approx(reference.mean(), rel=0.02)
    assert made.mean.max() == pytest.approx(2.0, rel=0.2)


@pytest.mark.slow
def test_halves_of_painted_light_are_independent():
    """They do not share an evenly spread sequence, of whose points one half may lie on one half of the film: their
    difference would be no measure of the error of their mean."""
    scene = {"type": "scene", "sensor": scenes.camera((0.0, 1.0, 4.0), (0.0, 1.0, 0.0), 40.0, size=(4, 4))}
    scene["floor"] = scenes.plate((0, 0, 0), 0.5, True)
    scene["lamp"] = {
        "type": "rectangle",
        "to_world": scenes.transform().translate([0.3, 1.3, -1]).rotate([0, 0, 1], 30).scale(0.5),
        "emitter": {"type": "area", "radiance": 20.0},
    }
    method = prepared(load(scene), "film_metropolis", sampler="owen", **SMALL)
    rows = [method._painted(i, 1, 1024.0, {"rays": 0.0, "nonfinite": 0.0}) for i in range(200)]
    halves = np.array([part.reshape(2, -1, 5)[:, :, 2].sum(axis=1) for part in rows])
    one, other = halves.mean(axis=0)
    assert one == pytest.approx(other, rel=0.02)
    assert abs(np.corrcoef(halves.T)[0, 1]) < 0.3


@pytest.mark.slow
def test_going_on_lowers_the_error():
    problem = scenes.room("rectangle", scenes.FEW)
    reference = run(problem, "path", passes=8, samples=512).mean
    errors = {1: [], 5: []}
    for seed in range(1, 5):
        method = prepared(problem, "film_metropolis", seed, **(SMALL | {"samples_per_pass": 16}))
        total = None
        for iteration in range(5):
            measurement = method.step(iteration, seed)
            total = measurement if total is None else total + measurement
            if iteration + 1 in errors:
                errors[iteration + 1].append(np.mean((total.mean() - reference) ** 2))
    # Five times the samples have a fifth of the variance.
    assert np.mean(errors[5]) < 0.4 * np.mean(errors[1])


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["kernel", "variable"])
def test_the_border_is_dark_without_samples_around_it(estimator):
    """Inside a uniform closed surface every pixel has the same radiance."""
    problem = scenes.furnace("sphere", 1.0, 0.5, size=(16, 16))
    how = {"estimator": estimator, "bandwidth": 1.0}
    rim = np.ones((16, 16), bool)
    rim[1:-1, 1:-1] = False

    def border(margin: float, inset: float) -> float:
        method, made = rendered(problem, 8, margin=margin, lights="chain", samples_per_pass=256)
        picture = developed(method, made, (16, 16), inset=inset, **how)
        return float(picture[rim].mean() / picture[~rim].mean())

    assert border(0.0, 0.0) < 0.85
    assert border(0.4, 0.0) == pytest.approx(1.0, abs=0.03)
    assert border(0.0, 0.25) == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_lights_painted_later_lower_the_error_of_the_rest():
    """A lamp in the picture has most of the luminance, and so most of the samples of chains that see it."""
    problem = load(
        {
            "type": "scene",
            "sensor": scenes.camera((0.0, 1.0, 4.0), (0.0, 0.7, 0.0), 45.0),
            "floor": scenes.plate((0, 0, 0), 2.0, True),
            "lamp": {
                "type": "rectangle",
                "to_world": scenes.transform().translate([0, 1.2, -1]).scale(0.5),
                "emitter": {"type": "area", "radiance": 20.0},
            },
        }
    )
    reference = run(problem, "path", passes=8, samples=512).mean
    assert reference[:7].max() > 19.0
    dark = np.s_[9:]  # rows of floor only: a pixel that the lamp touches has the noise of the paint
    assert 0.0 < reference[dark].max() < 2.0
    errors = {}
    for lights in ("chain", "later", "split"):
        runs = [rendered(problem, 2, seed, lights=lights)[1].mean for seed in range(1, 5)]
        errors[lights] = np.mean([np.mean((picture - reference)[dark] ** 2) for picture in runs])
    assert errors["later"] < 0.5 * errors["chain"], errors
    assert errors["split"] < 0.5 * errors["chain"], errors
