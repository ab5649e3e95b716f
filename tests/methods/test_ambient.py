"""Paths that end in an ambient term: closed forms, what they are without it, and what it brings."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.running import prepared, run
from support.scenes import furnace

from etendue import film
from etendue.methods import get
from etendue.scene import load
from etendue.surfaces import AMBIENT_TERMS
from etendue.transport import AmbientTable

RADIANCE, ALBEDO = 0.8, 0.5


@pytest.mark.parametrize("term", AMBIENT_TERMS)
def test_ambient_light_of_a_furnace(term):
    """Every surface emits L and reflects rho: H_k = pi L rho^k / (1 - rho), for every normal."""
    problem = furnace("box", RADIANCE, ALBEDO)
    for reflected in (1, 3):
        exact = np.pi * RADIANCE * ALBEDO**reflected / (1 - ALBEDO)
        found = np.stack(
            [prepared(problem, "ambient_path", seed, ambient=term).found.irradiance(reflected) for seed in range(8)]
        )
        error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
        assert (np.abs(found.mean(axis=0) - exact) < 5 * error + 1e-5).all()
        assert (found.std(axis=0) < 0.03 * exact).all()


@pytest.mark.parametrize(
    ("method", "bounces", "plate"),
    [("ambient_path", 2, False), ("ambient_path", 2, True), ("ambient_light", 1, False), ("ambient_light", 2, True)],
)
def test_pictures_of_a_furnace(method, bounces, plate):
    """Several seeds, as each has its own ambient light. A null surface is no reflection."""
    problem = furnace("sphere", RADIANCE, ALBEDO, plate=plate)
    means = [run(problem, method, seed=seed, passes=1, samples=256, bounces=bounces).mean.mean() for seed in range(8)]
    assert abs(np.mean(means) - RADIANCE / (1 - ALBEDO)) < 4 * np.std(means, ddof=1) / np.sqrt(8) + 1e-4
    assert np.std(means) < 0.03


@pytest.mark.parametrize("bounces", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_without_ambient_light_paths_are_shorter_ones(bounces):
    """Sample by sample those of ``path``, and of ``light``, of so many edges and one more."""
    problem = load("cornell-box", size=(16, 12))
    for method, plain in (("ambient_path", "path"), ("ambient_light", "light")):
        ending = prepared(problem, method, bounces=bounces, samples_per_pass=16)
        ending.ambient = AmbientTable("fuzzy", np.zeros((6, 3)))
        short = prepared(problem, plain, max_depth=bounces + 1, samples_per_pass=16)
        images = [each.step(0, 5).mean() for each in (ending, short)]
        np.testing.assert_allclose(*images, rtol=0 if method == "ambient_path" else 1e-4, atol=1e-7)


def test_what_is_left_out_becomes_less():
    """The relative error of the picture: of paths without an ambient term, with one, and with one after more bounces.
    Measured: 0.099, 0.063, 0.0053."""
    problem = load("cornell-box", size=(24, 24))
    exact, without = (run(problem, "path", passes=2, samples=512, max_depth=depth).mean for depth in (-1, 2))
    errors = [film.relative_mse(without, exact)]
    errors += [
        film.relative_mse(run(problem, "ambient_path", passes=2, samples=256, bounces=bounces).mean, exact)
        for bounces in (1, 2)
    ]
    assert errors[1] < 0.8 * errors[0]
    assert errors[2] < 0.2 * errors[1]


def test_light_that_leaves_is_no_ambient_light():
    """A white floor under a sky: nothing comes back to it. In a half-open place some does."""
    floor = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.9}}
    camera = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, -1, 3], [0, 0, 0], [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8},
    }
    sky = {"type": "constant", "radiance": 1.0}
    problem = load({"type": "scene", "floor": floor, "sensor": camera, "sky": sky})
    assert prepared(problem, "ambient_path").found.irradiance().max() == 0.0
    two = load({"type": "scene", "floor": floor, "sensor": camera, "sky": sky, "ball": ball()})
    light = prepared(two, "ambient_path").found.irradiance().max(axis=1)
    assert light[4] > 0.01  # what looks up sees the ball
    assert light[5] > light[4]  # what looks down sees the floor


def ball():
    return {"type": "sphere", "radius": 0.4, "center": [0, 0, 0.6], "bsdf": {"type": "diffuse"}}


def test_a_mirror_is_no_end():
    """The furnace seen in a mirror: the ambient term is that of the wall in the mirror."""
    dictionary = {
        "type": "scene",
        "box": {
            "type": "cube",
            "flip_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": ALBEDO},
            "emitter": {"type": "area", "radiance": RADIANCE},
        },
        "mirror": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0.9, 0]).rotate([1, 0, 0], 90).scale(0.5),
            "bsdf": {"type": "twosided", "bsdf": {"type": "conductor", "material": "none"}},
        },
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, -0.5, 0], [0, 1, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "filter": {"type": "box"}},
        },
    }
    means = [
        run(load(dictionary), "ambient_path", seed=seed, passes=1, samples=256, bounces=1).mean.mean(axis=2)
        for seed in range(6)
    ]
    # The middle sees the mirror, the corner does not.
    for pixel in ((4, 4), (0, 0)):
        values = np.array([mean[pixel] for mean in means])
        error = values.std(ddof=1) / np.sqrt(len(values))
        assert abs(values.mean() - RADIANCE / (1 - ALBEDO)) < 5 * error + 1e-3, pixel


def test_settings():
    settings = get("ambient_path").Settings.from_mapping({"ambient": "crisp", "bounces": "3", "mode": "next_event"})
    assert (settings.ambient, settings.bounces, settings.mode) == ("crisp", 3, "next_event")


def test_max_depth():
    """It ends paths before the ambient term, or not at all."""
    problem = load("cornell-box", size=(16, 12))
    for method, plain in (("ambient_path", "path"), ("ambient_light", "light")):

        def image(name, **settings):
            return prepared(problem, name, samples_per_pass=16, **settings).step(0, 5).mean()

        whole = image(method, bounces=2)
        np.testing.assert_allclose(image(method, bounces=2, max_depth=9), whole, rtol=1e-4, atol=1e-6)
        short = image(plain, max_depth=3)
        np.testing.assert_allclose(image(method, bounces=2, max_depth=3), short, rtol=1e-4, atol=1e-6)
        assert short.mean() < 0.97 * whole.mean()
