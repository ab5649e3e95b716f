"""Patches of mesh files."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import box, joined, square

from etendue.radiosity import PatchError, diagnose, read_patches

meshio = pytest.importorskip("meshio")
BOX = box((0, 0, 0), (1, 2, 3), 2)


def written(path, cells=None, mesh=BOX, kind="quad"):
    faces = mesh[1]
    blocks = [(kind, faces)] if kind == "quad" else [("triangle", np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]]))]
    data = {name: [np.asarray(values)] for name, values in (cells or {}).items()}
    meshio.write(path, meshio.Mesh(mesh[0], blocks, cell_data=data))
    return path


@pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")  # in meshio's reader of STL
@pytest.mark.parametrize(
    ("name", "kind", "count"),
    [
        ("a.ply", "quad", 24),
        ("a.obj", "quad", 24),
        ("a.stl", "triangle", 48),
        ("a.vtu", "quad", 24),
        ("a.vtk", "quad", 24),
    ],
)
def test_formats(tmp_path, name, kind, count):
    patches = read_patches(written(tmp_path / name, kind=kind))
    assert len(patches) == count
    np.testing.assert_allclose(patches.areas.sum(), 22)
    assert diagnose(patches).is_closed


def test_gltf(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "a.glb")
    patches = read_patches(tmp_path / "a.glb", reflectance=0.5)
    assert len(patches) == 12
    np.testing.assert_allclose(patches.areas.sum(), 22)


def test_arrays_of_a_file(tmp_path):
    area_of = np.repeat([3.0, 3.0, 6.0, 6.0, 2.0, 2.0], 4) / 4  # walls across x, x, y ... : see box()
    wall = np.repeat(np.arange(6), 4)
    cells = {"wall": wall, "emissivity": 1 - 0.1 * wall, "power": area_of}
    path = written(tmp_path / "a.vtu", cells)
    patches = read_patches(path, ids="wall", reflectance="emissivity", emission="power")
    assert patches.labels.tolist() == list(range(6))
    np.testing.assert_allclose(patches.reflectance[:, 0], 0.1 * np.arange(6))
    np.testing.assert_allclose(patches.emission[:, 0], np.repeat([3.0, 6.0, 2.0], 2) / 4)
    np.testing.assert_allclose(patches.areas, [6, 6, 3, 3, 2, 2])
    single = read_patches(path, reflectance=0.25, emission="power")
    np.testing.assert_allclose(single.emission[:, 0], area_of)
    given = read_patches(path, reflectance=0.01 * np.arange(24))
    np.testing.assert_array_equal(given.reflectance[:, 0], 0.01 * np.arange(24))


def test_broken_faces_are_named_and_their_patches_stay_empty(tmp_path, caplog):
    vertices, faces = joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (1, 0, 0), (0, 1, 0)))
    broken = np.concatenate([faces[:1], [[0, 1, 1, 0]], np.roll(faces[:1], 2, axis=1), faces[1:]])
    path = written(tmp_path / "a.vtu", {"rho": [0.1, np.nan, 0.3, 0.4], "group": [7, 8, 7, 5]}, (vertices, broken))
    patches = read_patches(path, reflectance="rho", emission=2.0)
    assert "of 4 faces 1 have no area and 1 are duplicates" in caplog.text and "face 1, 2" in caplog.text
    assert patches.empty.tolist() == [False, True, True, False] and patches.face.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(patches.reflectance[:, 0], [0.1, 0, 0, 0.4])
    np.testing.assert_allclose(patches.emission[:, 0], [2, 0, 0, 2])
    np.testing.assert_allclose(patches.areas, [1, 0, 0, 1])

    groups = read_patches(path, reflectance="rho", ids="group")
    assert groups.labels.tolist() == [5, 7, 8] and groups.face.tolist() == [3, 0, 1]
    np.testing.assert_allclose(groups.reflectance[:, 0], [0.4, 0.1, 0])
    np.testing.assert_allclose(groups.areas, [1, 1, 0])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("absent.ply", None, "there is no mesh file"),
        ("a.ply", "nonsense", "cannot be read as a mesh"),
        ("a.xyzzy", "nonsense", "cannot be read as a mesh"),
        ("a.glb", "nonsense", "cannot be read as a mesh"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles or quadrilaterals"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "1 of 3 vertices are not finite"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "none of 1 faces has an area"),
    ],
)
def test_files_that_cannot_be_read(tmp_path, name, text, words):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(PatchError) as error:
        read_patches(tmp_path / name)
    assert words in str(error.value) and name in str(error.value) and "\n" not in str(error.value)


def test_an_array_that_a_file_has_not(tmp_path):
    path = written(tmp_path / "a.vtu", {"albedo": np.full(24, 0.5)})
    with pytest.raises(PatchError, match="did you mean 'albedo'"):
        read_patches(path, reflectance="albdo")
