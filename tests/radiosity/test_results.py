"""Files of form factors and solutions, and radiosity at vertices."""

from __future__ import annotations

import json

import numpy as np
import pytest
from support.patches import box, cube, joined, square

from etendue.core import OutputError
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    Patches,
    RadiosityError,
    SurfaceError,
    form_factors,
    read_form_factors,
    read_patches,
    save_form_factors,
    save_solution,
    solve,
    vertex_radiosity,
)

sparse = pytest.importorskip("scipy.sparse")
meshio = pytest.importorskip("meshio")


@pytest.fixture(scope="module")
def segments():
    light = np.outer(np.repeat([0, 1, 0, 0, 0, 0], 4), [1.0, 2.0, 3.0])
    return ABuffer(cube(2, reflectance=0.5, emission=light), OwenSobol(4, seed=1)).cast(32)


@pytest.fixture(scope="module")
def solution(segments):
    return solve(segments.patches, segments)


def test_smoothing_of_a_wall_and_of_edges():
    """Inside a wall of equal squares a vertex has the mean of four; at the edges of a box walls stay apart."""
    patches = cube(3)
    values = np.random.default_rng(1).random((len(patches), 2))
    smooth = vertex_radiosity(patches, values)
    assert len(smooth.vertices) == 6 * 16 and smooth.values.shape == (96, 2)
    np.testing.assert_array_equal(smooth.vertices[smooth.faces], patches.vertices[patches.faces])
    for wall in range(6):
        own = smooth.faces[9 * wall : 9 * wall + 9]
        number, count = np.unique(own, return_counts=True)
        for vertex in number[count == 4]:
            around = (own == vertex).any(axis=1)
            np.testing.assert_allclose(smooth.values[vertex], values[9 * wall : 9 * wall + 9][around].mean(axis=0))
    rounded = vertex_radiosity(patches, values, angle=90)
    assert len(rounded.vertices) == 56  # 4^3 less the 8 inside: one for each place
    constant = vertex_radiosity(patches, np.full(len(patches), 7.0), angle=90)
    np.testing.assert_allclose(constant.values, 7.0)


def test_smoothing_does_not_depend_on_diagonals():
    """A square beside one that is cut: at the common corners both count alike."""
    points = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0], [0, 1, 0]]
    faces = [[0, 1, 4, 5], [1, 2, 3], [1, 3, 4]]
    smooth = vertex_radiosity(Patches(points, faces, ids=[0, 1, 1]), [0.0, 1.0])
    at = {tuple(p): v for p, v in zip(smooth.vertices[:, :2].tolist(), smooth.values.tolist(), strict=True)}
    assert at == pytest.approx({(0, 0): 0, (0, 1): 0, (1, 0): 0.5, (1, 1): 0.5, (2, 0): 1, (2, 1): 1})


def test_smoothing_keeps_the_sides_of_a_sheet_apart():
    sheet = Patches([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], two_sided=True)
    smooth = vertex_radiosity(sheet, [1.0, 1.0, 5.0, 5.0])
    assert smooth.patch.tolist() == [0, 1, 2, 3] and len(smooth.vertices) == 8
    for face, side in zip(smooth.faces, smooth.patch, strict=True):
        a, b, c = smooth.vertices[face[:3]]
        assert np.cross(b - a, c - a)[2] == (1 if side < 2 else -1)
        np.testing.assert_allclose(smooth.values[face], 1.0 if side < 2 else 5.0)


@pytest.mark.parametrize(
    ("values", "angle", "message"), [([1.0], 30, "one row for each of 24"), (np.ones(24), 200, "0 to 180 degrees")]
)
def test_smoothing_refuses(values, angle, message):
    with pytest.raises(SurfaceError, match=message):
        vertex_radiosity(cube(2), values, angle)


def test_form_factors_as_arrays(tmp_path, segments):
    for factors in (form_factors(segments), form_factors(segments, "F4").transposed()):
        save_form_factors(tmp_path / "f.npz", factors, emissivity=0.5, metadata={"seed": 1})
        loaded = sparse.load_npz(tmp_path / "f.npz")
        assert isinstance(loaded, sparse.csr_array)
        assert abs(loaded - factors.matrix).max() == 0
        again = read_form_factors(tmp_path / "f.npz")
        assert abs(again.errors - factors.errors).max() == 0
        for name in ("areas", "sky", "lines"):
            np.testing.assert_array_equal(getattr(again, name), getattr(factors, name))
        with np.load(tmp_path / "f.npz") as arrays:
            assert json.loads(str(arrays["metadata"])) == {"seed": 1}
            assert arrays["emissivity"].tolist() == [0.5] * 24


def test_form_factors_as_view3d_text(tmp_path, segments):
    factors = form_factors(segments)
    save_form_factors(tmp_path / "f.VF", factors, emissivity=np.linspace(0.1, 0.9, 24))
    head, *rest = (tmp_path / "f.VF").read_text().splitlines()
    assert head.split() == ["View3D", "3.2", "0", "1", "0", "24"] and len(head) < 34  # what its reader takes
    numbers = np.array(" ".join(rest).split(), dtype=float)  # it reads words, not lines
    assert numbers.size == 24 + 24 * 24 + 24
    np.testing.assert_allclose(numbers[:24], factors.areas)
    np.testing.assert_allclose(numbers[24:-24].reshape(24, 24), factors.matrix.todense(), rtol=1e-6)
    np.testing.assert_allclose(numbers[-24:], np.linspace(0.1, 0.9, 24))


def test_an_open_scene_is_no_enclosure(tmp_path):
    pair = Patches(*joined(square((0, 0, 0), (1, 0, 0), (0, 1, 0)), square((0, 0, 1), (0, 1, 0), (1, 0, 0))))
    save_form_factors(tmp_path / "f.vf", form_factors(ABuffer(pair).cast(16)))
    assert (tmp_path / "f.vf").read_text().startswith("View3D 3.2 0 0 0 2\n")


def test_a_solution_as_arrays(tmp_path, segments, solution):
    error = segments.gather_error(solution.radiosity)
    save_solution(tmp_path / "s.npz", solution, irradiance_error=error, metadata={"bundles": 32})
    with np.load(tmp_path / "s.npz") as arrays:
        np.testing.assert_array_equal(arrays["radiosity"], solution.radiosity)
        np.testing.assert_allclose(arrays["radiosity_error"], 0.5 * error)
        np.testing.assert_allclose(arrays["net_flux"] * arrays["areas"][:, None], solution.net_power)
        assert arrays["vertices"][arrays["faces"]].shape == (24, 4, 3)
        assert json.loads(str(arrays["metadata"])) == {"bundles": 32}


def test_a_solution_for_paraview(tmp_path, segments, solution):
    error = segments.gather_error(solution.radiosity)
    save_solution(tmp_path / "s.vtu", solution, irradiance_error=error)
    mesh = meshio.read(tmp_path / "s.vtu")
    for name in ("radiosity", "irradiance", "emission", "reflectance"):
        expected = getattr(solution if "radia" in name or "rad" in name else solution.patches, name)
        np.testing.assert_allclose(mesh.cell_data[name][0], expected)
    np.testing.assert_allclose(mesh.cell_data["irradiance_error"][0], error)
    np.testing.assert_allclose(mesh.cell_data["net_flux"][0], solution.radiosity - solution.irradiance)
    again = read_patches(tmp_path / "s.vtu", reflectance="reflectance", emission="emission", ids="patch")
    np.testing.assert_allclose(again.emission, solution.patches.emission)
    np.testing.assert_allclose(again.normals, solution.patches.normals, atol=1e-12)


def test_triangles_quadrilaterals_and_sheets_for_paraview(tmp_path):
    """Cells come in another order than faces: each has the value of its patch, and backs are cells of their own."""
    room = box((0, 0, 0), (1, 1, 1), 1, inward=True)
    vertices, faces = joined(
        room, (np.array([[0.2, 0.2, 0.5], [0.8, 0.2, 0.5], [0.2, 0.8, 0.5]]), np.array([[0, 1, 2, 2]]))
    )
    sheet = np.arange(7) == 6
    light = np.arange(8.0)
    patches = Patches(vertices, faces, reflectance=0.5, emission=light, two_sided=sheet)
    save_solution(tmp_path / "s.vtu", solve(patches, ABuffer(patches).cast(32)))
    mesh = meshio.read(tmp_path / "s.vtu")
    assert {block.type: len(block.data) for block in mesh.cells} == {"triangle": 2, "quad": 6}
    for block, number, emission in zip(mesh.cells, mesh.cell_data["patch"], mesh.cell_data["emission"], strict=True):
        np.testing.assert_array_equal(emission, light[number])
        a, b, c = (mesh.points[block.data[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        assert ((normals * patches.normals[number]).sum(axis=1) > 0).all()


def test_a_solution_as_vertex_colours(tmp_path, solution):
    save_solution(tmp_path / "s.ply", solution)
    mesh = meshio.read(tmp_path / "s.ply")
    smooth = vertex_radiosity(solution.patches, solution.radiosity)
    colours = np.stack([mesh.point_data[name] for name in ("red", "green", "blue")], axis=1)
    assert colours.dtype == np.float32
    np.testing.assert_allclose(colours, smooth.values, rtol=1e-6)
    np.testing.assert_allclose(mesh.points, smooth.vertices)
    assert b"property float red" in (tmp_path / "s.ply").read_bytes()[:400]
    assert len(read_patches(tmp_path / "s.ply")) == 24


def test_refusals(tmp_path, segments, solution):
    factors = form_factors(segments)
    with pytest.raises(RadiosityError, match=r"'\.txt' is not known; take \.npz, \.vf"):
        save_form_factors(tmp_path / "f.txt", factors)
    with pytest.raises(RadiosityError, match=r"it has no suffix; take \.npz, \.vtu, \.ply"):
        save_solution(tmp_path / "s", solution)
    with pytest.raises(OutputError, match="there is no folder"):
        save_solution(tmp_path / "nowhere" / "s.vtu", solution)
    with pytest.raises(RadiosityError, match="one for each of 24 patches"):
        save_form_factors(tmp_path / "f.npz", factors, emissivity=[0.1, 0.2])
    with pytest.raises(RadiosityError, match="have its shape"):
        save_solution(tmp_path / "s.npz", solution, irradiance_error=np.ones(24))
    two = segments.patches.with_properties([[0.5, 0.5]], [[1.0, 1.0]], 0.0)
    with pytest.raises(RadiosityError, match="one channel or three, not 2"):
        save_solution(tmp_path / "s.ply", solve(two, segments))
    assert not list(tmp_path.iterdir())


def test_a_save_that_fails_leaves_the_old_file(tmp_path, segments):
    (tmp_path / "f.npz").write_text("old")
    with pytest.raises(TypeError, match="JSON"):
        save_form_factors(tmp_path / "f.npz", form_factors(segments), metadata={"seed": object()})
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("f.npz", "old")]


@pytest.mark.parametrize("content", [None, b"", b"no zip", "other"])
def test_other_files_are_no_form_factors(tmp_path, content):
    path = tmp_path / "f.npz"
    if content == "other":
        np.savez(path, data=np.ones(3))
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(RadiosityError, match="file of form factors"):
        read_form_factors(path)
