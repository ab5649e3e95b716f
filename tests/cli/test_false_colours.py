"""`etendue develop --false-colour` and pictures of `etendue measure`: files, ranges, bad input in one line."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from etendue.cli.main import main
from etendue.core import Result
from etendue.display import false_colour
from etendue.film import write_exr

SCENE = """<scene version="3.0.0">
    <shape type="rectangle"><transform name="to_world"><scale value="4"/></transform><bsdf type="diffuse"/></shape>
    <emitter type="point"><point name="position" x="0" y="0" z="2"/><rgb name="intensity" value="1"/></emitter>
</scene>
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("scene.xml").write_text(SCENE)
    Path("meters.csv").write_text("0,0,0,0,0,1\n")
    ramp = np.linspace(0.0, 1.0, 420, dtype=np.float32)[:, None, None] * np.ones((1, 440, 3), np.float32)
    write_exr("ramp.exr", Result({"image": ramp}))


def pixels(name):
    return np.asarray(Image.open(name).convert("RGB"))


def test_luminance_of_a_picture(capsys):
    assert main(shlex.split("develop ramp.exr --false-colour --range 0:1000 -o a.png")) == 0
    assert main(shlex.split("develop ramp.exr --false-colour --range 0:1000 --isolines -o b.png")) == 0
    assert main(shlex.split("develop ramp.exr --false-colour")) == 0
    assert capsys.readouterr().out.split() == ["a.png", "b.png", "ramp.png"]
    plain, lined = pixels("a.png"), pixels("b.png")
    (expected,) = false_colour(683.0 * np.linspace(0.0, 1.0, 420)[None], 0.0, 1000.0, logarithmic=False)
    assert np.abs(plain[:420, 7].astype(int) - expected).max() <= 1  # the file has half precision
    # 200, 400 and 600 cd/m^2 are at 419 / 683 rows each.
    rows = np.flatnonzero((plain[:420, 7] != lined[:420, 7]).any(axis=1))
    assert {round(level * 419 / 683) for level in (200, 400, 600)} <= set(rows) and len(rows) < 16


def test_a_grid_as_table_and_picture(capsys):
    """Under the lamp E = I / h^2 = 1/4 W/m^2, at its side I h / d^3."""
    grid = "measure scene.xml --grid '-0.5,-0.5,0 3,0,0 0,1,0' --cells 3x1 --spp 64 --max-depth 2"
    assert main(shlex.split(f"{grid} --photometric --range 0:200 -o a.csv -o a.png")) == 0
    assert capsys.readouterr().out.split() == ["a.csv", "a.png"]
    shown = pixels("a.png")
    lux = 683.0 * 2.0 / np.sqrt(4.0 + np.arange(3.0) ** 2) ** 3
    expected = false_colour(lux[None], 0.0, 200.0, logarithmic=False)[0]
    assert np.abs(shown[3, [3, 400, 797]].astype(int) - expected).max() <= 2 and shown.shape[0] == 267
    assert np.loadtxt("a.csv", delimiter=",", skiprows=1)[:, 6] == pytest.approx(lux, rel=1e-3)
    assert main(shlex.split(f"{grid} --range 0:{200 / 683} -o b.png")) == 0
    assert np.abs(pixels("b.png")[3, [3, 797]].astype(int) - expected[[0, 2]]).max() <= 2


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("develop ramp.exr --false-colour --exposure 1 -o a.png", "leave out --tone and --exposure"),
        ("develop ramp.exr --false-colour --tone agx -o a.png", "leave out --tone and --exposure"),
        ("develop ramp.exr --isolines -o a.png", "are of false colours; give --false-colour"),
        ("develop ramp.exr --range 0:1 -o a.png", "are of false colours; give --false-colour"),
        ("develop ramp.exr --false-colour --range 5:1 -o a.png", "rises from its low to its high end, not from 5 to 1"),
        ("develop ramp.exr --false-colour --range 5 -o a.png", "--range needs LOW:HIGH, such as 0:500, not '5'"),
        ("develop ramp.exr --false-colour --range 0:nan -o a.png", "the ends of a scale are numbers, not nan"),
        ("develop ramp.exr --false-colour -o a.exr", "false colours are written as .png, not as 'a.exr'"),
        ("measure scene.xml --points meters.csv -o a.png", "a picture of readings needs a grid of meters"),
        ("measure scene.xml --points meters.csv -o a.exr", "readings are written as .csv or .png, not as 'a.exr'"),
        ("measure scene.xml --points meters.csv -o a.csv --range 0:1", "write a .png, too"),
        ("measure scene.xml --grid '0,0,0 1,0,0 0,1,0' --cells 2x2 -o a.png --range 3:2", "rises from its low"),
    ],
)
def test_bad_input(command, message, capsys):
    before = sorted(path.name for path in Path().iterdir())
    assert main(shlex.split(command)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and message in line
    assert sorted(path.name for path in Path().iterdir()) == before
