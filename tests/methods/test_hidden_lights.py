"""``hide_emitters``: the camera sees what is behind lights. Every method against Mitsuba's ``path``, whose geometry
behind lamps is meshes: it misplaces hits on other shapes there."""

from __future__ import annotations

from functools import lru_cache
from itertools import product
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_images, prepared, replicas, run
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue import methods
from etendue.core import UnsupportedError
from etendue.products.patches import picture


def description(integrator: str = "path", **options: Any) -> dict[str, Any]:
    """A floor and a glossy block under a sky, behind and below two lamps, one of which hides part of the other."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera((0.0, 1.2, 4.0), (0.0, 0.8, 0.0), 50.0)}
    scene["integrator"] = {"type": integrator, "hide_emitters": True, **options}
    turned = scenes.transform().translate([0.3, 0.5, -0.3]).rotate([0.6, 0.8, 0.0], 30)
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 1.5, True)
    scene["block"] = {"type": "cube", "to_world": turned.scale(0.35), "bsdf": {"type": "roughconductor", "alpha": 0.3}}
    scene["ball"] = {"type": "sphere", "center": [0.2, 0.8, 1.0], "radius": 0.25, "emitter": scenes._area(4, 5, 6)}
    place = scenes.transform().translate([0.1, 0.9, 0.6]).rotate([0, 1, 0], 20).scale(0.3)
    scene["plate"] = {"type": "rectangle", "to_world": place, "emitter": scenes._area(5, 3, 2)}
    scene["sky"] = {"type": "constant", "radiance": scenes.rgb(0.3, 0.3, 0.3)}
    return scene


def veiled() -> dict[str, Any]:
    """The same, seen through a mask that Mitsuba's ``volpath`` crosses."""
    scene = description("volpath")
    mask = {"type": "mask", "opacity": 0.4, "nested": {"type": "twosided", "inner": scenes.diffuse(0.7, 0.3, 0.3)}}
    place = scenes.transform().translate([0.3, 0.8, 1.6]).scale(0.5)
    scene["mask"] = {"type": "rectangle", "to_world": place, "bsdf": mask}
    return scene


@lru_cache(maxsize=2)
def reference(through_a_mask: bool) -> tuple[Any, np.ndarray]:
    problem = scenes.load(veiled() if through_a_mask else description())
    integrator = mi.load_dict({"type": problem.integrator, "hide_emitters": True})
    return problem, mitsuba_images(problem, integrator, 6, 512, seed=1000)


METHODS = ("path", "light", "bpt", "vcm", "guided", "sppm", "vegas", "pssmlt", "mmlt", "film_metropolis", "auto")
FAST = [("path", True), ("light", False), ("vcm", False), ("vcm", True)]


@pytest.mark.parametrize(("name", "through_a_mask"), thinned(product(METHODS, (False, True)), FAST))
def test_agrees_with_mitsuba(name, through_a_mask):
    problem, expected = reference(through_a_mask)
    if name in ("pssmlt", "mmlt", "film_metropolis", "guided", "auto"):
        images = replicas(problem, name, passes=1, hide_emitters=True)
    else:
        images = run(problem, name, hide_emitters=True).images
    assert_agree(images, expected, name, precision=0.03)


def test_the_integrator_of_a_scene_says_so():
    scene = description()
    hidden, loaded = (etendue.render(source, "path", spp=4) for source in (scene, mi.load_dict(scene)))
    np.testing.assert_array_equal(hidden.image, loaded.image)
    shown = etendue.render(scene, "path", spp=4, hide_emitters=False)
    assert hidden.image.max() < 3.0 < shown.image.max()
    assert not hidden.image[0].any() and shown.image[0].all()  # the sky


def test_a_lamp_that_bounds_a_medium_is_not_hidden():
    scene = description()
    scene["ball"] |= {"bsdf": {"type": "null"}, "interior": {"type": "homogeneous", "sigma_t": 0.4}}
    with pytest.raises(UnsupportedError, match=r"shape 'ball' of type 'sphere' emits light and bounds a medium"):
        etendue.render(scene, "path", spp=1)
    assert etendue.render(scene, "path", spp=1, hide_emitters=False).image.any()


@pytest.mark.parametrize("gather", [0, 16])
def test_pictures_of_solutions_hide_lights(gather):
    scene = description()
    del scene["block"]
    solution = etendue.solve_radiosity(scene, bundles=64).solution
    hidden = picture(solution, scene, gather=gather).image
    scene["integrator"]["hide_emitters"] = False
    shown = picture(solution, scene, gather=gather).image
    assert hidden.max() < 2.0 < shown.max()
    assert not hidden[0].any() and shown[0].all()


def test_first_hits_are_behind_lamps():
    problem = scenes.load(description())
    layers = {hide: prepared(problem, "path", aovs=True, hide_emitters=hide).step(0, 1) for hide in (True, False)}
    assert not layers[True].mean("emitted").any()
    behind, lamp = (layers[hide].mean("depth")[6, 8, 0] for hide in (True, False))
    assert lamp + 1.0 < behind


def test_alpha_is_the_coverage_of_what_is_seen():
    scene = description("vcm")
    scene["sensor"]["film"]["pixel_format"] = "rgba"
    loaded = mi.load_dict(scene)
    expected = np.array(mi.render(loaded, integrator=mi.load_dict({"type": "path", "hide_emitters": True}), spp=512))
    alpha = np.array(mi.render(loaded, spp=1))[:, :, 3]
    assert alpha.mean() == pytest.approx(expected[:, :, 3].mean(), abs=0.005)
    np.testing.assert_allclose(alpha, expected[:, :, 3], atol=0.13)  # of 32 rays in a pixel


@pytest.mark.parametrize("method", thinned(methods.names(), ("auto",)))
def test_every_method_has_alpha(method):
    scene = description()
    del scene["sky"]
    made = etendue.render(scene, method, spp=2, size=(8, 6), coverage=True, hide_emitters=True)
    assert made.layers["alpha"].shape == (6, 8, 1) and 0.1 < made.layers["alpha"].mean() < 0.9
