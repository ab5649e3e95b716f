"""Tests of the faces of mesh files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from etendue.cli.main import main

CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
CUBE = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]


def written(path, faces):
    rows = [*(f"v {x} {y} {z}" for x, y, z in CORNERS), *(f"f {face}" for face in faces), ""]
    Path(path).write_text("\n".join(rows))
    return path


def findings(capsys, path):
    status = main(["check", str(path), "--quick", "--json"])
    rows = json.loads(capsys.readouterr().out)["findings"]
    return status, {row["test"]: row for row in rows if row["component"].startswith("mesh")}


def reversed_(face):
    return " ".join(face.split()[::-1])


def test_a_cube(tmp_path, capsys):
    status, found = findings(capsys, written(tmp_path / "a.obj", CUBE))
    assert status == 0 and {row["verdict"] for row in found.values()} == {"pass"}
    assert found["orientation"]["meaning"] == "fronts are turned outward"
    _, found = findings(capsys, written(tmp_path / "a.obj", [reversed_(face) for face in CUBE]))
    assert found["orientation"]["meaning"] == "fronts are turned inward"


def test_faces_that_are_wrong(tmp_path, capsys):
    turned = [*CUBE[:3], reversed_(CUBE[3]), *CUBE[4:]]
    status, found = findings(capsys, written(tmp_path / "a.obj", turned))
    assert status == 1
    assert found["orientation"]["verdict"] == "fail" and "1 are not: 3 (counted" in found["orientation"]["meaning"]
    assert "4 edges are between faces" in found["edges"]["meaning"]
    status, found = findings(capsys, written(tmp_path / "a.obj", [*CUBE[:5], CUBE[0]]))
    assert status == 1 and found["faces"]["figure"] == 1
    assert found["edges"]["verdict"] == "warn" and found["edges"]["figure"] == 4


def test_a_turned_face_within_open_ground(tmp_path, capsys):
    """It is named; ground that faces down as a whole may be meant."""
    corners = "".join(f"v {x} {y} 0\n" for y in (0, 1, 2) for x in (0, 1, 2))
    up = ["1 2 5 4", "2 3 6 5", "4 5 8 7", "5 6 9 8"]
    for faces, verdict in ((up, "pass"), ([*up[:2], reversed_(up[2]), up[3]], "warn"), (map(reversed_, up), "pass")):
        (tmp_path / "a.obj").write_text(corners + "".join(f"f {face}\n" for face in faces))
        status, found = findings(capsys, tmp_path / "a.obj")
        assert status == 0 and found["orientation"]["verdict"] == verdict
        assert verdict == "pass" or "1 are not: 2 (counted" in found["orientation"]["meaning"]


def test_a_mesh_that_is_no_scene(tmp_path, capsys):
    meshio = pytest.importorskip("meshio")
    cube = [[int(k) - 1 for k in face.split()] for face in CUBE]
    meshio.write(tmp_path / "a.vtu", meshio.Mesh(CORNERS, [("quad", cube)]))
    status, found = findings(capsys, tmp_path / "a.vtu")
    assert status == 0 and set(found) == {"faces", "overlaps", "edges", "orientation"}
    assert main(["check", str(tmp_path / "b.vtu")]) != 0
    assert "there is no mesh file" in capsys.readouterr().err
