"""`etendue particles`: from a scene to a file, what is in it, packing anew, going on, and wrong arguments."""

from __future__ import annotations

import json
import shlex

import numpy as np
import pytest
from support.run_files import SCENE

import etendue
from etendue.cli.main import main
from etendue.particles import ParticleFile


def run(command: str) -> int:
    return main(shlex.split(command))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, variant):
    path = tmp_path_factory.mktemp("particles")
    (path / "scene.xml").write_text(SCENE)
    etendue.trace_particles(path / "scene.xml", paths=3000, save=path / "a.particles", samples_per_pass=1000)
    return path


@pytest.fixture(autouse=True)
def inside(folder, monkeypatch):
    monkeypatch.chdir(folder)


def test_trace_info_compress_and_resume(folder, capsys):
    command = "particles trace scene.xml -o new.particles --paths 2000 --keep first --after 1 -D rr_depth=3 --seed 4"
    assert run(command) == 0
    said = capsys.readouterr()
    assert said.out == "new.particles\n" and "light paths" in said.err
    known = ParticleFile("new.particles")
    settings = json.loads(known.header["settings"])
    assert (settings["keep"], settings["after"], settings["rr_depth"], known.header["seed"]) == ("first", 1, 3, 4)
    assert known.read().bounce.min() > 1

    assert run("info new.particles") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"{len(known)} of 2000 light paths in 1 pass; finished" in shown and "keep first" in shown
    assert run("info new.particles --json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["particles"] == len(known) == sum(shape["particles"] for shape in found["shapes"])
    assert found["codec"] == "packed+fast" and found["bounds"] == known.bounds

    assert run("particles compress new.particles -o exact.particles --codec exact+bz2") == 0
    assert "by exact+bz2" in capsys.readouterr().err
    one, two = (etendue.read_particles(name) for name in ("new.particles", "exact.particles"))
    np.testing.assert_array_equal(np.sort(one.position[:, 0]), np.sort(two.position[:, 0]))

    assert run("resume new.particles --paths 3000") == 0
    assert ParticleFile("new.particles").paths >= 3000
    assert run("particles trace scene.xml -o time.particles --time 0.3 --codec raw") == 0
    assert len(ParticleFile("time.particles")) > 0


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("particles trace scene.xml", "Missing option '-o'"),
        ("particles trace nowhere.xml -o b.particles", "there is no scene file 'nowhere.xml'"),
        ("particles trace scene.xml -o a.particles", "'a.particles' exists: choose another name"),
        ("particles trace scene.xml -o b.particles --keep last", "'keep' must be one of all, first, absorbed"),
        ("particles trace scene.xml -o b.particles --keep all -D keep=all", "gives 'keep' twice; give it once"),
        (
            "particles trace scene.xml -o b.particles --paths 10 --particles 10",
            "--paths and --particles limit the same",
        ),
        ("particles trace scene.xml -o b.particles --paths 0", "Invalid value for '--paths'"),
        ("particles trace scene.xml -o b.particles --time 0", "--time must be above 0"),
        ("particles trace scene.xml -o b.particles --codec packt", "there is no codec 'packt'; did you mean 'packed'"),
        ("particles trace scene.xml -o none/b.particles", "there is no folder 'none'"),
        ("particles trace scene.xml -o b.particles -D size=3", "has no option 'size'"),
        ("particles compress a.particles -o a.particles", "'a.particles' exists"),
        ("resume a.particles --spp 3", "method 'particles' counts paths: give paths in place of spp"),
        ("resume a.particles", "the budget of the checkpoint is used up; give a new one"),
        ("resume a.particles --paths 9000 --particles 9000", "paths and particles limit the same"),
        ("resume a.particles --paths 9000 -o b.particles", "is continued in place: leave out other outputs"),
        ("resume scene.xml --paths 3", "scene.xml is not an étendue checkpoint"),
    ],
)
def test_wrong_arguments_are_one_line(command, message, capsys, folder):
    before = (folder / "a.particles").read_bytes()
    assert run(command) != 0
    said = capsys.readouterr().err
    assert message in " ".join(said.split()) and said.count("error:") == 1
    assert said.strip().count("\n") == 0 or "Usage" in said
    assert (folder / "a.particles").read_bytes() == before
    assert not (folder / "b.particles").exists()
