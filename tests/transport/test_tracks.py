"""Recorded paths: on surfaces, with the throughput of the walk, and with the radiance of a path tracer."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from etendue import methods
from etendue.core import IndependentSource, OptionError
from etendue.scene import LightTable, Problem, load
from etendue.transport import CameraPath, CameraSampler, Event, PathRecorder, Tracks, Visibility, Walker, dimensions


@pytest.fixture(scope="module")
def glass() -> Problem:
    return load("cornell-glass", size=(32, 32))


def check_edges(problem: Problem, tracks: Tracks) -> None:
    """The straight way from each vertex to the next is free, and ends on a surface or out of the scene."""
    start, end = tracks.positions[:, :-1].reshape(-1, 3), tracks.positions[:, 1:].reshape(-1, 3)
    event = tracks.events[:, 1:].ravel()
    there = event != Event.NONE
    start, end, event = start[there], end[there], event[there]
    middle = mi.Point3f((0.5 * (start + end)).T)
    way = mi.Vector3f((end - start).T)
    distance = dr.norm(way)
    hit = problem.scene.ray_intersect_preliminary(mi.Ray3f(middle, way / distance))
    t, half = np.array(hit.t), 0.5 * np.array(distance)
    on_surface = event != Event.LEFT
    np.testing.assert_allclose(t[on_surface], half[on_surface], rtol=1e-3, atol=1e-3)
    assert np.isinf(t[~on_surface]).all()


@pytest.mark.parametrize("kind", ["camera", "light"])
def test_all_edges_have_the_same_kernels(glass: Problem, kind: str) -> None:
    """They take seconds to compile in a large scene."""

    def kernels(depth: int) -> set[Any]:
        recorder = PathRecorder(glass, depth)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            tracks = recorder.from_camera(22.0, 24.0, 50) if kind == "camera" else recorder.from_light(None, 50)
            history = dr.kernel_history()
        assert tracks.positions.shape[1] == depth + 1
        return {entry["hash"] for entry in history if entry["type"] == dr.KernelType.JIT}

    assert kernels(9) == kernels(3)


def test_camera_paths_follow_the_walk(glass: Problem) -> None:
    """Vertices are on surfaces; the throughput of the last one is that of the same walk in one symbolic loop."""
    paths, depth = 300, 7
    tracks = PathRecorder(glass, depth).from_camera(22.0, 24.0, paths, seed=3)
    assert len(tracks) == paths
    check_edges(glass, tracks)
    events = set(np.unique(tracks.events))
    assert {Event.START, Event.SCATTERED, Event.REFLECTED, Event.REFRACTED, Event.ENDED} <= events  # through the ball
    np.testing.assert_array_equal(np.isfinite(tracks.positions).all(axis=2), tracks.events != Event.NONE)

    source = IndependentSource(dr.arange(mi.UInt32, paths), 3, "tracks", 0)
    u = source.next_2d(0, dimensions.FILM)
    ray, weight, _ = CameraSampler(glass, True).through(mi.Point2f(21.5 + u[0], 23.5 + u[1]), source)
    most = dr.opaque(mi.UInt32, depth)
    walker = Walker(visibility=Visibility(glass.scene), lights=LightTable(glass.scene), max_edges=most, rr_depth=5)
    path = CameraPath.start(ray, most, active=dr.full(mi.Bool, True, paths), throughput=mi.Color3f(weight))
    path.radiance = mi.Color3f(1.0) * weight  # holds the throughput of the last edge

    def edge(s: CameraPath) -> CameraPath:
        vertex = walker.arrive(s)
        s.radiance = mi.Color3f(s.throughput)
        s.active &= vertex.valid & (vertex.number < most)
        scattered, _ = vertex.sample(source, s.active)
        walker.advance(s, vertex, scattered, source)
        return s

    path = walker.walk(path, edge, "test walk")
    last = tracks.throughput[np.arange(paths), tracks.lengths]
    np.testing.assert_allclose(last, np.array(path.radiance).T, rtol=1e-4, atol=1e-6)


def test_what_camera_paths_find_is_the_radiance_of_the_pixel() -> None:
    """Emission seen directly plus next event, as mode=next_event sums them, against the path tracer, by a Z-test."""
    glass = load("cornell-glass", size=(8, 8))
    tracks = PathRecorder(glass, 4).from_camera(3.5, 2.5, 40000, seed=1)
    # Emission counts at the first vertex and behind mirrors and glass, where no light point can be sampled.
    before = np.roll(tracks.events, 1, axis=1)
    seen = np.isin(before, (Event.START, Event.REFLECTED, Event.REFRACTED, Event.PASSED))
    sums = (tracks.emission * seen[:, :, None]).sum(axis=1) + tracks.direct.sum(axis=1)
    kind = methods.get("path")
    method = kind(kind.Settings(max_depth=4, samples_per_pass=256, reconstruction="independent", sampler="independent"))
    method.prepare(glass, 0)
    pixels = np.array([method.step(i, 5, {}).measurement.mean("image")[2, 3] for i in range(24)])
    error = np.hypot(sums.std(axis=0) / np.sqrt(len(sums)), pixels.std(axis=0, ddof=1) / np.sqrt(len(pixels)))
    assert (np.abs(sums.mean(axis=0) - pixels.mean(axis=0)) < 4 * error).all()
    assert (error < 0.05 * pixels.mean(axis=0)).all()


def test_light_paths_carry_the_power_of_their_light() -> None:
    """A closed room: the flux of the first edges is the light's power; all paths stay inside."""
    scene = {
        "type": "scene",
        "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}},
        "room": {"type": "cube", "flip_normals": True, "bsdf": {"type": "diffuse"}},
        "lamp": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0.8, 0]).rotate([1, 0, 0], 90).scale(0.2),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5}},
        },
        "bulb": {"type": "point", "position": [0.5, 0, 0], "intensity": {"type": "rgb", "value": 0.3}},
    }
    problem = load(scene)
    table = LightTable(problem.scene)
    recorder = PathRecorder(problem, 5)
    tracks = recorder.from_light(None, 4000)
    check_edges(problem, tracks)
    # The throughput of emission is the power times a cosine over its density: its mean over channels is the power.
    assert tracks.throughput[:, 0].mean() == pytest.approx(table.total_power, rel=0.05)
    assert not (tracks.events == Event.LEFT).any()
    for light, emitter in enumerate(problem.scene.emitters()):
        own = recorder.from_light(light, 500)
        box = emitter.bbox()
        low, high = np.array(box.min).ravel(), np.array(box.max).ravel()
        origins = own.positions[own.events[:, 0] == Event.START, 0]
        assert len(origins) and ((origins > low - 1e-2) & (origins < high + 1e-2)).all()
        share = float(table.probabilities[light]) * table.total_power
        assert own.throughput[:, 0].mean() == pytest.approx(share, rel=0.1)


def test_what_cannot_be_recorded_is_refused(glass: Problem) -> None:
    recorder = PathRecorder(glass)
    with pytest.raises(OptionError, match="off the film"):
        recorder.from_camera(40.0, 3.0, 10)
    with pytest.raises(OptionError, match="no light 7"):
        recorder.from_light(7, 10)
    with pytest.raises(OptionError, match="0"):
        recorder.from_camera(1.0, 1.0, 0)


def white_room(**lights: float) -> Problem:
    """A closed room with bulbs of the given intensities."""
    room = {"type": "cube", "flip_normals": True}
    scene = {
        "type": "scene",
        "camera": {"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}},
        "room": room | {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.9}}},
    }
    for name, value in lights.items():
        scene[name] = {"type": "point", "position": [0.5, 0, 0], "intensity": {"type": "rgb", "value": value}}
    return load(scene)


def test_a_light_that_emits_nothing_has_no_paths() -> None:
    problem = white_room(black=0.0, bright=1.0)
    number = [emitter.id() for emitter in problem.scene.emitters()].index("black")
    recorder = PathRecorder(problem)
    with pytest.raises(OptionError, match=f"light {number} of the scene emits nothing"):
        recorder.from_light(number, 10)
    assert len(recorder.from_light(1 - number, 10)) == 10


def test_paths_of_a_weak_light_are_as_long_as_without_the_others() -> None:
    both = white_room(weak=1e-5, bright=1.0)
    number = [emitter.id() for emitter in both.scene.emitters()].index("weak")
    lengths = PathRecorder(both, 20).from_light(number, 2000).lengths
    alone = PathRecorder(white_room(weak=1e-5), 20).from_light(0, 2000).lengths
    # The same random numbers; the last bit of a throughput may decide a roulette otherwise.
    assert (lengths == alone).mean() > 0.99
    assert (alone > 6).mean() > 0.3
