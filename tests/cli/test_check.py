"""`etendue check`: the table, JSON, the exit status."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
from support.run_files import SCENE

from etendue.cli.main import main
from etendue.radiosity import box, diagnose, orientation, read_patches
from etendue.surfaces import save_patches


def run(command: str) -> int:
    return main(shlex.split(command))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")
    (tmp_path / "scene.xml").write_text(SCENE)
    flakes = '<phase type="sggx"><volume name="S" type="constvolume"><float name="value" value="1"/></volume></phase>'
    medium = f'<medium type="homogeneous" name="interior">{flakes}</medium>'
    foggy = SCENE.replace("</shape>", f"{medium}</shape>", 1)
    assert foggy != SCENE
    (tmp_path / "foggy.xml").write_text(foggy)


def test_a_scene_in_order(capsys):
    assert run("check scene.xml --quick") == 0
    out = capsys.readouterr().out
    assert "material" in out
    assert " 0 failed" in out
    assert "fail " not in out


def test_what_is_not_supported_is_a_row(capsys):
    assert run("check foggy.xml --quick") == 1
    captured = capsys.readouterr()
    assert "microflakes" in captured.out
    assert captured.err == ""


def test_json(capsys):
    assert run("check foggy.xml --quick --json") == 1
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is False
    assert [f["test"] for f in report["findings"] if f["verdict"] == "fail"] == ["supported"]


def test_a_scene_that_is_not_there(capsys):
    assert run("check nothing.xml") == 3
    assert capsys.readouterr().err.startswith("error: ")


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "vtu"])
def test_a_mesh_is_turned_and_written(capsys, suffix):
    """A cube with two faces turned wrong, in two groups; what is written is tested, and has the groups of the file."""
    vertices, faces = box((0, 0, 0), (1, 1, 1), 1)
    faces = faces.copy()
    faces[[1, 4]] = faces[[1, 4], ::-1]
    lines = [f"v {x} {y} {z}\n" for x, y, z in vertices]
    lines += [f"g {'side' if k < 4 else 'cover'}\nf {' '.join(map(str, face + 1))}\n" for k, face in enumerate(faces)]
    Path("a.obj").write_text("".join(lines))
    assert run("check a.obj --quick") == 1
    assert "most fronts are turned outward, but 2 are not: 1, 4" in capsys.readouterr().out
    assert run(f"check a.obj --quick --orient outward -o b.{suffix}") == 0
    captured = capsys.readouterr()
    assert "turned outward, but" not in captured.out and "of 6 faces 2 are turned: face 1, 4" in captured.err
    made = read_patches(f"b.{suffix}")
    assert diagnose(made).is_closed and len(orientation(made).wrong) == 0
    assert made.areas.sum() == pytest.approx(6)
    if suffix in ("obj", "stl"):
        groups = read_patches(f"b.{suffix}", ids="groups")
        assert dict(zip(groups.names, groups.areas, strict=True)) == pytest.approx({"side": 4, "cover": 2})


def test_faces_of_no_group_stay_so():
    Path("a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\ng my wall\nf 1 2 3\ng roof\nf 1 4 2\ng\nf 1 3 4\n")
    save_patches("b.obj", read_patches("a.obj"))
    made = read_patches("b.obj")
    assert sorted(zip(made.names, made.areas, strict=True)) == [("", 0.5), ("my wall", 0.5), ("roof", 0.5)]


def test_only_meshes_are_turned(capsys):
    assert run("check scene.xml --quick --orient outward") == 2
    assert "orient and save are for mesh files" in capsys.readouterr().err
    Path("a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert run("check a.obj --quick -o b.txt") == 2
    assert "a mesh is written as .obj, .stl, .ply, .vtu" in capsys.readouterr().err
    assert run("check a.obj --quick --orient up") == 3
    assert "outward or inward, not 'up'" in capsys.readouterr().err
