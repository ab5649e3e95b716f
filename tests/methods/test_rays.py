"""Recorded rays: they are those of the method's pass, lie between surfaces, and leave the method as it is."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tables import thinned

from etendue import methods
from etendue.core import OptionError, prepared
from etendue.methods import LightRays, rays_through
from etendue.scene import LightTable, Problem, load
from etendue.transport import Edge, Event, Rays

SAMPLES, SEED, PIXEL = 64, 5, (10, 25)  # on the floor of the Cornell box
PASSES = 3


@pytest.fixture(scope="module")
def box() -> Problem:
    return load("cornell-box", size=(32, 32))


@pytest.fixture(scope="module")
def glass() -> Problem:
    return load("cornell-glass", size=(32, 32))


def made(name: str, problem: Problem, **settings: Any) -> Any:
    kind = methods.get(name)
    return prepared(kind(kind.Settings(**{"samples_per_pass": SAMPLES, "max_depth": 6} | settings)), problem, 0)


def passes(method: Any, count: int = PASSES) -> tuple[Any, Any]:
    """(the state before the last of some passes, the measurement of that pass)."""
    state = method.start()
    for iteration in range(count):
        before, made = state, method.step(iteration, SEED, state)
        state = made.state
    return before, made.measurement


def through(method: Any, state: Any, count: int = SAMPLES, iteration: int = PASSES - 1, **more: Any) -> Rays:
    method.enter({**state})
    rays = rays_through(method, PIXEL[0] + 0.5, PIXEL[1] + 0.5, count, iteration, SEED, **more)
    assert rays is not None
    return rays


def check_edges(problem: Problem, rays: Rays) -> None:
    """The straight way along the edges is free, and ends on a surface or out of the scene."""
    assert len(rays)
    middle = mi.Point3f((0.5 * (rays.start + rays.end)).T)
    way = mi.Vector3f((rays.end - rays.start).T)
    distance = dr.norm(way)
    hit = problem.scene.ray_intersect_preliminary(mi.Ray3f(middle, way / distance))
    t, half = np.array(hit.t), 0.5 * np.array(distance)
    on_surface = rays.event != Event.LEFT
    np.testing.assert_allclose(t[on_surface], half[on_surface], rtol=1e-3, atol=1e-3)
    assert np.isinf(t[~on_surface]).all()


JOINS = {"next_event": Edge.NEXT_EVENT, "connection": Edge.CONNECTION, "merge": Edge.MERGE}


@pytest.mark.parametrize(
    ("name", "settings", "layers"),
    [
        # Without hits on the lamp, which joins do not contain: the pixel does not show it.
        ("path", {"mode": "next_event"}, {"image": Edge.NEXT_EVENT}),
        ("guided", {"mode": "next_event", "generations": 1}, {"image": Edge.NEXT_EVENT}),
        pytest.param(
            *("bpt", {"split_layers": True}, {k: JOINS[k] for k in ("next_event", "connection")}),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *("bpt", {"split_layers": True, "light_source": "path"}, {"connection": Edge.CONNECTION}),
            marks=pytest.mark.slow,
        ),
        ("vcm", {"split_layers": True}, JOINS),
        pytest.param("bpm", {"split_layers": True}, {"merge": Edge.MERGE}, marks=pytest.mark.slow),
    ],
)
def test_joins_add_up_to_the_light_of_the_pass(
    box: Problem, name: str, settings: dict[str, Any], layers: dict[str, Edge]
) -> None:
    """What the recorded joins bring is what the same pass adds to the pixel: the same paths, with the same weights."""
    method = made(name, box, reconstruction="independent", **settings)
    state, measured = passes(method)
    rays = through(method, state)
    check_edges(box, rays.of(Edge.CAMERA))
    x, y = PIXEL
    for layer, kind in layers.items():
        found = rays.of(kind).value.sum(axis=0, dtype=np.float64) / SAMPLES
        # Single precision, and photons are summed in the order of an atomic counter.
        np.testing.assert_allclose(found, measured.mean(layer)[y, x], rtol=1e-4)


def test_splats_are_those_of_the_pass(box: Problem) -> None:
    """A scene whose film has a box filter: all splats on the film, by their sum over the picture."""
    scene = {**methods_scene(), "camera": {"type": "perspective", "fov": 60, **camera()}}
    problem = load(scene)
    method = made("light", problem, samples_per_pass=4)
    state, measured = passes(method)
    method.enter({**state})
    width, height = problem.size
    rays = rays_through(method, width / 2, height / 2, 1000, PASSES - 1, SEED, near=float(width))
    assert rays is not None and rays.dropped == 0
    splats = rays.of(Edge.SPLAT)
    light_paths = method.settings.light_paths * width * height * 4
    found = splats.value.sum(axis=0, dtype=np.float64) / light_paths
    np.testing.assert_allclose(found, measured.mean("splat").sum(axis=(0, 1)), rtol=1e-3)
    assert set(rays.of(Edge.LIGHT).path) == set(splats.light)


def camera() -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": 16, "height": 16, "filter": {"type": "box"}}
    return {"to_world": mi.ScalarTransform4f().translate([0, 0, -0.9]), "film": film}


def methods_scene() -> dict[str, Any]:
    """A closed room with a lamp at the ceiling."""
    return {
        "type": "scene",
        "room": {"type": "cube", "flip_normals": True, "bsdf": {"type": "diffuse"}},
        "lamp": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0.8, 0]).rotate([1, 0, 0], 90).scale(0.2),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5}},
        },
    }


@pytest.mark.parametrize(
    "name", thinned(["bpt", "vcm", "bpm", "pm", "ppm", "sppm", "light", "auto"], ["vcm", "sppm", "light"])
)
def test_light_paths_lead_to_the_joins(glass: Problem, name: str) -> None:
    """A connection, a merge or a splat is at a vertex of the light path that it names, which is drawn."""
    many = {"light_paths": 32.0} if name.endswith("ppm") else {}  # so that there are photons within the first radius
    many |= {"choice": "vcm"} if name == "auto" else {}
    method = made(name, glass, samples_per_pass=1, **many)
    state, _ = passes(method, 1)
    rays = through(method, state, 100, 0)
    joins = rays.of(Edge.CONNECTION, Edge.MERGE, Edge.SPLAT)
    light = rays.of(Edge.LIGHT)
    assert len(joins) and len(light)
    check_edges(glass, light)
    at = np.where((joins.kind == Edge.SPLAT)[:, None], joins.start, joins.end)
    drawn = np.isin(joins.light, light.path)
    assert drawn.mean() > 0.5 and len(np.unique(light.path)) <= 100
    for number, place in zip(joins.light[drawn], at[drawn], strict=True):
        ends = light.end[light.path == number]
        assert np.linalg.norm(ends - place, axis=1).min() < 1e-4


@pytest.mark.parametrize(
    "name",
    thinned(
        ["path", "vegas", "stratified", "guided", "light", "bpt", "vcm", "sppm", "auto"],
        ["path", "guided", "sppm"],
    ),
)
def test_a_pass_after_recording_is_the_same(box: Problem, name: str) -> None:
    plain, recorded = (made(name, box, samples_per_pass=4) for _ in range(2))
    (_, expected), (before, _) = passes(plain, PASSES + 1), passes(recorded)
    after = recorded.step(PASSES - 1, SEED, before).state
    through(recorded, after, 20, PASSES)
    recorded.enter({**after})
    found = recorded.step(PASSES, SEED, after).measurement
    np.testing.assert_allclose(found.mean("image"), expected.mean("image"), rtol=1e-3, atol=1e-5)


def test_guided_directions_are_told(box: Problem) -> None:
    method = made("guided", box, samples_per_pass=16)
    assert not (through(method, method.start(), 200, 0).event == Event.GUIDED).any()
    state, _ = passes(method)
    events = through(method, state, 200).event
    guided = (events == Event.GUIDED).sum()
    # The guide is trained where paths have been, and sampled with at most the probability `share` at diffuse surfaces.
    scattered = guided + (events == Event.SCATTERED).sum()
    share = method.settings.share
    assert guided > 10 and guided / scattered < share + 4 * np.sqrt(share * (1 - share) / scattered)


def test_events_are_those_of_the_surfaces(glass: Problem) -> None:
    method = made("path", glass)
    rays = rays_through(method, 22.0, 24.0, 300)  # the ball of glass
    assert rays is not None
    camera_paths = rays.of(Edge.CAMERA)
    check_edges(glass, camera_paths)
    assert {Event.SCATTERED, Event.REFLECTED, Event.REFRACTED, Event.ENDED} <= set(np.unique(camera_paths.event))
    first = camera_paths[camera_paths.number == 1]
    assert len(first) == 300 and (first.path == np.arange(300)).all()
    assert set(np.unique(first.event)) <= {Event.REFLECTED, Event.REFRACTED, Event.SCATTERED, Event.ENDED}
    # An edge begins where the one before has ended.
    follows = (np.diff(camera_paths.path.astype(int)) == 0) & (np.diff(camera_paths.number.astype(int)) == 1)
    np.testing.assert_allclose(camera_paths.start[1:][follows], camera_paths.end[:-1][follows], atol=1e-3)


@pytest.mark.parametrize("name", ["path", "vcm"])
def test_another_place_and_number_have_the_same_kernels(glass: Problem, name: str) -> None:
    """They take seconds to compile in a large scene."""
    method = made(name, glass, samples_per_pass=1)

    def kernels(*where: Any) -> set[Any]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            rays_through(method, *where)
            history = dr.kernel_history()
        return {entry["hash"] for entry in history if entry["type"] == dr.KernelType.JIT}

    first = kernels(22.0, 24.0, 200) | kernels(10.0, 30.0, 200)
    assert kernels(3.0, 14.0, 150, 4) <= first


def test_no_edge_is_lost_if_there_are_more_than_expected(box: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    method = made("path", box)
    whole = rays_through(method, 10.0, 25.0, 100)
    monkeypatch.setattr("etendue.methods.rays._EDGES", 1)
    again = rays_through(method, 10.0, 25.0, 100)
    assert whole is not None and again is not None and again.dropped == 0
    np.testing.assert_array_equal(again.end, whole.end)
    monkeypatch.setattr("etendue.transport.rays.MOST_EDGES", 150)
    few = rays_through(method, 10.0, 25.0, 100)
    assert few is not None and few.dropped == sum(
        max(0, len(whole.of(kind)) - 150) for kind in (Edge.CAMERA, Edge.NEXT_EVENT)
    )


def test_methods_without_paths_of_pixels_show_none(box: Problem) -> None:
    assert rays_through(made("pssmlt", box, samples_per_pass=1), 3.0, 3.0, 10) is None


def test_what_cannot_be_recorded_is_refused(box: Problem) -> None:
    method = made("path", box)
    with pytest.raises(OptionError, match="off the film"):
        rays_through(method, 40.0, 3.0, 10)
    with pytest.raises(OptionError, match="not 0"):
        rays_through(method, 1.0, 1.0, 0)
    with pytest.raises(OptionError, match="no light 7"):
        LightRays(box).trace(7, 10)


# -- light paths ---------------------------------------------------------------------------------------------------


def test_light_paths_carry_the_power_of_their_light() -> None:
    """A closed room: the flux of the first edges is the light's power; all paths stay inside."""
    bulb = {"type": "point", "position": [0.5, 0, 0], "intensity": {"type": "rgb", "value": 0.3}}
    problem = load({**methods_scene(), "bulb": bulb, "camera": {"type": "perspective", **camera()}})
    table, recorder = LightTable(problem.scene), LightRays(problem)
    rays = recorder.trace(None, 4000)
    check_edges(problem, rays)
    # The throughput of emission is the power times a cosine over its density: its mean over channels is the power.
    first = rays[rays.number == 1]
    assert first.value.sum() / (3 * 4000) == pytest.approx(table.total_power, rel=0.05)
    assert not (rays.event == Event.LEFT).any()
    for light, emitter in enumerate(problem.scene.emitters()):
        own = recorder.trace(light, 500)
        own = own[own.number == 1]
        corners = emitter.bbox()
        low, high = np.array(corners.min).ravel(), np.array(corners.max).ravel()
        assert len(own) and ((own.start > low - 1e-2) & (own.start < high + 1e-2)).all()
        share = float(table.probabilities[light]) * table.total_power
        assert own.value.sum() / (3 * 500) == pytest.approx(share, rel=0.1)


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
    recorder = LightRays(problem)
    with pytest.raises(OptionError, match=f"light {number} of the scene emits nothing"):
        recorder.trace(number, 10)
    assert len(np.unique(recorder.trace(1 - number, 10).path)) == 10


def test_paths_of_a_weak_light_are_as_long_as_without_the_others() -> None:
    both = white_room(weak=1e-5, bright=1.0)
    number = [emitter.id() for emitter in both.scene.emitters()].index("weak")
    lengths = np.bincount(LightRays(both).trace(number, 2000).path)
    alone = np.bincount(LightRays(white_room(weak=1e-5)).trace(0, 2000).path)
    # The same random numbers; the last bit of a throughput may decide a roulette otherwise.
    assert (lengths == alone).mean() > 0.99
    assert (alone > 6).mean() > 0.3
