"""Casting in passes: budgets, stops and checkpoints lose nothing and change nothing."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from support.patches import box, cube, joined, square
from support.running import Stepped

import etendue.radiosity.casting
import etendue.radiosity.lines.abuffer
import etendue.radiosity.solvers.shot
from etendue.core import CheckpointError, Replica
from etendue.engine import Budget, Checkpoint, Job, RunError, Runner
from etendue.radiosity import (
    ABuffer,
    CastingSettings,
    LineCasting,
    MixedSegments,
    Patches,
    PatchProblem,
    RadiosityError,
    SpiralPoints,
    solve,
)
from etendue.radiosity.solvers.shot import Shot


def lit_room(**properties):
    """With a small lamp, and a pebble that few lines meet."""
    lamp, pebble = square((0.47, 0.48, 0.97), (0, 0.05, 0), (0.05, 0, 0)), box((0.6, 0.3, 0.4), (0.605, 0.305, 0.405))
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), pebble, lamp)
    emission = np.where(np.arange(len(faces)) == len(faces) - 1, 100.0, 0.0)
    return Patches(vertices, faces, **{"reflectance": 0.5, "emission": emission, **properties})


def prepared(patches, seed=3, lines=200, replicates=1, **options):
    casting = LineCasting(CastingSettings(lines=lines, replicates=replicates), **options)
    casting.prepare(PatchProblem(patches), seed)
    return Stepped(casting)


def run(casting, **budget):
    return Runner(casting.method, seed=3, budget=Budget(**budget)).run()


def test_passes_make_the_segments_of_the_engine():
    patches = cube(2)
    casting = prepared(patches, most=20)
    result = run(casting, samples=20)
    assert casting.count == 20 and result.passes == 3 and result.stopped_by == "samples"
    same = ABuffer(patches, SpiralPoints(3), 200).cast(20)
    segments = casting.segments()
    np.testing.assert_array_equal(np.concatenate(segments.chunks), np.concatenate(same.chunks))
    np.testing.assert_array_equal(segments.expected, same.expected)
    assert casting.shot() is None and not isinstance(segments, MixedSegments)
    assert casting.made == len(same)


def test_engines_with_other_pieces(monkeypatch):
    """Dr.Jit's kernels take more bundles at once: steps are as many, and make the same lines."""
    monkeypatch.setattr(etendue.radiosity.casting, "ABuffer", partial(ABuffer, backend="drjit"))
    casting = prepared(cube(1), most=200)
    assert casting.samples_per_iteration == 64
    result = run(casting, samples=200)
    assert result.passes == 4 and casting.count == 200
    loops = ABuffer(cube(1), SpiralPoints(3), 200).cast(200)
    assert abs(casting.made - len(loops)) <= 3 and len(casting.segments().chunks) == 4


def outcome(casting):
    segments = casting.segments()
    assert isinstance(segments, MixedSegments)
    solution = solve(casting.patches, segments, "conjugate-gradient", shot=casting.shot())
    return solution.radiosity, solution.irradiance_error(segments)


@pytest.mark.parametrize("replicates", [1, 8])
def test_a_run_that_is_resumed_is_the_run_that_was_not_interrupted(tmp_path, replicates):
    """Bit by bit, through a file; looking at errors on the way changes nothing."""
    patches = lit_room()
    whole = prepared(patches, most=256, replicates=replicates)
    run(whole, samples=256)

    part = prepared(patches, goal="irradiance", most=256, replicates=replicates)
    for i in range(17):
        part.step(i, 3)
    assert part.noise() > 0
    job = Job(PatchProblem(patches), part.method, seed=3, budget=Budget(samples=256), place={}, state=part.state())
    stopped = job.runner(cancel=Stop(after=5)).run()
    assert stopped.stopped_by == "cancel" and part.count == 8 * 22
    job.checkpoint(stopped).write(tmp_path / "lines.checkpoint")
    part.close()

    saved = Checkpoint.read(tmp_path / "lines.checkpoint")
    saved.require_scene(PatchProblem(lit_room()).fingerprint)
    rest = prepared(patches, most=256, replicates=replicates)
    rest.restore(saved.state)
    while rest.count < 256:
        rest.step(0, 3)
    for ours, theirs in zip(outcome(rest), outcome(whole), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_piece_whose_casting_fails_is_cast_again(tmp_path, monkeypatch):
    """After its lines were kept, and rays of the shot with them: by the same casting, and from its checkpoint."""
    monkeypatch.setattr(etendue.radiosity.solvers.shot, "BATCH", 1 << 16)
    patches, lines = lit_room(), 20_000
    whole = prepared(patches, lines=lines, most=192)
    run(whole, samples=192)

    def fail(shot, rays, grow=Shot.grow):
        grow(shot, rays)
        if rays > 100 * whole.engine.expected(1).sum() / 8:  # a quarter of the segments of that many bundles
            raise RuntimeError("on purpose")

    part = prepared(patches, lines=lines, most=192)
    with monkeypatch.context() as patch:
        patch.setattr(Shot, "grow", fail)
        with pytest.raises(RunError) as caught:
            run(part, samples=192)
    left = caught.value.run
    assert 0 < left.passes < 24
    Job(PatchProblem(patches), part.method, seed=3, budget=Budget(), place={}).checkpoint(left).write(tmp_path / "a")
    saved = Checkpoint.read(tmp_path / "a")
    rest = prepared(patches, lines=lines, most=192)
    rest.restore(saved.state)
    for casting, begun in ((rest, saved), (part, left)):
        start, state = begun.measurement, begun.state
        result = Runner(casting.method, seed=3, budget=Budget(samples=192), start=start, state=state).run()
        assert result.passes == 24
        for ours, theirs in zip(outcome(casting), outcome(whole), strict=True):
            np.testing.assert_array_equal(ours, theirs)


class Stop:
    """Says so after some questions."""

    def __init__(self, after):
        self.after = after

    def is_set(self):
        self.after -= 1
        return self.after < 0


def test_a_finished_run_can_go_on_to_any_number():
    patches = cube(1)
    first, whole = prepared(patches, most=20), prepared(patches, most=43)
    begun = run(first, samples=20)
    first.close()
    first.most = 43
    start, state = begun.measurement, begun.state
    result = Runner(first.method, seed=3, budget=Budget(samples=43), start=start, state=state).run()
    run(whole, samples=43)
    assert first.count == 43 and result.passes == 6
    a, b = (np.concatenate(x.segments().chunks) for x in (first, whole))
    np.testing.assert_array_equal(a, b)
    few = prepared(patches, most=8)
    with pytest.raises(CheckpointError, match="43 bundles, more than 8"):
        few.restore(result.state)


def test_a_run_ends_at_an_error():
    casting = prepared(lit_room(), goal="irradiance")
    assert casting.noise() is None
    result = run(casting, error=0.03**2, samples=1 << 14)
    assert result.stopped_by == "error" and casting.count >= 128
    segments = casting.segments()
    solution = solve(casting.patches, segments, shot=casting.shot())
    areas = casting.patches.areas[:, None]
    error = (areas * solution.irradiance_error(segments)).sum() / (areas * solution.irradiance).sum()
    assert error < 0.031
    before = casting.count
    casting = prepared(lit_room(), goal="irradiance")
    run(casting, error=0.001**2, samples=1 << 14)
    assert casting.count > before

    rows = prepared(cube(2), goal="rows")
    assert run(rows, error=0.02**2, samples=1 << 14).stopped_by == "error"
    expected = rows.engine.expected(rows.count)
    assert 0.7 * 0.02 < (1 / np.sqrt(expected)).mean() <= 0.02


def ends(patches, target, seeds, **options):
    """Of runs to an error, all relative to the mean over the surface: what they state, and their scatter."""
    areas, found, stated = patches.areas[:, None], [], []
    for seed in range(seeds):
        casting = prepared(patches, seed, goal="irradiance", **options)
        result = Runner(casting.method, seed=seed, budget=Budget(error=target**2, samples=1 << 14)).run()
        casting.close()
        assert result.stopped_by == "error"
        solution = solve(patches, casting.segments(), "conjugate-gradient", shot=casting.shot())
        found.append(solution.irradiance)
        error = (areas * solution.irradiance_error(casting.segments())).sum() / (areas * solution.irradiance).sum()
        assert error == pytest.approx(np.sqrt(casting.noise()), rel=0.05)
        stated.append(error)
    scatter = (areas * np.std(found, axis=0, ddof=1)).sum() / (areas * np.mean(found, axis=0)).sum()
    return np.mean(stated), scatter


def glowing_cube():
    return cube(2, reflectance=0.5, emission=np.arange(24) < 4)


def test_a_budget_in_error_ends_where_the_scatter_over_seeds_says():
    stated, scatter = ends(glowing_cube(), 0.012, 12, replicates=8)
    assert stated == pytest.approx(0.012, rel=0.15) and scatter == pytest.approx(0.012, rel=0.25)
    # Parts of one sequence tell no more than a bound.
    stated, scatter = ends(glowing_cube(), 0.024, 6)
    assert stated > 1.5 * scatter


@pytest.mark.slow
@pytest.mark.parametrize(("patches", "target", "lines"), [(lit_room(), 0.002, 200), (glowing_cube(), 0.005, 200)])
def test_budgets_in_error_end_where_the_scatter_over_30_seeds_says(patches, target, lines):
    """With a shot, whose rays have a share in the error, and without."""
    stated, scatter = ends(patches, target, 30, replicates=8, lines=lines)
    assert stated == pytest.approx(target, rel=0.15) and scatter == pytest.approx(target, rel=0.25)


def test_an_error_that_is_added_up_is_that_of_all_lines(monkeypatch):
    """As many segments as a solution is kept for: only what is new is looked at."""
    monkeypatch.setattr(etendue.radiosity.casting, "_FEW_SEGMENTS", 0)
    patches = lit_room(emission=1.0)
    casting = prepared(patches, goal="irradiance", replicates=3)
    for i in range(40):
        casting.step(i, 3)
        if i in (16, 17, 25, 39):
            carried, irradiance = casting.noise() and casting._known
            error = casting._lines().gather_error(carried, patches.sky)
            areas = patches.areas[:, None]
            assert np.sqrt(casting.noise()) == pytest.approx((areas * error).sum() / (areas * irradiance).sum())
    casting.close()
    assert casting.shot() is None


def test_a_run_ends_after_a_time():
    ticks = iter(np.arange(0, 1000, 0.25))
    casting = prepared(cube(1))
    result = Runner(casting.method, seed=3, budget=Budget(seconds=6), clock=lambda: next(ticks)).run()
    casting.close()
    assert result.stopped_by == "seconds" and 2 < result.passes < 12 and casting.count == 8 * result.passes


def test_what_follows_the_lines_is_reckoned_with():
    """By the lines cast, and the local rays that small patches will get."""
    casting = prepared(lit_room())
    seconds = []
    for i in range(16):
        casting.step(i, 3)
        seconds.append(casting.finish_seconds)
    casting.close()
    assert all(s > 0 for s in seconds)
    casting._passes[:] = 0, 1  # of the rays alone
    assert isinstance(casting.segments(), MixedSegments)
    assert casting.finish_seconds == pytest.approx(3e-7 * casting.segments().rays + 1e-8 * casting.made)
    without = LineCasting(CastingSettings(lines=200, local_rays=False))
    without.prepare(PatchProblem(lit_room()), 3)
    Replica(without, 3).step(0)
    without.close()
    without._passes[:] = 1, 1e9
    without.made = 1_000_000
    solution = solve(without.patches, without.segments(), "conjugate-gradient")
    assert len(solution.residuals) <= 1000 * without.finish_seconds - 3 <= 2.5 * len(solution.residuals)


def test_the_shot_is_cast_along_with_the_lines(monkeypatch):
    """So that little of it is left when the time is up."""
    monkeypatch.setattr(etendue.radiosity.solvers.shot, "BATCH", 1 << 16)
    casting = prepared(lit_room(), lines=20_000)
    for i in range(24):
        casting.step(i, 3)
    casting.close()
    before = casting.method._left()["shot"]["blocks"]
    casting.shot()
    after = casting.method._left()["shot"]["blocks"]
    assert after - 4 < before <= after and after > 4


def test_a_run_takes_no_more_memory_than_there_is(monkeypatch):
    patches = cube(1)
    casting = prepared(patches)
    each = casting.engine.expected(1).sum() / 2
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: int(100.5 * 8 * each))
    assert casting.memory() == 100 and 1 <= casting.memory(matrix=True) < 100
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: 1000)
    with pytest.raises(RadiosityError, match="not even one bundle"):
        prepared(patches)
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: None)
    assert prepared(patches).memory() > 1e9


def test_fingerprints_tell_patches_apart():
    known = PatchProblem(lit_room()).fingerprint
    assert known == PatchProblem(lit_room()).fingerprint
    moved = lit_room()
    moved.vertices[0] += 1e-9
    for other in (lit_room(reflectance=0.6), lit_room(sky=1.0), lit_room(two_sided=True), moved):
        assert PatchProblem(other).fingerprint != known


def distant_cubes(**properties):
    """Cubes of a metre, in fours of squares a side, at 10 km of each other, and a lit plate beside the first."""
    plate = square((0, 0, 1.5), (0, 1, 0), (1, 0, 0))
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2), box((10_000, 0, 0), (10_001, 1, 1), 2), plate)
    emission = np.where(np.arange(len(faces)) == len(faces) - 1, 1.0, 0.0)
    return Patches(vertices, faces, **{"reflectance": 0.5, "emission": emission, **properties})


def test_surfaces_far_from_each_other_get_local_rays(caplog):
    """Bundles that meet a patch four times would have 2e9 lines."""
    patches = distant_cubes()
    casting = prepared(patches, lines=0, replicates=4, goal="irradiance", most=64)
    assert "local rays are cast from all patches instead" in caplog.text
    run(casting, samples=64)
    segments = casting.segments()
    assert casting.made == len(segments) >= 64 * 8192 and segments.nbytes < 1e7
    # Parallel squares in closed form, whose distance is half a side; far away there is nothing to see.
    top = [i for i in range(24) if patches.normals[i, 2] > 0.9]
    found = segments.gather(patches.emission)[:, 0]
    assert found[top].mean() == pytest.approx(0.41525, rel=0.01)
    assert found[24:48].max() < 1e-6


def test_the_lines_of_a_bundle_are_bounded(caplog, monkeypatch):
    patches = distant_cubes()
    engine = ABuffer(patches)
    assert engine.bundles.lines_per_point == pytest.approx(1 << 24, rel=1e-6) and "take LocalRays" in caplog.text
    caplog.clear()
    assert ABuffer(cube(2)).bundles.lines_per_point == pytest.approx(16384) and not caplog.text
    monkeypatch.setattr(etendue.radiosity.lines.abuffer, "free_memory", lambda: 10**8)
    with pytest.raises(RadiosityError, match="GB on each thread"):
        ABuffer(patches, lines=1e9)
