"""Patches of every size and place are solved alike: far from the origin, and of another size than a metre."""

from __future__ import annotations

import meshio
import mitsuba as mi
import numpy as np
import pytest
from support.patches import room
from support.scenes import diffuse, rgb

from etendue.points import OwenSobol
from etendue.products.patches import picture
from etendue.radiosity import (
    ABuffer,
    ChainedRays,
    LocalRays,
    Patches,
    RayScene,
    Solution,
    atlas,
    lightmap,
    read_patches,
    save_solution,
    scene_patches,
    shot_at_patches,
)

FAR = np.array([500000.25, -4000000.5, 30.0])


def met(size, away):
    """How many lines of each engine meet the patches of a room, and what a lamp lights."""
    plain = room(2)
    vertices = size * plain.vertices + away * np.array([1.0, -0.5, 0.3])
    patches = Patches(vertices, plain.faces, emission=np.r_[1.0, np.zeros(len(plain) - 1)])
    scene = RayScene(patches)
    engines = ABuffer(patches, lines=1024), LocalRays(scene), ChainedRays.through(scene)
    return [*(engine.cast(64).counted for engine in engines), shot_at_patches(scene, 1e4, OwenSobol(4)).irradiance]


def test_lines_meet_the_same_patches():
    expected = met(1.0, 0.0)
    for place in ((1e-3, 0.0), (1e4, 0.0), (1.0, 1e3), (1.0, 5e5)):
        for one, other in zip(expected, met(*place), strict=True):
            np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9)


def solved(patches, irradiance):
    """A solution whose irradiance is known."""
    radiosity = patches.emission + patches.reflectance * irradiance
    return Solution(patches, radiosity, irradiance, np.zeros(len(patches)), (0.0,))


def corner(away):
    """A floor, a box and a lamp, seen from beside them."""

    def at(frame):
        matrix = np.array(frame.matrix, dtype=float).reshape(4, 4)
        matrix[:3, 3] += away
        return mi.ScalarTransform4d(matrix)

    turn = mi.ScalarTransform4d()
    return {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "to_world": at(turn.look_at([0.3, 1.1, 3.3], [0, 0.2, 0], [0, 1, 0])),
            "film": {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}},
        },
        "box": {"type": "cube", "to_world": at(turn.translate([0, 0.3, 0]).scale(0.3)), "bsdf": diffuse(0.5, 0.6, 0.7)},
        "floor": {"type": "cube", "to_world": at(turn.translate([0, -0.1, 0]).scale([1, 0.1, 1]))},
        "lamp": {
            "type": "rectangle",
            "to_world": at(turn.translate([0, 2, 0]).rotate([1, 0, 0], 90)),
            "emitter": {"type": "area", "radiance": rgb(1, 2, 3)},
        },
    }


def test_a_scene_far_from_the_origin_has_the_same_patches_and_pictures():
    """In the coordinates of the scene, where single precision holds places to 1/4."""
    pytest.importorskip("xatlas")
    results, textures = [], []
    for away in (np.zeros(3), FAR):
        scene = corner(away)
        patches = scene_patches(scene, max_area=0.2)
        solution = solved(patches, 1.5 + patches.centres - away)
        texture = lightmap(solution, *atlas(patches, 64))
        seen = picture(solution, scene, spp=16).image
        assert np.isfinite(seen).all() and seen.mean() > 0.1
        # A texel at the edge of an island may be lost by rounding: of the texture, how much it covers and its mean.
        covered = texture.values[texture.covered]
        sums = np.array([len(covered), covered.mean()])
        results.append([patches.vertices - away, patches.areas, seen])
        textures.append(sums)
    for one, other in zip(*results, strict=True):
        assert np.abs(other - one).mean() < 1e-4 * np.abs(one).mean()
    np.testing.assert_allclose(textures[1], textures[0], rtol=5e-3)


@pytest.mark.slow
def test_gathering_far_from_the_origin():
    """By the same random numbers, so that there is no noise but where rounding leads a path elsewhere."""
    images = []
    for away in (np.zeros(3), FAR):
        patches = scene_patches(corner(away), max_area=0.2)
        images.append(picture(solved(patches, 1.5 + patches.centres - away), corner(away), gather=16).image)
    assert np.abs(images[1] - images[0]).mean() < 1e-3 * images[0].mean()


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".ply"])
def test_files_of_solutions_far_from_the_origin(suffix, tmp_path):
    plain = room(2)
    patches = Patches(plain.vertices + FAR, plain.faces, reflectance=0.5)
    save_solution(tmp_path / f"far{suffix}", solved(patches, np.ones((len(patches), 1))))
    found = read_patches(tmp_path / f"far{suffix}")
    np.testing.assert_allclose(found.vertices.min(axis=0), patches.vertices.min(axis=0), rtol=0, atol=1e-6)
    assert found.areas.sum() == pytest.approx(plain.areas.sum(), rel=1e-6)


def test_meshes_far_from_the_origin(caplog, tmp_path):
    """Of single precision: a line says what it holds."""
    vertices, faces = np.array([[5e5, 0, 0], [500001, 0, 0], [5e5, 1, 0]]), np.array([[0, 1, 2]])
    Patches(vertices, faces)
    assert not caplog.text
    Patches(vertices.astype(np.float32), faces)
    assert "single precision rounds coordinates of 5e+05 to multiples of 0.06" in caplog.text
    caplog.clear()
    meshio.Mesh(vertices.astype(np.float32), [("triangle", faces)]).write(tmp_path / "wall.ply")
    read_patches(tmp_path / "wall.ply")
    assert "wall.ply: single precision rounds coordinates of 5e+05" in caplog.text
    caplog.clear()
    scene_patches(mi.load_dict({"type": "scene", "wall": corner(FAR)["box"] | {"bsdf": diffuse(0.1, 0.2, 0.3)}}))
    assert "single precision rounds coordinates of 4e+06" in caplog.text
