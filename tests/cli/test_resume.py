"""One resume for every kind of run, by the command and from Python: half a run and the rest are the whole."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support.patches import box, joined
from support.tables import thinned

import etendue
from etendue import film
from etendue.cli.main import main
from etendue.core import CheckpointError, OptionError
from etendue.particles import ParticleFile
from etendue.products.particles import ParticleResult

meshio = pytest.importorskip("meshio")


@dataclass(frozen=True)
class Kind:
    """A command, the limit of its method, and a number of it; the suffix of the file, and the class of the result."""

    command: str
    limit: str
    count: int
    result: type = etendue.RadiosityResult
    suffix: str = "npz"

    def run(self, count: int, name: str) -> int:
        checkpoint = "" if self.suffix == "particles" else f"--checkpoint {name}.checkpoint"
        return run(f"{self.command} --{self.limit} {count} -o {name}.{self.suffix} {checkpoint}")

    @property
    def checkpoint(self) -> str:
        return "a.particles" if self.suffix == "particles" else "a.checkpoint"


MESH = "hall.vtu --emission glow --reflectance 0.5 --seed 3"
TRACE = "particles trace cornell-box --seed 3"
KINDS = {
    "picture": Kind(
        "render cornell-box -m path --size 12x8 --seed 3 --samples-per-pass 2", "spp", 2, etendue.Rendering, "exr"
    ),
    "readings": Kind(
        "measure cornell-box --grid '-0.5,0.2,0.5 1,0,0 0,0,-1' --cells 3x2 --samples-per-pass 2 --photometric",
        "spp",
        4,
        etendue.Readings,
        "csv",
    ),
    "lines": Kind("form-factors hall.vtu --estimator reciprocal --seed 3", "bundles", 8, etendue.FormFactorResult),
    "spheres": Kind(
        "form-factors hall.vtu -m spheres --objects thing --seed 3", "bundles", 16, etendue.FormFactorResult
    ),
    "replicates": Kind(f"radiosity {MESH} --replicates 4", "bundles", 32),
    "solution": Kind(f"radiosity {MESH} --solver jacobi --ambient fuzzy --bounces 3", "bundles", 8),
    "multipath": Kind(f"radiosity {MESH} -m multipath --points-per-pass 512 --shot 4096", "points", 2048),
    "boxes": Kind(f"radiosity {MESH} -m boxes --objects thing --least 4 --threshold 2 --grid 2", "passes", 1),
    "particles": Kind(f"{TRACE} --samples-per-pass 500", "paths", 500, ParticleResult, "particles"),
    "chains": Kind(
        f"{TRACE} -m metropolis_particles --chains 64 --steps 8 --bootstrap 1024",
        "paths",
        512,
        ParticleResult,
        "particles",
    ),
}


def run(command: str) -> int:
    return main(shlex.split(command))


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """A mesh of a hall with two boxes, which the array ``thing`` numbers; a wall glows."""
    path = tmp_path_factory.mktemp("hall") / "hall.vtu"
    mesh = joined(box((0, 0, 0), (1, 1, 1), 2, inward=True), box((0.2,) * 3, (0.4,) * 3), box((0.6,) * 3, (0.8,) * 3))
    arrays = {"thing": [np.repeat([-1, 4, 5], [24, 6, 6])], "glow": [np.eye(36)[5]]}
    meshio.write(path, meshio.Mesh(mesh[0], [("quad", mesh[1])], cell_data=arrays))
    return path


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, hall, variant):
    monkeypatch.chdir(tmp_path)
    shutil.copy(hall, tmp_path)
    return tmp_path


def arrays_of(file: str) -> dict[str, np.ndarray]:
    """What a file has, without how it was made."""
    if file.endswith(".exr"):
        return film.read_exr(file).layers
    if file.endswith(".csv"):
        return {"table": np.loadtxt(file, delimiter=",", skiprows=1)}
    if file.endswith(".particles"):
        found = ParticleFile(file).read()
        return {name: getattr(found, name) for name in ("position", "power", "shape", "path", "bounce")}
    with np.load(file) as saved:
        return {name: saved[name] for name in saved.files if name != "metadata"}


@pytest.mark.parametrize("name", thinned(KINDS, [name for name in KINDS if name != "chains"]))
def test_runs_of_every_kind_go_on(name, capsys):
    """Resumed by the command, and again from Python, a run has the numbers of an uninterrupted one."""
    kind = KINDS[name]
    assert kind.run(4 * kind.count, "whole") == 0 and kind.run(kind.count, "a") == 0
    file = f"a.{kind.suffix}"
    capsys.readouterr()
    assert run(f"resume {kind.checkpoint}") == 4
    assert "the budget of the checkpoint is used up; give a new one" in capsys.readouterr().err
    for wrong in ("points", "paths"):
        if wrong != kind.limit:
            assert run(f"resume {kind.checkpoint} --{wrong} 9") == 2
            assert f"counts {kind.limit}: give {kind.limit} in place of {wrong}" in capsys.readouterr().err

    assert run(f"resume {kind.checkpoint} --{kind.limit} {2 * kind.count}") == 0
    assert next(Path(line).name for line in capsys.readouterr().out.split()) == file
    seen: list[int] = []
    result = etendue.resume(
        kind.checkpoint,
        **{kind.limit: 4 * kind.count},
        save=file if kind.suffix == "exr" else (),
        callback=lambda update: seen.append(update.progress.passes),
    )
    assert isinstance(result, kind.result) and seen and seen == list(range(seen[0], seen[-1] + 1))
    same_arrays(file, f"whole.{kind.suffix}")


def same_arrays(one: str, other: str) -> None:
    found, expected = arrays_of(one), arrays_of(other)
    assert found.keys() == expected.keys()
    for name, array in found.items():
        np.testing.assert_array_equal(array, expected[name], err_msg=name)


def test_the_files_of_a_run_on_patches_or_others_are_written(capsys):
    kind = KINDS["boxes"]
    assert kind.run(1, "a") == 0
    before = Path("a.npz").read_bytes()
    result = etendue.resume("a.checkpoint", passes=2, save=["b.npz", "b.vtu"])
    assert result.passes == 2 and Path("a.npz").read_bytes() == before and Path("b.vtu").is_file()
    half = Path("b.npz").read_bytes()
    etendue.resume("a.checkpoint", passes=3)  # those of the run before
    assert Path("a.npz").read_bytes() == before and Path("b.npz").read_bytes() != half
    with pytest.raises(OptionError, match=r"take \.npz"):
        etendue.resume("a.checkpoint", passes=4, save="c.exe")


def test_a_scene_that_has_moved_or_changed(capsys):
    kind = KINDS["solution"]
    assert kind.run(16, "whole") == 0 and kind.run(8, "a") == 0
    Path("hall.vtu").rename("moved.vtu")
    assert run("resume a.checkpoint --bundles 16") == 4
    assert "hall.vtu" in capsys.readouterr().err
    assert run("resume a.checkpoint --bundles 16 --scene moved.vtu") == 0
    same_arrays("a.npz", "whole.npz")
    assert etendue.resume("a.checkpoint", bundles=24).bundles == 24  # it remembers where the scene is now
    mesh = meshio.read("moved.vtu")
    mesh.points[0] += 0.1
    mesh.write("moved.vtu")
    with pytest.raises(CheckpointError, match="the scene is not the one"):
        etendue.resume("a.checkpoint", bundles=32)
