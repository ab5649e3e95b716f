"""Meshes with polygons of any number of corners, in every format; empty and broken files."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.radiosity import PatchError, diagnose, read_patches
from etendue.surfaces.readers.polygons import cut_polygons, ears

meshio = pytest.importorskip("meshio")

#: A prism on a concave pentagon, from z = 0 to 1.
POINTS = np.array([(x, y, z) for z in (0, 1) for x, y in ((0, 0), (2, 0), (2, 1), (1, 0.3), (0, 1))], float)
FACES = [[4, 3, 2, 1, 0], [5, 6, 7, 8, 9], [0, 1, 6, 5], [1, 2, 7, 6], [2, 3, 8], [2, 8, 7], [3, 4, 9, 8], [4, 0, 5, 9]]
AREAS = [1.3, 1.3, 2, 1, np.hypot(1, 0.7) / 2, np.hypot(1, 0.7) / 2, np.hypot(1, 0.7), 1]
CORNERS, STARTS = [k for face in FACES for k in face], np.cumsum([0, *map(len, FACES)])
LIST = "\n".join(f"{len(face)} {' '.join(map(str, face))}" for face in FACES)
ROWS = "\n".join(" ".join(map(str, point)) for point in POINTS)
WALLS = "CELL_DATA 8\nSCALARS wall int 1\nLOOKUP_TABLE default\n" + "\n".join(map(str, range(8))) + "\n"


def text(values):
    return " ".join(map(str, values))


def legacy(version, form):
    return f"# vtk DataFile Version {version}\nprism\n{form}\nDATASET POLYDATA\nPOINTS 10 double\n"


def binary(version):
    def big(values, kind):
        return np.asarray(values).astype(f">{kind}").tobytes() + b"\n"

    data = legacy(version, "BINARY").encode() + big(POINTS, "f8")
    if version == "3.0":
        whole = [k for face in FACES for k in (len(face), *face)]
        data += f"POLYGONS 8 {len(whole)}\n".encode() + big(whole, "i4")
    else:
        data += f"POLYGONS 9 {len(CORNERS)}\nOFFSETS vtktypeint64\n".encode() + big(STARTS, "i8")
        data += b"CONNECTIVITY vtktypeint64\n" + big(CORNERS, "i8")
    return data + b"CELL_DATA 8\nSCALARS wall int 1\nLOOKUP_TABLE default\n" + big(range(8), "i4")


FILES = {
    "a.off": f"OFF # a prism\n10 8 0\n{ROWS}\n{LIST}\n",
    "b.off": f"OFF 10 8 0\n{ROWS}\n" + "\n".join(f"{line} 0.5 0.5 0.5" for line in LIST.splitlines()),
    "a.ply": "ply\nformat ascii 1.0\nelement vertex 10\nproperty double x\nproperty double y\nproperty double z\n"
    f"element face 8\nproperty list uchar int vertex_indices\nend_header\n{ROWS}\n{LIST}\n",
    "a.obj": "".join(f"v {text(p)}\n" for p in POINTS)
    + "".join(f"g wall\nf {text(k + 1 for k in face)}\n" for face in FACES),
    "relative.obj": "".join(f"v {text(p)} 1 0 0\n" for p in POINTS)
    + "".join(f"g wall\nf {text(f'{k - 10}//1' for k in face)}\n" for face in FACES),
    "a.vtk": legacy("3.0", "ASCII") + f"{ROWS}\nPOLYGONS 8 {len(CORNERS) + 8}\n{LIST}\n{WALLS}",
    "b.vtk": legacy("5.1", "ASCII")
    + f"{ROWS}\nPOLYGONS 9 {len(CORNERS)}\nOFFSETS vtktypeint64\n{text(STARTS)}\nCONNECTIVITY vtktypeint64\n"
    + f"{text(CORNERS)}\n{WALLS}",
    "c.vtk": binary("3.0"),
    "d.vtk": binary("5.1"),
    "a.vtp": '<VTKFile type="PolyData" version="0.1" byte_order="LittleEndian"><PolyData><Piece NumberOfPoints="10" '
    'NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="8"><CellData><DataArray type="Int32" '
    f'Name="wall" format="ascii">{text(range(8))}</DataArray></CellData><Points><DataArray type="Float64" '
    f'NumberOfComponents="3" format="ascii">{text(POINTS.ravel())}</DataArray></Points><Polys><DataArray type="Int64" '
    f'Name="connectivity" format="ascii">{text(CORNERS)}</DataArray><DataArray type="Int64" Name="offsets" '
    f'format="ascii">{text(STARTS[1:])}</DataArray></Polys></Piece></PolyData></VTKFile>',
}


@pytest.mark.parametrize("name", FILES)
def test_every_format_keeps_the_rows_of_its_polygons(name, tmp_path):
    content = FILES[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    patches = read_patches(tmp_path / name)
    assert patches.face.tolist() == patches.labels.tolist() == list(range(8)) and diagnose(patches).is_closed
    np.testing.assert_allclose(patches.areas, AREAS)
    array = {".obj": "obj:group_ids", ".vtk": "wall", ".vtp": "wall"}.get((tmp_path / name).suffix)
    if array is not None:
        assert read_patches(tmp_path / name, ids=array).labels.tolist() == list(range(8))
        np.testing.assert_array_equal(read_patches(tmp_path / name, emission=array).emission[:, 0], range(8))


@pytest.mark.parametrize("face", ["5 0 1 2 1 0", "4 0 1 1 0", "5 0 0 0 0 0", "6 0 1 1 0 0 1"])
def test_a_polygon_is_named_if_nothing_of_it_is_left(tmp_path, caplog, face):
    """Corners that are run to and fro have no area."""
    lines = "\n".join(f"{len(face)} {text(face)}" for face in FACES).split("\n")
    lines.insert(1, face)
    (tmp_path / "a.off").write_text("\n".join(["OFF\n10 9 0", ROWS, *lines, ""]))
    patches = read_patches(tmp_path / "a.off")
    assert "of 9 faces 1 have no area and 0 are duplicates" in caplog.text and "face 1 (" in caplog.text
    np.testing.assert_allclose(patches.areas, np.insert(AREAS, 1, 0))


@pytest.mark.parametrize("count", [5, 8, 31])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_stars_are_cut_without_overlap(count, axis):
    """Areas of the triangles are those of the polygon, with corners on straight edges, too."""
    angle = np.linspace(0, 2 * np.pi, 2 * count, endpoint=False)
    star = np.where(np.arange(2 * count) % 2, 0.3, 1.0)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    star = np.stack([star, (star + np.roll(star, -1, axis=0)) / 2], axis=1).reshape(-1, 2)
    x, y = star.T
    points = np.roll(np.column_stack([x, y, np.zeros(len(x))]), axis, axis=1)
    for order in (np.arange(len(x)), np.arange(len(x))[::-1]):
        faces, rows = cut_polygons(points, [order.tolist()])
        assert not rows.any() and len(faces) == len(x) - 2
        a, b, c = (points[faces[:, k]] for k in range(3))
        areas = np.cross(b - a, c - a) / 2
        whole = np.cross(points[order], np.roll(points[order], -1, axis=0)).sum(axis=0) / 2
        np.testing.assert_allclose(areas.sum(axis=0), whole, atol=1e-12)
        assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(np.linalg.norm(whole))


def ring(*corners):
    return np.array([(x, y, 0.0) for x, y in corners])


def test_corners_of_real_polygons(variant):
    """The first corner again at the end, corners given twice, corners on an edge, a spike, and a chain of
    holes by seams; each has the area of the polygon."""
    cases = [
        (ring((0, 0), (2, 0), (2, 1), (1, 2), (0, 1), (0, 0)), 3.0),
        (ring((0, 0), (0, 0), (2, 0), (2, 0), (2, 1), (1, 2), (1, 2), (0, 1)), 3.0),
        (ring((0, 0), (1, 0), (2, 0), (3, 0), (1.5, 1)), 1.5),
        (ring((0, 0), (3, 0), (3, 1), (5, 1), (3, 1), (0, 1)), 3.0),
        (ring((0, 0), (0.5, 2), (0.6, 2.4), (0.599, 2.4), (0.5, 2), (0.25, 1)), 0.0),
    ]
    there = [c for x in range(1, 10, 2) for c in ((x, 1), (x, 2), (x + 1, 2))]
    back = [c for x in range(9, 0, -2) for c in ((x + 1, 2), (x + 1, 1), (x, 1))]
    cases.append((ring((-1, -1), (20, -1), (20, 9), (-1, 9), (-1, -1), *there, *back[1:]), 210.0 - 5.0))
    for corners, area in cases:
        triangles = ears(corners)
        assert triangles is not None
        found = sum(np.cross(b - a, c - a)[2] / 2 for a, b, c in corners[np.array(triangles, int).reshape(-1, 3)])
        assert found == pytest.approx(area, abs=1e-3)
    assert ears(ring((0, 0), (2, 2), (2, 0), (0, 2), (-1, 1))) is None


@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "stl", "vtk", "vtp", "vtu", "glb", "gltf", "msh"])
def test_an_empty_file(suffix, tmp_path):
    (tmp_path / f"a.{suffix}").write_text("")
    with pytest.raises(PatchError, match=rf"a\.{suffix} is empty"):
        read_patches(tmp_path / f"a.{suffix}")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "# nothing\n", "no triangles or quadrilaterals"),
        ("a.obj", "f 1 2 3\n", "face 0 names vertex 0, but there are 0 vertices"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "face 0 names vertex 8, but there are 3"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf 1 2\n", "face 0 has 2 corners"),
        ("a.obj", "v 0 0\nv 1 0 0\nf 1 2 1\n", "cannot be read as a mesh"),
        ("a.obj", "v a b c\n", "cannot be read as a mesh: could not convert"),
        ("a.off", "OFF\n", "cannot be read as a mesh"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n", "is cut off: it has 1 lines for 3 vertices and 1 faces"),
        ("a.off", "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2\n", "a line has too few numbers"),
        ("a.off", "OFF\n3 1 0\n0 0\n1 0\n1 1\n3 0 1 2\n", "cannot be read as a mesh"),
        ("a.obj", "v 0 0\nv 1 0\nv 1 1\nf 1 2 1\n", "cannot be read as a mesh"),
        ("a.off", "4OFF\n3 1 0\n", "4OFF is not known"),
        (
            "a.obj",
            "v 0 0 0\nv 2 2 0\nv 2 0 0\nv 0 1 0\nv 3 3 0\nf 1 3 2 5 4\nf 1 2 3 4\n",
            "face 1 crosses itself: cut it into triangles",
        ),
        (
            "a.off",  # a pentagram, whose corners all turn the same way
            "OFF\n5 1 0\n1 0 0\n-0.8 0.6 0\n0.3 -0.95 0\n0.3 0.95 0\n-0.8 -0.6 0\n5 0 1 2 3 4\n",
            "face 0 of 5 corners crosses itself",
        ),
        ("a.stl", "solid x\nendsolid x\n", "has no vertices"),
        ("a.vtp", "<VTKFile/>", "it has no polygons of VTK"),
        ("a.vtk", legacy("3.0", "ASCII") + ROWS + "\nLINES 1 3\n2 0 1\n", "has lines beside polygons"),
        ("a.vtk", legacy("3.0", "ASCII") + ROWS + "\n", "no triangles or quadrilaterals"),
    ],
)
def test_broken_files_are_named_in_one_line(name, content, message, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(PatchError) as error:
        read_patches(tmp_path / name)
    assert message in str(error.value) and name in str(error.value) and "\n" not in str(error.value)
