"""The emitter ``focusarea``: its radiance, its power, its samplers against their densities, agreement with ``path``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import mitsuba_images, run
from support.statistics import assert_agree, assert_mean
from support.tables import crossed

import etendue
from etendue.scene import load

N = 200_000
EXPONENTS = (0.0, 1.0, 6.5, 60.0)
PIXELS = np.linspace(0.5, 6.0, 48).reshape(4, 4, 3)


def lamp(exponent: float, textured: bool = False, shape: str = "rectangle", kind: str = "focusarea") -> dict[str, Any]:
    """A lamp that shines down, of area 1.44 where it is a rectangle."""
    emitter: dict[str, Any] = {"type": kind, "radiance": scenes.bitmap(PIXELS) if textured else 5.0}
    if kind == "focusarea":
        emitter["exponent"] = exponent
    down = scenes.transform().translate([0, 2.2, 0]).rotate([1, 0, 0], 90).scale([0.6, 0.6, 1.0])
    place = {"center": [0, 1.6, 0], "radius": 0.3} if shape == "sphere" else {"to_world": down}
    return {"type": shape, "emitter": emitter} | place


def stage(light: dict[str, Any], bsdf: dict[str, Any] | None = None) -> Any:
    down = scenes.transform().rotate([1, 0, 0], -90).scale(2.0)
    wall = scenes.transform().translate([0, 1.5, -1.3]).scale([2.0, 1.5, 1.0])
    return {
        "type": "scene",
        "sensor": scenes.camera(),
        "light": light,
        "floor": {"type": "rectangle", "to_world": down, "bsdf": bsdf or scenes.diffuse(0.5, 0.5, 0.4)},
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": scenes.diffuse(0.4, 0.5, 0.6)},
    }


def emitter_of(scene: dict[str, Any]) -> tuple[Any, Any]:
    built = mi.load_dict(scene)
    return built, built.emitters()[0]


def numbers(n: int, seed: int = 3) -> list[Any]:
    u = np.random.default_rng(seed).random((4, n)).astype(np.float32)
    return [mi.Point2f(u[:2]), mi.Point2f(u[2:])]


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_radiance_and_radiosity(exponent):
    """L = radiance (n + 2) / 2 cos^n; its integral against the cosine is pi radiance whatever the exponent."""
    _scene, emitter = emitter_of(stage(lamp(exponent)))
    cos = np.linspace(-1.0, 1.0, 40001)
    si = dr.zeros(mi.SurfaceInteraction3f, cos.size)
    si.wi = mi.Vector3f(np.stack([np.sqrt(1 - cos**2), 0 * cos, cos]).astype(np.float32))
    radiance = np.array(emitter.eval(si)[0], np.float64)
    expected = np.where(cos > 0, 5.0 * (exponent + 2) / 2 * np.maximum(cos, 0) ** exponent, 0.0)
    np.testing.assert_allclose(radiance, expected, rtol=1e-3, atol=1e-6)
    assert 2 * np.pi * np.trapezoid(radiance * cos, cos) == pytest.approx(5.0 * np.pi, rel=1e-3)


@pytest.mark.parametrize("textured", [False, True])
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_rays(exponent, textured):
    """Directions have density (n + 2) / (2 pi) cos^(n + 1) apart from the point; the mean weight is the power."""
    scene, emitter = emitter_of(stage(lamp(exponent, textured)))
    place, direction = numbers(N)
    ray, weight = emitter.sample_ray(0.0, 0.5, place, direction)
    cos = -np.array(ray.d.y, np.float64)
    radius = np.linspace(0.0, 1.0, 9)[1:-1]
    for bound in radius ** (1.0 / (exponent + 2)):
        assert_mean(cos < bound, bound ** (exponent + 2), (exponent, bound))
    azimuth = np.arctan2(np.array(ray.d.z), np.array(ray.d.x))
    for octant in range(8):
        assert_mean(np.floor((azimuth + np.pi) / (np.pi / 4)).clip(0, 7) == octant, 1 / 8, octant)
    assert np.array(ray.o.y).min() > 2.19
    mean = PIXELS.mean((0, 1)) if textured else np.full(3, 5.0)
    if not textured:
        np.testing.assert_allclose(np.array(weight), np.pi * 5.0 * 1.44, rtol=1e-3)
    np.testing.assert_allclose(np.array(weight, np.float64).mean(1), np.pi * mean * 1.44, rtol=0.02)
    ps, _ = emitter.sample_position(0.0, place)
    assert_mean(1.0 / np.broadcast_to(np.array(ps.pdf, np.float64), N), 1.44, exponent)
    del scene


@pytest.mark.parametrize("shape", ["rectangle", "sphere", "textured"])
def test_directions_towards_the_light(shape):
    """Sampled directions, their density as asked for again, and a ray that arrives there see the same light."""
    light = lamp(3.0, shape == "textured", "sphere" if shape == "sphere" else "rectangle")
    scene, emitter = emitter_of(stage(light))
    random = np.random.default_rng(5)
    it = dr.zeros(mi.SurfaceInteraction3f, 20_000)
    it.p = mi.Point3f(random.uniform([[-1], [0], [-1]], [[1], [1.2], [1]], (3, 20_000)).astype(np.float32))
    ds, weight = emitter.sample_direction(it, numbers(20_000)[0])
    live = np.array(ds.pdf) > 0
    assert live.mean() > 0.95
    pdf = emitter.pdf_direction(it, ds)
    np.testing.assert_allclose(np.array(pdf)[live], np.array(ds.pdf)[live], rtol=1e-3)
    value = emitter.eval_direction(it, ds)
    np.testing.assert_allclose(np.array(weight * pdf)[:, live], np.array(value)[:, live], rtol=1e-3)
    hit = scene.ray_intersect(mi.Ray3f(it.p, ds.d))
    seen = live & (np.abs(np.array(hit.t - ds.dist)) < 1e-3) & (np.abs(np.array(dr.dot(hit.n, ds.d))) > 0.1)
    assert seen.mean() > 0.9
    np.testing.assert_allclose(np.array(emitter.eval(hit))[:, seen], np.array(value)[:, seen], rtol=2e-2, atol=2e-3)
    assert (np.array(dr.reinterpret_array(mi.UInt32, ds.emitter)) > 0).all()


def images(problem: Any, samples: int = 256) -> np.ndarray:
    return mitsuba_images(problem, mi.load_dict({"type": "path", "max_depth": 5}), 6, samples, 40)


def test_exponent_zero_is_an_area_light():
    focused = images(load(stage(lamp(0.0)), check=False))
    assert_agree(focused, images(load(stage(lamp(0.0, kind="area")))))


def test_mitsubas_particles_agree_with_its_paths():
    problem = load(stage(lamp(5.0)), check=False)
    reference = images(problem)
    # ptracer draws a lamp that the camera sees as if it were diffuse: this camera does not see it.
    particles = mitsuba_images(problem, mi.load_dict({"type": "ptracer", "max_depth": 5}), 6, 1024, 7)
    assert_agree(particles, reference, "ptracer")


@pytest.mark.parametrize(("mode", "row"), crossed(["mis", "naive"], ["rectangle", "sphere", "textured"], 2))
def test_the_path_of_etendue_agrees(row, mode):
    """By next event and hits, and by hits alone."""
    light = lamp(4.0, row == "textured", "sphere" if row == "sphere" else "rectangle")
    problem = load(stage(light, scenes.MATERIALS["phong"]()), check=False)
    result = run(problem, "path", samples=1024 if mode == "naive" else 256, max_depth=5, mode=mode)
    assert_agree(result.images, images(problem), (row, mode), precision=0.03)


def test_parameters_can_be_changed():
    _scene, emitter = emitter_of(stage(lamp(0.0)))
    parameters = mi.traverse(emitter)
    assert {"radiance.value", "exponent", "sampling_weight"} == set(parameters.keys())
    parameters["exponent"] = 4.0
    parameters.update()
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    np.testing.assert_allclose(np.array(emitter.eval(si)).ravel(), 15.0, rtol=1e-5)
    assert "exponent = [4]" in str(emitter)
    parameters["exponent"] = -1.0
    with pytest.raises(etendue.core.OptionError, match="'exponent' is"):
        parameters.update()


@pytest.mark.parametrize(
    ("extra", "text"),
    [
        ({"exponent": -1.0}, "'focusarea': 'exponent' is .*-1.* at least 0"),
        ({"to_world": None}, "no 'to_world'"),
        ({"focus": 1.0}, "focus"),
    ],
)
def test_bad_parameters(extra, text):
    if "to_world" in extra:
        extra = {"to_world": scenes.transform()}
    with pytest.raises(Exception, match=text):
        mi.load_dict({"type": "rectangle", "emitter": {"type": "focusarea"} | extra})
