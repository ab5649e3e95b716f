"""Form factors and radiosity from Python: the same as by the parts, with budgets, callbacks and checkpoints."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from support.patches import cube, room

import etendue
from etendue.core import CheckpointError, OptionError, OutputError, SceneError
from etendue.engine import Budget, RunError, Runner
from etendue.radiosity import (
    CastingSettings,
    CastLines,
    LineCasting,
    PatchProblem,
    read_form_factors,
    read_solution,
    solve,
)

#: Light leaves one wall.
LIT = {"reflectance": 0.5, "emission": np.repeat([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 4)}


def lit_room():
    """A room with four boxes, light from one wall."""
    patches = room(2)
    emission = np.zeros(len(patches))
    emission[4:8] = 1.0
    return room(2, reflectance=0.5, emission=emission)


def test_form_factors_of_patches(tmp_path):
    calls = []
    patches = cube(2)
    result = etendue.compute_form_factors(
        patches, bundles=64, seed=3, callback=lambda update: calls.append(update.progress), save=tmp_path / "f.npz"
    )
    assert (result.bundles, result.stopped_by, result.patches) == (64, "samples", patches)
    assert [progress.samples for progress in calls] == list(range(8, 65, 8))
    np.testing.assert_allclose(result.factors.row_sums(), 1.0, atol=1e-9)
    opposite = result.factors.matrix[:4, 4:8].sum(axis=1)  # of walls of a cube that face each other, 0.19982
    assert abs(opposite.mean() - 0.19982) < 4.0 * opposite.std(ddof=1) / 2.0 < 0.04
    read = read_form_factors(tmp_path / "f.npz")
    np.testing.assert_array_equal(read.matrix.toarray(), result.factors.matrix.toarray())


def test_form_factors_of_a_mesh_file(tmp_path):
    patches = cube(1)
    meshio.write(tmp_path / "cube.vtu", meshio.Mesh(patches.vertices, [("quad", patches.faces)]))
    result = etendue.compute_form_factors(tmp_path / "cube.vtu", bundles=32)
    same = etendue.compute_form_factors(cube(1), bundles=32)
    np.testing.assert_allclose(result.factors.matrix.toarray(), same.factors.matrix.toarray(), atol=1e-12)


def test_a_solution_is_that_of_its_parts(tmp_path):
    patches = cube(2, **LIT)
    files = [tmp_path / "solution.npz", tmp_path / "solution.vtu"]
    result = etendue.solve_radiosity(patches, bundles=64, seed=5, save=files)
    casting = LineCasting(CastingSettings(), most=64)
    casting.prepare(PatchProblem(patches), 5)
    lines = CastLines(casting, Runner(casting, seed=5, budget=Budget(samples=64)).run().measurement)
    expected = solve(patches, lines.segments(), "conjugate-gradient", shot=lines.shot())
    np.testing.assert_array_equal(result.solution.radiosity, expected.radiosity)
    assert result.irradiance_error.shape == result.solution.irradiance.shape
    read, error = read_solution(files[0])
    np.testing.assert_array_equal(read.radiosity, expected.radiosity)
    np.testing.assert_array_equal(error, result.irradiance_error)
    assert files[1].exists()


@pytest.mark.parametrize("solver", ["jacobi", "southwell", "direct"])
def test_solvers_agree(solver):
    patches = cube(2, **LIT)
    found = etendue.solve_radiosity(patches, solver=solver, bundles=256).solution.radiosity
    assert found == pytest.approx(etendue.solve_radiosity(patches, bundles=256).solution.radiosity, rel=0.02)


def test_methods_agree():
    """Lines that are stored, single lines, and boxes around the objects, within their errors."""
    patches = lit_room()
    found = [
        etendue.solve_radiosity(patches, bundles=1024),
        etendue.solve_radiosity(patches, "multipath", points=1 << 17, point_set="halton"),
        etendue.solve_radiosity(patches, "boxes", passes=8, objects="components", least=4, threshold=2.0),
    ]
    assert [(one.bundles, one.points, one.passes) for one in found] == [(1024, 0, 0), (0, 1 << 17, 0), (0, 0, 8)]
    assert len(found[2].parts.tree.part) > 1  # there are boxes
    for one in found[1:]:
        light, expected = (r.solution.radiosity[:, 0] * patches.areas for r in (one, found[0]))
        assert light.sum() == pytest.approx(expected.sum(), rel=0.02)
        assert np.abs(light - expected).sum() / expected.sum() < 0.05


def test_a_scene_is_cut_into_patches():
    result = etendue.solve_radiosity("cornell-box", bundles=16, max_area=0.2)
    assert len(result.patches) > 60 and result.patches.face_areas.max() <= 0.2 + 1e-9
    assert result.solution.radiosity.shape == (len(result.patches), 3)


def test_a_budget_in_error():
    result = etendue.solve_radiosity(cube(2, **LIT), error=0.02)
    assert result.stopped_by == "error"
    light = (result.patches.areas[:, None] * result.solution.irradiance).sum()
    assert (result.patches.areas[:, None] * result.irradiance_error).sum() / light == pytest.approx(0.02, rel=0.5)


@pytest.mark.slow
def test_the_error_of_independent_sequences_is_that_which_is_made():
    """Squared deviations from many lines, in estimated variances; of one sequence the estimate is an upper one."""
    patches = lit_room()
    exact = etendue.solve_radiosity(patches, bundles=2048, seed=99, shot=False).solution.irradiance

    def ratio(seed, replicates):
        made = etendue.solve_radiosity(patches, bundles=64, replicates=replicates, seed=seed, shot=False)
        return ((made.solution.irradiance - exact) ** 2).sum() / (made.irradiance_error**2).sum()

    assert 0.5 < np.mean([ratio(seed, 8) for seed in range(8)]) < 2.0
    assert np.mean([ratio(seed, 1) for seed in range(8)]) < 0.2


def test_a_callback_stops_and_a_checkpoint_goes_on(tmp_path):
    patches, kept = cube(2, **LIT), tmp_path / "lines.checkpoint"
    whole = etendue.solve_radiosity(patches, bundles=64, seed=2)
    half = etendue.solve_radiosity(
        patches, bundles=64, seed=2, callback=lambda update: update.progress.samples < 24, checkpoint=kept
    )
    assert (half.bundles, half.stopped_by) == (24, "cancel")
    with pytest.raises(CheckpointError, match="in memory"):
        etendue.resume(kept)
    rest = etendue.resume(kept, scene=cube(2, **LIT))
    assert rest.bundles == 64
    np.testing.assert_array_equal(rest.solution.radiosity, whole.solution.radiosity)
    with pytest.raises(CheckpointError, match="not the one"):
        etendue.resume(kept, scene=cube(1, **LIT | {"emission": 1.0}), bundles=96)


def test_what_was_cast_before_a_failure_is_kept(tmp_path):
    def fail(update):
        if update.progress.samples == 24:
            raise RuntimeError("on purpose")

    kept = tmp_path / "lines.checkpoint"
    with pytest.raises(RunError, match="on purpose"):
        etendue.compute_form_factors(cube(1), bundles=64, callback=fail, checkpoint=kept)
    assert etendue.resume(kept, scene=cube(1), bundles=32).bundles == 32


@pytest.mark.parametrize("named", [True, False])
def test_lines_of_which_nothing_can_be_made_are_kept(named, tmp_path):
    """The folder goes while lines are cast."""
    folder = tmp_path / "out"
    folder.mkdir()
    options = {"checkpoint": tmp_path / "lines.checkpoint"} if named else {}

    def go(update):
        if folder.exists():
            folder.rmdir()

    with pytest.raises(OutputError, match=r"the lines are kept: etendue resume '") as caught:
        etendue.compute_form_factors(cube(1), bundles=16, save=folder / "a.npz", callback=go, **options)
    kept = str(caught.value).partition("etendue resume '")[2].partition("'")[0]
    assert etendue.resume(kept, scene=cube(1), bundles=16, save=tmp_path / "b.npz").bundles == 16


def lit(*arguments, **options):
    return etendue.solve_radiosity(cube(2, **LIT), *arguments, **options)


def factors(*arguments, **options):
    return etendue.compute_form_factors(cube(1), *arguments, **options)


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: factors(estimator="F9"), OptionError, "no estimator 'F9'"),
        (lambda: factors("F1"), OptionError, "no method 'F1' for form factors; .*: lines, spheres, exact"),
        (lambda: factors("multipath"), OptionError, "no method 'multipath' for form factors"),
        (lambda: factors(objects="components"), OptionError, "objects is for method spheres"),
        (lambda: factors("exact", bundles=8), OptionError, "no lines are cast, so leave out bundles"),
        (lambda: factors("exact", wait=False), OptionError, "makes its result at once, without passes: leave out wait"),
        (lambda: factors(bundles=0), OptionError, "in bundles must be a whole number"),
        (lambda: factors(points=8), OptionError, "method 'lines' has no option 'points'"),
        (lambda: factors(save="a.txt"), OptionError, "not known"),
        (lambda: factors(save="no/where/a.npz"), OutputError, "no folder"),
        (lambda: factors(save="a.nc", checkpoint="a.nc"), OptionError, "two outputs"),
        (lambda: lit("jacobi"), OptionError, "'jacobi' is a solver of method lines: give solver jacobi"),
        (lambda: lit(solver="multipath"), OptionError, "is a method, not a solver: give method multipath"),
        (lambda: lit(solver="jacoby"), OptionError, "did you mean 'jacobi'"),
        (lambda: lit("spheres"), OptionError, "no method 'spheres' for a solution"),
        (
            lambda: lit("multipath", bundles=8),
            OptionError,
            "'multipath' counts points: give points in place of bundles",
        ),
        (lambda: lit("multipath", solver="jacobi"), OptionError, "a solver is for method lines"),
        (lambda: lit("multipath", threshold=0.2), OptionError, "threshold is for boxes"),
        (lambda: lit("boxes", threshold=-1), OptionError, "'threshold' must be"),
        (lambda: lit("ambient", bundles=8), OptionError, "no lines are cast, so leave out bundles"),
        (lambda: lit(ambient="fuzzy", wait=False), OptionError, "leave out wait"),
        (lambda: lit(divide=True, workers=2), OptionError, "divide puts boxes on workers: give method boxes, too"),
        (lambda: lit("boxes", divide=True), OptionError, "give workers or cluster with divide"),
        (lambda: lit(max_area=1.0), OptionError, "max_area is for scenes and mesh files"),
        (lambda: etendue.solve_radiosity(cube(1)), SceneError, "has no light"),
        (lambda: etendue.compute_form_factors("missing.ply"), SceneError, "no mesh file"),
        (lambda: etendue.solve_radiosity("no-such-scene"), SceneError, "no-such-scene"),
    ],
)
def test_what_cannot_be(call, error, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=text):
        call()
    assert not list(tmp_path.iterdir())


def test_a_checkpoint_inside_a_pass_goes_on_to_any_number(tmp_path):
    """The pass has 8 bundles; each run ends inside one, or at its end."""
    patches, kept = cube(2, **LIT), tmp_path / "lines.checkpoint"
    etendue.solve_radiosity(patches, seed=2, bundles=3, checkpoint=kept)
    for bundles in (5, 8, 21):
        result = etendue.resume(kept, scene=patches, bundles=bundles)
        whole = etendue.solve_radiosity(patches, seed=2, bundles=bundles)
        assert (result.bundles, len(result.segments)) == (bundles, len(whole.segments))
        np.testing.assert_allclose(result.solution.radiosity, whole.solution.radiosity, rtol=1e-9)


def test_the_arguments_of_version_1_mean_the_same(caplog):
    """``hierarchy`` is method spheres or boxes, with its objects and settings; it warns."""
    patches = lit_room()
    for old, new in (
        ({"hierarchy": True}, {}),
        ({"hierarchy": "components"}, {"objects": "components"}),
    ):
        caplog.clear()
        was = etendue.compute_form_factors(patches, bundles=16, seed=1, main_share=0.3, **old)
        assert "hierarchy is now method spheres" in caplog.text
        now = etendue.compute_form_factors(patches, "spheres", bundles=16, seed=1, main_share=0.3, **new)
        np.testing.assert_array_equal(was.factors.matrix.toarray(), now.factors.matrix.toarray())
    caplog.clear()
    settings = {"objects": "components", "least": 4, "threshold": 2.0, "lines": 20_000, "grid": 3}
    was = etendue.solve_radiosity(patches, hierarchy=settings, passes=2, seed=1)
    assert "hierarchy is now method boxes" in caplog.text
    caplog.clear()
    now = etendue.solve_radiosity(patches, "boxes", passes=2, seed=1, **settings)
    np.testing.assert_allclose(was.solution.radiosity, now.solution.radiosity, rtol=1e-12)
    assert not caplog.text
