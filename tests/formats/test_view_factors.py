"""Matrices of view factors as the files of other programs: what their readers take."""

from __future__ import annotations

import csv
import io
import json
import re

import numpy as np
import pytest

from etendue.formats import (
    FormatError,
    Zone,
    elmer_lines,
    energyplus_json,
    energyplus_lines,
    moose_lines,
    openfoam_face_lines,
    openfoam_factor_lines,
    read_view3d,
    table_lines,
    udales_lines,
    udales_sky_lines,
    view3d_lines,
    write_udales_netcdf,
)

sparse = pytest.importorskip("scipy.sparse")
#: Three surfaces of areas 1, 2 and 4 of an enclosure; the second is flat, the first does not see itself.
AREAS = np.array([1.0, 2.0, 4.0])
DENSE = np.array([[0.0, 0.2, 0.8], [0.1, 0.0, 0.9], [0.2, 0.45, 0.35]])
NAMES = ["Z1:Floor", "Z1:Roof", "Z1:Wall"]


@pytest.fixture
def matrix():
    return sparse.csr_array(DENSE)


def test_udales(tmp_path, matrix):
    """1-based, ascending, the row is that from which light comes; the netCDF holds the transpose."""
    tiny = matrix.tolil()
    tiny[0, 0] = 4e-9
    lines = "".join(udales_lines(tiny.tocsr())).splitlines()
    assert lines[:3] == ["1 2 0.20000000", "1 3 0.80000000", "2 1 0.10000000"] and len(lines) == 7
    assert list(udales_sky_lines(np.array([0.948132, 1.0]))) == ["# sky view factors\n", "0.94813200\n", "1.00000000\n"]
    from scipy.io import netcdf_file

    write_udales_netcdf(tmp_path / "vf.nc.inp.001", matrix)
    with netcdf_file(tmp_path / "vf.nc.inp.001", mmap=False) as file:
        variable = file.variables["view factor"]
        assert variable.dimensions == ("columns", "rows")
        np.testing.assert_allclose(variable.data, DENSE.T, rtol=1e-6)


def test_energyplus(matrix):
    text = "".join(energyplus_lines([Zone("Z1", NAMES, matrix)]))
    fields = [field.strip() for field in text.rstrip(" \n;").split(",")]
    assert fields[:2] == ["ZoneProperty:UserViewFactors:BySurfaceName", "Z1"] and text.endswith(";\n")
    assert text.count(";") == 1 and len(fields) == 2 + 3 * 9
    triples = list(zip(fields[2::3], fields[3::3], map(float, fields[4::3]), strict=True))
    assert triples[0] == ("Z1:Floor", "Z1:Floor", 0.0) and triples[3] == ("Z1:Roof", "Z1:Floor", 0.1)
    content = json.loads("".join(energyplus_json([Zone("Z1", NAMES, matrix)])))
    (made,) = content["ZoneProperty:UserViewFactors:BySurfaceName"].values()
    assert made["zone_or_zonelist_or_space_or_spacelist_name"] == "Z1"
    assert [tuple(entry.values()) for entry in made["view_factors"]] == triples
    with pytest.raises(FormatError, match="EnergyPlus has no names with"):
        list(energyplus_lines([Zone("Z1", ["a,b", "c", "d"], matrix)]))


def test_moose(matrix):
    text = "".join(moose_lines(matrix, ["bottom", "top", "left"]))
    block = dict(re.findall(r"(\w+) = (?:'([^']*)'|\w+)\n", text))
    assert "type = SpecifiedViewFactor\n" in text and block["boundary"].split() == ["bottom", "top", "left"]
    np.testing.assert_allclose([list(map(float, row.split())) for row in block["view_factors"].split(";")], DENSE)
    with pytest.raises(FormatError, match="MOOSE has no names with blanks"):
        list(moose_lines(matrix, ["a b", "c", "d"]))


def test_elmer(matrix):
    lines = iter("".join(elmer_lines(matrix)).splitlines())
    read = np.zeros((3, 3))
    for i in range(3):
        for _ in range(int(next(lines))):
            row, column, factor = next(lines).split()
            assert int(row) == i + 1
            read[i, int(column) - 1] = float(factor)
    assert next(lines, None) is None
    np.testing.assert_allclose(read, DENSE)


def test_openfoam(matrix):
    """Both lists have the same shape, and a face that sees nothing an empty list."""
    alone = sparse.csr_array(np.vstack([DENSE[:2], np.zeros(3)]))
    read = []
    for lines, kind, name in (
        (openfoam_factor_lines(alone), "scalarListList", "F"),
        (openfoam_face_lines(alone), "labelListList", "globalFaceFaces"),
    ):
        head, body = "".join(lines).split("}", 1)
        assert re.search(rf"class\s+{kind};", head) and re.search(rf"object\s+{name};", head)
        count, *rows = re.fullmatch(r"\s*(\d+)\n\(\n(.*)\)\n", body, re.S).groups()
        rows = rows[0].splitlines()
        assert int(count) == len(rows) == 3 and rows[2] == "0()"
        read.append([re.fullmatch(r"(\d+)\((.*)\)", row).groups() for row in rows])
    made = np.zeros((3, 3))
    for i, ((count, factors), (same, faces)) in enumerate(zip(*read, strict=True)):
        assert count == same and int(count) == len(faces.split())
        made[i, list(map(int, faces.split()))] = list(map(float, factors.split()))
    np.testing.assert_allclose(made, alone.toarray())


def test_tables(matrix):
    """Names with commas and quotes are those of any reader of CSV."""
    names = ['the "big", one', "b", "Bögen"]
    text = "".join(table_lines(matrix, names, {"sky": np.zeros(3), "area": AREAS}))
    head, *rows = csv.reader(io.StringIO(text))
    assert head == ["name", *names, "sky", "area"] and [row[0] for row in rows] == names
    np.testing.assert_allclose(np.array([row[1:] for row in rows], float), np.c_[DENSE, np.zeros(3), AREAS])


def test_view3d_is_read_back(tmp_path, matrix):
    path = tmp_path / "f.vf"
    path.write_text("".join(view3d_lines(matrix, AREAS, np.array([0.9, 0.8, 0.7]), True)))
    found = read_view3d(path)
    assert found.is_closed
    for made, given in zip(found[:3], (DENSE, AREAS, [0.9, 0.8, 0.7]), strict=True):
        np.testing.assert_allclose(made, given, rtol=1e-6)
    numbers = np.concatenate([AREAS, DENSE.ravel(), [0.9, 0.8, 0.7]]).astype("<f4").tobytes()
    path.write_bytes(b"View3D 3.2 1 0 0 3".ljust(31) + b"\n" + numbers)
    np.testing.assert_allclose(read_view3d(path).matrix, DENSE, rtol=1e-6)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "there is no file"),
        (b"", "no file of form factors of View3D"),
        (b"View3D 3.2 0 1 0 2\n1 1\n0 1\n1 0\n0.9\n", "no file of form factors of View3D"),  # a number is missing
        (b"View3D 3.2 0 1 0 1\n1\nnan\n1\n", "no file of form factors of View3D"),
        (b"View3D 3.2 2 1 0 1\n1\n0\n1\n", "out=0 or 1"),
        (b"View3D 3.2 0 1 1 1\n1\n0\n1\n", "write it with emit=0"),
    ],
)
def test_other_files_are_not_of_view3d(tmp_path, content, message):
    if content is not None:
        (tmp_path / "f.vf").write_bytes(content)
    with pytest.raises(FormatError, match=message):
        read_view3d(tmp_path / "f.vf")
