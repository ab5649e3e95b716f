"""Form factors and radiosity from Python: the same as by the parts, with budgets, callbacks and checkpoints."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from support.patches import cube

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


def test_form_factors_of_patches(tmp_path):
    calls = []
    patches = cube(2)
    result = etendue.compute_form_factors(
        patches, "F1", bundles=64, seed=3, callback=calls.append, save=tmp_path / "factors.npz"
    )
    assert (result.bundles, result.stopped_by, result.patches) == (64, "samples", patches)
    assert [progress.samples for progress in calls] == list(range(8, 65, 8))
    np.testing.assert_allclose(result.factors.row_sums(), 1.0, atol=1e-9)
    opposite = result.factors.matrix[:4, 4:8].sum(axis=1)  # of walls of a cube that face each other, 0.19982
    assert abs(opposite.mean() - 0.19982) < 4.0 * opposite.std(ddof=1) / 2.0 < 0.04
    read = read_form_factors(tmp_path / "factors.npz")
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
    found = etendue.solve_radiosity(patches, solver, bundles=256).solution.radiosity
    assert found == pytest.approx(etendue.solve_radiosity(patches, bundles=256).solution.radiosity, rel=0.02)


def test_a_scene_is_cut_into_patches():
    result = etendue.solve_radiosity("cornell-box", bundles=16, max_area=0.2)
    assert len(result.patches) > 60 and result.patches.face_areas.max() <= 0.2 + 1e-9
    assert result.solution.radiosity.shape == (len(result.patches), 3)


def test_a_budget_in_error():
    result = etendue.solve_radiosity(cube(2, **LIT), error=0.02)
    assert result.stopped_by == "error"
    light = (result.patches.areas[:, None] * result.solution.irradiance).sum()
    assert (result.patches.areas[:, None] * result.irradiance_error).sum() / light == pytest.approx(0.02, rel=0.5)


def test_a_callback_stops_and_a_checkpoint_goes_on(tmp_path):
    patches, kept = cube(2, **LIT), tmp_path / "lines.checkpoint"
    whole = etendue.solve_radiosity(patches, bundles=64, seed=2)
    half = etendue.solve_radiosity(
        patches, bundles=64, seed=2, callback=lambda progress: progress.samples < 24, checkpoint=kept
    )
    assert (half.bundles, half.stopped_by) == (24, "cancel")
    rest = etendue.solve_radiosity(cube(2, **LIT), seed=2, resume=kept)
    assert rest.bundles == 64
    np.testing.assert_array_equal(rest.solution.radiosity, whole.solution.radiosity)
    with pytest.raises(CheckpointError):
        etendue.solve_radiosity(cube(1, **LIT | {"emission": 1.0}), seed=2, resume=kept, bundles=64)


def test_what_was_cast_before_a_failure_is_kept(tmp_path):
    def fail(progress):
        if progress.samples == 24:
            raise RuntimeError("on purpose")

    kept = tmp_path / "lines.checkpoint"
    with pytest.raises(RunError, match="on purpose"):
        etendue.compute_form_factors(cube(1), bundles=64, callback=fail, checkpoint=kept)
    assert etendue.compute_form_factors(cube(1), resume=kept, bundles=32).bundles == 32


@pytest.mark.parametrize("named", [True, False])
def test_lines_of_which_nothing_can_be_made_are_kept(named, tmp_path, monkeypatch):
    """The folder goes while lines are cast."""
    folder = tmp_path / "out"
    folder.mkdir()
    options = {"checkpoint": tmp_path / "lines.checkpoint"} if named else {}

    def go(progress):
        if folder.exists():
            folder.rmdir()

    with pytest.raises(OutputError, match=r"the lines are kept: resume='") as caught:
        etendue.compute_form_factors(cube(1), bundles=16, save=folder / "a.npz", callback=go, **options)
    kept = str(caught.value).partition("resume='")[2].partition("'")[0]
    assert etendue.compute_form_factors(cube(1), bundles=16, resume=kept).bundles == 16


@pytest.mark.parametrize(
    ("call", "error", "text"),
    [
        (lambda: etendue.compute_form_factors(cube(1), "F9"), OptionError, "no estimator 'F9'"),
        (lambda: etendue.solve_radiosity(cube(2, **LIT), "jacoby"), OptionError, "did you mean 'jacobi'"),
        (lambda: etendue.solve_radiosity(cube(1)), SceneError, "has no light"),
        (lambda: etendue.solve_radiosity(cube(1, emission=1.0), max_area=1.0), OptionError, "max_area= is for scenes"),
        (lambda: etendue.compute_form_factors(cube(1), bundles=0), OptionError, "in bundles must be a whole number"),
        (lambda: etendue.compute_form_factors(cube(1), save="a.csv"), OptionError, "not known"),
        (lambda: etendue.compute_form_factors(cube(1), save="no/where/a.npz"), OutputError, "no folder"),
        (lambda: etendue.compute_form_factors(cube(1), save="a.nc", checkpoint="a.nc"), OptionError, "two outputs"),
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
        result = etendue.solve_radiosity(patches, seed=2, bundles=bundles, resume=kept, checkpoint=kept)
        whole = etendue.solve_radiosity(patches, seed=2, bundles=bundles)
        assert (result.bundles, len(result.segments)) == (bundles, len(whole.segments))
        np.testing.assert_allclose(result.solution.radiosity, whole.solution.radiosity, rtol=1e-9)
