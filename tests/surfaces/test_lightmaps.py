"""Lightmaps: values in texels, seams, coordinates that overlap, atlases."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.patches import box, cube, joined, square
from support.scenes import camera, diffuse

from etendue.core import BackendError, SceneError
from etendue.film import read_exr
from etendue.products.patches import picture
from etendue.radiosity import (
    Patches,
    RadiosityError,
    Solution,
    SurfaceError,
    TexturedMesh,
    atlas,
    gltf_mesh,
    lightmap,
    save_lightmap,
    save_textured_mesh,
    scene_mesh,
)
from etendue.surfaces.lightmaps import atlases

pytest.importorskip("scipy.ndimage")


def solved(patches, irradiance):
    """A solution whose irradiance is known."""
    irradiance = np.broadcast_to(irradiance, (len(patches), 3)).astype(float)
    radiosity = patches.emission + patches.reflectance * irradiance
    return Solution(patches, radiosity, irradiance, np.zeros(len(patches)), (0.0,))


def grid(n, **properties):
    """The unit square in the plane z = 0, n x n patches that look up."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.stack([corner, corner + n + 1, corner + n + 2, corner + 1], axis=1)
    return Patches(np.stack([i / n, j / n, 0 * i], axis=1), faces, **properties)


def plane(uv):
    """The same square as two triangles."""
    return TexturedMesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]), np.array(uv)
    )


def bilinear(values, uv):
    """What a texture unit reads, v upward."""
    height, width = values.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - uv[:, 1]) * height - 0.5, 0, height - 1)
    i, j = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    s, t = (x - i)[:, None], (y - j)[:, None]
    low = values[j, i] * (1 - s) + values[j, i + 1] * s
    high = values[j + 1, i] * (1 - s) + values[j + 1, i + 1] * s
    return low * (1 - t) + high * t


def random_points(mesh, count, seed=1):
    """Points of triangles: texture coordinates, positions, triangles."""
    rng = np.random.default_rng(seed)
    triangle = rng.integers(len(mesh.faces), size=count)
    s, t = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - s, s * (1 - t), s * t], axis=1)[:, :, None]
    faces = mesh.faces[triangle]
    return (mesh.uv[faces] * weights).sum(axis=1), (mesh.vertices[faces] * weights).sum(axis=1), triangle


def test_texels_have_the_values_at_their_centres():
    """A linear irradiance is interpolated as it is, up to half a patch from the border."""
    patches = grid(8, reflectance=0.5, emission=0.25)
    x, y = patches.centres[:, 0], patches.centres[:, 1]
    solution = solved(patches, np.stack([1 + x, 2 + y, 3 + x - y], axis=1))
    made = lightmap(solution, plane([[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]]), (64, 64))
    assert made.covered.sum() == 32 * 32 and made.covered[16:48, 16:48].all()
    u, v = np.meshgrid((np.arange(32) + 0.5) / 32, 1 - (np.arange(32) + 0.5) / 32)
    expected = 0.25 + 0.5 * np.stack([1 + u, 2 + v, 3 + u - v], axis=2)
    inner = slice(4, 28)
    np.testing.assert_allclose(made.values[16:48, 16:48][inner, inner], expected[inner, inner], rtol=1e-5)
    irradiance = lightmap(solution, plane([[0, 0], [1, 0], [1, 1], [0, 1]]), (32, 32), quantity="irradiance").values
    np.testing.assert_allclose(irradiance[inner, inner], (expected[inner, inner] - 0.25) / 0.5, rtol=1e-5)
    flat = lightmap(solution, plane([[0, 0], [1, 0], [1, 1], [0, 1]]), (8, 8), smooth=False).values
    by_place = solution.radiosity.reshape(8, 8, 3)  # x, y
    np.testing.assert_allclose(flat, by_place.transpose(1, 0, 2)[::-1], rtol=1e-6)


def test_nothing_black_reaches_the_seams():
    """Islands of all shapes on a small map: of a constant radiosity every lookup is that constant."""
    pytest.importorskip("xatlas")
    patches = Patches(
        *joined(box((0, 0, 0), (1, 1, 1), 3, inward=True), box((0.3, 0.3, 0.3), (0.6, 0.5, 0.7), 1)), reflectance=0.5
    )
    mesh, size = atlas(patches, 64)
    made = lightmap(solved(patches, 2.0), mesh, size)
    assert max(size) <= 64 and 0.2 < made.covered.mean() < 1
    uv, _, _ = random_points(mesh, 5000)
    np.testing.assert_allclose(bilinear(made.values, uv), 1.0, rtol=1e-5)


def test_an_atlas_shows_the_right_place():
    """Fronts and backs of sheets, triangles and quadrilaterals: the map at a point has the value of the point."""
    pytest.importorskip("xatlas")
    room = box((0, 0, 0), (1, 1, 1), 6, inward=True)
    sheet = square((0.2, 0.2, 0.5), (0.6, 0, 0), (0, 0.6, 0))
    vertices, faces = joined(room, sheet)
    patches = Patches(vertices, faces, reflectance=0.5, two_sided=np.arange(len(faces)) == len(faces) - 1)
    back = len(patches) - 1
    irradiance = 1 + patches.centres + 5 * (np.arange(len(patches)) == back)[:, None]
    mesh, size = atlas(patches, 256)
    made = lightmap(solved(patches, irradiance), mesh, size)
    uv, points, triangle = random_points(mesh, 4000)
    a, b, c = (mesh.vertices[mesh.faces[triangle, k]] for k in range(3))
    looks_down = (np.abs(points[:, 2] - 0.5) < 1e-6) & (np.cross(b - a, c - a)[:, 2] < 0)
    on_sheet = (np.abs(points[:, 2] - 0.5) < 1e-6) & ((points > 0.2) & (points < 0.8)).all(axis=1)
    assert looks_down[on_sheet].any() and not looks_down[on_sheet].all()
    read = bilinear(made.values, uv)
    middle = np.array([0.5, 0.5, 0.5])  # of the sheet, which is one patch
    on_walls = ~on_sheet & ((np.abs(points - 0.5) < 0.4).sum(axis=1) == 2)  # away from edges
    np.testing.assert_allclose(read[on_walls], 0.5 * (1 + points[on_walls]), atol=0.02)
    far = on_sheet & ((points[:, :2] > 0.25) & (points[:, :2] < 0.75)).all(axis=1)
    for side, value in ((far & ~looks_down, 1 + middle), (far & looks_down, 6 + middle)):
        np.testing.assert_allclose(read[side] / value, 0.5, rtol=1e-4)


def test_files(tmp_path):
    """The mesh that is written, and read again, fits the map."""
    pytest.importorskip("xatlas")
    pytest.importorskip("trimesh")
    patches = cube(4, reflectance=0.5)
    solution = solved(patches, 1 + patches.centres)
    mesh, size = atlas(patches, 128)
    made = lightmap(solution, mesh, size)
    save_lightmap(tmp_path / "map.exr", made, {"bundles": 7})
    saved = read_exr(tmp_path / "map.exr")
    np.testing.assert_array_equal(saved.image, made.values)
    assert saved.metadata["bundles"] == 7 and list(saved.layers) == ["image"]
    for name in ("m.glb", "m.gltf"):
        save_textured_mesh(tmp_path / name, mesh, "map.exr")
        read = gltf_mesh(tmp_path / name)
        again = lightmap(solution, read, size)
        np.testing.assert_allclose(again.values[made.covered], made.values[made.covered], atol=0.02)
        assert (again.covered == made.covered).mean() > 0.95  # not where centres lie on edges
    assert b"map.exr" in (tmp_path / "m.glb").read_bytes()
    save_textured_mesh(tmp_path / "m.obj", mesh)
    lines = (tmp_path / "m.obj").read_text().splitlines()
    assert [sum(line.startswith(k) for line in lines) for k in ("v ", "vt ", "f ")] == [
        *(len(mesh.vertices), len(mesh.vertices), len(mesh.faces))
    ]


@pytest.mark.usefixtures("mitsuba_files")
def test_mitsuba_shows_the_lightmap_on_the_mesh(tmp_path):
    """As light of the `.obj`, textured by the `.exr`: the picture is that of the solution."""
    pytest.importorskip("xatlas")
    patches = cube(4, reflectance=0.5)
    solution = solved(patches, 1 + patches.centres)
    mesh, size = atlas(patches, 256)
    save_lightmap(tmp_path / "map.exr", lightmap(solution, mesh, size))
    save_textured_mesh(tmp_path / "m.obj", mesh)
    texture = {"type": "bitmap", "filename": str(tmp_path / "map.exr"), "raw": True, "wrap_mode": "clamp"}
    room = {
        "type": "obj",
        "filename": str(tmp_path / "m.obj"),
        "emitter": {"type": "area", "radiance": texture},
    }
    view = camera((0.8, 0.2, 0.9), (0.3, 0.6, 0.1), 80.0, size=(24, 18))
    scene = mi.load_dict({"type": "scene", "sensor": view, "room": room})
    textured = np.array(mi.render(scene, integrator=mi.load_dict({"type": "path", "max_depth": 1}), spp=64))
    shown = np.pi * picture(solution, scene, spp=64).image
    np.testing.assert_allclose(textured, shown, rtol=0.03)
    assert np.ptp(shown) > 0.3


def test_a_mesh_of_mitsuba_with_its_own_coordinates():
    """Of a rectangle turned into a mesh: the map is what Mitsuba's texture puts back in its place."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)  # the first row of a bitmap is at v = 0
    shape = mi.Mesh("plane", 4, 2, has_vertex_texcoords=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"], parameters["vertex_texcoords"] = points.ravel(), uv.ravel()
    parameters["faces"] = np.array([0, 1, 2, 0, 2, 3], np.uint32)
    parameters.update()
    scene = mi.load_dict({"type": "scene", "plane": shape})
    patches = grid(16, reflectance=0.5)
    made = lightmap(solved(patches, 1 + patches.centres), scene_mesh(scene), (32, 32))
    texture = mi.load_dict({"type": "bitmap", "data": mi.TensorXf(made.values), "raw": True, "wrap_mode": "clamp"})
    ray = mi.Ray3f(mi.Point3f([0.3, 0.6], [0.7, 0.2], 1.0), mi.Vector3f(0, 0, -1))
    si = scene.ray_intersect(ray)
    read = np.array(texture.eval(si)).T
    np.testing.assert_allclose(read, 0.5 * (1 + np.array([[0.3, 0.7, 0], [0.6, 0.2, 0]])), atol=0.01)
    ball = mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": diffuse(0.5, 0.5, 0.5)}})
    with pytest.raises(SceneError, match="no texture coordinates of vertices"):
        scene_mesh(ball)


@pytest.mark.parametrize(
    ("uv", "message"),
    [
        ([[0, 0], [1, 0], [1, 1], [0.6, 0.4]], "overlap: triangles 0 and 1 share texel"),
        ([[0, 0], [1.5, 0], [1.5, 1], [0, 1]], "leave the unit square"),
        ([[0, 0], [np.nan, 0], [1, 1], [0, 1]], "leave the unit square"),
    ],
)
def test_coordinates_that_are_no_atlas(uv, message):
    with pytest.raises(SurfaceError, match=message):
        lightmap(solved(grid(1, reflectance=0.5), 1.0), plane(uv), (32, 32))


def test_refusals(tmp_path, monkeypatch):
    solution, mesh = solved(grid(1, reflectance=0.5), 1.0), plane([[0, 0], [1, 0], [1, 1], [0, 1]])
    away = TexturedMesh(mesh.vertices + np.array([0, 0, 3]), mesh.faces, mesh.uv)
    with pytest.raises(SurfaceError, match="the mesh with the texture coordinates is not on the patches"):
        lightmap(solution, away, (8, 8))
    with pytest.raises(RadiosityError, match="of 'radiosity' or 'irradiance'"):
        lightmap(solution, mesh, (8, 8), quantity="light")
    with pytest.raises(SurfaceError, match="at least one texel"):
        lightmap(solution, mesh, (0, 8))
    with pytest.raises(SurfaceError, match=r"written as \.glb, \.gltf, \.obj"):
        save_textured_mesh(tmp_path / "m.stl", mesh)
    with pytest.raises(SurfaceError, match=r"written as \.exr"):
        save_lightmap(tmp_path / "m.png", lightmap(solution, mesh, (8, 8)))
    monkeypatch.setitem(__import__("sys").modules, "xatlas", None)
    with pytest.raises(BackendError, match=r"pip install 'etendue\[lightmap\]'"):
        atlas(solution.patches)
    assert atlases.LIGHTMAP_MESHES.keys() == {".glb", ".gltf", ".obj"} and not list(tmp_path.iterdir())


def test_an_atlas_needs_room():
    pytest.importorskip("xatlas")
    with pytest.raises(SurfaceError, match="at least 16 texels"):
        atlas(cube(1), 8)
    apart = joined(*(square((2 * k, 0, 0), (1, 0, 0), (0, 1, 0)) for k in range(64)))
    with pytest.raises(SurfaceError, match="no room for 128 triangles; make it larger"):
        atlas(Patches(*apart), 16)
