"""`etendue points`: the list, points as CSV, discrepancies, plots."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from etendue.cli.main import main
from etendue.points import Halton, Hammersley, RandomShift, Weyl, point_sets, star_discrepancy


def run(command: str) -> int:
    return main(shlex.split(command))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "160")


def test_every_point_set_is_listed(capsys):
    assert run("points") == 0
    lines = capsys.readouterr().out.splitlines()
    for name, kind in point_sets().items():
        (line,) = (line for line in lines if line.split()[:1] == [name])
        assert str(kind.max_dimension or "any") in line and "[" not in line and "``" not in line


@pytest.mark.parametrize(
    ("command", "points", "first"),
    [
        ("points halton", Halton(2).block(16), 0),
        ("points halton -n 3 -d 5 --first 100", Halton(5).block(3, 100), 100),
        ("points weyl+shift --seed 4 -n 20000", RandomShift(Weyl(2), 4).block(20000), 0),
        ("points hammersley -n 8 --first 2", Hammersley(2, 10).block(8, 2), 2),
    ],
)
def test_points_as_csv(command, points, first, capsys):
    assert run(command) == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head == ",".join(["index", *(f"x{d}" for d in range(points.shape[1]))])
    values = np.array([[float(word) for word in row.split(",")] for row in rows])
    np.testing.assert_array_equal(values[:, 0], first + np.arange(len(points)))
    np.testing.assert_array_equal(values[:, 1:], points)


def test_measures(capsys):
    assert run("points halton -n 500 --measure") == 0
    rows = dict(line.rsplit(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert float(rows["star discrepancy"]) == pytest.approx(star_discrepancy(Halton(2).block(500)), rel=1e-5)
    assert rows.keys() == {"star discrepancy", "L2 star", "L2 centered", "L2 wrap", "L2 mixture"}


def test_measures_of_many_points_are_bounds(capsys):
    assert run("points sobol -n 100000 --measure") == 0
    words = capsys.readouterr().out.split()
    assert words[:2] == ["star", "discrepancy"] and float(words[2]) < float(words[4])
    assert words[5:] == ["L2", "not", "for", "so", "many", "points:", "it", "visits", "every", "pair"]
    assert run("points sobol -n 10 -d 40 --measure") == 0
    assert "no bound" in capsys.readouterr().out


def test_a_plot(capsys):
    assert run("points halton -n 200 --plot a.svg --pair 0,1 --pair 10,11") == 0
    assert capsys.readouterr().out == "a.svg\n"
    text = Path("a.svg").read_text("utf-8")
    assert text.count("h0") == 400 and "dimension 11" in text and "halton, 200 points from 0" in text
    assert run("points sobol -n 5000 --plot b.svg") == 0
    assert " to 0." in Path("b.svg").read_text("utf-8")  # bounds of the discrepancy


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("points nothing", "there is no point set 'nothing'"),
        ("points halton -d 9999", "at most 6542 dimensions"),
        ("points halton --first 4294967290", "an index is below 2^32"),
        ("points halton --pair 0,1", "give --plot FILE.svg"),
        ("points halton --plot a.svg --pair 1", "two dimensions such as 0,1"),
        ("points halton --plot a.png", "--plot writes .svg"),
        ("points halton -d 2 --plot a.svg --pair 0,5", "has the dimensions 0 to 1, not 5"),
        ("points halton -d 1 --plot a.svg", "has the dimensions 0 to 0, not 1"),
        ("points halton --measure --plot a.svg", "exclude each other"),
        ("points halton --plot nowhere/a.svg", "there is no folder"),
    ],
)
def test_bad_input(command, message, capsys):
    assert run(command) in (2, 5)
    err = capsys.readouterr().err
    assert message in err and len(err.splitlines()) == 1
    assert not list(Path().glob("*.svg"))
