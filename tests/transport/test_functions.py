"""A scene as functions of rays: what they say, and that the rendering equation composed from them is solved."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
from support.scenes import camera, diffuse, rgb
from support.statistics import assert_agree, assert_mean

import etendue
from etendue.core import OptionError
from etendue.integration import Integrand, MeanSample, Stratified, integral
from etendue.transport import TransportFunctions, film_picture


def rays(*rows):
    """Rays (origin, direction) as columns of the device."""
    columns = np.array(rows, dtype=np.float32)
    columns[:, 3:6] /= np.linalg.norm(columns[:, 3:6], axis=1, keepdims=True)
    return [mi.Float(column.copy()) for column in columns.T]


def numbers(f, x):
    return np.array([np.array(v) for v in f.parts(f.evaluate(x))], dtype=float)


@pytest.fixture
def plate():
    """A floor at y = 0 under a lamp at y = 2 that looks down; the sensor stands at the side."""
    up, down = mi.ScalarTransform4f().rotate([1, 0, 0], -90), mi.ScalarTransform4f().translate([0, 2, 0])
    return TransportFunctions(
        mi.load_dict(
            {
                "type": "scene",
                "floor": {"type": "rectangle", "to_world": up.scale(3), "bsdf": diffuse(0.5, 0.25, 0.125)},
                "lamp": {
                    "type": "rectangle",
                    "to_world": down.rotate([1, 0, 0], 90).scale(0.5),
                    "emitter": {"type": "area", "radiance": rgb(1.0, 2.0, 3.0)},
                    "bsdf": diffuse(0.0, 0.0, 0.0),
                },
                "sensor": camera(),
            }
        )
    )


def test_what_rays_meet(plate):
    """Floor, lamp from below, lamp from behind, nothing."""
    x = rays([1, 1, 0, 0, -1, 0], [0, 1, 0, 0, 1, 0], [0, 3, 0, 0, -1, 0], [0, 1, 0, 1, 0.001, 0])
    assert numbers(plate.distance, x)[0] == pytest.approx([1, 1, 1, math.inf])
    expected = [[1, 0, 0, 0, 1, 0], [0, 2, 0, 0, -1, 0], [0, 2, 0, 0, 1, 0], [0, 1, 0, 0, 0, 0]]
    assert pytest.approx(np.array(expected, dtype=float), abs=1e-6) == numbers(plate.hit, x).T
    assert pytest.approx(np.array([[0, 0, 0], [1, 2, 3], [0, 0, 0], [0, 0, 0]])) == numbers(plate.emitted, x).T
    assert numbers(plate.albedo, x)[:, 0] == pytest.approx([0.5, 0.25, 0.125])


def test_light_that_goes_on(plate):
    """Diffuse: the weight is the reflectance, directions have density cos / pi; where nothing is met, light ends."""
    u = np.random.default_rng(1).random((3, 4000)).astype(np.float32)
    down = rays(*[[1, 1, 0, 0, -1, 0]] * 4000)
    x = [*down, *(mi.Float(row.copy()) for row in u)]
    onwards, weight = numbers(plate.scatter, x), numbers(plate.weight, x)
    assert weight == pytest.approx(np.broadcast_to([[0.5], [0.25], [0.125]], weight.shape), rel=1e-5)
    assert onwards[:3] == pytest.approx(np.broadcast_to([[1], [0], [0]], (3, 4000)), abs=1e-3)
    assert np.linalg.norm(onwards[3:], axis=0) == pytest.approx(np.ones(4000), rel=1e-5)
    assert_mean(onwards[4], 2 / 3, "mean of the cosine")
    lost = [*rays([0, 1, 0, 1, 0.001, 0]), mi.Float(0.5), mi.Float(0.5), mi.Float(0.5)]
    assert numbers(plate.weight, lost) == pytest.approx(0)
    assert numbers(plate.distance, [mi.Float(v) for v in numbers(plate.scatter, lost)]) == pytest.approx(math.inf)


def test_direct_light(plate):
    """Below the middle of a square lamp of half side a at height h: E = 4 L (a / s) atan(a / s) / s ... by corners."""
    a, h = 0.5, 2.0
    s = math.sqrt(h * h + a * a)
    irradiance = 4 * (a / s) * math.atan(a / s)  # of four squares of side a seen from a corner, for radiance 1
    looking = rays(*[[0, 1, 0, 0, -1, 0]] * 50)
    direct = integral(plate.direct, [6, 7], Stratified(), samples=400)
    found = numbers(direct, looking)
    for channel, (reflectance, radiance) in enumerate(((0.5, 1.0), (0.25, 2.0), (0.125, 3.0))):
        assert_mean(found[channel], irradiance * reflectance / math.pi * radiance, channel)


def test_functions_asked_at_other_rays_answer_for_them(plate):
    """What is remembered is of the very same arrays."""
    a, b = rays([1, 1, 0, 0, -1, 0]), rays([0, 1, 0, 0, 1, 0])
    for _ in range(3):
        assert numbers(plate.emitted, a)[0] == pytest.approx(0) and numbers(plate.emitted, b)[0] == pytest.approx(1)
        a, b = b, a
        assert numbers(plate.emitted, a)[0] == pytest.approx(1) and numbers(plate.emitted, b)[0] == pytest.approx(0)
        a, b = b, a


def test_the_rendering_equation_in_a_furnace():
    """Inside a sphere that emits 1 and reflects rho: 1 + rho + ... + rho^n, in every pixel."""
    rho = np.array([0.8, 0.5, 0.2])
    inside = {"type": "twosided", "bsdf": diffuse(*rho)}
    scene = {"type": "scene", "sensor": camera((0, 0, 0.1), (0, 0, 1))}
    emitter = {"type": "area", "radiance": rgb(1.0, 1.0, 1.0)}
    scene["ball"] = {"type": "sphere", "flip_normals": True, "bsdf": inside, "emitter": emitter}
    light = TransportFunctions(mi.load_dict(scene))
    radiance = light.emitted
    for bounce in range(3):
        radiance = light.emitted + integral(
            light.weight * radiance.compose(light.scatter), [6, 7, 8], samples=2, seed=bounce
        )
    picture = light.picture(radiance, (4, 3), samples=2, seed=9)
    assert picture.shape == (3, 4, 3)
    assert picture == pytest.approx(np.broadcast_to(sum(rho**k for k in range(4)), picture.shape), rel=1e-4)


def test_a_picture_is_that_of_the_sensor(plate):
    """Pixels, their order and what lies in them are those of a rendering."""
    seen = [plate.picture(plate.emitted + integral(plate.direct, [6, 7], seed=1), (16, 12), 16, seed=n) for n in (2, 3)]
    twice = [etendue.render(plate.scene, "path", spp=64, seed=n, max_depth=2).image for n in range(6)]
    several = [
        plate.picture(plate.emitted + integral(plate.direct, [6, 7], seed=1 + n), (16, 12), 16, seed=50 + n)
        for n in range(6)
    ]
    assert not np.array_equal(*seen)
    assert_agree(np.array(several), np.array(twice, dtype=float), "functions and path")


def test_a_function_of_the_film_is_averaged_over_pixels():
    corner = film_picture(Integrand(lambda x: x[0] + 10 * x[1], 2, on="device"), (4, 2), 400, Stratified())
    expected = (np.arange(4) + 0.5) / 4 + 10 * (np.arange(2)[:, None] + 0.5) / 2
    assert corner[..., 0] == pytest.approx(expected, abs=0.02)  # 5 sigma
    with pytest.raises(OptionError, match="at least one pixel"):
        film_picture(Integrand(lambda x: x[0], 2, on="device"), (0, 4), integrator=MeanSample())


def test_a_sensor_that_is_not_there(plate):
    with pytest.raises(OptionError, match="1 sensors, number 1"):
        TransportFunctions(plate.scene, sensor=1)
