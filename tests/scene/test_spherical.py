"""The sensor ``spherical``: directions, their density, crop windows, splats, and pictures of known skies."""

from __future__ import annotations

from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_images, mitsuba_path, run
from support.statistics import assert_agree, assert_mean
from support.tables import thinned

import etendue
from etendue.scene import load

N = 100_000
WINDOW = {"crop_offset_x": 12, "crop_offset_y": 4, "crop_width": 20, "crop_height": 12}


def sensor(width: int = 48, height: int = 24, crop: bool = False, rfilter: str = "box", **more: Any) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": rfilter}}
    film |= {"pixel_format": "rgb", "component_format": "float32"} | (WINDOW if crop else {})
    look = scenes.transform().look_at([0.3, 1.2, 1.0], [0, 0.6, 0], [0.1, 1, 0])
    return {"type": "spherical", "film": film, "to_world": look} | more


def window(crop: bool) -> tuple[int, int]:
    return (20, 12) if crop else (48, 24)


def points(n: int = N) -> Any:
    return mi.Point2f(np.random.default_rng(3).random((2, n)).astype(np.float32))


@pytest.mark.parametrize("crop", [False, True])
def test_points_on_rays_are_seen_where_the_rays_came_from(crop):
    camera = mi.load_dict(sensor(crop=crop))
    place = points()
    ray, weight = camera.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(weight), 1.0)
    np.testing.assert_allclose(np.array(dr.norm(ray.d)), 1.0, rtol=1e-5)
    it = dr.zeros(mi.Interaction3f, N)
    it.p = ray(3.0)
    ds, importance = camera.sample_direction(it, mi.Point2f(0.5))
    inner = np.array(dr.all((place > 1e-3) & (place < 1 - 1e-3)))
    assert np.array(ds.pdf)[inner].all()
    size = np.array(window(crop))[:, None]
    np.testing.assert_allclose(np.array(ds.uv)[:, inner], (np.array(place) * size)[:, inner], atol=2e-3)
    np.testing.assert_allclose(np.array(ds.d), -np.array(ray.d), atol=1e-5)
    np.testing.assert_allclose(np.array(ds.dist), 3.01, rtol=1e-5)
    # p = W H / (2 pi^2 sin theta) a pixel
    theta = np.pi * (np.array(place.y) * size[1] + (4 if crop else 0)) / 24
    per_pixel = np.array(importance[0]) * np.array(ds.dist) ** 2 * size.prod()
    np.testing.assert_allclose(per_pixel[inner], (48 * 24 / (2 * np.pi**2 * np.sin(theta)))[inner], rtol=2e-3)


@pytest.mark.parametrize("crop", [False, True])
def test_the_importance_of_a_picture_is_one(crop):
    """Over all directions, and none of it lies outside the window."""
    camera = mi.load_dict(sensor(crop=crop))
    v = np.random.default_rng(4).normal(size=(3, 4 * N))
    v /= np.linalg.norm(v, axis=0)
    it = dr.zeros(mi.Interaction3f, 4 * N)
    it.p = mi.Point3f((np.array([[0.3], [1.2], [1.0]]) + 2.0 * v).astype(np.float32))
    ds, importance = camera.sample_direction(it, mi.Point2f(0.5))
    density = np.array(importance[0], np.float64) * 4.0
    assert_mean(4 * np.pi * density, 1.0, crop)
    inside = np.array(ds.pdf) > 0
    assert not density[~inside].any()
    uv, size = np.array(ds.uv)[:, inside], window(crop)
    assert uv.min() >= 0
    assert (uv.max(1) <= size).all()
    # Each quarter of the window has a quarter of the importance.
    left, upper = uv[0] < size[0] / 2, uv[1] < size[1] / 2
    for part in (left & upper, left & ~upper, ~left & upper):
        values = np.zeros(4 * N)
        values[inside] = density[inside] * part
        assert_mean(4 * np.pi * values, 0.25, crop)


def test_what_the_picture_shows_where():
    """The middle looks along +z of the sensor, the upper edge up, the right quarter to the right."""
    look = scenes.transform().look_at([0, 0, 0], [0, 0, -1], [0, 1, 0])
    camera = mi.load_dict({"type": "spherical", "to_world": look})
    for place, direction in {(0.5, 0.5): (0, 0, -1), (0.75, 0.5): (1, 0, 0), (0.25, 0.5): (-1, 0, 0)}.items():
        ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(*place), mi.Point2f(0.5))
        np.testing.assert_allclose(np.array(ray.d).ravel(), direction, atol=1e-6)
    ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(0.3, 0.0), mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(ray.d).ravel(), [0, 1, 0], atol=1e-6)


def test_near_and_far():
    camera = mi.load_dict(sensor(near_clip=0.5, far_clip=4.0))
    ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(0.4, 0.3), mi.Point2f(0.5))
    origin = np.array([0.3, 1.2, 1.0])
    assert np.linalg.norm(np.array(ray.o).ravel() - origin) == pytest.approx(0.5, rel=1e-5)
    assert np.array(ray.maxt) == pytest.approx(3.5)
    it = dr.zeros(mi.Interaction3f, 4)
    it.p = mi.Point3f(origin.tolist()) + ray.d * mi.Float([0.4, 0.6, 3.9, 4.1])
    ds, importance = camera.sample_direction(it, mi.Point2f(0.5))
    assert np.array(ds.pdf).tolist() == [0, 1, 1, 0]
    assert ((np.array(importance[0]) > 0) == [False, True, True, False]).all()


def test_differentials_reach_the_next_pixel():
    camera = mi.load_dict(sensor())
    place = mi.Point2f(0.4, 0.3)
    ray, _ = camera.sample_ray_differential(0.0, 0.5, place, mi.Point2f(0.5))
    right, _ = camera.sample_ray(0.0, 0.5, place + mi.Point2f(1 / 48, 0), mi.Point2f(0.5))
    below, _ = camera.sample_ray(0.0, 0.5, place + mi.Point2f(0, 1 / 24), mi.Point2f(0.5))
    assert ray.has_differentials
    np.testing.assert_allclose(np.array(ray.d_x), np.array(right.d), atol=1e-6)
    np.testing.assert_allclose(np.array(ray.d_y), np.array(below.d), atol=1e-6)


def sky(camera: dict[str, Any], light: dict[str, Any]) -> Any:
    return load({"type": "scene", "sensor": camera, "light": light, "far": {"type": "disk"} | FAR()})


def FAR() -> dict[str, Any]:
    return {"to_world": scenes.transform().translate([900, 0, 0]).scale(1e-3)}


@pytest.mark.parametrize("crop", [False, True])
def test_a_uniform_sky_is_a_constant_picture(crop):
    problem = sky(sensor(crop=crop, rfilter="gaussian"), {"type": "constant", "radiance": 0.7})
    np.testing.assert_allclose(mitsuba_path(problem, 1, 4), 0.7, rtol=1e-4)
    for method in ("path", "bpt"):
        np.testing.assert_allclose(run(problem, method, 1, 4).mean, 0.7, rtol=1e-4)


def test_a_picture_of_an_environment_map_is_the_map():
    random = np.random.default_rng(6)
    theta, phi = np.meshgrid((np.arange(24) + 0.5) / 24 * np.pi, (np.arange(48) + 0.5) / 48 * 2 * np.pi, indexing="ij")
    smooth = [1 + 0.5 * np.sin(theta) * np.cos(phi + p) + 0.3 * np.cos(theta) for p in random.random(3) * 6]
    pixels = np.stack(smooth, -1).astype(np.float32)
    light = {"type": "envmap", "bitmap": mi.Bitmap(pixels)}
    problem = sky(sensor() | {"to_world": scenes.transform()}, light)
    picture = mitsuba_path(problem, 1, 64)[0]
    # Rows of an environment map lie on the poles and evenly between; columns in the middles of the picture's pixels.
    rows = (np.arange(24) + 0.5) / 24 * 23
    low = np.floor(rows).astype(int)
    share = (rows - low)[:, None, None]
    expected = pixels[low] * (1 - share) + pixels[np.minimum(low + 1, 23)] * share
    np.testing.assert_allclose(picture, expected, atol=0.02)


def room(camera: dict[str, Any]) -> Any:
    down = scenes.transform().rotate([1, 0, 0], -90).scale(2.0)
    wall = scenes.transform().translate([0, 1.5, -1.3]).scale([2.0, 1.5, 1.0])
    bsdf = scenes.MATERIALS
    return load(
        {"type": "scene", "sensor": camera}
        | scenes.EMITTERS["rectangle"]()
        | {"floor": {"type": "rectangle", "to_world": down, "bsdf": bsdf["ward"]()}}
        | {"ball": {"type": "sphere", "center": [0, 0.4, 0], "radius": 0.39, "bsdf": bsdf["phong"]()}}
        | {"wall": {"type": "rectangle", "to_world": wall, "bsdf": scenes.diffuse(0.4, 0.5, 0.6)}}
    )


@pytest.mark.parametrize(
    ("method", "crop"),
    thinned([*product(("path", "light", "bpt"), (False, True)), ("ptracer", True)], [("path", True), ("light", True)]),
)
def test_methods_agree_with_path(method, crop):
    """Light tracing puts its splats where camera rays look: étendue's and Mitsuba's own."""
    problem = room(sensor(crop=crop, rfilter="box" if crop else "tent"))
    reference = mitsuba_path(problem, samples=128)
    if method == "ptracer":
        images = mitsuba_images(problem, mi.load_dict({"type": method}), 6, 1024, 7)
    else:
        result = run(problem, method, samples=64, **({"light_paths": 4.0} if method == "light" else {}))
        assert result.measurement.counters["nonfinite"] == 0
        images = result.images
    assert_agree(images, reference, (method, crop))


@pytest.mark.slow
def test_merging_renders():
    """Merging is biased a little; its picture is near the reference all the same."""
    problem = room(sensor())
    reference = mitsuba_path(problem, samples=256).mean(0)
    picture = run(problem, "vcm", samples=32).mean
    assert abs(picture.mean() / reference.mean() - 1) < 0.02


def test_sizes():
    """Another size from a dictionary, from XML without a film, and of a loaded scene."""
    parts = {"type": "scene", "light": {"type": "constant"}, "floor": {"type": "disk"}}
    bare = {"type": "spherical"}
    assert load(parts | {"sensor": bare}, size=(20, 10)).size == (20, 10)
    built = mi.load_dict(parts | {"sensor": sensor(crop=True, near_clip=0.3)})
    problem = load(built, size=(96, 48))
    assert problem.size == (40, 24)
    assert tuple(problem.sensor.film().crop_offset()) == (24, 8)
    assert float(np.asarray(mi.traverse(problem.sensor)["near_clip"])[0]) == pytest.approx(0.3)
    before, after = (np.array(s.world_transform().matrix) for s in (built.sensors()[0], problem.sensor))
    np.testing.assert_allclose(after, before, atol=1e-6)


def test_from_xml(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(
        '<scene version="3.0.0"><sensor type="spherical"><float name="near_clip" value="0.2"/></sensor>'
        '<emitter type="constant"/><shape type="disk"/></scene>'
    )
    problem = load(str(file), size=(8, 4))
    assert problem.size == (8, 4)
    assert "spherical[" in str(problem.sensor)
    assert problem.fingerprint == load(str(file), size=(8, 4)).fingerprint


def test_parameters_can_be_changed():
    camera = mi.load_dict(sensor())
    parameters = mi.traverse(camera)
    assert {"near_clip", "far_clip", "to_world", "film.size"} <= set(parameters.keys())
    parameters["to_world"] = mi.Transform4f().translate([1, 2, 3])
    parameters["near_clip"] = 1.0
    parameters.update()
    ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(ray.o).ravel(), [1, 2, 4], atol=1e-5)
    parameters["near_clip"] = -1.0
    with pytest.raises(etendue.core.OptionError, match="'near_clip' is"):
        parameters.update()


@pytest.mark.parametrize(
    ("extra", "text"),
    [
        ({"near_clip": 0.0}, "'near_clip' is .* above 0"),
        ({"near_clip": 2.0, "far_clip": 1.0}, "'far_clip' is .* above 2"),
        ({"to_world": None}, "a scale"),
        ({"fov": 60.0}, "fov"),
    ],
)
def test_bad_parameters(extra, text):
    if "to_world" in extra:
        extra = {"to_world": scenes.transform().scale(2.0)}
    with pytest.raises(Exception, match=text):
        mi.load_dict(sensor() | extra)
