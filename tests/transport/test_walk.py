"""Operations of a walk: trace an edge, connect a light point, advance."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes

from etendue.core import IndependentSource
from etendue.scene import LightTable
from etendue.transport import CameraPath, DirectWeights, Scattered, Visibility, Walker

N = 1 << 14
HEIGHT, ALBEDO, INTENSITY = 2.0, 0.6, 3.0


def walker(*sheets: float, material: dict[str, Any] | None = None, rr_depth: int = 100) -> Walker:
    """A floor at z = 0 under a point light, and null sheets above it."""
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera(),
        "floor": {"type": "rectangle", "bsdf": material or scenes.diffuse(*3 * (ALBEDO,))},
        "light": {"type": "point", "position": [0.0, 0.0, HEIGHT], "intensity": scenes.rgb(*3 * (INTENSITY,))},
    }
    for index, z in enumerate(sheets):
        scene[f"sheet{index}"] = {
            "type": "rectangle",
            "to_world": scenes.transform().translate([0, 0, z]),
            "bsdf": {"type": "null"},
        }
    loaded = scenes.load(scene).scene
    return Walker(
        visibility=Visibility(loaded),
        lights=LightTable(loaded),
        max_edges=dr.opaque(mi.UInt32, 16),
        rr_depth=rr_depth,
    )


def falling(tracer: Walker, x: float = 0.5, height: float = 5.0, **own: Any) -> CameraPath:
    """Paths that begin straight down."""
    origin = mi.Point3f(dr.full(mi.Float, x, N), 0.0, height)
    return CameraPath.start(mi.Ray3f(origin, mi.Vector3f(0.0, 0.0, -1.0)), tracer.max_edges, **own)


def numbers(role: str = "walk") -> IndependentSource:
    return IndependentSource(dr.arange(mi.UInt32, N), 5, role, 0)


@pytest.mark.parametrize("sheets", [(), (1.0,), (0.5, 1.5, 3.0)])
def test_an_edge_goes_on_behind_what_it_crosses(sheets):
    """Its length and its density are those from where it began; its rays are counted one by one."""
    tracer, source = walker(*sheets), numbers()
    path = falling(tracer, pdf=mi.Float(0.7))
    for _ in sheets:
        vertex = tracer.arrive(path)
        scattered, _ = vertex.sample(source, path.active)
        assert np.asarray(scattered.is_null).all()
        path.pdf = tracer.keep_if_null(scattered, path.pdf, scattered.pdf)
        tracer.advance(path, vertex, scattered, source)
    vertex = tracer.arrive(path)
    beside = 5e-4 * (1 + len(sheets))  # a ray begins so far, at most, from the surface that it leaves
    np.testing.assert_allclose(np.asarray(vertex.distance), 5.0, atol=beside)
    np.testing.assert_allclose(np.asarray(vertex.position.z), 0.0, atol=1e-4)
    np.testing.assert_allclose(np.asarray(path.throughput), 1.0)
    assert set(np.asarray(path.pdf).tolist()) == {np.float32(0.7)}
    assert set(np.asarray(vertex.number).tolist()) == set(np.asarray(path.rays).tolist()) == {len(sheets) + 1}
    scattered, _ = vertex.sample(source, path.active)
    after = tracer.keep_if_null(scattered, path.pdf, scattered.pdf)
    assert (np.asarray(after) != np.float32(0.7)).all()
    tracer.advance(path, vertex, scattered, source)
    assert not np.asarray(path.travelled).any()


@pytest.mark.parametrize("x", [0.0, 0.5])
def test_a_light_point_brings_what_a_point_light_does(x):
    """rho / pi I cos / d^2 = rho I h / (pi d^3), through a sheet too, from one shadow ray a path."""
    expected = ALBEDO / np.pi * INTENSITY * HEIGHT / np.hypot(HEIGHT, x) ** 3
    for tracer, height in ((walker(), 5.0), (walker(1.0), 0.5)):
        path = falling(tracer, x, height)
        vertex = tracer.arrive(path)
        light = tracer.light_point(vertex, numbers(), path.active & vertex.smooth)
        _, (f,) = vertex.sample(numbers(), path.active, [light])
        found, seen = tracer.next_event(path, vertex, light, f, DirectWeights("next_event"))
        assert np.asarray(seen).all()
        np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-4)
        assert set(np.asarray(path.rays).tolist()) == {2}
        _, seen = tracer.next_event(path, vertex, light, f, DirectWeights("next_event"), wanted=mi.Bool(False))
        assert not np.asarray(seen).any()
        assert set(np.asarray(path.rays).tolist()) == {2}


def test_roulette_keeps_the_mean():
    """By the throughput of the path, or by one that the caller gives."""
    tracer = walker(rr_depth=1)
    for by, survival in ((None, 0.5), ((mi.Color3f(0.2), mi.Float(1.0)), 0.2)):
        path = falling(tracer, throughput=mi.Color3f(0.5 / ALBEDO))
        vertex = tracer.arrive(path)
        scattered, _ = vertex.sample(numbers(), path.active)
        factor = tracer.advance(path, vertex, scattered, numbers(), by)
        np.testing.assert_allclose(np.asarray(factor), 1.0 / survival, rtol=1e-5)
        alive = np.asarray(path.active)
        assert abs(alive.mean() - survival) < 4.5 * np.sqrt(survival * (1.0 - survival) / N)
        np.testing.assert_allclose(np.asarray(path.throughput)[0], 0.5 / survival, rtol=1e-5)


def test_a_proposal_takes_the_place_of_the_material():
    """Whatever answers as one: here, straight up, as a mirror would not."""

    def up(bsdf: Any, si: Any, source: Any, vertex: Any, active: Any, directions: Any = ()) -> Any:
        zenith = si.to_world(mi.Vector3f(0.0, 0.0, 1.0))
        one, no = mi.Float(1.0), mi.Bool(False)
        return Scattered(zenith, mi.Color3f(0.25), one, one, one, one, no, no, active), []

    tracer = walker(material={"type": "roughconductor", "alpha": 0.3})
    path = falling(tracer)
    vertex = tracer.arrive(path)
    scattered, _ = vertex.sample(numbers(), path.active, proposal=up)
    tracer.advance(path, vertex, scattered, numbers())
    np.testing.assert_allclose(np.asarray(path.ray.d)[:, 0], [0.0, 0.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(np.asarray(path.throughput)[:, 0], 0.25)
