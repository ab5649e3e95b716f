"""The command `glare`: what it prints, and options that are wrong."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from etendue import film
from etendue.cli.main import main
from etendue.core import Result
from etendue.lighting import EFFICACY, View, glare


@pytest.fixture
def luminance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """A picture with two lamps, as ``a.exr`` in the current folder."""
    monkeypatch.chdir(tmp_path)
    values = np.full((60, 60), 100.0, np.float32)
    values[10:14, 20:24], values[25:28, 40:43] = 9000.0, 4000.0
    film.write_exr("a.exr", Result({"image": np.repeat((values / EFFICACY)[..., None], 3, axis=2)}, {}))
    return values


def run(command: str) -> int:
    return main(shlex.split(command))


def test_the_command_prints_what_python_finds(luminance, capsys):
    assert run("glare a.exr --view spherical --fov 180") == 0
    lines = capsys.readouterr().out.splitlines()
    found = glare(luminance, View("spherical", 180.0))
    assert lines[0] == found.summary() and "2 sources" in lines[0]
    rows = [line.split() for line in lines[-2:]]
    assert sorted(round(float(row[0]), -1) for row in rows) == [4000.0, 9000.0]
    # The middle is in row 12 and column 22 of 60, which are 180 degrees: 36 from the zenith, 66 from the left. Lower
    # pixels have larger solid angles.
    lamp = next(row for row in rows if row[0].startswith("9"))
    assert float(lamp[2]) == pytest.approx(-24.0, abs=0.2) and float(lamp[3]) == pytest.approx(53.75, abs=0.2)
    assert run("glare a.exr --view perspective --fov 90 --ev 1500 --threshold 5000 --low-light") == 0
    found = glare(luminance, View("perspective", 90.0), vertical_illuminance=1500.0, threshold=5000.0, low_light=True)
    assert capsys.readouterr().out.splitlines()[0] == found.summary()
    assert run("glare a.exr --view spherical --threshold 1000x") == 0
    assert "UGR -" in capsys.readouterr().out
    assert run("glare a.exr --view perspective --fov 60") == 0
    assert "of the hemisphere" in capsys.readouterr().err


SCENE = """<scene version="3.0.0">
    {sensors}
    <shape type="sphere"><boolean name="flip_normals" value="true"/><float name="radius" value="3"/>
        <emitter type="area"><rgb name="radiance" value="5"/></emitter></shape>
</scene>"""
FILM = """<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="12"/>{more}
    <rfilter type="box"/></film>"""


def test_pictures_tell_their_camera(tmp_path, monkeypatch, capsys):
    """A field of view of the height, a spherical camera; those that are no eye are refused."""
    monkeypatch.chdir(tmp_path)
    film_of, cropped = FILM.format(more=""), FILM.format(more='<integer name="crop_width" value="12"/>')
    sensors = [
        '<sensor type="perspective"><float name="fov" value="60"/><string name="fov_axis" value="y"/>'
        f"{film_of}</sensor>",
        f'<sensor type="spherical">{film_of}</sensor>',
        f'<sensor type="orthographic">{film_of}</sensor>',
        f'<sensor type="perspective">{cropped}</sensor>',
    ]
    Path("s.xml").write_text(SCENE.format(sensors="".join(sensors)))
    found = []
    for k in range(len(sensors)):
        assert run(f"render s.xml -m path --spp 1 --sensor {k} --no-checkpoint -o {k}.exr") == 0
    capsys.readouterr()
    for options in ("", " --view perspective --fov 60 --fov-axis y"):
        assert run(f"glare 0.exr{options}") == 0
        found.append(capsys.readouterr().out.splitlines()[0])
    assert found[0] == found[1] and "1 source above" in found[0]
    assert run("glare 1.exr") == 0  # E = pi L
    lux = float(capsys.readouterr().out.split(" lx")[0].split()[-1])
    assert lux == pytest.approx(np.pi * 5.0 * EFFICACY, rel=1e-3)
    for picture, message in (("2", "of the sensor 'orthographic', which is no eye"), ("3", "render the whole film")):
        assert run(f"glare {picture}.exr") == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("a.exr", "'a.exr' does not tell its camera; give --view spherical"),
        ("a.exr --fov 60", "--fov is that of a --view"),
        ("a.exr --view fisheye", "perspective or spherical"),
        ("a.exr --view perspective", "give fov"),
        ("a.exr --view spherical --threshold bright", "5x for 5 times the mean"),
        ("a.exr --view spherical --threshold 0", "luminance above 0"),
        ("a.exr --view spherical --ev 1", "more than the vertical illuminance"),
        ("a.png --view spherical", "which is in an .exr"),
        ("b.exr --view spherical", "there is no picture"),
    ],
)
def test_bad_options(luminance, capsys, command, message):
    assert run(f"glare {command}") in (2, 3)
    error = capsys.readouterr().err
    assert message in " ".join(error.split())
