"""Shadow rays end where they were aimed, whatever they cross on the way."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes

from etendue.transport import Visibility


@pytest.mark.parametrize("sheets", [0, 1, 3])
def test_points_of_a_ball_are_seen_through_sheets(sheets):
    """From below, points of a ball that face away by up to 89 degrees; sheets cross it and hang below it."""
    scene = {"type": "scene", "sensor": scenes.camera(), "sky": {"type": "constant"}, "ball": {"type": "sphere"}}
    for index in range(sheets):
        place = scenes.transform().translate([0.0, 0.3 - 0.7 * index, 0.0]).rotate([1, 0, 0], 80.0).scale(9.0)
        scene[f"sheet{index}"] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "null"}}
    visibility = Visibility(scenes.load(scene).scene)
    assert visibility.transparent == (sheets > 0)

    rng = np.random.default_rng(3)
    ends = rng.standard_normal((20000, 3))
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    starts = np.array([0.0, -3.0, 0.0]) + rng.uniform(-0.5, 0.5, ends.shape)
    way = ends - starts
    distance = np.linalg.norm(way, axis=1)
    facing = -(way * ends).sum(1) / distance > np.cos(np.radians(89.0))
    at = in_space(starts[facing])
    ray = at.spawn_ray_to(mi.Point3f(*ends[facing].T.astype(np.float32)))
    sight = visibility.along(ray, mi.UInt32(8), mi.Bool(True))
    seen, share = sight.visible, sight.transmittance
    assert facing.sum() > 5000
    assert np.asarray(seen).mean() > 0.999
    assert np.asarray(share).min() == 1.0


def in_space(points: np.ndarray) -> mi.Interaction3f:
    """Points in free space."""
    at = dr.zeros(mi.Interaction3f)
    at.p = mi.Point3f(*points.T.astype(np.float32))
    return at


@pytest.mark.parametrize("reach", [np.inf, np.finfo(np.float32).max])
@pytest.mark.parametrize("sheets", [1, 2, 3])
def test_an_endless_ray_is_blocked_behind_sheets(sheets, reach):
    """However many surfaces it has crossed, what stands behind the last one is in its way."""
    scene = {"type": "scene", "sensor": scenes.camera(), "sky": {"type": "constant"}}
    for index in range(sheets):
        place = scenes.transform().translate([0.0, 0.0, 1.0 + index]).scale(9.0)
        scene[f"sheet{index}"] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "null"}}
    scene["wall"] = {"type": "rectangle", "to_world": scenes.transform().translate([1.0, 0.0, 9.0])}
    visibility = Visibility(scenes.load(scene).scene)
    starts = in_space(np.array([[1.0, 0.5, 0.0], [-1.0, 0.5, 0.0]]))  # before the wall, and beside it
    ray = starts.spawn_ray(mi.Vector3f(0.0, 0.0, 1.0))
    ray.maxt = mi.Float(float(reach))
    sight = visibility.along(ray, mi.UInt32(8), mi.Bool(True))
    seen, share = sight.visible, sight.transmittance
    assert np.asarray(seen).tolist() == [False, True]
    assert np.asarray(share)[0].tolist() == [0.0, 1.0]


def test_sheets_of_instances_attenuate_and_walls_of_instances_block():
    half = {"type": "mask", "opacity": 0.25, "bsdf": {"type": "diffuse"}}
    right, left = (scenes.transform().translate([x, 0.0, 0.0]) for x in (1.0, -1.0))
    scene = {
        "type": "scene",
        "sensor": scenes.camera(),
        "sky": {"type": "constant"},
        "sheet": {"type": "shapegroup", "rectangle": {"type": "rectangle", "bsdf": half}},
        "wall": {"type": "shapegroup", "rectangle": {"type": "rectangle"}},
        "once": {"type": "instance", "to_world": right, "group": {"type": "ref", "id": "sheet"}},
        "twice": {"type": "instance", "to_world": right.translate([0, 0, 1]), "group": {"type": "ref", "id": "sheet"}},
        "solid": {"type": "instance", "to_world": left, "group": {"type": "ref", "id": "wall"}},
    }
    visibility = Visibility(scenes.load(scene).scene)
    starts = in_space(np.array([[1.0, 0.2, -3.0], [-1.0, 0.2, -3.0], [9.0, 0.2, -3.0]]))
    ray = starts.spawn_ray(mi.Vector3f(0.0, 0.0, 1.0))
    for spare, expected in ((8, [0.75**2, 0.0, 1.0]), (1, [0.0, 0.0, 1.0]), (0, [0.0, 0.0, 1.0])):
        share = visibility.along(ray, mi.UInt32(spare), mi.Bool(True)).transmittance
        np.testing.assert_allclose(np.asarray(share)[0], expected, rtol=1e-5)


def test_opaque_meshes_tested_first_change_nothing():
    """Cubes, balls and sheets with holes between random points: as if every surface had been looked at in turn."""
    scene = {"type": "scene", "sensor": scenes.camera(), "sky": {"type": "constant"}}
    checker = {"type": "checkerboard", "color0": 0.0, "color1": 1.0, "to_uv": scenes.transform().scale(4.0)}
    leaf = {"type": "mask", "opacity": checker, "bsdf": {"type": "diffuse"}}
    haze = {"type": "mask", "opacity": 0.4, "bsdf": {"type": "diffuse"}}
    rng = np.random.default_rng(11)
    shapes = [{"type": "cube"}, {"type": "sphere"}, {"type": "rectangle", "bsdf": leaf}, {"type": "cube", "bsdf": haze}]
    for index in range(16):
        place = (
            scenes.transform().translate(list(rng.uniform(-3.0, 3.0, 3))).rotate([0, 0.6, 0.8], 40.0 * index).scale(0.5)
        )
        scene[f"shape{index}"] = shapes[index % 4] | {"to_world": place}
    loaded = scenes.load(scene).scene
    visibility, plain = Visibility(loaded), Visibility(loaded)
    plain._opaque = None

    starts, ends = rng.uniform(-4.0, 4.0, (2, 20000, 3))
    ray = in_space(starts).spawn_ray_to(mi.Point3f(*ends.T.astype(np.float32)))
    sight = visibility.along(ray, mi.UInt32(8), mi.Bool(True))
    seen, share = sight.visible, sight.transmittance
    reference = plain.along(ray, mi.UInt32(8), mi.Bool(True))
    expected, expected_share = reference.visible, reference.transmittance
    assert (visibility._opaque is None) == (dr.backend_v(mi.Float) != dr.JitBackend.LLVM)
    assert 0.5 < np.asarray(seen).mean() < 0.9
    np.testing.assert_array_equal(np.asarray(seen), np.asarray(expected))
    np.testing.assert_array_equal(np.asarray(share), np.asarray(expected_share))
    assert len(np.unique(np.asarray(share)[0])) >= 4  # 0, 1, and through one wall of haze or more
