"""Emitters, sensors, ray casting and functions: right ones pass, broken ones are found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes

from etendue.conformance import check_emitter, check_function, check_ray_casting, check_sensor, rays
from etendue.integration import Integrand, coordinate


def failing(findings: list[Any]) -> set[str]:
    return {f.test for f in findings if f.verdict != "pass"}


@pytest.mark.parametrize("name", [e for e in scenes.EMITTERS if e not in ("two", "mixed")])
def test_every_emitter_passes(name):
    problem = scenes.room(name, ("diffuse",))
    rows = check_emitter(problem.scene.emitters()[0], problem.scene)
    assert failing(rows) == set(), rows
    tests = {r.test for r in rows}
    assert {"range", "power"} <= tests
    assert ({"radiance", "density", "integral", "sampler"} <= tests) == (name not in scenes.DELTA_EMITTERS)


class Faulty:
    """A thing with one method replaced."""

    def __init__(self, thing: Any, **methods: Any) -> None:
        self._thing, self._methods = thing, methods

    def __getattr__(self, name: str) -> Any:
        return self._methods.get(name) or getattr(self._thing, name)


def wrong_density(emitter: Any) -> dict[str, Any]:
    return {"pdf_direction": lambda *a: 1.3 * emitter.pdf_direction(*a)}


def wrong_ray(emitter: Any) -> dict[str, Any]:
    def sample_ray(*arguments: Any) -> Any:
        ray, weight = emitter.sample_ray(*arguments)
        return ray, 1.1 * weight

    return {"sample_ray": sample_ray}


def wrong_radiance(emitter: Any) -> dict[str, Any]:
    return {"eval_direction": lambda *a: 0.9 * emitter.eval_direction(*a)}


def wrong_sample(emitter: Any) -> dict[str, Any]:
    """Draws from three quarters of the lamp, and says nothing of it."""
    return {"sample_direction": lambda it, u: emitter.sample_direction(it, mi.Point2f(0.75 * u.x, u.y))}


def wrong_value(emitter: Any) -> dict[str, Any]:
    def sample_direction(it: Any, u: Any) -> Any:
        ds, weight = emitter.sample_direction(it, u)
        return ds, dr.select(u.x > 0.99, dr.nan, weight)

    return {"sample_direction": sample_direction}


@pytest.mark.parametrize(
    ("fault", "found"),
    [
        (wrong_density, {"density", "integral", "sampler"}),
        (wrong_ray, {"power"}),
        (wrong_radiance, {"radiance"}),
        (wrong_sample, {"sampler"}),
        (wrong_value, {"range"}),
    ],
)
def test_broken_emitters_are_found(fault, found):
    problem = scenes.room("rectangle", ("diffuse",))
    emitter = problem.scene.emitters()[0]
    assert failing(check_emitter(Faulty(emitter, **fault(emitter)), problem.scene, "lamp")) == found


@pytest.mark.parametrize("name", scenes.SENSORS)
def test_every_sensor_passes(name):
    problem = scenes.room("constant", ("diffuse",), sensor=name)
    rows = check_sensor(problem.sensor, problem.scene)
    assert failing(rows) == set(), rows
    assert ("projection" in {r.test for r in rows}) == (name != "orthographic")


def test_a_displaced_splat_is_found():
    problem = scenes.room("constant", ("diffuse",))

    def sample_direction(it: Any, u: Any) -> Any:
        ds, weight = problem.sensor.sample_direction(it, u)
        ds.uv += 0.5
        return ds, weight

    sensor = Faulty(problem.sensor, sample_direction=sample_direction)
    (row,) = (r for r in check_sensor(sensor, problem.scene, "camera") if r.verdict == "fail")
    assert row.test == "projection"
    assert row.figure == pytest.approx(0.5, abs=0.01)


def hilly() -> Any:
    """A scene of many triangles."""
    x, y = np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 24), indexing="ij")
    points = np.stack([x, 0.3 * np.sin(5 * x) * np.cos(4 * y), y], -1).reshape(-1, 3)
    i = (np.arange(23)[:, None] * 24 + np.arange(23)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + 25], -1), np.stack([i, i + 25, i + 24], -1)])
    hills = scenes.mesh(points, faces, scenes.diffuse(0.5, 0.5, 0.5))
    cube = {"type": "cube", "to_world": scenes.transform().translate([0, 0.6, 0]).scale(0.2)}
    scene = {"type": "scene", "sensor": scenes.camera(), "light": {"type": "constant"}, "hills": hills, "cube": cube}
    return scenes.load(scene | {"ball": {"type": "sphere", "center": [0.5, 0.7, 0], "radius": 0.1}}).scene


def test_ray_casting_agrees_with_every_triangle_and_another_variant():
    scene = hilly()
    rows = check_ray_casting(scene, variants=("scalar_rgb",))
    assert [r.test for r in rows] == ["hits", "misses", "variant scalar_rgb"]
    assert failing(rows) == set(), rows
    assert mi.variant() == scene.variant_name()


def test_rays_that_pass_through_triangles_are_found():
    scene = hilly()

    def ray_intersect(ray: Any) -> Any:
        si = scene.ray_intersect(ray)
        return dr.select(si.p.x > 0.9, dr.zeros(mi.SurfaceInteraction3f, dr.width(ray)), si)

    def behind(ray: Any) -> Any:
        si = scene.ray_intersect(ray)
        si.t *= 1.01
        return si

    assert failing(check_ray_casting(Faulty(scene, ray_intersect=ray_intersect))) == {"misses"}
    assert "hits" in failing(check_ray_casting(Faulty(scene, ray_intersect=behind)))


def test_a_function_stays_in_its_range():
    box = [(0.0, 2.0), (-1.0, 1.0)]
    good = coordinate(0, box) * coordinate(1, box) + 1.0
    assert failing(check_function(good)) == set()
    wave = Integrand(lambda x: np.sin(6 * x[0]), 1, range=(0.0, 1.0))
    (row,) = check_function(wave, "wave")
    assert row.verdict == "fail"
    assert row.figure == pytest.approx(0.477, abs=0.01)
    assert failing(check_function(Integrand(lambda x: np.where(x[0] == x[1], np.nan, 1.0), 2))) == {
        "range"
    }  # in two corners
    assert failing(check_function(Integrand(lambda x: dr.square(x[0]), 1, range=(0.0, 1.0), on="device"))) == set()
    assert failing(check_function(Integrand(lambda x: x[7], 1))) == {"interface"}
    several = Integrand(lambda x: np.stack([x[0], x[1], x[0] * 0 + 2.0]), 2, values=3, range=(0.0, 2.0))
    assert failing(check_function(several)) == set()
    assert failing(check_function(Integrand(lambda x: np.stack([x[0], 3 * x[1]]), 2, values=2, range=(0.0, 1.0))))


@pytest.mark.parametrize("turn", [0.0, -90.0, 45.0])
@pytest.mark.parametrize("kind", ["rectangle", "ply"])
def test_rays_at_a_flat_scene(turn: float, kind: str, tmp_path: Path) -> None:
    shape = {"type": "rectangle", "to_world": mi.ScalarTransform4d().rotate([1, 0, 0], turn).scale(4)}
    if kind == "ply":
        mi.load_dict(shape).write_ply(str(tmp_path / "floor.ply"))
        shape = {"type": "ply", "filename": str(tmp_path / "floor.ply")}
    scene = mi.load_dict({"type": "scene", "floor": shape})
    for seed in range(3):
        rows = check_ray_casting(scene, variants=("scalar_rgb",), seed=seed)
        assert {row.verdict for row in rows} == {"pass"}
        (aimed,) = (int(row.meaning.split()[2]) for row in rows if row.test == "misses")
        assert aimed > 500


def test_rays_within_a_plane_prove_nothing() -> None:
    triangle = np.array([[[0.0, 0.0, 1e-16], [4.0, 0.0, -1e-16], [0.0, 4.0, 1e-16]]])
    origin = np.array([[-1.0, 1.0, 0.0], [-1.0, 1.0, 1.0]])
    along, down = np.array([1.0, 0.0, 0.0]), np.array([2.0, 0.0, -1.0]) / 5**0.5
    surely, perhaps = rays._nearest(origin, np.stack([along, down]), triangle, 6.0)
    assert np.isinf(surely[0])
    assert np.isfinite(perhaps[0])
    assert surely[1] == pytest.approx(5**0.5)
