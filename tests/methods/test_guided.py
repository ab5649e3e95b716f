"""Guided path tracing: the picture of ``path``, with less noise the longer it has learned."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest
from support import scenes
from support.running import go, mitsuba_path, prepared, replicas, run
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue.core import CheckpointError
from etendue.methods.gain import Gain
from etendue.scene import load

#: A pass of these teaches enough for a small picture.
TRAINED = {"cell_samples": 500, "generations": 3, "give_up": False}


def lit_room(**view: Any) -> Any:
    return scenes.room("mixed", scenes.FEW, **view)


def behind_a_door(size: tuple[int, int] = (24, 18)) -> Any:
    """Indirect light only."""
    return load("ajar", size=size)


def variance(images: np.ndarray, mean: np.ndarray) -> float:
    """Of a picture, relative to the brightness, without the worst pixels, one in a hundred."""
    pixels = (np.square(images - mean).mean(0) / (mean**2 + 0.01)).mean(-1).ravel()
    return float(np.sort(pixels)[: int(0.99 * len(pixels))].mean())


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"mode": "naive"},
        *(pytest.param(s, marks=pytest.mark.slow) for s in ({"bsdf_sampling": False}, {"heuristic": "power"})),
    ],
    ids=str,
)
def test_without_training_it_is_path(settings):
    settings = {"samples_per_pass": 4, **settings}
    mine = go(prepared(lit_room(), "guided", generations=0, **settings), 2).mean
    plain = go(prepared(lit_room(), "path", **settings), 2).mean
    np.testing.assert_allclose(mine, plain, rtol=1e-5, atol=1e-7)


#: What must not change the picture.
SWITCHES: dict[str, dict[str, Any]] = {
    "plain": {},
    "mostly guide": {"share": 0.95},
    "coarse": {"leaf_share": 0.5, "cell_samples": 100_000},
    "fine": {"leaf_share": 0.002, "cell_samples": 100},
    "next event": {"mode": "next_event"},
    "naive": {"mode": "naive"},
    "power": {"heuristic": "power", "rr_depth": 2},
    "uniform directions": {"bsdf_sampling": False},
    "lights by power": {"learn_lights": False},
    "all passes alike": {"first_weight": 1.0},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SWITCHES)
def test_switches_do_not_change_the_mean(name):
    emitter = "rectangle" if name == "naive" else "mixed"
    # Uniform directions rarely find the bright ones of glossy materials, and such means are not normal.
    materials = ("diffuse",) if name == "uniform directions" else scenes.FEW
    scene = scenes.room(emitter, materials, rfilter="gaussian")
    reference = mitsuba_path(scene, passes=6, samples=256)
    images = replicas(scene, "guided", runs=6, passes=6, samples=96, **TRAINED | SWITCHES[name])
    assert_agree(images, reference, name, precision=0.03)


@pytest.mark.parametrize("group", thinned(("wrapped", "specular", "transparent"), ("specular",)))
def test_delta_and_null_components(group):
    scene = scenes.room("rectangle", group)
    reference = replicas(scene, "path", runs=6, passes=1, samples=512, seed=40)
    images = replicas(scene, "guided", runs=6, passes=6, samples=96, **TRAINED)
    assert_agree(images, reference, group, precision=0.03)


def test_it_learns_where_the_door_is():
    """Passes after training have less than a third of the variance of those before; and the mean is that of path."""
    runner = prepared(behind_a_door((16, 12)), "guided", samples_per_pass=256, generations=3, cell_samples=1000)
    go(runner, 7)
    trained = go(runner, 8, first=7).images
    plain = run(behind_a_door((16, 12)), "path", passes=8, samples=512, seed=2).images
    mean = trained.mean(0)
    assert variance(trained, mean) < 0.33 * 2.0 * variance(plain, mean)
    assert_agree(trained, plain, "ajar", block=6, precision=0.15)


def test_it_learns_which_lamp_matters():
    """One lamp of nine lights the room; the others, just as strong, shine above its ceiling."""
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera(),
        "floor": scenes.plate([0, 0, 0], 2.0, up=True),
        "ceiling": scenes.plate([0, 2.3, 0], 6.0, up=False),
        "ball": {"type": "sphere", "center": [0, 0.4, 0], "radius": 0.4, "bsdf": scenes.diffuse(0.6, 0.4, 0.3)},
        "lamp": scenes.lamp([-0.8, 2.2, 0.3], 0.15, 30.0),
    }
    for i in range(8):
        scene[f"above-{i}"] = scenes.lamp([0.4 * i - 1.4, 3.5, 0.0], 0.15, 30.0)
    problem = scenes.load(scene)
    images = {}
    for learn in (True, False):
        runner = prepared(problem, "guided", samples_per_pass=64, learn_lights=learn, **TRAINED)
        go(runner, 7)
        images[learn] = go(runner, 8, first=7).images
    mean = images[True].mean(0)
    assert variance(images[True], mean) < 0.3 * variance(images[False], mean)
    assert_agree(images[True], images[False], "lamps", precision=0.05)


def test_the_guide_grows_and_stays():
    """Cells of the scene and nodes of their trees, in the state after each pass."""
    runner = prepared(behind_a_door(), "guided", samples_per_pass=64, generations=3, cell_samples=200)
    guides = [runner.state()["guide"]]
    for iteration in range(9):
        runner.step(iteration, 1)
        guides.append(runner.state()["guide"])
    nodes = [len(guide["parent"]) for guide in guides]
    assert [i for i, (a, b) in enumerate(itertools.pairwise(nodes)) if a != b] == [0, 2, 6]
    cells = [len(guide["level"]) for guide in guides]
    assert cells[-1] > cells[1] > 6
    parent, node = guides[-1]["parent"], np.arange(nodes[-1])  # 4 n + q of the q-th quarter of node n; -1 of a root
    for _ in range(3):  # a tree has three levels and more
        node = parent[node[parent[node] >= 0]] // 4
    assert len(node) > 0


def test_passes_weigh_more_as_it_learns():
    runner = prepared(lit_room(), "guided", samples_per_pass=4, generations=4, first_weight=0.25)
    passes = [runner.step(i, 1) for i in range(8)]
    assert [m.weights["image"] / 4 for m in passes] == [0.25, 0.5, 0.5, 1, 1, 1, 1, 1]
    means = [m.mean() for m in passes[:3]]
    total = passes[0] + passes[1] + passes[2]
    np.testing.assert_allclose(total.mean(), 0.2 * means[0] + 0.4 * means[1] + 0.4 * means[2])


@pytest.mark.parametrize("stop", thinned([5, 8], [5]))
def test_a_run_goes_on_where_it_stopped(stop):
    """In the midst of a generation, at the end of one and after training: bit by bit."""
    settings = {"samples_per_pass": 16, **TRAINED}
    whole = go(prepared(lit_room(), "guided", **settings), 10)
    first = prepared(lit_room(), "guided", **settings)
    begun = go(first, stop)
    resumed = prepared(lit_room(), "guided", **settings)
    resumed.restore(dict(first.state()))
    rest = go(resumed, 10 - stop, first=stop)
    np.testing.assert_array_equal((begun.measurement + rest.measurement).mean(), whole.mean)


def test_a_state_that_does_not_fit_is_refused():
    first = prepared(lit_room(), "guided", samples_per_pass=16, **TRAINED)
    go(first, 1)
    state = dict(first.state())
    state["found"] = np.array(state["found"])[:-4]
    with pytest.raises(CheckpointError, match="damaged"):
        prepared(lit_room(), "guided", samples_per_pass=16, **TRAINED).restore(state)


def test_learning_compiles_nothing():
    scene = lit_room()
    go(prepared(scene, "guided", samples_per_pass=16, **TRAINED), 3)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        go(prepared(scene, "guided", samples_per_pass=16, seed=2, **TRAINED), 10, seed=2)
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(kernel["cache_hit"] for kernel in kernels)


@pytest.mark.slow
def test_little_memory_learns_from_fewer_paths():
    scene = scenes.room("sphere", scenes.FEW)
    scene.memory = 1_000_000
    runner = prepared(scene, "guided", samples_per_pass=128, **TRAINED)
    assert runner._stride(192 * 128) == 6
    images = replicas(scene, "guided", runs=6, passes=3, samples=128, **TRAINED)
    assert runner._stride(10) == 1
    assert_agree(images, run(scene, "path", passes=6, samples=384, seed=9).images, "memory", precision=0.03)


def test_a_black_picture_teaches_nothing():
    """A lamp that no path meets: no light to learn from, and no NaN."""
    scene = scenes.load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "light": scenes.EMITTERS["point"]()["light"],
            "ball": {"type": "sphere", "center": [0, 0.5, 0], "radius": 0.4, "bsdf": scenes.MATERIALS["conductor"]()},
        }
    )
    result = run(scene, "guided", passes=4, samples=4)
    assert not result.mean.any()
    assert result.measurement.counters["nonfinite"] == 0


def test_the_noise_of_its_weighted_passes():
    """Var m = sum w^2 (x - m)^2 / ((sum w)^2 - sum w^2), of passes of weight w and picture x."""
    found = go(prepared(behind_a_door(), "guided", samples_per_pass=4, generations=3), 9)
    weights = np.repeat([0.375, 0.75, 1.0], [1, 2, 6])
    mean = np.average(found.images, axis=0, weights=weights)
    scatter = np.tensordot(weights**2, np.square(found.images - mean), axes=1)
    variance = scatter / (weights.sum() ** 2 - np.square(weights).sum())
    np.testing.assert_allclose(found.measurement.variance_of_mean(), variance, rtol=1e-6, atol=1e-12)


@pytest.mark.slow
def test_small_budgets_are_no_noisier_than_path():
    """Where next event estimation finds nearly all light and there is little to learn: 64 samples a pixel. Ratios of
    variance for nine seeds in threes: 0.93, 0.93, 0.94; with one share of the guide for all cells, 1.25 to 1.28."""

    def noise(method: str) -> float:
        made = [etendue.render("cornell-box", method, spp=64, size=(64, 64), seed=seed).image for seed in (1, 2, 3)]
        return float((np.var(made, axis=0, ddof=1) / (np.mean(made, axis=0) ** 2 + 0.01)).mean())

    assert noise("guided") < noise("path")


def squares(monkeypatch: Any, scene: Any, seed: int, generations: int, **settings: Any) -> np.ndarray:
    """(lots, 2): mean squares of the paths of each lot of training, and what these paths tell of those without the
    guide."""
    found: list[tuple[float, float]] = []

    def add(self: Any, light: Any, square: Any, count: int, rays: float) -> None:
        found.append((float(np.square(light, dtype=np.float64).mean()), float(np.mean(square, dtype=np.float64))))

    own = {"samples_per_pass": 512, "cell_samples": 500, "generations": generations}
    with monkeypatch.context() as patch:
        patch.setattr(Gain, "add", add)
        patch.setattr(Gain, "end_generation", lambda self: 1.0)
        go(prepared(scene, "guided", seed, **own, **settings), (1 << generations) - 1, seed=seed)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("lamps", "rr_depth"), [("shaded", 99), ("one hidden", 2)])
def test_guided_paths_tell_the_noise_of_plain_ones(lamps, rr_depth, monkeypatch):
    """Whose mean square is measured without a guide."""
    scene: dict[str, Any] = {
        "type": "scene",
        "sensor": scenes.camera(),
        "floor": scenes.plate([0, 0, 0], 2.0, up=True),
        "ceiling": scenes.plate([0, 2.3, 0], 2.0, up=False),
        "ball": {"type": "sphere", "center": [0, 0.4, 0], "radius": 0.4, "bsdf": scenes.MATERIALS["roughconductor"]()},
        "lamp": scenes.lamp([0.3, 1.9, 0.2], 0.3, 9.0),
    }
    if lamps == "shaded":
        scene["shade"] = scenes.plate([0.3, 1.5, 0.2], 0.6, up=True)
    else:
        scene["hidden"] = scenes.lamp([0.0, 4.0, 0.0], 0.3, 9.0)
    problem, options = scenes.load(scene), {"rr_depth": rr_depth, "max_depth": 6}
    plain = np.concatenate([squares(monkeypatch, problem, seed, 1, **options)[:, 0] for seed in range(30)])
    guided, told = np.concatenate([squares(monkeypatch, problem, seed, 4, **options)[7:] for seed in (51, 52, 53)]).T
    assert guided.mean() < 0.8 * plain.mean()  # the guide has learned something
    error = np.hypot(*(lots.std(ddof=1) / len(lots) ** 0.5 for lots in (plain, told)))
    assert abs(told.mean() - plain.mean()) < 4.0 * error < 0.1 * plain.mean()


def test_a_guide_that_does_not_pay_is_given_up():
    """Under an even sky: the rest is path tracing, and a run goes on with it."""
    scene = scenes.field(0.5, 1.0, size=(16, 16))
    settings = {"samples_per_pass": 64, "generations": 2}
    runner = prepared(scene, "guided", **settings)
    whole = go(runner, 8)
    assert runner.develop(whole.measurement).metadata["guide"]["given_up"]
    assert not np.isnan(whole.mean).any()
    first = prepared(scene, "guided", **settings)
    go(first, 5)
    resumed = prepared(scene, "guided", **settings)
    resumed.restore(dict(first.state()))
    np.testing.assert_array_equal(go(resumed, 3, first=5).images, whole.images[5:])
    assert_agree(whole.images[4:], run(scene, "path", passes=4, samples=64, seed=9).images, "given up", precision=0.05)


def test_the_size_of_the_guide_is_that_of_the_state():
    """Also if the method has learned more since."""
    runner = prepared(behind_a_door(), "guided", samples_per_pass=64, generations=3, cell_samples=200)
    begun, state = go(runner, 1), runner.state()
    go(runner, 6, first=1)
    guide = runner.method.develop(begun.measurement, state).metadata["guide"]
    assert guide == {
        "generation": 1,
        "given_up": False,
        "cells": len(state["guide"]["level"]),
        "places": len(state["found"]),
    }
    now = runner.develop(begun.measurement).metadata["guide"]
    assert now["cells"] == runner.guide.cells > guide["cells"]
