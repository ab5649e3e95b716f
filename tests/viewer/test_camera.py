"""The camera: movements in closed form, and the matrices that sensors and pages get."""

import dataclasses
import math

import mitsuba as mi
import numpy as np
import pytest

from etendue.core import OptionError
from etendue.scene import Problem, RenderSpace, bundled_scene, load
from etendue.viewer.camera import Pose, held_back, place, projection
from etendue.viewer.preview import Preview


def pose(**changes):
    values = {"origin": [0.0, 0.0, 4.0], "target": [0.0, 0.0, 0.0], "up": [0.0, 1.0, 0.0]}
    values = {k: np.array(v) for k, v in values.items()} | changes
    return Pose(own=np.eye(3), fov=60.0, size=2.0, **values)


def test_movements_have_their_closed_form():
    start = pose()
    quarter = start.orbited(math.pi / 2, 0.0)
    assert np.allclose(quarter.origin, [4.0, 0.0, 0.0]) and np.allclose(quarter.target, 0.0)
    above = start.orbited(0.0, 10.0)  # not over the pole
    assert above.distance == pytest.approx(4.0) and above.origin[1] == pytest.approx(4.0 * math.cos(0.02))
    # Mitsuba's picture has the camera's left on the left: seen along -z with y up, x grows to the right.
    assert np.allclose(start.shifted(0.5, 0.0, 0.0).origin, [2.0, 0.0, 4.0])
    assert np.allclose(start.shifted(0.0, 0.5, 0.25).target, [0.0, 2.0, -1.0])
    assert start.approached(math.log(2.0)).distance == pytest.approx(2.0)
    assert start.approached(1e9).distance > 0
    assert start.zoomed(math.log(2.0)).fov == pytest.approx(30.0) and start.zoomed(-1e9).fov == 150.0
    assert np.allclose(start.rolled(math.pi / 2).up, np.cross([0, 0, -1], [0, 1, 0]))
    turned = start.turned(math.pi / 2, 0.0)
    assert np.allclose(turned.origin, start.origin) and np.allclose(turned.target, [4.0, 0.0, 4.0])


def test_orbits_are_around_the_pivot_which_keeps_its_place():
    start = pose(pivot=np.array([1.0, 0.5, 2.0]))
    for turn in ((0.3, 0.0), (0.0, -0.4), (0.3, 0.2)):
        moved = start.orbited(*turn)
        before, after = (p._frame().T @ (p.pivot - p.origin) for p in (start, moved))
        assert np.allclose(after, before)
        assert moved.distance == pytest.approx(start.distance)
        assert not np.allclose(moved.origin, start.origin)


def test_an_orbit_ends_at_a_wall():
    problem = load("cornell-box", size=(16, 16))
    inside = dataclasses.replace(Pose.of(problem), origin=np.array([0.0, 0.0, 0.7]), target=np.array([0.0, 0.0, -0.9]))
    near, through = inside.orbited(0.1, 0.0), inside.orbited(1.2, 0.0)
    assert held_back(problem, inside, near) is near
    assert held_back(problem, inside, through) is inside
    assert held_back(problem, inside, inside) is inside


@pytest.mark.parametrize("message", [{"orbit": [1]}, {"pan": [1, "a"]}, {"dolly": None}, {"fly": [1, 2, float("nan")]}])
def test_movements_that_are_no_numbers_are_refused(message):
    with pytest.raises(OptionError):
        pose().moved(message)


def test_the_pose_of_a_scene_is_that_of_its_sensor_and_projects_as_it_does():
    """Of a tilted and mirrored sensor as well: the matrix is kept, and points of its rays project to their pixels."""
    description = bundled_scene("cornell-box").build()
    matrix = np.array(mi.ScalarTransform4f().look_at([0.4, 0.3, 3.9], [0, 0, 0], [0.3, 1, 0.1]).matrix)
    description["sensor"]["to_world"] = mi.ScalarTransform4f(matrix @ np.diag([-1.0, 1.0, 1.0, 1.0]))
    problem: Problem = load(description, size=(48, 32))
    found = Pose.of(problem)
    assert np.allclose(found.matrix(), np.array(problem.sensor.world_transform().matrix).reshape(4, 4), atol=1e-5)
    assert not found.is_plain
    moved = found.orbited(0.3, 0.2)
    place(problem.sensor, moved)
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(0.25, 0.75), mi.Point2f(0.5))
    point = np.array(ray(2.0)).ravel()
    x, y, _, w = np.array(projection(problem, moved)) @ [*point, 1.0]
    assert (x / w, y / w) == pytest.approx((12.0, 24.0), abs=1e-3)
    assert moved.placed(moved.plain(problem), problem).distance == pytest.approx(moved.distance)


def test_moving_pictures_of_a_thin_lens_keep_their_trace():
    """Without its aperture, which frozen functions do not know."""
    problem = load("skylight", size=(32, 24))
    (step, preview), pose = (0, Preview(problem)), Pose.of(problem)
    pictures = [preview.picture(pose) for _ in range(3)]
    (moving,) = preview._made.values()
    assert moving._function != moving._radiance and preview._step == step
    assert pictures[0].shape == (24, 32, 3) and not np.array_equal(pictures[0], pictures[1])
    assert np.mean(pictures) == pytest.approx(0.21, rel=0.1)


def seen_from(to_world, **sensor):
    """A box seen by a sensor: (pose, problem)."""
    description = bundled_scene("cornell-box").build()
    kept = {key: description["sensor"][key] for key in ("film", "sampler")}
    description["sensor"] = {"type": "perspective", "fov": 40.0, "to_world": to_world, **kept} | sensor
    if sensor.get("type") == "orthographic":
        del description["sensor"]["fov"]
    problem = load(description, size=(48, 32))
    return Pose.of(problem), problem


def look_at(origin, target=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0)):
    return mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))


def assert_projects(found, problem):
    place(problem.sensor, found)
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(0.25, 0.75), mi.Point2f(0.5))
    x, y, _, w = np.array(projection(problem, found)) @ [*np.array(ray(2.0)).ravel(), 1.0]
    assert (x / w, y / w) == pytest.approx((12.0, 24.0), abs=1e-3)


def test_a_picture_whose_principal_point_is_moved():
    found, problem = seen_from(look_at((0, 0, 4)), principal_point_offset_x=0.1, principal_point_offset_y=-0.2)
    assert_projects(found.orbited(0.2, 0.1), problem)


def test_the_target_is_what_the_middle_shows():
    """Also beyond a near plane, from which the distance of a ray counts."""
    far, near = (seen_from(look_at((0, 0, 4)), near_clip=clip)[0] for clip in (2.0, 1e-3))
    assert np.allclose(far.target, near.target, atol=1e-5) and -1.0 <= far.target[2] <= 1.0


def test_a_steep_camera_orbits_around_the_axis_that_it_shows_upright():
    assert np.allclose(seen_from(look_at((3, 10, 4)))[0].up, [0, 1, 0])
    assert np.allclose(seen_from(look_at((3, 4, 10), up=(0, 0, 1)))[0].up, [0, 0, 1])


def test_an_up_that_is_set_is_up_in_the_picture():
    found, problem = seen_from(look_at((0, 0, 4), up=(0.6, 0.8, 0.0)))
    assert np.allclose(found.plain(problem)["up"], [0.6, 0.8, 0.0], atol=1e-6)
    same = found.placed(found.plain(problem), problem)
    assert np.allclose(same.matrix(), found.matrix(), atol=1e-6)
    assert np.allclose(found.placed({"up": [0, 1, 0]}, problem).matrix()[:3, 1], [0, 1, 0], atol=1e-6)


def test_an_orthographic_camera_approaches_by_the_size_of_its_view():
    matrix = np.array(look_at((0, 0, 4)).matrix) @ np.diag([0.8, 0.8, 1.0, 1.0])
    found, problem = seen_from(mi.ScalarTransform4f(matrix), type="orthographic")
    near = found.approached(math.log(2.0))
    assert np.allclose(near.matrix(), found.matrix() @ np.diag([0.5, 0.5, 1.0, 1.0]), atol=1e-6)
    assert np.allclose(found.zoomed(math.log(2.0)).matrix(), near.matrix())
    assert np.linalg.norm(found.approached(1e9).own[:, 0]) > 0
    assert_projects(near.shifted(0.25, 0.0, 0.0), problem)
    assert near.shifted(0.5, 0.0, 0.0).origin[0] - near.origin[0] == pytest.approx(0.4, abs=1e-6)  # half its width


def test_a_pose_is_the_same_in_another_render_space():
    old, new = RenderSpace(), RenderSpace((1.0, 2.0, 3.0), 4.0)
    start = pose(up=np.array([0.6, 0.8, 0.0]))
    there = start.carried(old, new)
    assert np.allclose(new.to_scene(there.origin), start.origin) and np.allclose(
        new.to_scene(there.target), start.target
    )
    assert np.allclose(there.matrix()[:3, :3], start.matrix()[:3, :3]) and there.size == 4.0 * start.size
    assert start.carried(old, old) is start
