"""Multipath from Python and from the command line: budgets, checkpoints, outputs, refusals."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from support import passes
from support.patches import box, cube, joined, square

import etendue
from etendue.cli.main import main
from etendue.core import CheckpointError, OptionError, Progress
from etendue.jobs.multipath import MultipathWork
from etendue.radiosity import (
    MultipathPasses,
    Patches,
    RadiosityError,
    exact_form_factors,
    read_solution,
    solve as solve_system,
)

meshio = pytest.importorskip("meshio")

#: Light leaves one wall.
LIT = {"reflectance": 0.5, "emission": np.repeat([0.0, 1.0, 0.0, 0.0, 0.0, 0.0], 4)}
POINTS = 1 << 13


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, variant):
    monkeypatch.chdir(tmp_path)


def solve(patches=None, **options):
    return etendue.solve_radiosity(cube(2, **LIT) if patches is None else patches, "multipath", **options)


def lamp_in_a_room():
    vertices, faces = joined(
        box((0, 0, 0), (1, 1, 1), 2, inward=True), square((0.5, 0.5, 0.9), (0, 0.05, 0), (0.05, 0, 0))
    )
    emission = np.where(np.arange(len(faces)) == len(faces) - 1, 100.0, 0.0)
    return vertices, faces, emission


def test_it_comes_to_the_solution_of_the_system():
    """Of 16 seeds, within their scatter; the estimated error is an upper estimate of it."""
    exact = etendue.solve_radiosity(cube(2, **LIT), "direct", bundles=1024).solution.irradiance
    runs = [solve(points=POINTS, seed=seed, shot=seed % 2 == 0) for seed in range(16)]
    assert {run.points for run in runs} == {POINTS} and runs[0].stopped_by == "samples"
    found = np.array([run.solution.irradiance for run in runs])
    error = found.std(axis=0, ddof=1) / 4
    assert np.abs((found.mean(axis=0) - exact) / error).max() < 4.5
    assert found.std(axis=0, ddof=1).mean() < 1.3 * np.mean([run.irradiance_error for run in runs])
    power = runs[0].solution.power
    assert power["emitted"] == pytest.approx(4 * runs[0].patches.areas[4], rel=1e-9)
    assert runs[0].solution.imbalance < 0.02 and runs[0].segments is None and runs[0].bundles == 0


def scattered(points=None, generator=None):
    """(irradiance of 16 seeds, that of the system)"""
    exact = solve_system(cube(2, **LIT), exact_form_factors(cube(2, **LIT)), "direct").irradiance
    asked = {"points": 1 << 12, "shot": False, "point_set": points, "generator": generator}
    return np.array([solve(seed=seed, **asked).solution.irradiance for seed in range(16)]), exact


@pytest.mark.parametrize("generator", ["sphere-pairs", "box-walls", "great-circle"])
def test_lines_of_all_generators_come_to_the_solution_of_the_system(generator):
    found, exact = scattered("independent", generator)
    assert np.abs((found.mean(axis=0) - exact) / (found.std(axis=0, ddof=1) / 4)).max() < 4.5


def test_sequences_have_less_error():
    """The squared errors are 0.34, 0.41 and 0.57 of those of independent lines."""
    errors = {}
    for points in ("independent", "sobol", "halton", "weyl"):
        found, exact = scattered(points)
        errors[points] = ((found - exact) ** 2).mean()
    assert max(errors["sobol"], errors["halton"]) < 0.6 * errors["independent"]
    assert errors["weyl"] < 0.8 * errors["independent"]


def test_what_no_name_is_given_of():
    found = [solve(points=1 << 10, **asked).solution.radiosity for asked in ({}, {"point_set": "sobol"})]
    other = solve(points=1 << 10, generator="box-walls").solution.radiosity
    np.testing.assert_array_equal(*found)
    assert not np.array_equal(other, found[0])


def test_a_first_shot_and_the_files():
    vertices, faces, emission = lamp_in_a_room()
    patches = Patches(vertices, faces, reflectance=0.5, emission=emission)
    files = [Path("s.npz"), Path("s.nc"), Path("s.vtu")]
    result = solve(patches, points=POINTS, save=files)
    assert result.shot is not None and (without := solve(patches, points=POINTS, shot=False)).shot is None
    assert without.irradiance_error.sum() > 3 * result.irradiance_error.sum()
    for path in files[:2]:
        read, error = read_solution(path)
        np.testing.assert_allclose(read.radiosity, result.solution.radiosity)
        np.testing.assert_allclose(error, result.irradiance_error)
        assert read.residual == result.solution.residual < 0.01
    assert files[2].exists()
    light = (patches.areas[:, None] * (1 - patches.reflectance) * result.solution.irradiance).sum()
    assert light == pytest.approx((patches.areas * emission).sum(), rel=0.02)


def test_an_error_ends_the_run():
    result = solve(error=0.02)
    assert result.stopped_by == "error"
    areas = result.patches.areas[:, None]
    assert (areas * result.irradiance_error).sum() < 0.02 * (areas * result.solution.irradiance).sum()


def test_a_callback_stops_and_a_checkpoint_goes_on():
    whole = solve(points=POINTS, seed=2)
    half = solve(points=POINTS, seed=2, callback=lambda progress: progress.samples < POINTS // 4, checkpoint="c")
    assert (half.points, half.stopped_by) == (POINTS // 4, "cancel")
    assert not Path("c.records").exists()
    rest = solve(seed=2, resume="c")
    assert rest.points == POINTS
    np.testing.assert_array_equal(rest.solution.radiosity, whole.solution.radiosity)
    np.testing.assert_array_equal(rest.irradiance_error, whole.irradiance_error)
    for options, text in (
        ({"shot": False}, "begun with shot=True"),
        ({"seed": 3}, "made with seed 2"),
        ({"point_set": "halton"}, "points was sobol, is halton"),
        ({"points": POINTS // 8}, "more than"),
        ({"patches": cube(1, reflectance=0.5, emission=1.0), "points": POINTS}, "the scene is not the one"),
    ):
        with pytest.raises(CheckpointError, match=text):
            solve(**{"seed": 2, "resume": "c"} | options)
    with pytest.raises(CheckpointError, match="made by method 'multipath', not 'global-lines'"):
        etendue.solve_radiosity(cube(2, **LIT), seed=2, resume="c", bundles=16)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"bundles": 16}, "multipath casts single lines, not bundles: give points="),
        ({"lines": 100.0}, "leave out lines=, the lines of a bundle"),
        ({"local_rays": False}, "multipath casts no local rays: leave out local_rays="),
        ({"points": 0}, "a budget in points must be a whole number of at least 1"),
        ({"solver": "jacobi", "points": 16}, "points= is for multipath; limit jacobi by bundles="),
        ({"solver": "jacobi", "point_set": "halton"}, "point_set= is for multipath: give solver= multipath"),
        ({"point_set": "hallton"}, "there is no point set 'hallton'; did you mean 'halton'"),
        ({"generator": "bundles"}, "there is no generator 'bundles'; there are: sphere-pairs"),
        ({"solver": None, "hierarchy": {"points": "weyl"}, "point_set": "halton"}, "'weyl' and 'halton': give one"),
    ],
)
def test_options_that_do_not_belong_together(options, text):
    with pytest.raises(OptionError, match=text):
        etendue.solve_radiosity(cube(2, **LIT), **{"solver": "multipath"} | options)
    assert not list(Path().iterdir())


def test_a_first_shot_that_cannot_reach_the_error(monkeypatch):
    monkeypatch.setattr("etendue.jobs.multipath._MOST_SHOT_RAYS", 1 << 17)
    vertices, faces, emission = lamp_in_a_room()
    patches = Patches(vertices, faces, reflectance=0.5, emission=emission)
    with pytest.raises(RadiosityError, match=r"has a standard error of .*: ask for an error= above .* \(shot=\)"):
        solve(patches, error=1e-7)


def test_faces_on_each_other_are_told(caplog):
    """Lines meet one of two faces that face the same way, such as a carpet on the floor. Of a box that stands on the
    floor, with a bottom, they meet both."""
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), inward=True), square((0.2, 0.2, 0), (0.6, 0, 0), (0, 0.6, 0)))
    solve(Patches(vertices, faces, reflectance=0.5, emission=np.eye(7)[5]), points=1 << 14)
    assert any("faces lie on each other" in message for message in caplog.messages)
    caplog.clear()
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), inward=True), box((0.2, 0.2, 0), (0.8, 0.8, 0.3)))
    solve(Patches(vertices, faces, reflectance=0.5, emission=np.eye(12)[5]), points=1 << 14)
    solve(points=1 << 14)
    assert not caplog.messages


# ------------------------------------------------------------------ the command line


def run(command):
    return main(shlex.split(command))


def write_room():
    vertices, faces, emission = lamp_in_a_room()
    meshio.write("room.vtu", meshio.Mesh(vertices, [("quad", faces)], cell_data={"glow": [emission]}))


def arrays_of(name):
    with np.load(name) as saved:
        known = {key: saved[key] for key in saved.files}
    return known, json.loads(str(known.pop("metadata")))


ROOM = "radiosity room.vtu --emission glow --reflectance 0.5 --solver multipath"


def test_a_stopped_run_keeps_its_work_and_resumes_to_the_same(monkeypatch, capsys):
    write_room()
    assert run(f"{ROOM} -o whole.npz --points {POINTS} --seed 5") == 0
    err = capsys.readouterr().err
    assert f"multipath: {POINTS} lines, " in err and "the light of one emitter was sent by" in err
    step = MultipathPasses.step

    def interrupted(self, iteration, seed, state):
        if iteration == 5:
            passes.press_ctrl_c()
        return step(self, iteration, seed, state)

    with monkeypatch.context() as patch:
        patch.setattr(MultipathPasses, "step", interrupted)
        assert run(f"{ROOM} -o part.npz --points {POINTS} --seed 5 --checkpoint c") == 130
    assert 0 < arrays_of("part.npz")[1]["points"] < POINTS
    assert run("resume c") == 0
    (resumed, known), (whole, same) = arrays_of("part.npz"), arrays_of("whole.npz")
    assert known["points"] == same["points"] == POINTS and known["solver"] == "multipath"
    for name, array in whole.items():
        np.testing.assert_array_equal(resumed[name], array, err_msg=name)
    capsys.readouterr()
    assert run(f"resume c --points {2 * POINTS}") == 0
    assert arrays_of("part.npz")[1]["points"] == 2 * POINTS
    for arguments, message in (
        ("", "used up; give a new one with --points, --time or --error"),
        ("--bundles 64", "multipath casts single lines, not bundles: give --points"),
        ("--spp 4", "--spp, -m and -D do not apply"),
    ):
        capsys.readouterr()
        assert run(f"resume c {arguments}") > 0
        assert message in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (f"{ROOM} --bundles 16", "multipath casts single lines, not bundles: give --points"),
        (f"{ROOM} --no-local-rays", "multipath casts no local rays: leave out --no-local-rays"),
        (f"{ROOM} --lines 100", "multipath casts single lines: leave out --lines, the lines of a bundle"),
        (f"{ROOM} --point-set hallton", "there is no point set 'hallton'; did you mean 'halton'"),
        (
            "radiosity room.vtu --emission glow --hierarchy --generator bundles",
            "there is no generator 'bundles'; there are: sphere-pairs",
        ),
        ("radiosity room.vtu --emission glow --generator box-walls", "--generator is for multipath: give --solver"),
        ("radiosity room.vtu --emission glow --hierarchy --lines 9", "give the lines of a pass as a setting, lines=N"),
        (
            "radiosity room.vtu --emission glow --ambient --lines 9",
            "an ambient solution needs no lines: leave out --lines",
        ),
        ("radiosity room.vtu --emission glow --points 16", "--points is for multipath; limit conjugate-gradient by"),
    ],
)
def test_refusals_of_the_command_line(command, message, capsys):
    write_room()
    assert run(command) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]
    assert {path.name for path in Path().iterdir()} == {"room.vtu"}


def test_a_checkpoint_of_bundles_takes_no_points(capsys):
    write_room()
    assert run("form-factors room.vtu --bundles 8 --checkpoint c") == 0
    capsys.readouterr()
    assert run("resume c --points 64") == 2
    assert "has bundles of lines: give --bundles in place of --points" in capsys.readouterr().err


def test_progress_in_words():
    from etendue.jobs import RadiosityRequest

    work = MultipathWork(RadiosityRequest(source=cube(2, **LIT), solver="multipath"))
    told = [work.progress_text(Progress(passes=1, samples=n, rays=5.0, elapsed=1.0)) for n in (1, 64)]
    assert told == ["1 line, 5 segments", "64 lines, 5 segments"]
