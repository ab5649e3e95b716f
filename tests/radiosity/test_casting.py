"""Casting in passes: budgets, stops and checkpoints lose nothing and change nothing."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from support.patches import box, cube, joined, square
from support.tasks import job_of

import etendue.radiosity.casting
import etendue.radiosity.error_estimate
import etendue.radiosity.lines.abuffer
import etendue.radiosity.solvers.shot
from etendue.core import CheckpointError
from etendue.engine import Budget, Checkpoint, RunError, Runner
from etendue.radiosity import (
    ABuffer,
    CastingSettings,
    CastLines,
    LineCasting,
    MixedSegments,
    Patches,
    PatchProblem,
    RadiosityError,
    Segments,
    SpiralPoints,
    solve,
)
from etendue.radiosity.solvers.shot import Shot

pytestmark = pytest.mark.usefixtures("compiled_lines")


def lit_room(**properties):
    """With a small lamp, and a pebble that few lines meet."""
    lamp, pebble = square((0.47, 0.48, 0.97), (0, 0.05, 0), (0.05, 0, 0)), box((0.6, 0.3, 0.4), (0.605, 0.305, 0.405))
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), pebble, lamp)
    emission = np.where(np.arange(len(faces)) == len(faces) - 1, 100.0, 0.0)
    return Patches(vertices, faces, **{"reflectance": 0.5, "emission": emission, **properties})


class Casting:
    """A prepared casting and what its passes have measured."""

    def __init__(self, patches, seed=3, lines=200, replicates=1, settings=None, **options):
        made = settings or CastingSettings(lines=lines, replicates=replicates)
        self.method, self.seed, self.measurement = LineCasting(made, **options), seed, None
        self.method.prepare(PatchProblem(patches), seed)

    def step(self, iteration):
        measured = self.method.step(iteration, self.seed, {}).measurement
        self.measurement = measured if self.measurement is None else self.measurement + measured

    def run(self, start=None, **budget):
        result = Runner(self.method, seed=self.seed, budget=Budget(**budget), start=start).run()
        self.method.close()
        self.measurement = result.measurement
        return result

    @property
    def lines(self):
        return CastLines(self.method, self.measurement)

    @property
    def noise(self):
        return self.method.noise(self.measurement)


def rows(segments):
    return np.concatenate(segments.chunks)


def test_passes_make_the_segments_of_the_engine():
    patches = cube(2)
    casting = Casting(patches, most=20)
    result = casting.run(samples=20)
    assert casting.lines.count == 20 and result.passes == 3 and result.stopped_by == "samples"
    same = ABuffer(patches, SpiralPoints(3), 200).cast(20)
    segments = casting.lines.segments()
    np.testing.assert_array_equal(rows(segments), rows(same))
    np.testing.assert_array_equal(segments.expected, same.expected)
    assert casting.lines.shot() is None and not isinstance(segments, MixedSegments)
    assert result.result.metadata == {"bundles": 20, "segments": len(same)}


def test_passes_in_any_order_are_the_same_lines():
    """On several castings, as a cluster would have them; with the light of a shot."""
    patches = lit_room()
    whole, *parts = (Casting(patches, lines=2000) for _ in range(3))
    for iteration in range(12):
        whole.step(iteration)
    for part, iterations in zip(parts, ((7, 2, 0, 11), (1, 3, 10, 9, 8, 4, 6, 5)), strict=True):
        for iteration in iterations:
            part.step(iteration)
        part.method.close()
    whole.method.close()
    parts[0].measurement += parts[1].measurement
    np.testing.assert_array_equal(rows(parts[0].lines.segments()), rows(whole.lines.segments()))
    for ours, theirs in zip(outcome(parts[0]), outcome(whole), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)  # sums of the shot in another order


def test_engines_with_other_pieces(monkeypatch):
    """Dr.Jit's kernels take more bundles at once: passes are larger, and make the same lines."""
    monkeypatch.setattr(etendue.radiosity.casting, "ABuffer", partial(ABuffer, backend="drjit"))
    casting = Casting(cube(1), most=200)
    assert casting.method.samples_per_iteration == casting.method.settings.bundles_per_pass == 13
    result = casting.run(samples=200)
    assert result.passes == 16 and casting.lines.count == 200
    loops = ABuffer(cube(1), SpiralPoints(3), 200).cast(200)
    segments = casting.lines.segments()
    assert abs(len(segments) - len(loops)) <= 3 and len(segments.chunks) == 16


def outcome(casting):
    segments = casting.lines.segments()
    assert isinstance(segments, MixedSegments)
    solution = solve(casting.method.patches, segments, "conjugate-gradient", shot=casting.lines.shot())
    return solution.radiosity, solution.irradiance_error(segments)


@pytest.mark.parametrize("replicates", [1, 8])
def test_a_run_that_is_resumed_is_the_run_that_was_not_interrupted(tmp_path, replicates):
    """Bit by bit, through a file; looking at errors on the way changes nothing."""
    patches = lit_room()
    whole = Casting(patches, most=256, replicates=replicates)
    whole.run(samples=256)

    part = Casting(patches, goal="irradiance", most=256, replicates=replicates)
    for i in range(17):
        part.step(i)
    assert part.noise > 0
    job = job_of(PatchProblem(patches), part.method, 3, Budget(samples=256), start=part.measurement)
    stopped = job.runner(cancel=Stop(after=5)).run()
    assert stopped.stopped_by == "cancel" and part.method.bundles(stopped.measurement) == 8 * 22
    job.checkpoint(stopped).write(tmp_path / "lines.checkpoint")
    part.method.close()

    saved = Checkpoint.read(tmp_path / "lines.checkpoint")
    saved.require_scene(PatchProblem(lit_room()).fingerprint)
    rest = Casting(patches, settings=saved.settings_of(LineCasting), most=256)
    rest.method.go_on(saved.measurement)
    rest.run(saved.measurement, samples=256)
    for ours, theirs in zip(outcome(rest), outcome(whole), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_pass_whose_casting_fails_is_cast_again(tmp_path, monkeypatch):
    """With the rays of the shot: by the same casting, and from its checkpoint."""
    monkeypatch.setattr(etendue.radiosity.solvers.shot, "BATCH", 1 << 16)
    patches, lines = lit_room(), 20_000
    whole = Casting(patches, lines=lines, most=192)
    whole.run(samples=192)
    blocks = sum(whole.measurement.weights.values())

    def fail(shot, first, count, light=Shot.light):
        if 2 * first > blocks:
            raise RuntimeError("on purpose")
        return light(shot, first, count)

    part = Casting(patches, lines=lines, most=192)
    with monkeypatch.context() as patch:
        patch.setattr(Shot, "light", fail)
        with pytest.raises(RunError) as caught:
            part.run(samples=192)
    left = caught.value.run
    assert 0 < left.passes < 24
    job_of(PatchProblem(patches), part.method, 3).checkpoint(left).write(tmp_path / "a")
    rest = Casting(patches, lines=lines, most=192)
    for casting, begun in ((rest, Checkpoint.read(tmp_path / "a")), (part, left)):
        result = casting.run(begun.measurement, samples=192)
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
    first, whole = Casting(patches, most=20), Casting(patches, most=43)
    begun = first.run(samples=20)
    first.method.most = 43
    first.method.go_on(begun.measurement)
    result = first.run(begun.measurement, samples=43)
    whole.run(samples=43)
    assert first.lines.count == 43 and result.passes == 6
    np.testing.assert_array_equal(rows(first.lines.segments()), rows(whole.lines.segments()))
    few = Casting(patches, most=8)
    with pytest.raises(CheckpointError, match="43 bundles, more than 8"):
        few.method.go_on(result.measurement)
    with pytest.raises(RadiosityError, match="pass 1 has no lines"):
        few.step(1)


def test_a_run_ends_at_an_error():
    patches = lit_room()
    casting = Casting(patches, goal="irradiance")
    casting.step(0)
    assert casting.noise is None
    result = casting.run(error=0.03**2, samples=1 << 14)
    assert result.stopped_by == "error" and casting.lines.count >= 128
    segments = casting.lines.segments()
    solution = solve(patches, segments, shot=casting.lines.shot())
    areas = patches.areas[:, None]
    error = (areas * solution.irradiance_error(segments)).sum() / (areas * solution.irradiance).sum()
    assert error < 0.031
    before = casting.lines.count
    casting = Casting(patches, goal="irradiance")
    casting.run(error=0.001**2, samples=1 << 14)
    assert casting.lines.count > before

    factors = Casting(cube(2), goal="rows")
    assert factors.run(error=0.02**2, samples=1 << 14).stopped_by == "error"
    expected = factors.method.engine.expected(factors.lines.count)
    assert 0.7 * 0.02 < (1 / np.sqrt(expected)).mean() <= 0.02


def ends(patches, target, seeds, **options):
    """Of runs to an error, all relative to the mean over the surface: what they state, and their scatter."""
    areas, found, stated = patches.areas[:, None], [], []
    for seed in range(seeds):
        casting = Casting(patches, seed, goal="irradiance", **options)
        result = casting.run(error=target**2, samples=1 << 14)
        assert result.stopped_by == "error"
        segments = casting.lines.segments()
        solution = solve(patches, segments, "conjugate-gradient", shot=casting.lines.shot())
        found.append(solution.irradiance)
        error = (areas * solution.irradiance_error(segments)).sum() / (areas * solution.irradiance).sum()
        assert error == pytest.approx(np.sqrt(casting.noise), rel=0.05)
        stated.append(error)
    scatter = (areas * np.std(found, axis=0, ddof=1)).sum() / (areas * np.mean(found, axis=0)).sum()
    return np.mean(stated), scatter


def glowing_cube():
    return cube(2, reflectance=0.5, emission=np.arange(24) < 4)


@pytest.mark.slow
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
    """As many segments as a solution is kept for: only those of new passes are looked at."""
    monkeypatch.setattr(etendue.radiosity.error_estimate, "_FEW_SEGMENTS", 0)
    patches = lit_room(emission=1.0)
    casting = Casting(patches, goal="irradiance", replicates=3)
    for i in range(40):
        casting.step(i)
        if i == 16:
            first = solve(patches, as_cast(casting), "conjugate-gradient", tolerance=1e-3)
        if i in (16, 17, 25, 39):
            # All lines anew, by what the first solution sends.
            error = as_cast(casting).gather_error(first.radiosity, patches.sky)
            areas = patches.areas[:, None]
            expected = (areas * error).sum() / (areas * first.irradiance).sum()
            assert np.sqrt(casting.noise) == pytest.approx(expected)
    casting.method.close()
    assert casting.lines.shot() is None


def as_cast(casting):
    """The segments of a measurement of three replicates, without local rays."""
    record = casting.measurement.records["segments"]
    batches = [iteration % 3 for _, iteration in record.passes]
    return Segments(casting.method.patches, list(record), batches, casting.method.engine.expected(casting.lines.count))


def test_a_run_ends_after_a_time():
    ticks = iter(np.arange(0, 1000, 0.25))
    casting = Casting(cube(1))
    result = Runner(casting.method, seed=3, budget=Budget(seconds=6), clock=lambda: next(ticks)).run()
    casting.method.close()
    assert result.stopped_by == "seconds" and 2 < result.passes < 12
    assert casting.method.bundles(result.measurement) == 8 * result.passes


def test_what_follows_the_lines_is_reckoned_with(monkeypatch):
    """By the lines cast, and the local rays that small patches will get."""
    casting = Casting(lit_room())
    for i in range(16):
        casting.step(i)
        assert casting.method.finish_seconds(casting.measurement) > 0
    casting.method.close()
    # Sums that take no time: what is left is of the rays alone.
    monkeypatch.setattr(etendue.radiosity.casting.time, "perf_counter", lambda: 0.0)
    still = Casting(lit_room())
    segments = casting.lines.segments()
    assert isinstance(segments, MixedSegments)
    expected = 3e-7 * segments.rays + 1e-8 * len(casting.measurement.records["segments"])
    assert still.method.finish_seconds(casting.measurement) == pytest.approx(expected)
    # A millisecond for the sums over a pass of the whole: a solution takes about as many as it has steps.
    ticks = iter(range(1 << 20))
    monkeypatch.setattr(etendue.radiosity.casting.time, "perf_counter", lambda: next(ticks) / 1000)
    without = Casting(lit_room(), settings=CastingSettings(lines=200, local_rays=False))
    without.step(0)
    without.method.close()
    steps = len(solve(lit_room(), without.lines.segments(), "conjugate-gradient").residuals)
    assert steps <= 1000 * without.method.finish_seconds(without.measurement) - 3 <= 2.5 * steps


def test_the_shot_is_cast_along_with_the_lines(monkeypatch):
    """So that little of it is left when the time is up."""
    monkeypatch.setattr(etendue.radiosity.solvers.shot, "BATCH", 1 << 16)
    casting = Casting(lit_room(), lines=20_000)
    for i in range(24):
        casting.step(i)
    casting.method.close()
    with_lines = sum(casting.measurement.weights.values())
    rays = casting.lines.shot().rays
    left = []

    def light(shot, first, count, light=Shot.light):
        left.append(count)
        return light(shot, first, count)

    monkeypatch.setattr(Shot, "light", light)
    assert casting.lines.shot().rays == rays
    assert 0 <= left[0] < 4 < with_lines


def test_a_run_takes_no_more_memory_than_there_is(monkeypatch):
    patches = cube(1)
    casting = Casting(patches).method
    each = casting.engine.expected(1).sum() / 2
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: int(100.5 * 8 * each))
    assert casting.memory() == 100 and 1 <= casting.memory(matrix=True) < 100
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: 1000)
    with pytest.raises(RadiosityError, match="not even one bundle"):
        Casting(patches)
    monkeypatch.setattr(etendue.radiosity.casting, "free_memory", lambda: None)
    assert Casting(patches).method.memory() > 1e9


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
    casting = Casting(patches, lines=0, replicates=4, goal="irradiance", most=64)
    assert "local rays are cast from all patches instead" in caplog.text
    casting.run(samples=64)
    segments = casting.lines.segments()
    assert len(casting.measurement.records["segments"]) == len(segments) >= 64 * 8192 and segments.nbytes < 1e7
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
