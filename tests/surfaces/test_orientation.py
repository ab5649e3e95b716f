"""Faces that are turned the wrong way, found by rays."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.cli.main import main
from etendue.radiosity import Patches, box, joined, orientation, read_patches
from etendue.surfaces.orienting import turned


def boxes(*places):
    return joined(*(box(low, high, 1, inward=False) for low, high in places))


def mixed(vertices, faces, wrong):
    faces = np.array(faces)
    faces[wrong] = turned(faces[wrong])
    return Patches(vertices, faces)


@pytest.mark.parametrize("inward", [False, True])
def test_some_faces_of_two_boxes(variant, inward):
    """One box has three wrong faces, the other is inside out as a whole."""
    vertices, faces = boxes(((0, 0, 0), (1, 1, 1)), ((3, 0, 0), (4, 2, 5)))
    found = orientation(mixed(vertices, faces, [1, 2, 5, *range(6, 12)]), inward=inward)
    wrong = {1, 2, 5, *range(6, 12)}
    assert set(found.wrong) == (set(range(12)) - wrong if inward else wrong)
    assert len(found.undecided) == 0


def test_a_box_in_a_box(variant):
    """A room with a solid in it: the room's fronts are those of its walls, which face a cavity of a solid."""
    vertices, faces = boxes(((0, 0, 0), (9, 9, 9)), ((3, 3, 3), (4, 5, 6)))
    found = orientation(Patches(vertices, faces))
    assert set(found.wrong) == set(range(6, 12))


@pytest.mark.parametrize("is_cut", [False, True])
def test_houses_without_floors_on_the_ground(variant, is_cut):
    """Ground under the houses, or cut out around one, so that walls and ground are one sheet."""
    vertices, faces = boxes(((0, 0, 0), (1, 1, 1)), ((3, 0, 0), (4, 2, 5)))
    walls = faces[Patches(vertices, faces).face_normals[:, 2] > -0.5]
    if is_cut:
        walls = walls[:5]
        frame = [(-9, -9), (9, -9), (9, 9), (-9, 9), (0, 0), (1, 0), (1, 1), (0, 1)]
        ground = np.array([[k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4)])
    else:
        frame, ground = [(-9, -9), (9, -9), (9, 9), (-9, 9)], np.array([[0, 1, 2, 3]])
    corners, city = joined((vertices, walls), (np.array([(*p, 0) for p in frame], float), ground))
    wrong = [0, 4, len(city) - 1]
    for inward in (False, True):
        found = orientation(mixed(corners, city, wrong), inward=inward)
        assert len(found.undecided) == 0
        # A room's walls would face the other side; sheets face up in any case.
        expected = set(wrong) ^ (set(range(len(walls))) if inward and not is_cut else set())
        assert set(found.wrong) == expected


def test_sheets_that_stand_upright_have_no_outside(variant):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 2], [0, 0, 2], [5, 5, 0], [6, 5, 0], [6, 6, 0], [5, 6, 0]], float)
    found = orientation(Patches(vertices, [[0, 1, 2, 3], [4, 7, 6, 5]]))
    assert found.undecided.tolist() == [0] and found.wrong.tolist() == [1]
    assert orientation(Patches(vertices, [[0, 1, 2, 3], [4, 7, 6, 5]]), up="y").undecided.tolist() == [1]


def test_a_house_without_floor_and_ground(variant):
    vertices, faces = box((0, 0, 0), (40, 50, 9), 1, inward=False)
    faces = faces[Patches(vertices, faces).face_normals[:, 2] > -0.5]
    assert orientation(mixed(vertices, faces, [0, 3])).wrong.tolist() == [0, 3]


def test_triangles_and_sheets(variant):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    assert len(orientation(Patches(vertices, faces)).wrong) == 0
    faces[2] = faces[2, ::-1]
    assert orientation(Patches(vertices, faces)).wrong.tolist() == [2]
    sheets = orientation(Patches(vertices, faces, two_sided=True))
    assert len(sheets.wrong) == len(sheets.undecided) == 0


def test_reading_turns_faces(tmp_path, caplog):
    path = tmp_path / "a.obj"
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    # All outward, but the last.
    rows = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 4 8 6"]
    path.write_text("\n".join([*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {row}" for row in rows), ""]))
    assert not np.all(read_patches(path).face_normals.sum(axis=0) == 0)
    patches = read_patches(path, orient="outward")
    np.testing.assert_allclose((patches.centres - 0.5) * 2, patches.normals, atol=1e-12)
    assert "of 6 faces 1 are turned: face 5 (counted from 0)" in caplog.text
    patches = read_patches(path, orient="inward")
    np.testing.assert_allclose((0.5 - patches.centres) * 2, patches.normals, atol=1e-12)


@pytest.mark.parametrize("command", ["form-factors a.obj", "radiosity a.obj --emission 1 --reflectance 0.5"])
def test_the_commands_turn_faces(tmp_path, monkeypatch, capsys, command):
    """In a cube whose faces all look out, patches see only the sky."""
    monkeypatch.chdir(tmp_path)
    vertices, faces = box((0, 0, 0), (1, 1, 1), 1, inward=False)
    rows = [*(f"v {x} {y} {z}" for x, y, z in vertices), *(" ".join(["f", *map(str, face + 1)]) for face in faces), ""]
    (tmp_path / "a.obj").write_text("\n".join(rows))
    for orient, sees in ("inward", False), ("outward", True):
        assert main([*command.split(), "--orient", orient, "--bundles", "16", "-o", "f.npz"]) == 0
        assert ("patches see only the sky" in capsys.readouterr().err) == sees
