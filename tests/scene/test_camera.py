"""A camera in the place of the scene's own: what it sees, and what is no camera."""

import json

import mitsuba as mi
import numpy as np
import pytest

from etendue.core import OptionError
from etendue.scene import Camera, described_sensor, load

SCENE = """<scene version="3.0.0">
    <sensor type="perspective"><string name="focal_length" value="50mm"/><film type="hdrfilm"/></sensor>
    <sensor type="orthographic"><film type="hdrfilm"/></sensor>
    <sensor type="thinlens">
        <float name="fov" value="20"/><string name="fov_axis" value="diagonal"/>
        <float name="aperture_radius" value="0.001"/><float name="focus_distance" value="3"/><film type="hdrfilm"/>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere"/>
</scene>"""


@pytest.fixture
def path(tmp_path):
    (tmp_path / "scene.xml").write_text(SCENE)
    return tmp_path / "scene.xml"


def rays(problem):
    """Origin and directions through the middle, the upper and the right edge of the picture."""
    at = mi.Point2f([0.5, 0.5, 1.0], [0.5, 0.0, 0.5])
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, at, mi.Point2f(0.5))
    return np.array(ray.o).T, np.array(ray.d).T


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("sensor", [0, 2])
def test_it_looks_where_it_is_told_to(path, sensor, axis):
    camera = Camera([1, 2, 3], [1, 2, -4], up=[1, 0, 0], fov=40, fov_axis=axis)
    origins, (middle, up, right) = rays(load(path, size=(60, 30), sensor=sensor, camera=camera))
    np.testing.assert_allclose(origins, np.tile([1, 2, 3], (3, 1)), atol=0.02)  # near clip, lens
    np.testing.assert_allclose(middle, [0, 0, -1], atol=1e-3)
    # An edge is 20 degrees from the middle, and the film is twice as wide as it is high.
    high = np.tan(np.radians(20)) * (0.5 if axis == "x" else 1.0)
    np.testing.assert_allclose(up / -up[2], [high, 0, -1], atol=1e-3)
    np.testing.assert_allclose(right / -right[2], [0, -2 * high, -1], atol=1e-3)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_pictures_tell_it(path, axis):
    camera = Camera([1, 2, 3], [1, 2, -4], up=[1, 0, 0], fov=40, fov_axis=axis)
    told = described_sensor(load(path, size=(60, 30), camera=camera))
    across = 1.0 if axis == "x" else 2.0
    assert np.tan(np.radians(0.5 * told["fov"])) == pytest.approx(across * np.tan(np.radians(20)), rel=1e-5)
    np.testing.assert_allclose(told["to_world"], [[0, 1, 0, 1], [1, 0, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]], atol=1e-6)
    assert told["size"] == told["crop_size"] == [60, 30]
    assert json.loads(json.dumps(told)) == told


def test_what_is_not_told_stays(path):
    _, kept = rays(load(path, size=(60, 40)))
    _, turned = rays(load(path, size=(60, 40), camera=Camera([0, 0, 0], [1, 0, 0])))
    np.testing.assert_allclose(kept @ kept[0], turned @ turned[0], atol=1e-5)  # the same field of view
    (origin, *_), (middle, *_) = rays(load(path, camera=Camera(fov=10)))
    np.testing.assert_allclose([*origin, *middle], [0, 0, origin[2], 0, 0, 1], atol=1e-5)


def test_a_resumed_run_needs_the_camera_again(path):
    camera = Camera([0, 0, 5], [0, 0, 0], fov=30)
    assert Camera(**camera.to_dict()) == camera
    assert load(path, camera=camera).fingerprint != load(path).fingerprint


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"origin": [0, 0, 1]}, "needs both origin and target"),
        ({"target": [0, 0, 1]}, "needs both origin and target"),
        ({"origin": [0, 0, 1], "target": [0, 0, 1]}, "is its origin"),
        ({"origin": [0, 0, 1], "target": [0, 3, 1]}, "along its view"),
        ({"origin": [0, 0, 1], "target": [0, 3, 1], "up": [0, 0, 0]}, "is zero"),
        ({"origin": [0, 1], "target": [0, 3, 1]}, "three numbers"),
        ({"origin": [0, 1, float("nan")], "target": [0, 3, 1]}, "three numbers"),
        ({"origin": "abc", "target": [0, 3, 1]}, "three numbers"),
        ({"fov": 180}, "between 0 and 180"),
        ({"fov": 0.0}, "between 0 and 180"),
        ({"fov": True}, "between 0 and 180"),
        ({"fov_axis": "diagonal"}, "x or y"),
    ],
)
def test_what_is_no_camera(values, text):
    with pytest.raises(OptionError, match=text):
        Camera(**values)


def test_sensors_without_a_field_of_view_and_loaded_scenes_are_refused(path):
    with pytest.raises(OptionError, match="'orthographic'"):
        load(path, sensor=1, camera=Camera(fov=30))
    with pytest.raises(OptionError, match="loaded scene"):
        load(mi.load_file(str(path)), camera=Camera(fov=30))
