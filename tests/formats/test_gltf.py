"""glTF files: vertex colours, normals, texture coordinates."""

from __future__ import annotations

import base64
import json
import struct

import numpy as np
import pytest
from support.patches import cube

from etendue.formats import FormatError
from etendue.points import OwenSobol
from etendue.radiosity import (
    ABuffer,
    GltfMesh,
    Patches,
    RadiosityError,
    SurfaceError,
    coloured_mesh,
    gltf_mesh,
    read_patches,
    save_solution,
    solve,
    vertex_radiosity,
    write_gltf,
)

trimesh = pytest.importorskip("trimesh")
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
_TYPE = {5126: np.float32, 5125: np.uint32}


@pytest.fixture(scope="module")
def solution():
    """A room with a bright lamp: 4 of 24 patches."""
    light = np.outer(np.repeat([0, 1, 0, 0, 0, 0], 4), [20.0, 10.0, 5.0])
    patches = cube(2, reflectance=0.5, emission=light)
    return solve(patches, ABuffer(patches, OwenSobol(4, seed=1)).cast(32))


def parsed(path):
    """JSON and binary of a file, by the letter of the format's specification."""
    data = path.read_bytes()
    if path.suffix == ".gltf":
        content = json.loads(data)
        return content, base64.b64decode(content["buffers"][0]["uri"].partition(",")[2])
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data)) and len(data) % 4 == 0
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    binary_size, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0" and 28 + size + binary_size == len(data)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def array(content, binary, number):
    accessor = content["accessors"][number]
    view = content["bufferViews"][accessor["bufferView"]]
    count = accessor["count"] * _WIDTH[accessor["type"]]
    values = np.frombuffer(binary, _TYPE[accessor["componentType"]], count, view["byteOffset"])
    return values.reshape(accessor["count"], -1)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_colours_normals_and_what_is_brighter_than_white(tmp_path, solution, suffix):
    path = tmp_path / f"s{suffix}"
    save_solution(path, solution, metadata={"bundles": 32})
    content, binary = parsed(path)
    assert content["asset"]["extras"] == {"bundles": 32} and "KHR_materials_unlit" in content["extensionsUsed"]
    primitive = content["meshes"][0]["primitives"][0]
    found = {name: array(content, binary, number) for name, number in primitive["attributes"].items()}
    triangles = array(content, binary, primitive["indices"]).reshape(-1, 3)
    exposure = content["meshes"][0]["extras"]["exposure"]
    assert len(triangles) == 48 and found["COLOR_0"].dtype == np.float32

    smooth = vertex_radiosity(solution.patches, solution.radiosity)
    expected = {tuple(np.round(p, 5)): [] for p in smooth.vertices}
    for point, value in zip(smooth.vertices, smooth.values, strict=True):
        expected[tuple(np.round(point, 5))].append(value)
    for point, value in zip(found["POSITION"], found["_RADIOSITY"], strict=True):
        assert min(np.abs(value - v).max() for v in expected[tuple(np.round(point.astype(float), 5))]) < 1e-5
    np.testing.assert_allclose(found["COLOR_0"], np.clip(exposure * found["_RADIOSITY"], 0, 1), rtol=1e-5)
    lamp = solution.patches.emission.any(axis=1)
    assert (exposure * solution.radiosity[lamp] > 1).any()  # cut, and the reason for _RADIOSITY
    assert (exposure * solution.radiosity[~lamp]).max() == pytest.approx(1.0)

    a, b, c = (found["POSITION"][triangles[:, k]] for k in range(3))
    turned = np.cross(b - a, c - a)
    for k in range(3):
        np.testing.assert_allclose(np.cross(turned, found["NORMAL"][triangles[:, k]]), 0, atol=1e-6)
        assert ((turned * found["NORMAL"][triangles[:, k]]).sum(axis=1) > 0).all()
    position = content["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == [0, 0, 0] and position["max"] == [1, 1, 1]


def test_other_libraries_read_it(tmp_path, solution):
    save_solution(tmp_path / "s.glb", solution)
    mesh = trimesh.load(tmp_path / "s.glb", force="mesh", process=False)
    content, binary = parsed(tmp_path / "s.glb")
    attributes = content["meshes"][0]["primitives"][0]["attributes"]
    np.testing.assert_allclose(mesh.vertices, array(content, binary, attributes["POSITION"]))
    np.testing.assert_allclose(mesh.vertex_attributes["_RADIOSITY"], array(content, binary, attributes["_RADIOSITY"]))
    assert len(read_patches(tmp_path / "s.glb")) == 48


def test_the_exposure_can_be_given(solution):
    smooth = vertex_radiosity(solution.patches, solution.radiosity)
    mesh = coloured_mesh(solution, smooth, exposure=1e-3)
    np.testing.assert_allclose(mesh.attributes["COLOR_0"], 1e-3 * mesh.attributes["_RADIOSITY"])


def test_one_channel_is_grey(tmp_path):
    patches = cube(1, reflectance=0.5, emission=[0, 1, 0, 0, 0, 0])
    save_solution(tmp_path / "s.glb", solve(patches, ABuffer(patches).cast(16)))
    content, binary = parsed(tmp_path / "s.glb")
    colours = array(content, binary, content["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"])
    assert colours.shape[1] == 3 and (colours == colours[:, :1]).all()


def test_corners_of_two_walls_are_two_vertices():
    """Even where the radiosity is the same: normals are not."""
    patches = Patches(*cube_corner(), emission=1.0)
    mesh = coloured_mesh(solve(patches, ABuffer(patches).cast(4)), vertex_radiosity(patches, np.ones((2, 1))))
    assert len(mesh.vertices) == 8
    assert {tuple(n) for n in np.round(np.abs(mesh.normals)).tolist()} == {(0, 0, 1), (0, 1, 0)}


def cube_corner():
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]]
    return points, [[0, 1, 2, 3], [0, 4, 5, 1]]


def test_second_texture_coordinates_of_placed_meshes(tmp_path):
    """Node transforms count, and v is turned upward."""
    uv = np.array([[0.1, 0.2], [0.9, 0.2], [0.5, 0.7]])
    mesh = GltfMesh(np.eye(3), np.ones((3, 3)), np.array([[0, 1, 2]]), {"TEXCOORD_0": uv + 0.05, "TEXCOORD_1": uv})
    for suffix in (".gltf", ".glb"):
        write_gltf(tmp_path / f"m{suffix}", mesh)
    content = json.loads((tmp_path / "m.gltf").read_text())
    content["nodes"][0]["translation"] = [1.0, 2.0, 3.0]
    (tmp_path / "moved.gltf").write_text(json.dumps(content))
    for name, offset in (("m.glb", 0), ("m.gltf", 0), ("moved.gltf", [1, 2, 3])):
        read = gltf_mesh(tmp_path / name)
        np.testing.assert_allclose(read.vertices, np.eye(3) + offset)
        np.testing.assert_allclose(read.uv, [[0.1, 0.8], [0.9, 0.8], [0.5, 0.3]], rtol=1e-6)
        assert read.faces.tolist() == [[0, 1, 2]]


def test_refusals(tmp_path, solution):
    save_solution(tmp_path / "s.glb", solution)
    with pytest.raises(SurfaceError, match="no second texture coordinates"):
        gltf_mesh(tmp_path / "s.glb")
    with pytest.raises(FormatError, match="there is no mesh file"):
        gltf_mesh(tmp_path / "nothing.glb")
    (tmp_path / "broken.glb").write_bytes(b"glTF and no more")
    with pytest.raises(FormatError, match="cannot be read as glTF"):
        gltf_mesh(tmp_path / "broken.glb")
    bands = solution.patches.with_properties([[0.5] * 4], [[1.0] * 4], 0.0)
    with pytest.raises(RadiosityError, match="one channel or three, not 4"):
        save_solution(tmp_path / "b.gltf", solve(bands, ABuffer(bands).cast(4)))
