"""`etendue check`: the table, JSON, the exit status."""

from __future__ import annotations

import json
import shlex

import pytest
from support.run_files import SCENE

from etendue.cli.main import main


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
