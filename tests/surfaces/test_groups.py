"""Groups of faces by name: of OBJ, STL and Gmsh."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.radiosity import ABuffer, PatchError, PatchSource, exact_form_factors, form_factors, read_patches

meshio = pytest.importorskip("meshio")

CORNERS = "".join(f"v {x} {y} {z}\n" for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
#: A floor of two triangles apart from each other in the file, and a ceiling.
OBJ = CORNERS + "g floor\no below\nf 1 2 3\ng upper ceiling\nusemtl paint\no above\nf 8 7 6 5\n"
OBJ += "g floor\no below\nf 1 3 4\n"
PLATES = 0.19982490


def written(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("ids", ["groups", "g", "o"])
def test_groups_of_obj_are_patches(tmp_path, ids):
    patches = read_patches(written(tmp_path, "a.obj", OBJ), ids=ids)
    assert list(patches.names) == (["below", "above"] if ids == "o" else ["floor", "upper ceiling"])
    factors = exact_form_factors(patches)
    assert factors.matrix[0, 1] == pytest.approx(PLATES, abs=1e-8)
    assert list(factors.name) == list(patches.names)


def test_faces_know_their_group(tmp_path):
    """Without ids, each face is a patch with the name of its group; before the first group there is no name."""
    patches = read_patches(written(tmp_path, "a.obj", OBJ))
    assert list(patches.names) == ["floor", "upper ceiling", "floor"]
    parts = patches.subdivided(0.3)
    assert set(parts.names[parts.centres[:, 2] == 0]) == {"floor"}
    assert set(parts.names[parts.centres[:, 2] == 1]) == {"upper ceiling"}
    patches = read_patches(written(tmp_path, "a.obj", OBJ), ids="usemtl")
    assert list(patches.names) == ["", "paint"]
    plain = read_patches(written(tmp_path, "b.obj", CORNERS + "f 1 2 3 4\n"))
    assert plain.shapes is None


def test_groups_stay_when_they_are_subdivided(tmp_path):
    source = PatchSource(source=written(tmp_path, "a.obj", OBJ), max_area=0.1, mesh={"ids": "groups"})
    patches = source.open().patches
    assert list(patches.names) == ["floor", "upper ceiling"]
    assert form_factors(ABuffer(patches).cast(256)).matrix[0, 1] == pytest.approx(PLATES, rel=0.05)
    assert source.objects_of(patches).names == ("0", "1")  # of a mesh, objects are connected surfaces unless named
    assert len(read_patches(source.source, ids="obj:group_ids")) == 3  # every statement, as ever


def facet(*corners):
    points = "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
    return f"facet normal 0 0 0\nouter loop\n{points}endloop\nendfacet\n"


def test_solids_of_stl(tmp_path):
    below = facet((0, 0, 0), (1, 0, 0), (1, 1, 0)) + facet((0, 0, 0), (1, 1, 0), (0, 1, 0))
    above = facet((0, 1, 1), (1, 1, 1), (1, 0, 1)) + facet((0, 1, 1), (1, 0, 1), (0, 0, 1))
    path = written(tmp_path, "a.stl", f"solid roof\n{above}endsolid roof\nsolid ground\n{below}endsolid ground\n")
    patches = read_patches(path, ids="groups")
    assert list(patches.names) == ["roof", "ground"]
    np.testing.assert_allclose(patches.normals, [[0, 0, -1], [0, 0, 1]])
    assert exact_form_factors(patches).matrix[0, 1] == pytest.approx(PLATES, abs=1e-8)
    assert list(read_patches(path).names) == ["roof", "roof", "ground", "ground"]


def test_physical_names_of_gmsh(tmp_path):
    mesh = (
        '$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 7 "hot"\n2 3 "cold"\n3 9 "air"\n$EndPhysicalNames\n'
        "$Nodes\n8\n"
        + "".join(
            f"{k + 1} {x} {y} {z}\n"
            for k, (x, y, z) in enumerate((x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
        )
        + "$EndNodes\n$Elements\n3\n1 2 2 7 1 1 2 3\n2 2 2 3 2 8 7 6\n3 2 2 7 1 1 3 4\n$EndElements\n"
    )
    patches = read_patches(written(tmp_path, "a.msh", mesh), ids="groups")
    assert list(patches.names) == ["cold", "hot"]
    assert list(patches.labels) == [3, 7]
    np.testing.assert_allclose(patches.areas, [0.5, 1])


def test_a_file_without_groups(tmp_path):
    with pytest.raises(PatchError, match="has no named groups of faces"):
        read_patches(written(tmp_path, "b.obj", CORNERS + "f 1 2 3 4\n"), ids="groups")
