"""Patches of Mitsuba scenes: shapes, materials, lights."""

from __future__ import annotations

import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest
from support.scenes import bitmap, diffuse, mesh, rgb, transform

from etendue.core import EtendueError, SceneError, UnsupportedError
from etendue.radiosity import PatchError, diagnose, scene_patches

GREY = diffuse(0.5, 0.5, 0.5)
LAMP = {"type": "area", "radiance": rgb(1.0, 2.0, 3.0)}


def patches_of(shape, **options):
    return scene_patches(mi.load_dict({"type": "scene", "shape": shape}), **options)


@pytest.mark.parametrize(
    ("shape", "area", "count"),
    [
        ({"type": "rectangle"}, 4, 1),
        ({"type": "cube"}, 24, 12),
        ({"type": "disk"}, 64 / 2 * np.sin(2 * np.pi / 64), 64),
        ({"type": "cylinder"}, 64 * 2 * np.sin(np.pi / 64), 64),
        ({"type": "sphere"}, None, 64 * 32),
    ],
)
@pytest.mark.parametrize("flip", [False, True])
def test_shapes(shape, area, count, flip):
    to_world = transform().translate([3, -2, 1]).rotate([0, 0.6, 0.8], 40).scale(2)
    patches = patches_of({**shape, "to_world": to_world, "flip_normals": flip, "bsdf": GREY}, segments=64)
    assert len(patches) == count
    assert patches.areas.sum() == pytest.approx(4 * area if area else 16 * np.pi, rel=1e-6 if area else 4e-3)
    np.testing.assert_allclose(patches.reflectance, 0.5, rtol=1e-6)
    outward = ((patches.centres - patches.sphere[0]) * patches.normals).sum(axis=1)
    if shape["type"] in ("cube", "sphere", "cylinder"):
        assert ((outward < 0) == flip).all()
    normal = np.array(
        mi.load_dict({**shape, "to_world": to_world, "flip_normals": flip}).sample_position(0, [0.3, 0.4]).n
    )
    if shape["type"] in ("rectangle", "disk"):
        np.testing.assert_allclose(patches.normals, np.broadcast_to(normal.T, (count, 3)), atol=1e-6)
    if shape["type"] in ("sphere", "cube"):
        assert diagnose(patches).is_closed


def test_emission_is_pi_radiance_and_the_back_of_a_sheet_reflects():
    two = {"type": "twosided", "a": diffuse(0.1, 0.2, 0.3), "b": diffuse(0.4, 0.5, 0.6)}
    patches = patches_of({"type": "rectangle", "bsdf": two, "emitter": LAMP})
    assert len(patches) == 2
    np.testing.assert_allclose(patches.reflectance, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], rtol=1e-5)
    np.testing.assert_allclose(patches.emission, [np.pi * np.array([1, 2, 3]), [0, 0, 0]], rtol=1e-6)


def test_textures_are_averaged_over_a_face():
    left_right = bitmap(np.array([[[0.2] * 3, [0.6] * 3]]))
    texture = {**left_right, "filter_type": "nearest"}
    patches = patches_of({"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}})
    np.testing.assert_allclose(patches.reflectance, 0.4, rtol=1e-5)
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    colours = np.repeat([[0.0], [0.3], [0.6], [0.3]], 3, axis=1)
    of_vertices = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    shape = mesh(points, np.array([[0, 1, 2], [0, 2, 3]]), of_vertices, colours=colours)
    np.testing.assert_allclose(patches_of(shape).reflectance, 0.3, atol=0.01)


def test_other_reflecting_materials_count_as_diffuse(caplog):
    metal = {"type": "conductor", "specular_reflectance": 0.25, "material": "none"}
    np.testing.assert_allclose(patches_of({"type": "rectangle", "bsdf": metal}).reflectance, 0.25, rtol=1e-5)
    assert "counts as diffuse" in caplog.text


def test_a_constant_light_is_the_sky_and_shapes_make_patches():
    scene = {"type": "scene", "sky": {"type": "constant", "radiance": rgb(1, 2, 3)}}
    scene["ball"] = {"type": "sphere", "bsdf": GREY}
    scene["sheet"] = {"type": "rectangle", "bsdf": {"type": "twosided", "a": diffuse(0.2, 0.2, 0.2)}}
    patches = scene_patches(mi.load_dict(scene), per="shape")
    np.testing.assert_allclose(patches.sky, np.pi * np.array([1, 2, 3]), rtol=1e-6)
    order = np.argsort(patches.reflectance[:, 0])
    np.testing.assert_allclose(patches.areas[order][:2], 4)
    np.testing.assert_allclose(patches.reflectance[order, 0], [0.2, 0.2, 0.5], rtol=1e-5)
    assert patches.other_side[order].tolist() == [order[1], order[0], -1]


def test_a_scene_by_name_and_by_area():
    patches = scene_patches("cornell-box", max_area=0.1)
    assert patches.areas.max() <= 0.1 * (1 + 1e-6) and patches.emission.any()


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ({"type": "sphere", "bsdf": {"type": "dielectric"}}, "transmits light"),
        ({"type": "rectangle", "bsdf": {"type": "mask", "bsdf": GREY, "opacity": 0.5}}, "transmits light"),
        ({"type": "rectangle", "bsdf": {"type": "conductor", "material": "none"}}, "reflects 1"),
        ({"type": "rectangle", "emitter": {"type": "directionalarea", "radiance": 1.0}}, "does not emit evenly"),
        ({"type": "point", "intensity": 1.0}, "has no surface"),
    ],
)
def test_what_radiosity_cannot_have(shape, words):
    scene = mi.load_dict({"type": "scene", "floor": {"type": "rectangle", "bsdf": GREY}, "it": shape})
    with pytest.raises((UnsupportedError, PatchError)) as error:
        scene_patches(scene)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_scene_without_shapes_and_other_options():
    with pytest.raises(SceneError, match="no shapes"):
        scene_patches(mi.load_dict({"type": "scene"}))
    scene = mi.load_dict({"type": "scene", "floor": {"type": "rectangle"}})
    for options in ({"per": "wall"}, {"segments": 2}, {"per": "shape", "max_area": 0.1}):
        with pytest.raises(EtendueError):
            scene_patches(scene, **options)


def test_no_variant_has_to_be_set_before():
    code = "from etendue.radiosity import scene_patches\nprint(len(scene_patches('cornell-box')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout.strip()) == (0, "30"), done.stderr
