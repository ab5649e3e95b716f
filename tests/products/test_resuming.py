"""Checkpoints that étendue 1 has written, and files that are no run. (``version1`` was made by its commands, such as
``etendue radiosity hall.vtu --hierarchy``; ``expected.npz`` has what its own ``etendue resume`` made of them.)"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import etendue
from etendue.core import CheckpointError, OptionError
from etendue.engine import Checkpoint
from etendue.film import read_exr
from etendue.products import saved_task
from etendue.radiosity import read_solution

VERSION_1 = Path(__file__).parent / "version1"
#: By name: limit of the method and its number, its present name, and a setting with its present name.
RUNS = {
    "picture": ("spp", 4, "path", ("samples_per_pass", 2)),
    "lines": ("bundles", 8, "lines", ("lines", 12.0)),
    "spheres": ("bundles", 8, "spheres", ("point_set", "halton")),
    "solution": ("bundles", 8, "lines", ("shot", True)),
    "multipath": ("points", 512, "multipath", ("point_set", "halton")),
    "boxes": ("passes", 2, "boxes", ("grid", 2)),
}


@pytest.fixture
def folder(tmp_path):
    return Path(shutil.copytree(VERSION_1, tmp_path / "runs"))


@pytest.mark.parametrize("name", RUNS)
def test_a_run_of_version_1_goes_on_to_the_same(name, folder, variant):
    limit, count, method, (setting, value) = RUNS[name]
    scene = folder / ("ball.xml" if name == "picture" else "hall.vtu")
    saved, file = folder / f"{name}.checkpoint", folder / ("a.exr" if name == "picture" else "a.npz")
    if name == "picture":
        found = etendue.resume(saved, scene=scene, **{limit: count}, save=file).image
        np.testing.assert_allclose(read_exr(file).image, found, rtol=1e-3)
    elif isinstance(result := etendue.resume(saved, scene=scene, **{limit: count}, save=file), etendue.RadiosityResult):
        found = result.solution.radiosity
        np.testing.assert_array_equal(read_solution(file)[0].radiosity, found)
    else:
        found = result.factors.matrix.toarray()
    with np.load(VERSION_1 / "expected.npz") as expected:
        rounding = 1e-6 if variant.startswith("llvm") else 1e-3  # a GPU's is not that of the CPU that wrote them
        np.testing.assert_allclose(found, expected[name], rtol=rounding, atol=1e-9)
    written = Checkpoint.read(saved)  # by this version, which goes on with it by itself
    assert written.method == method and "lines" not in written.notes
    assert written.settings_of(etendue.products.find(method)).to_dict()[setting] == value
    task, _ = saved_task(saved, limits={limit: 2 * count})
    assert Path(task.source.place()["source"]) == scene


def test_a_solution_of_version_1_ends_as_it_was_asked_for(folder):
    own = {"scene": folder / "hall.vtu", "save": folder / "solution.npz"}  # its folder may be gone
    task, _ = saved_task(folder / "solution.checkpoint", limits={"bundles": 8}, **own)
    assert (task.product.chosen_solver, task.product.ambient, task.product.bounces) == ("jacobi", "fuzzy", 3)
    assert [path.name for path in task.product.outputs.files] == ["solution.npz"]
    task, _ = saved_task(folder / "boxes.checkpoint", limits={"passes": 2}, **own)
    assert (task.source.objects, task.source.groups) == ("thing", {"threshold": 2.0, "least": "4"})


@pytest.mark.parametrize(
    "notes",
    [
        {"lines": {"work": "form-factors"}},
        {"lines": {"work": "radiosity", "source": "a", "outputs": {"files": [], "colour": 1}}},
        {"product": {"kind": "solution"}},
        {"product": {"kind": "form factors", "estimator": "F1"}},
    ],
)
def test_notes_that_are_no_request(notes, folder):
    path = folder / "lines.checkpoint"
    saved = Checkpoint.read(path)
    saved.notes = notes
    saved.write(path)
    with pytest.raises(CheckpointError, match="does not contain its request"):
        saved_task(path, scene=folder / "hall.vtu")


def test_limits_and_outputs_that_a_run_does_not_have(folder):
    with pytest.raises(OptionError, match="is no file of particles: a number of particles does not apply"):
        saved_task(folder / "lines.checkpoint", limits={"particles": 5})
    etendue.trace_particles("cornell-box", paths=100, save=folder / "a.particles")
    with pytest.raises(OptionError, match="is continued in place: leave out other outputs"):
        saved_task(folder / "a.particles", limits={"paths": 200}, save="b.particles")
    for name, limits in (("picture", {"bundles": 4}), ("lines", {"passes": 4}), ("boxes", {"bundles": 4})):
        limit = RUNS[name][0]
        with pytest.raises(OptionError, match=f"counts {limit}: give {limit} in place of {next(iter(limits))}"):
            saved_task(folder / f"{name}.checkpoint", scene=folder / "hall.vtu", limits=limits)
