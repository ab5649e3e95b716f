"""Multipath as a method: passes, budgets, checkpoints."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, joined, square
from support.running import Stepped
from support.tasks import job_of

from etendue.core import CheckpointError, Iterations
from etendue.engine import Budget, Checkpoint, Runner
from etendue.radiosity import (
    MultipathPasses,
    MultipathSettings,
    Patches,
    PatchProblem,
    RayScene,
    multipath,
    shot_at_patches,
    small_emitters,
)


def lit_cube():
    """One patch a wall, one wall lit; in closed form: form factors of a cube are .19982 opposite, .20004 beside."""
    vertices, faces = box((0, 0, 0), (1, 1, 1), inward=True)
    return Patches(vertices, faces, reflectance=0.6, emission=np.eye(6)[0])


def lamp_in_a_room():
    vertices, faces = joined(
        box((0, 0, 0), (1, 1, 1), 2, inward=True), square((0.5, 0.5, 0.98), (0, 0.05, 0), (0.05, 0, 0))
    )
    emission = np.where(np.arange(len(faces)) == len(faces) - 1, 100.0, 0.0)
    return Patches(vertices, faces, reflectance=0.5, emission=emission)


def prepared(patches, seed=3, points=1 << 10, **settings):
    method = MultipathPasses(MultipathSettings(points_per_pass=points, **settings))
    method.prepare(PatchProblem(patches), seed)
    return method


def run(method, seed=3, start=None, state=None, **budget):
    return Runner(method, seed=seed, budget=Budget(**budget), start=start, state=state).run()


def solution(result):
    return result.method.solution(result.measurement)


def test_passes_are_one_run_of_lines_in_another_unit_of_power():
    patches = lamp_in_a_room()
    found = solution(run(prepared(patches), samples=8 << 10))
    expected = multipath(MultipathSettings().lines(patches, 3), 8 << 10)
    for name in ("radiosity", "unshot", "sent", "absorbed", "to_sky"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-12, err_msg=name)


def test_the_closed_form_of_a_lit_cube():
    found = []
    for seed in range(8):
        result = solution(run(prepared(lit_cube(), seed), seed, samples=8 << 10))
        out = result.absorbed + result.to_sky + result.unshot.sum(axis=0)
        np.testing.assert_allclose(result.sent, out, rtol=1e-9)
        found.append([result.radiosity[0, 0], result.radiosity[1:, 0].mean()])
    error = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(np.mean(found, axis=0) - [1.1607, 0.2679]) < 3 * error + 1e-4).all()
    assert error.max() < 0.005


def test_a_run_is_resumed_bit_by_bit(tmp_path):
    patches = lamp_in_a_room()
    whole = solution(run(prepared(patches), samples=8 << 10))
    method = prepared(patches)
    part = run(method, samples=3 << 10)
    job_of(PatchProblem(patches), method, 3).checkpoint(part).write(tmp_path / "a")
    saved = Checkpoint.read(tmp_path / "a")
    assert saved.settings_of(MultipathPasses) == method.settings
    rest = run(prepared(patches), start=saved.measurement, state=saved.state, samples=8 << 10)
    np.testing.assert_array_equal(solution(rest).radiosity, whole.radiosity)
    np.testing.assert_array_equal(solution(rest).unshot, whole.unshot)
    np.testing.assert_allclose(rest.state["unshot"][:-2] / 8, whole.unshot, rtol=1e-9, atol=1e-12)
    with pytest.raises(CheckpointError, match="not of 6 patches"):
        prepared(lit_cube()).enter(saved.state)


def test_a_pass_leaves_the_state_it_was_given():
    method = prepared(lit_cube())
    runner = Stepped(method)
    runner.step(0, 3)
    state = runner.state()
    before = state["unshot"].copy()
    runner.step(1, 3)
    np.testing.assert_array_equal(state["unshot"], before)
    assert (runner.state()["unshot"] != before).any()


def test_replicas_add():
    first, second = (run(prepared(lit_cube(), seed), seed, iterations=4) for seed in (1, 2))
    second.measurement.iterations = Iterations({1: [(0, 4)]})
    alone = [solution(result) for result in (first, second)]
    both = first.method.solution(first.measurement + second.measurement)
    for name in ("radiosity", "unshot", "sent", "absorbed"):
        np.testing.assert_allclose(getattr(both, name), sum(getattr(one, name) for one in alone) / 2, atol=1e-12)


@pytest.mark.parametrize(("patches", "rays"), [(lit_cube(), 0), (lamp_in_a_room(), 1 << 12)], ids=["lines", "shot"])
def test_a_budget_in_error_ends_at_the_scatter_over_seeds(patches, rays):
    """Or below: parts of an even sequence scatter more than their mean errs. 16 seeds tell a scatter to 18 %."""
    target, seeds, found = 0.02, 16, []
    for seed in range(seeds):
        result = run(prepared(patches, seed, 256, shot=rays), seed, error=target**2, samples=1 << 18)
        assert result.stopped_by == "error" and result.method.noise(result.measurement) <= target**2
        found.append(solution(result).radiosity)
    # Of the irradiance; reflectances are all alike.
    areas, reflected = patches.areas[:, None], np.mean(found, axis=0) - patches.emission
    scatter = (areas * np.std(found, axis=0, ddof=1)).sum() / (areas * reflected).sum()
    assert 0.1 * target < scatter < (1 + 3 / np.sqrt(2 * (seeds - 1))) * target


def test_a_shot_goes_first():
    patches = lamp_in_a_room()
    method = prepared(patches, points=1 << 12, shot=1 << 14)
    result = solution(run(method, iterations=4))
    shot = shot_at_patches(RayScene(patches), 1 << 14, emitters=small_emitters(patches, 1.0))
    expected = multipath(MultipathSettings().lines(patches, 5), 1 << 14, shot=shot)
    areas = patches.areas[:, None]
    assert (areas * np.abs(result.radiosity - expected.radiosity)).sum() < 0.01 * (areas * expected.radiosity).sum()
