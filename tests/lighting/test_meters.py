"""Meters: their files, and grids."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.lighting import LightingError, Meters

ROWS = [[0, 0.5, 1, 0, 0, 2], [3, -1e-2, 2, 0, 1, 1]]


@pytest.mark.parametrize(
    "text",
    [
        "0 0.5 1 0 0 2\n3 -1e-2 2 0 1 1\n",  # as Radiance's files of sensors
        "\ufeff# meters\r\n0,0.5,1,0,0,2\r\n\r\n3, -1e-2, 2, 0, 1, 1",
        "0;0.5;1;0;0;2\n3;-1e-2;2;0;1;1",
        "nx,ny,nz,X,Y,Z,height\n0,0,2,0,0.5,1,7\n0,1,1,3,-1e-2,2,7\n",
        '"x","y","z","nx","ny","nz"\n0,0.5,1,0,0,2\n3,-1e-2,2,0,1,1\n',
    ],
)
def test_files(tmp_path, text):
    path = tmp_path / "meters.csv"
    path.write_text(text, "utf-8")
    meters = Meters.read(path)
    assert np.allclose(meters.points, np.array(ROWS)[:, :3])
    assert np.allclose(meters.directions, [[0, 0, 1], [0, 0.5**0.5, 0.5**0.5]])


def test_names(tmp_path):
    path = tmp_path / "meters.csv"
    path.write_text('name,x,y,z,nx,ny,nz\n"desk, left",0,0,1,0,0,1\n')
    assert Meters.read(path).names == ("desk, left",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no meters"),
        ("x,y,z\n0,0,0\n", "not all of x,y,z,nx,ny,nz"),
        ("0 0 0 0 0 1\n1 2 3\n", "line 2"),
        ("0 0 0 0 0 1\n# a remark\n1 2 3 4 5 up\n", "line 3"),
        ("0 0 0 0 0 0\n", "length 0"),
        ("nan 0 0 0 0 1\n", "number 0 is not finite"),
        ("0 0 0 0 0 1\n0 nan 0 0 0 1\n", "number 1 is not finite"),
    ],
)
def test_bad_files(tmp_path, text, message):
    path = tmp_path / "meters.csv"
    path.write_text(text)
    with pytest.raises(LightingError, match=message) as error:
        Meters.read(path)
    assert "\n" not in str(error.value)
    with pytest.raises(LightingError, match="cannot read"):
        Meters.read(tmp_path / "missing.csv")


def test_grid():
    grid = Meters.grid((1, 0, 0.85), (4, 0, 0), (0, 3, 0), (4, 3))
    assert np.allclose(
        grid.points[:5], [[1.5, 0.5, 0.85], [2.5, 0.5, 0.85], [3.5, 0.5, 0.85], [4.5, 0.5, 0.85], [1.5, 1.5, 0.85]]
    )
    assert np.allclose(grid.directions, [0, 0, 1])
    for edges, message in (((0, 2, 0), "parallel"), ((0, 0, np.inf), "not finite")):
        with pytest.raises(LightingError, match=message):
            Meters.grid((0, 0, 0), (0, 1, 0), edges, (2, 2))
    with pytest.raises(LightingError, match="one cell"):
        Meters.grid((0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0))


def test_one_direction_for_all():
    assert np.allclose(Meters(np.zeros((3, 3)), [[0, 2, 0]]).directions, [[0, 1, 0]] * 3)
    with pytest.raises(LightingError, match="3 points"):
        Meters(np.zeros((3, 3)), [[0, 2, 0]] * 2)
    assert Meters(**Meters([[1, 2, 3]], [[0, 0, 1]], names=("a",)).to_dict()).names == ("a",)
