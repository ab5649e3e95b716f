"""Shading normals: whatever they do to a picture, every method does the same."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_path, run
from support.statistics import assert_agree
from support.tables import crossed


def tilted_floor():
    """A flat floor whose vertex normals lean by 40 degrees, between two walls."""
    points = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], float)
    lean = np.deg2rad(40)
    normals = np.tile([np.sin(lean), np.cos(lean), 0.0], (4, 1))
    floor = scenes.mesh(points, np.array([[0, 1, 2], [0, 2, 3]]), scenes.diffuse(0.6, 0.5, 0.4), normals)
    wall = {"type": "rectangle", "to_world": scenes.transform().translate([0, 0.8, -1]).scale([1, 0.8, 1])}
    return {"floor": floor, "wall": wall | {"bsdf": scenes.diffuse(0.5, 0.5, 0.5)}}


def coarse_ball():
    """An octahedron shaded as a ball, over a floor."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [4, 2, 1], [1, 2, 5], [5, 2, 0], [4, 3, 0], [1, 3, 4], [5, 3, 1], [0, 3, 5]])
    ball = scenes.mesh(points * 0.6 + [0, 0.65, 0], faces, scenes.MATERIALS["roughplastic"](), points)
    floor = {"type": "rectangle", "to_world": scenes.transform().rotate([1, 0, 0], -90).scale(1.5)}
    return {"ball": ball, "floor": floor | {"bsdf": scenes.diffuse(0.5, 0.5, 0.5)}}


def bumps():
    """A ball with a normal map and one with a bump map, over a floor."""
    floor = {"type": "rectangle", "to_world": scenes.transform().rotate([1, 0, 0], -90).scale(1.5)}
    return {
        "normals": scenes.thing("normalmap", (-0.5, 0.302, 0.0)),
        "bumps": scenes.thing("bumpmap", (0.5, 0.302, 0.0)),
        "floor": floor | {"bsdf": scenes.diffuse(0.5, 0.5, 0.5)},
    }


SCENES = {"tilted floor": tilted_floor, "coarse ball": coarse_ball, "bumps": bumps}
SMALL = {"radius": 0.02, "radius_unit": "absolute", "alpha": 1.0}
METHODS = {
    "path": ("path", {}),
    "light": ("light", {"light_paths": 2.0}),
    "bpt": ("bpt", {"connections": 2}),
    "vcm": ("vcm", SMALL),
    "bpm": ("bpm", SMALL | {"radius": 0.03}),
    "sppm": ("sppm", SMALL | {"radius": 0.03}),
    "sppm photons": ("sppm", SMALL | {"radius": 0.03, "direct": "photons"}),
}


def scene(name):
    light = scenes.EMITTERS["rectangle"]()
    return scenes.load({"type": "scene", "sensor": scenes.camera()} | light | SCENES[name]())


@lru_cache
def expected(name):
    return mitsuba_path(scene(name), passes=6, samples=512)


@pytest.mark.parametrize(("name", "method"), crossed(SCENES, METHODS, 6))
def test_methods_agree(name, method):
    reference = expected(name)
    problem = scene(name)
    kind, settings = METHODS[method]
    images = run(problem, kind, passes=6, samples=128, **settings).images
    if kind in ("bpm", "sppm"):  # its bias at edges is small, not zero
        noise = images.mean(axis=(1, 2)).std(0, ddof=1) / np.sqrt(len(images))
        mean = reference.mean(axis=(0, 1, 2))
        assert (np.abs(images.mean(axis=(0, 1, 2)) - mean) < 0.04 * mean + 3.0 * noise).all()
    else:
        assert_agree(images, reference, (name, method), precision=0.03)
