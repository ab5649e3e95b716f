"""Pictures by chains: their means, what they tell about themselves, and what stops them."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.running import go, prepared, run
from support.tables import thinned
from support.tasks import rendering

from etendue import methods
from etendue.core import SceneError, uses_cuda
from etendue.engine import Budget, Job
from etendue.integration import Layout, Slot
from etendue.methods.metropolis.chains import Chains, bootstrap_within
from etendue.methods.metropolis.states import BrightnessMap
from etendue.methods.metropolis.targets import CAP, Contribution, Traced, largest_target

SMALL = {"samples_per_pass": 32, "bootstrap": 1 << 13}


def test_no_light_is_one_line():
    """A lamp that shines away from everything that the camera sees."""
    scene = {"type": "scene", "sensor": scenes.camera()}
    scene["floor"] = scenes.plate((0.0, 0.0, 0.0), 2.0, up=True)
    scene["lamp"] = scenes.lamp((0.0, -1.0, 0.0), 0.3, 5.0)
    with pytest.raises(SceneError, match=r"the bootstrap found no light: .* raise bootstrap$"):
        prepared(scenes.load(scene), "pssmlt", **SMALL)


#: Method and settings, the fast ones first.
OTHERWISE = [
    ("pssmlt", {"equalise": False, "vertices": 1}),
    ("mmlt", {}),
    ("pssmlt", {"large_steps": 0.1, "step_size": 0.02}),
    ("pssmlt", {"chains": 128}),
    ("pssmlt", {"bsdf_sampling": False, "max_depth": 3}),  # long paths hardly ever find peaks
    ("pssmlt", {"sampler": "owen"}),
    ("pssmlt", {"estimator": "bidirectional"}),
    ("pssmlt", {"estimator": "bidirectional", "vertices": 2}),
    ("mmlt", {"vertices": 2, "equalise": False}),
]


@pytest.mark.parametrize("row", [OTHERWISE[0], *(pytest.param(r, marks=pytest.mark.slow) for r in OTHERWISE[1:])])
def test_the_mean_is_that_of_path(row):
    """Whatever the factor by brightness, the numbers that a chain keeps, and the steps."""
    method, settings = row
    problem = scenes.room("rectangle", scenes.FEW)
    edges = settings.get("max_depth", -1)
    path = run(problem, "path", passes=6, samples=256, max_depth=edges).images.mean(axis=(1, 2, 3))
    means = [go(prepared(problem, method, seed, **(SMALL | settings)), 2, seed).mean.mean() for seed in range(1, 9)]
    error = np.hypot(np.std(means, ddof=1) / np.sqrt(8), path.std(ddof=1) / np.sqrt(6))
    assert error < 0.02 * path.mean()
    assert abs(np.mean(means) - path.mean()) < 4.5 * error


def test_facts():
    problem = scenes.room("rectangle", scenes.FEW)
    runner = prepared(problem, "pssmlt", **SMALL)
    result = runner.develop(go(runner, 6).measurement)
    assert list(result.layers) == ["image"]
    facts = result.metadata["chains"]
    luminance = np.asarray(mi.luminance(mi.Color3f(result.image.reshape(-1, 3).T.copy()))).mean()
    assert abs(luminance - facts["mean_luminance"]) < 6.0 * facts["mean_luminance_error"] + 0.02 * luminance
    assert facts["mean_luminance_error"] < 0.02 * facts["mean_luminance"]
    assert 0.1 < facts["accepted_small"] < 1.0 and 0.1 < facts["accepted_large"] < 1.0
    assert 0 < facts["longest_stay"] <= facts["steps"] and facts["startup_bias"] < 0.01


def test_the_factor_by_brightness():
    """Of a picture whose right half is ten times as bright: the least of the error measure, and the same function on
    host and device."""
    rng = np.random.default_rng(1)
    x, y = (rng.random((1, 1 << 16)) * side for side in (32.0, 16.0))
    luminance = np.where(x < 16.0, 0.1, 1.0)
    parts = np.split(np.stack([x, y, luminance]).astype(np.float32), 4, axis=2)
    factors = BrightnessMap.measured(parts, (32, 16))
    for place, level in ((4.0, 0.1), (28.0, 1.0)):
        found = factors.on_host(np.array([place]), np.array([8.0]))[0]
        assert found == pytest.approx(1.0 / np.sqrt(level**2 + 0.01), rel=0.1)
    device = np.array(factors.at(mi.Point2f(mi.Float(x[0]), mi.Float(y[0]))))
    np.testing.assert_allclose(device, factors.on_host(x, y)[0], rtol=1e-4)


def test_the_first_states_are_not_among_the_samples_that_tell_the_factors():
    """Few samples in a cell of the factors find light. Where states are drawn from the same ones, bright places have
    too many of them for their factor, and the picture with the right brightness by factors is too bright."""
    scenes.camera()

    def trace(sources: Any, lanes: int) -> Traced:
        (u, v), w = sources["camera"].next_2d(0, 0), sources["camera"].next_1d(0, 2)
        value, nothing = dr.select(w < 0.05, 1.0 + 9.0 * u, 0.0), dr.zeros(mi.UInt32, lanes)
        return Traced([Contribution(16.0 * mi.Point2f(u, v), mi.Color3f(value))], nothing, nothing)

    target = target_of(Layout([Slot(0, 2), Slot(2)], [], 0), trace)
    runner = Chains(target, (16, 16), 1 << 12, 1 << 12, "independent", True)
    light, found = 1.0 + 9.0 * (np.arange(16) + 0.5) / 16.0, []
    for seed in range(40):
        start = runner.start(seed)
        place = start.states.contributions[0].position
        picture = 1.0 / start.factors.on_host(np.array(place.x), np.array(place.y))  # of states, in total
        found.append(picture.mean() * (start.factors.of_pixels * light).mean() / light.mean())
    error = np.std(found) / np.sqrt(len(found))
    assert error < 0.01 and abs(np.mean(found) - 1.0) < 3.0 * error, (np.mean(found), error)


def target_of(layout: Layout, trace: Any) -> Any:
    return SimpleNamespace(layouts={"camera": layout}, trace=trace, reads=list)


def heavy(lit: float = 1.0) -> Any:
    """A target without a finite mean, on ``lit`` of its numbers."""

    def trace(sources: Any, lanes: int) -> Traced:
        u, v = sources["camera"].next_2d(0, 0)
        value = dr.select(v < lit, dr.rcp(dr.square(u) * u + 1e-20), 0.0)
        nothing = dr.zeros(mi.UInt32, lanes)
        return Traced([Contribution(mi.Point2f(u, v), mi.Color3f(value))], nothing, nothing)

    return target_of(Layout([Slot(0, 2)], [], 0), trace)


def runner_of(target: Any, chains: int = 1 << 12, bootstrap: int = 1 << 14, **options: Any) -> Chains:
    return Chains(target, (1, 1), chains, bootstrap, "independent", False, **options)


@pytest.mark.parametrize("lit", [1.0, 0.02])
def test_no_chain_stays_at_a_bright_path(lit, monkeypatch):
    """Chains at the brightest paths of a target with a heavy tail leave them as fast as is said, without those that
    begin anew."""
    monkeypatch.setattr(Chains, "renewed", lambda self, carried, *_: carried.states)
    scenes.camera()
    runner, steps = runner_of(heavy(lit)), 64
    start = runner.start(1)
    states = replace(start.states, target=dr.full(mi.Float, start.cap, runner.chains))
    end, _ = runner.run(replace(start, states=states, share=1.0), steps, 1, None)
    slowest = 1.0 / max(CAP, 10.0 / lit)
    stay = np.mean(np.array(end.states.rejected) == steps)
    expected = (1.0 - slowest) ** steps
    # No faster either, or more of the target were limited than must be.
    assert abs(stay - expected) < 0.08
    assert dr.max(start.states.target)[0] <= start.cap * (1.0 + 1e-6)


def test_chains_begin_anew_in_proportion_to_the_light_that_large_steps_find():
    """As many as if first states had been drawn from all samples, at those that have it, and in their own half."""
    scenes.camera()
    runner = runner_of(heavy(), chains=1 << 14)
    start = runner.start(1)
    half, first = runner.chains // 2, 1 << 20
    moves = runner.moves(1, first)
    numbers = mi.UInt32([5, 900, (1 << 31) + 7])  # two proposals of the first half and one of the second have light
    expected = moves["camera"].write(runner.target.layouts["camera"], dr.zeros(mi.Float, 6), None, numbers, 3).numpy()
    targets = np.zeros((2, 4 * half))
    targets[0, [5, 900]], targets[1, 7] = (3.0, 1.0), 2.0
    states = runner.renewed(replace(start, found=np.array([[1.0, 10.0, 1.0], [1.0, 20.0, 1.0]])), first, targets, 1)
    before, after = (one.numbers["camera"].numpy().reshape(2, -1) for one in (start.states, states))
    places = expected.reshape(2, -1)
    anew = [(after == places[:, [k]]).all(axis=0) for k in range(3)]
    assert not anew[0][half:].any() and not anew[1][half:].any() and not anew[2][:half].any()
    # Half of them change with a share of 4 / 10, three quarters of these to the brighter one; the others of 2 / 20.
    for begun, share in zip(anew, (0.3, 0.1, 0.1), strict=True):
        assert abs(begun.sum() - share * half) < 4.0 * np.sqrt(half * share)
    begun = np.any(anew, axis=0)
    np.testing.assert_array_equal(after[:, ~begun], before[:, ~begun])
    traced = runner.trace(moves, numbers, None)
    values = np.minimum(traced.contributions[0].value.x.numpy(), start.cap)
    for one, value in zip(anew, values, strict=True):
        np.testing.assert_allclose(states.target.numpy()[one], value, rtol=1e-6)
    np.testing.assert_array_equal(states.target.numpy()[~begun], start.states.target.numpy()[~begun])


def test_chains_that_cannot_move_show_all_that_large_steps_have_found():
    """Where small steps are refused and large ones nearly always, chains would stay at what the bootstrap has found:
    here at few of 256 bright cells, each as probable as the others."""
    scenes.camera()

    def trace(sources: Any, lanes: int) -> Traced:
        (u, v), w = sources["camera"].next_2d(0, 0), sources["camera"].next_1d(0, 2)
        value, nothing = dr.select(w < 1.0 / 4096.0, 1.0, 0.0), dr.zeros(mi.UInt32, lanes)
        return Traced([Contribution(16.0 * mi.Point2f(u, v), mi.Color3f(value))], nothing, nothing)

    target = target_of(Layout([Slot(0, 2), Slot(2)], [], 0), trace)
    runner = runner_of(target, 1 << 12, 1 << 14)
    carried = replace(runner.start(1), size=1e-6, share=0.5)
    errors = []
    for _ in range(33):
        place = carried.states.contributions[0].position
        cells = np.bincount((np.array(place.y).astype(int) * 16 + np.array(place.x).astype(int)), minlength=256)
        errors.append(float(np.square(cells / 16.0 - 1.0).mean()))
        carried, _ = runner.run(carried, 8, 1, None)
    # The relative variance of a cell is 256 over the samples that have found light: 32, and after the passes 160.
    found = carried.found[:, 1].sum()
    assert errors[0] > 5.0 and errors[-1] < 1.5 * 256.0 / found < 3.0, (errors[0], errors[-1], found)


def test_the_largest_target_of_some_values():
    rng = np.random.default_rng(1)
    for values in (np.ones(1000), rng.random(1000) ** -2.0, np.where(rng.random(5000) < 0.004, rng.random(5000), 0.0)):
        cap = largest_target(values)
        longest = max(CAP, 10.0 * len(values) / np.count_nonzero(values))
        assert cap == pytest.approx(longest * np.minimum(values, cap).mean())


def test_the_share_of_large_steps_is_that_asked_for():
    """Of a few steps in a pass: none in many passes, one in others, whose weights differ."""
    scenes.camera()
    target = target_of(heavy().layouts["camera"], lambda s, n: flat(s["camera"].next_2d(0, 0), n))
    runner = runner_of(target)
    carried, large, means = replace(runner.start(1), share=0.06, size=0.1), 0.0, []
    total: list[float] = []
    runner.record = lambda independent, ones, weight: total.append(
        dr.mean(ones[0].value.x * weight)[0] * (1.0 if independent else factor)
    )
    for _ in range(25):
        factor = 0.25 * carried.found[:, 1].sum() / carried.found[:, 0].sum() / carried.unit
        total.clear()
        carried, made = runner.run(carried, 4, 1, None)
        means.append(sum(total) / 4)
        large += made.counters["large steps"] / runner.chains
    assert large == 6.0
    assert np.mean(means) == pytest.approx(0.5, rel=0.01)


def flat(u: Any, lanes: int) -> Traced:
    """A target u of mean 1/2."""
    nothing = dr.zeros(mi.UInt32, lanes)
    return Traced([Contribution(mi.Point2f(*u), mi.Color3f(u[0]))], nothing, nothing)


def test_the_bootstrap_keeps_to_the_memory():
    """It grows for light that few samples find, to a limit; and both halves must have found some."""
    scenes.camera()
    free = runner_of(heavy(1e-3), bootstrap=1 << 12).start(1)
    assert free.found[:, 0].sum() == 8 << 12
    assert runner_of(heavy(1e-3), bootstrap=1 << 12, room=4 * 36 << 12).start(1).found[:, 0].sum() == 4 << 12
    with pytest.raises(SceneError, match="the bootstrap found no light"):
        runner_of(heavy(0.0), bootstrap=1 << 12).start(1)


@pytest.mark.parametrize("batches", [1, 2, 5, 18, 19])
def test_chains_start_from_as_many_samples_as_asked_for(batches, monkeypatch):
    """Beside those that tell the factors by film position."""
    monkeypatch.setattr("etendue.methods.metropolis.chains._BATCH", 256)
    monkeypatch.setattr("etendue.methods.metropolis.chains._ENOUGH_LIT", 1)
    scenes.camera()
    runner = replace(runner_of(heavy(), 256, batches * 256), equalise=True)
    assert runner.start(1).found[:, 0].sum() == batches * 256


@pytest.mark.parametrize("equalise", [False, True])
def test_a_bootstrap_of_a_number_of_paths_has_no_more(equalise, monkeypatch):
    """The samples that tell the factors included; and not many fewer."""
    monkeypatch.setattr("etendue.methods.metropolis.chains._BATCH", 64)
    scenes.camera()
    for paths in (4, 30, 101, 127, 128, 199, 500, 577, 1000):
        runner = replace(runner_of(heavy(), 256, bootstrap_within(paths, equalise)), equalise=equalise, usual=1 << 18)
        assert 0.5 * paths < 2 * runner.start(1).large <= paths


@pytest.mark.parametrize("method", thinned(["pssmlt", "film_metropolis", "mmlt"], ["pssmlt"]))
def test_the_bootstrap_of_a_small_budget_is_no_more_than_its_first_pass(method, monkeypatch):
    """Of a whole job: the method is not prepared for a larger pass first."""
    started, start = [], Chains.start

    def counted(runner: Chains, seed: int) -> Any:
        begun = start(runner, seed)
        started.append(2 * begun.large)
        return begun

    monkeypatch.setattr(Chains, "start", counted)
    problem = scenes.room("rectangle", scenes.FEW, size=(32, 24))
    job = Job.open(rendering(problem.scene, methods.get(method), budget=Budget(samples=16), size=(32, 24)))
    assert uses_cuda() or job.method.samples_per_iteration == 16
    assert sum(started) <= 32 * 24 * 16
    assert job.method.settings.bootstrap == 0


def test_the_bias_of_the_start_is_of_the_target():
    """The equalised and limited one, from which starts are drawn."""
    runner = prepared(scenes.room("rectangle", scenes.FEW), "pssmlt", **SMALL)
    found = runner._carried.found
    target = np.array([0.5, 0.5, 1.5, 1.5])  # the relative variance is 1/4
    state = runner.start() | {"found": np.tile([4.0, target.sum(), (target**2).sum()], (2, 1))}
    facts = runner.facts(runner.step(0, 1), state)
    assert facts["startup_bias"] == pytest.approx((1.0 + 0.25) / found[:, 0].sum())


@pytest.mark.slow
def test_a_filter_does_not_depend_on_what_is_accepted():
    """The chains of both reconstructions are the same, so their pictures have the same centre."""
    problem = scenes.room("rectangle", scenes.FEW, rfilter="gaussian")
    centres = []
    for reconstruction in ("independent", "neighbours"):
        runner = prepared(problem, "pssmlt", reconstruction=reconstruction, **SMALL)
        pictures = go(runner, 8).images.mean(axis=-1)
        x = np.arange(pictures.shape[2]) + 0.5
        centres.append((pictures.sum(axis=1) @ x) / pictures.sum(axis=(1, 2)))
    shift = centres[0] - centres[1]
    error = shift.std(ddof=1) / np.sqrt(len(shift))
    assert error < 0.01
    assert abs(shift.mean()) < 4.5 * error


def test_a_camera_at_the_origin():
    """Light sub-paths that leave the scene have no place on its film."""
    scene = {"type": "scene", "sensor": scenes.camera((0.0, 0.0, 0.0), (0.0, -0.3, -1.0), 60.0)}
    scene["floor"], scene["lamp"] = scenes.plate((0.0, -1.0, -2.0), 1.5, True), scenes.lamp((0.0, 1.0, -2.0), 0.3, 9.0)
    runner = prepared(scenes.load(scene), "mmlt", samples_per_pass=8, bootstrap=1 << 10)
    place = runner._carried.states.contributions[0].position
    assert dr.all(dr.isfinite(place.x) & dr.isfinite(place.y))
    assert np.isfinite(runner.step(0, 1).mean()).all()


@pytest.mark.slow
def test_long_paths_of_a_white_room():
    """Lengths of paths are drawn as light decreases along them, or the picture has no finite variance."""
    problem, images = scenes.furnace("box", 1.0, 0.9, size=(4, 4)), []
    for seed in range(1, 7):
        runner = prepared(problem, "mmlt", seed, samples_per_pass=2048, bootstrap=1 << 12)
        assert 0.85 < runner.runner.target.longer < 0.95
        images.append(go(runner, 1, seed).mean.mean())
    error = np.std(images, ddof=1) / np.sqrt(6)
    assert error < 0.1
    assert abs(np.mean(images) - 10.0) < 4.5 * error


@pytest.mark.parametrize("depth", thinned([3, 14], [3]))
def test_the_probabilities_of_lengths(depth):
    runner = prepared(scenes.furnace("box", 1.0, 0.9, size=(4, 4)), "mmlt", max_depth=depth, bootstrap=1 << 10)
    u = (dr.arange(mi.Float, 1 << 16) + 0.5) / (1 << 16)
    length, probability = runner.runner.target._length(u)
    found = np.bincount(np.array(length), minlength=depth + 1)[1:] / (1 << 16)
    assert len(found) == depth
    np.testing.assert_allclose(found[np.array(length) - 1], np.array(probability), atol=1e-3)


@pytest.mark.parametrize(
    "method, settings",
    [
        ("pssmlt", {}),
        pytest.param("pssmlt", {"estimator": "bidirectional"}, marks=pytest.mark.slow),
        pytest.param("mmlt", {}, marks=pytest.mark.slow),
    ],
)
def test_kernels_of_steps_are_traced_once(method, settings):
    """The picture is that of steps which are traced anew."""
    options = SMALL | settings | {"chains": 256, "step_size": 0.02, "large_steps": 0.25}
    pictures = []
    for frozen in (False, True):
        chains = prepared(scenes.room("rectangle", scenes.FEW), method, 3, **options)
        runner = chains.runner
        if not frozen:
            runner._frozen = runner._proposals
        pictures.append(go(chains, 2, 3).mean)
        if frozen:
            assert runner._frozen.recordings == 2  # large steps and small ones
    assert np.allclose(*pictures, rtol=1e-4, atol=1e-4 * pictures[0].mean())


def test_light_vertices_without_room_are_traced_again():
    """With more room, by kernels of that room."""
    options = SMALL | {"estimator": "bidirectional", "chains": 256, "step_size": 0.02, "large_steps": 0.25}
    pictures = []
    for room in (4.0, 0.01):
        chains = prepared(scenes.room("rectangle", scenes.FEW), "pssmlt", 3, **options)
        runner = chains.runner
        runner.target._per_path, recorded = room, runner._frozen
        pictures.append(go(chains, 2, 3).mean)
        assert (runner.target._per_path == room) == (room == 4.0) == (runner._frozen is recorded)
    assert np.allclose(*pictures, rtol=1e-4, atol=1e-4 * pictures[0].mean())


@pytest.mark.parametrize("method, settings", [("pssmlt", {"estimator": "bidirectional"}), ("mmlt", {})])
def test_any_number_of_chains_begins_anew_by_the_same_kernels(method, settings):
    """Their number differs from pass to pass."""
    chains = prepared(scenes.room("rectangle", scenes.FEW), method, 3, **(SMALL | settings))
    runner, kernels = chains.runner, []
    gc.collect()  # kernels contain the lights and materials of all scenes there are
    for lanes in (1234, 998):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            traced = runner.trace(runner.moves(1, 0), dr.arange(mi.UInt32, lanes), None)
            dr.eval(traced.contributions, traced.rays)
            kernels.append({one["hash"] for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT})
    assert kernels[1] and kernels[1] <= kernels[0]


@pytest.mark.parametrize("method, settings", [("pssmlt", {}), ("pssmlt", {"estimator": "bidirectional"}), ("mmlt", {})])
def test_a_method_ends_with_its_last_reference(method, settings):
    """Not by garbage collection, which may come while the kernels of another one are traced."""
    gc.disable()
    try:
        chains = prepared(scenes.room("rectangle", scenes.FEW), method, 3, **(SMALL | settings | {"chains": 256}))
        go(chains, 1, 3)
        gone = weakref.ref(chains)
        del chains
        assert gone() is None
    finally:
        gc.enable()
