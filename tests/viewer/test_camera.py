"""The camera: movements in closed form, and the matrices that sensors and pages get."""

import math

import mitsuba as mi
import numpy as np
import pytest

from etendue.core import OptionError
from etendue.scene import Problem, bundled_scene, load
from etendue.viewer.camera import Pose, place, projection, vertical_fov
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


def test_the_vertical_field_of_view():
    assert vertical_fov(90.0, (200, 100)) == pytest.approx(math.degrees(2 * math.atan(0.5)))


def test_moving_pictures_of_a_thin_lens_keep_their_trace():
    """Without its aperture, which frozen functions do not know."""
    problem = load("skylight", size=(32, 24))
    (step, preview), pose = (0, Preview(problem)), Pose.of(problem)
    pictures = [preview.picture(pose) for _ in range(3)]
    (moving,) = preview._made.values()
    assert moving._function != moving._radiance and preview._step == step
    assert pictures[0].shape == (24, 32, 3) and not np.array_equal(pictures[0], pictures[1])
    assert np.mean(pictures) == pytest.approx(0.21, rel=0.1)
