"""`etendue info`, `etendue diff` and the files that commands print: what is in a file, and how pictures differ."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import etendue
from etendue import film
from etendue.cli.experiments.run_file import TABLES
from etendue.cli.main import main


def run(command: str) -> int:
    return main(shlex.split(command))


@pytest.fixture(scope="module")
def made(tmp_path_factory, variant):
    """A file of each kind."""
    folder = tmp_path_factory.mktemp("files")
    options = {"spp": 2, "size": (16, 12), "seed": 3}
    files = [folder / "a.exr", folder / "a.png"]
    etendue.render("cornell-box", "path", save=files, checkpoint=folder / "a.checkpoint", aovs=True, **options)
    options["seed"] = 4
    etendue.render("cornell-box", "path", save=folder / "b.exr", **options)
    etendue.trace_particles("cornell-box", paths=1000, save=folder / "a.particles", samples_per_pass=500)
    etendue.solve_radiosity("cornell-box", bundles=8, save=folder / "s.npz", checkpoint=folder / "s.checkpoint")
    etendue.compute_form_factors("cornell-box", bundles=8, estimator="F2", save=folder / "f.npz")
    (folder / "text").write_text("no file of étendue")
    return folder


@pytest.fixture(autouse=True)
def inside(made, monkeypatch):
    monkeypatch.chdir(made)


@pytest.mark.parametrize(
    ("file", "words", "known"),
    [
        ("a.exr", ["picture 16 x 12", "albedo", "depth (1)", "method path", "seed 3"], {"samples": 2, "seed": 3}),
        ("a.png", ["picture 16 x 12"], {"picture": "16 x 12"}),
        ("a.checkpoint", ["of method path, 1 pass", "scene cornell-box", "budget spp 2"], {"stopped_by": "samples"}),
        ("s.checkpoint", ["of method lines, 1 pass", "shot true", "budget bundles 8"], {"seed": 0}),
        ("s.npz", ["source cornell-box", "solver conjugate-gradient", "radiosity 30 x 3"], {"bundles": 8}),
        ("f.npz", ["source cornell-box", "estimator F2"], {"bundles": 8, "estimator": "F2"}),
        (
            "a.particles",
            ["of 1000 light paths in 2 passes; finished", "samples_per_pass 500"],
            {"codec": "packed+fast"},
        ),
    ],
)
def test_what_is_in_a_file(file, words, known, capsys):
    assert run(f"info {file}") == 0
    shown = " ".join(capsys.readouterr().out.split())
    for text in words:
        assert text in shown
    assert run(f"info {file} --json") == 0
    assert known.items() <= json.loads(capsys.readouterr().out).items()


@pytest.mark.parametrize(("file", "message"), [("nope", "there is no file 'nope'"), ("text", "'text' is no picture")])
def test_what_is_no_file_of_a_run(file, message, capsys):
    assert run(f"info {file}") == 2
    assert message in capsys.readouterr().err


def test_the_difference_of_pictures(tmp_path, capsys):
    one, other = film.read_image("a.exr"), film.read_image("b.exr")
    error = film.relative_mse(one, other)
    picture = tmp_path / "d.png"
    assert run(f"diff a.exr b.exr -o {picture} --limit {error * 0.99}") == 1
    *rows, path = capsys.readouterr().out.splitlines()
    found = {re.split(r"  +", row)[0]: float(re.split(r"  +", row)[1].split()[0]) for row in rows}
    assert path == str(picture) and film.read_image(picture).shape == (12, 16, 3)
    assert found["relMSE"] == pytest.approx(error, rel=1e-3)
    assert found["RMS of luminance"] == pytest.approx(film.luminance_rmse(one, other), rel=1e-3)
    assert found["bias of the mean"] == pytest.approx(film.relative_bias(one, other), rel=1e-2)
    assert found["largest difference"] == pytest.approx(np.abs(one - other).max(), rel=1e-3)
    assert run(f"diff a.exr b.exr --limit {error * 1.01}") == run("diff a.exr a.exr --limit 0") == 0


def test_pictures_that_cannot_be_compared(tmp_path, capsys):
    film.write_exr(tmp_path / "small.exr", etendue.core.Result({"image": np.ones((8, 8, 3), np.float32)}))
    for words, message in (
        (f"a.exr {tmp_path / 'small.exr'}", "the reference 8 x 8"),
        ("a.exr nope.exr", "there is no picture 'nope.exr'"),
        ("a.exr b.exr -o d.exr", "is a .png, not 'd.exr'"),
    ):
        capsys.readouterr()
        assert run(f"diff {words}") in (2, 3)
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line


@pytest.mark.parametrize("name", ["caustics", "stage"])
def test_a_bundled_scene_as_xml(name, tmp_path, monkeypatch, capsys):
    """It may be moved with its files; Mitsuba reads it, and the pictures are the same."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path)
    assert run(f"scenes {name} -o here/room.xml") == 0
    assert capsys.readouterr().out == "here/room.xml\n"
    Path("here").rename("there")
    options = {"spp": 1, "size": (12, 8)}
    own = etendue.render("there/room.xml", "path", **options)
    np.testing.assert_allclose(own.image, etendue.render(name, "path", **options).image, rtol=1e-4, atol=1e-6)
    assert mi.load_file("there/room.xml").shapes()


@pytest.mark.parametrize("words", ["scenes nope", "scenes caustics -o a.txt", "scenes -o a.xml"])
def test_scenes_that_cannot_be_written(words, capsys):
    assert run(words) in (2, 3)
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_example_of_a_run_file_has_all_keys_and_is_valid(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("run --example") == 0
    text = capsys.readouterr().out
    Path("a.toml").write_text(text)
    assert run("run a.toml --check") == 0 and "is in order: " in capsys.readouterr().out
    assert run("run") == 2
    tables = re.split(r"^(?:# )?\[(\w+)\]", text, flags=re.MULTILINE)
    for name, part in zip(("", *tables[1::2]), tables[::2], strict=True):
        for key in set(TABLES[name]) - {"samples"}:  # the name of spp in version 1
            assert re.search(rf"(^|[# ]){key} = |\[{name}\.{key}\]", part, re.MULTILINE), f"{key} of [{name}]"
    assert tomllib.loads(text).keys() <= TABLES.keys() | TABLES[""].keys()


def test_quiet_prints_paths_and_warnings_only(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("--quiet render cornell-box -m path --size 8x8 --spp 1 -o a.exr") == 0
    said = capsys.readouterr()
    assert said.out == "a.exr\na.checkpoint\n" and said.err == ""
    assert run("-q radiosity cornell-box --bundles 8 -o s.npz") == 0
    said = capsys.readouterr()
    assert said.out == "s.npz\n" and all(line.startswith("warning: ") for line in said.err.splitlines())
    assert run("-q render cornell-box -m path --size 0x8") == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert run("render cornell-box -m path --size 8x8 --spp 1 -o a.exr") == 0
    assert "1 spp" in capsys.readouterr().err
