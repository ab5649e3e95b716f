"""Solutions by multipath: budgets, checkpoints, outputs, the first shot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.patches import box, cube, joined, square

import etendue
from etendue.core import CheckpointError, OptionError
from etendue.products.patches import solutions
from etendue.radiosity import Patches, RadiosityError, exact_form_factors, read_solution, solve as solve_system

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
    exact = etendue.solve_radiosity(cube(2, **LIT), solver="direct", bundles=1024).solution.irradiance
    runs = [solve(points=POINTS, seed=seed, **({"shot": 0} if seed % 2 else {})) for seed in range(16)]
    assert {run.points for run in runs} == {POINTS} and runs[0].stopped_by == "samples"
    found = np.array([run.solution.irradiance for run in runs])
    error = found.std(axis=0, ddof=1) / 4
    assert np.abs((found.mean(axis=0) - exact) / error).max() < 4.5
    assert found.std(axis=0, ddof=1).mean() < 1.3 * np.mean([run.irradiance_error for run in runs])
    power = runs[0].solution.power
    assert power["emitted"] == pytest.approx(4 * runs[0].patches.areas[4], rel=1e-9)
    assert runs[0].solution.imbalance < 0.02 and runs[0].segments is None and runs[0].bundles == 0


def scattered(points, **generator):
    """(irradiance of 16 seeds, that of the system)"""
    exact = solve_system(cube(2, **LIT), exact_form_factors(cube(2, **LIT)), "direct").irradiance
    asked = {"points": 1 << 12, "shot": 0, "point_set": points, **generator}
    return np.array([solve(seed=seed, **asked).solution.irradiance for seed in range(16)]), exact


@pytest.mark.parametrize("generator", ["sphere-pairs", "box-walls", "great-circle"])
def test_lines_of_all_generators_come_to_the_solution_of_the_system(generator):
    found, exact = scattered("independent", generator=generator)
    assert np.abs((found.mean(axis=0) - exact) / (found.std(axis=0, ddof=1) / 4)).max() < 4.5


def test_sequences_have_less_error():
    """The squared errors are 0.34, 0.41 and 0.57 of those of independent lines."""
    errors = {}
    for points in ("independent", "sobol", "halton", "weyl"):
        found, exact = scattered(points)
        errors[points] = ((found - exact) ** 2).mean()
    assert max(errors["sobol"], errors["halton"]) < 0.6 * errors["independent"]
    assert errors["weyl"] < 0.8 * errors["independent"]


def test_a_first_shot_and_the_files():
    vertices, faces, emission = lamp_in_a_room()
    patches = Patches(vertices, faces, reflectance=0.5, emission=emission)
    files = [Path("s.npz"), Path("s.nc"), Path("s.vtu")]
    result = solve(patches, points=POINTS, save=files)
    assert result.shot is not None and (without := solve(patches, points=POINTS, shot=0)).shot is None
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
    half = solve(points=POINTS, seed=2, callback=lambda update: update.progress.samples < POINTS // 4, checkpoint="c")
    assert (half.points, half.stopped_by) == (POINTS // 4, "cancel")
    assert not Path("c.records").exists()
    rest = etendue.resume("c", scene=cube(2, **LIT))
    assert rest.points == POINTS
    np.testing.assert_array_equal(rest.solution.radiosity, whole.solution.radiosity)
    np.testing.assert_array_equal(rest.irradiance_error, whole.irradiance_error)
    with pytest.raises(CheckpointError, match="the scene is not the one"):
        etendue.resume("c", scene=cube(1, reflectance=0.5, emission=1.0), points=2 * POINTS)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"lines": 100.0}, "method 'multipath' has no option 'lines'"),
        ({"local_rays": False}, "method 'multipath' has no option 'local_rays'"),
        ({"point_set": "hallton"}, "'point_set' must be one of sobol, halton, weyl, independent"),
        ({"generator": "bundles"}, "'generator' must be one of sphere-pairs, box-walls, great-circle"),
        ({"method": "lines", "point_set": "halton"}, "method 'lines' has no option 'point_set'"),
    ],
)
def test_options_that_do_not_belong_together(options, text):
    with pytest.raises(OptionError, match=text):
        etendue.solve_radiosity(cube(2, **LIT), **{"method": "multipath"} | options)


def test_a_first_shot_that_cannot_reach_the_error(monkeypatch):
    monkeypatch.setattr(solutions, "_MOST_SHOT_RAYS", 1 << 17)
    vertices, faces, emission = lamp_in_a_room()
    patches = Patches(vertices, faces, reflectance=0.5, emission=emission)
    with pytest.raises(
        RadiosityError, match=r"has a standard error of .*: ask for an error above .* or with none \(shot=0\)"
    ):
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
