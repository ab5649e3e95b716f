"""Model files as scenes: against the same scenes described to Mitsuba, and their errors."""

from __future__ import annotations

import base64
import json
import struct
from collections import defaultdict

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from support import scenes
from support.patches import box
from support.running import run
from support.spectral import spectral_variant
from support.statistics import assert_agree
from support.tables import crossed

from etendue.core import SceneError
from etendue.scene import load, portable, restored, scene_xml
from etendue.scene.graph import below, contents, plugin_name

FLOOR = np.array([[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]])
LAMP = np.array([[-0.4, 1.5, -0.3], [0.2, 1.5, -0.3], [0.2, 1.5, 0.5], [-0.4, 1.5, 0.5]])
QUAD = [[0, 1, 2], [0, 2, 3]]
SIZE = (24, 18)
PICTURE = np.array([[[230, 40, 40], [40, 200, 40]], [[40, 40, 220], [200, 200, 60]]], np.uint8)

MTL = """newmtl floor
Kd 0.6 0.4 0.2
Ks 0 0 0
newmtl lamp
Kd 0 0 0
Ks 0 0 0
Ke 9 8 7
newmtl glass
Kd 1 1 1
Ni 1.4
d 0.2
illum 7
newmtl varnish
Kd 0.3 0.3 0.3
Ks 0.5 0.5 0.5
Ns 198
illum 2
newmtl veil
Kd 0.3 0.3 0.3
d 0.25
illum 1
newmtl picture
Kd 1 1 1
map_Kd picture.png
illum 1
"""


def obj(folder, materials=("floor", "lamp"), mtl=MTL):
    """The floor and the lamp as quadrilaterals, other materials on the floor's."""
    lines = ["mtllib room.mtl"]
    for points in (FLOOR, LAMP):
        lines += ["v " + " ".join(map(str, point)) for point in points]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    for number, name in enumerate(materials):
        first = 5 if name == "lamp" else 1
        lines += [f"usemtl {name}", f"o part{number}"]
        lines.append("f " + " ".join(f"{first + k}/{k + 1}" for k in range(4)))
    (folder / "room.mtl").write_text(mtl)
    (folder / "room.obj").write_text("\n".join(lines) + "\n")
    return folder / "room.obj"


def described(sensor):
    """The same scene by a dictionary."""
    floor = {"type": "twosided", "nested": scenes.diffuse(0.6, 0.4, 0.2)}
    dark = {"type": "twosided", "nested": scenes.diffuse(0.0, 0.0, 0.0)}
    return {
        "type": "scene",
        "sensor": sensor,
        "floor": scenes.mesh(FLOOR, np.array(QUAD), floor),
        "lamp": scenes.mesh(LAMP, np.array(QUAD), dark, emitter=scenes._area(9, 8, 7)),
    }


def gltf(folder, nodes, materials=(), **more):
    """A file with the mesh of the floor, once for each material, under ``nodes``."""
    data = FLOOR.astype(np.float32).tobytes() + np.array(QUAD, np.uint16).tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    corners = {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}
    corners |= {"min": FLOOR.min(0).tolist(), "max": FLOOR.max(0).tolist()}
    file = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "materials": list(materials),
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1} | ({"material": k} if materials else {})]}
            for k in range(max(len(materials), 1))
        ],
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48, "target": 34962},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12, "target": 34963},
        ],
        "accessors": [corners, {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
    } | more
    (folder / "room.gltf").write_text(json.dumps(file))
    return folder / "room.gltf"


def material(problem, name=""):
    """The parameters of all objects of a scene's material, those of equal names together."""
    shape = next(s for s in problem.scene.shapes() if name in s.id())
    found = defaultdict(list)
    for node in below(shape.bsdf()):
        for key, value in contents(node).values:
            found[f"{plugin_name(node)}.{key}"] += np.array(value).ravel().tolist()
    return found


def test_obj_with_materials(tmp_path):
    ours = load(obj(tmp_path), size=SIZE)
    assert len(ours.scene.shapes()) == 2 and len(ours.scene.emitters()) == 1
    problem = load(described(ours.sensor), size=SIZE)
    assert_agree(run(ours, "path", passes=6, samples=64).images, run(problem, "path", passes=6, samples=64).images)


def test_materials_of_mtl(tmp_path):
    Image.fromarray(PICTURE).save(tmp_path / "picture.png")
    problem = load(obj(tmp_path, ("lamp", "glass", "varnish", "veil", "picture")), size=SIZE)
    assert material(problem, "glass")["dielectric.eta"] == pytest.approx([1.4], rel=1e-3)
    assert material(problem, "varnish")["roughplastic.alpha"] == pytest.approx([0.1])
    assert material(problem, "veil")["uniformspectrum.value"] == pytest.approx([0.25])
    assert len(material(problem, "picture")["bitmap.data"]) == PICTURE.size


def test_texture_coordinates_of_obj(tmp_path):
    """The first row of a picture is at the top, where v is 1."""
    Image.fromarray(PICTURE).save(tmp_path / "picture.png")
    problem = load(obj(tmp_path, ("picture", "lamp")), size=SIZE)
    shape = next(s for s in problem.scene.shapes() if "picture" in s.id())
    ray = mi.Ray3f(mi.Point3f([-0.5, 0.5, 0.5], 1.0, [-0.5, -0.5, 0.5]), mi.Vector3f(0.0, -1.0, 0.0))
    seen = np.array(shape.bsdf().eval_diffuse_reflectance(problem.scene.ray_intersect(ray))).T
    # vt 0 0 is at (-1, -1), vt 1 0 at (-1, 1), vt 1 1 at (1, 1): the lower left, upper left and upper right texel.
    assert seen.argmax(1).tolist() == [2, 0, 1]


def test_gltf_camera_lights_and_materials(tmp_path):
    """A node with a rotation, a camera with a matrix, three lights."""
    turned = {"rotation": [0.0, np.sin(0.2), 0.0, np.cos(0.2)], "translation": [0.1, 0.0, 0.0], "scale": [1, 1, 0.8]}
    eye = np.array(mi.ScalarTransform4d().look_at([0.5, 2.0, 3.0], [0.2, 0.0, 0.0], [0.0, 1.0, 0.0]).matrix)
    eye = eye @ np.diag([-1.0, 1.0, -1.0, 1.0])
    lights = [
        {"type": "point", "intensity": 5.0, "color": [1.0, 0.5, 0.25]},
        {"type": "spot", "intensity": 20.0, "spot": {"outerConeAngle": 0.5, "innerConeAngle": 0.3}},
        {"type": "directional", "intensity": 0.5},
    ]
    down = [-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # -z becomes -y
    nodes = [
        {"children": [1, 2, 3, 4, 5], **{"translation": [0.0, 0.5, 0.0]}},
        {"mesh": 0} | turned,
        {"camera": 0, "matrix": eye.T.ravel().tolist()},
        *(
            {"translation": [0.3, 1.0 + k, 0.2], "rotation": down, "extensions": {"KHR_lights_punctual": {"light": k}}}
            for k in range(3)
        ),
    ]
    matte = {"name": "matte", "pbrMetallicRoughness": {"baseColorFactor": [0.6, 0.4, 0.2, 1], "metallicFactor": 0.0}}
    lens = {"type": "perspective", "perspective": {"yfov": 0.6, "znear": 0.1, "aspectRatio": 1.0}}
    extensions = {"KHR_lights_punctual": {"lights": lights}}
    ours = load(gltf(tmp_path, nodes, [matte], cameras=[lens], extensions=extensions), size=SIZE)

    def up(*place):
        return scenes.transform().translate([0.0, 0.5, 0.0]) @ scenes.transform().translate(list(place))

    place = up(0.1, 0.0, 0.0).rotate([0, 1, 0], np.rad2deg(0.4)).scale([1, 1, 0.8])
    points = FLOOR @ np.array(place.matrix)[:3, :3].T + np.array(place.matrix)[:3, 3]
    principled = {"type": "principled", "roughness": 1.0, "base_color": scenes.rgb(0.6, 0.4, 0.2)}
    to_floor = [up(0.3, 1.0 + k, 0.2).rotate([1, 0, 0], 90) for k in range(3)]
    camera = mi.ScalarTransform4f().look_at([0.5, 2.5, 3.0], [0.2, 0.5, 0.0], [0.0, 1.0, 0.0])
    expected = load(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": np.rad2deg(0.6), "fov_axis": "y", "to_world": camera},
            "floor": scenes.mesh(points, np.array(QUAD), {"type": "twosided", "nested": principled}),
            "point": {"type": "point", "position": [0.3, 1.5, 0.2], "intensity": scenes.rgb(5.0, 2.5, 1.25)},
            "spot": {"type": "spot", "to_world": to_floor[1], "intensity": 20.0}
            | {"cutoff_angle": np.rad2deg(0.5), "beam_width": np.rad2deg(0.3)},
            "sun": {"type": "directional", "to_world": to_floor[2], "irradiance": 0.5},
        },
        size=SIZE,
    )
    images = [run(problem, "path", passes=6, samples=64).images for problem in (ours, expected)]
    assert_agree(*images)


def test_materials_of_gltf(tmp_path):
    extensions = {
        "KHR_materials_emissive_strength": {"emissiveStrength": 7.0},
        "KHR_materials_transmission": {"transmissionFactor": 0.9},
        "KHR_materials_ior": {"ior": 1.3},
    }
    rough = {"metallicFactor": 0.25, "roughnessFactor": 0.35, "baseColorFactor": [0.123456, 0.5, 1, 0.5]}
    described = {"name": "all", "emissiveFactor": [1.0, 0.5, 0.0], "extensions": extensions, "alphaMode": "BLEND"}
    described["pbrMetallicRoughness"] = rough
    problem = load(gltf(tmp_path, [{"mesh": 0}], [described]), size=SIZE)
    found = material(problem)
    assert found["principled.eta"] == pytest.approx([1.3])
    assert {0.35, 0.25, 0.9, 0.5} <= {round(value, 5) for value in found["uniformspectrum.value"]}
    assert found["srgbreflectancespectrum.value"] == pytest.approx([0.123456, 0.5, 1.0])
    radiance = dict(contents(problem.scene.emitters()[0]).objects)["radiance"]
    assert np.array(contents(radiance).values[0][1]).ravel() == pytest.approx([7.0, 3.5, 0.0])


def test_dispersion_of_gltf(tmp_path, caplog):
    extensions = {
        "KHR_materials_transmission": {"transmissionFactor": 1.0},
        "KHR_materials_ior": {"ior": 1.6},
        "KHR_materials_dispersion": {"dispersion": 0.5},
    }
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.4, "baseColorFactor": [0.9, 0.5, 1, 1]}
    rough = {"name": "all", "extensions": extensions, "pbrMetallicRoughness": surface}
    smooth = rough | {"pbrMetallicRoughness": surface | {"roughnessFactor": 0.0}}
    assert "principled.eta" in material(load(gltf(tmp_path, [{"mesh": 0}], [rough]), size=SIZE))
    assert "rendered without it in RGB" in caplog.text
    with spectral_variant():
        for name, described in (("roughdispersive", rough), ("dispersive", smooth)):
            problem = load(gltf(tmp_path, [{"mesh": 0}], [described]), size=SIZE)
            (bsdf,) = {shape.bsdf() for shape in problem.scene.shapes()}
            assert plugin_name(bsdf) == name
            wavelengths = mi.SurfaceInteraction3f()
            wavelengths.wavelengths = mi.Spectrum(486.1327, 587.5618, 656.2725, 500.0)
            at_f, at_d, at_c, _ = (float(index[0]) for index in bsdf._indices(wavelengths))
            assert at_d == pytest.approx(1.6, abs=1e-5)
            assert (at_d - 1.0) / (at_f - at_c) == pytest.approx(40.0, rel=1e-3)


def test_a_model_without_camera_and_light(tmp_path, caplog):
    problem = load(obj(tmp_path, ("floor",)), size=SIZE)
    assert "no camera" in caplog.text and "no light" in caplog.text
    picture = run(problem, "path", passes=4, samples=512).mean
    sun = 3.0 / np.pi / np.sqrt(1.0 + 0.8**2 + 0.5**2)
    floor = np.array([0.6, 0.4, 0.2]) * (0.2 + sun)
    # One of two lights is picked by each of 2,048 samples: relative standard error 0.02, or less if stratified.
    assert picture[SIZE[1] // 2, SIZE[0] // 2] == pytest.approx(floor, rel=0.04)
    assert picture[0, 0] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("extent", "size"), crossed([(1, 1, 1), (30, 6, 20), (2, 5, 2), (4, 3, 12)], [(64, 48), (48, 72)], 2)
)
def test_a_bare_mesh_is_seen_whole_and_its_sides_differ(tmp_path, caplog, extent, size):
    """Whatever its shape and that of the picture: the border is sky, and three sides have light of their own."""
    vertices, faces = box((5, 5, 5), np.add(5, extent), 1)
    lines = [*(f"v {x} {y} {z}" for x, y, z in vertices), *(f"f {' '.join(map(str, face + 1))}" for face in faces), ""]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    problem = load(tmp_path / "a.obj", size=size)
    load(tmp_path / "a.obj", size=size)
    assert caplog.text.count("no camera") == 1  # told once
    picture = run(problem, "path", passes=1, samples=64).mean[..., 0]
    border = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    np.testing.assert_allclose(border, 0.2, rtol=0.05)  # the filter reaches over the margin
    inside = np.abs(picture - 0.2) > 0.02
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    assert max(np.ptp(rows), np.ptp(columns)) > 0.5 * min(size)
    shade, front, top = (0.5 / np.pi * (0.2 * np.pi + 3 * x / np.sqrt(1.89)) for x in (0.0, 0.5, 1.0))
    for side in (shade, front, top):
        assert np.count_nonzero(np.abs(picture - side) < 0.2 * side) >= 3


def test_a_model_is_sent_to_workers_and_written_as_xml(tmp_path):
    Image.fromarray(PICTURE).save(tmp_path / "picture.png")
    path = obj(tmp_path, ("picture", "lamp"))
    expected = run(load(path, size=SIZE), "path", passes=1, samples=4).mean
    source, parameters = restored(portable(path), tmp_path)
    assert (run(load(source, size=SIZE, parameters=parameters), "path", passes=1, samples=4).mean == expected).all()
    (tmp_path / "copy.xml").write_text(scene_xml(path, folder=tmp_path / "parts"))
    copy = run(load(tmp_path / "copy.xml", size=SIZE), "path", passes=1, samples=4).mean
    np.testing.assert_allclose(copy, expected, atol=1e-4)


def test_files_that_are_missing(tmp_path):
    path = obj(tmp_path, ("picture", "lamp"))
    with pytest.raises(SceneError, match=r"names picture\.png, which is not in its folder"):
        load(path)
    (tmp_path / "room.mtl").unlink()
    with pytest.raises(SceneError, match=r"names room\.mtl"):
        load(path)


def textured(folder, name="picture.png", **texture):
    """A file of one material with a picture, with texture coordinates of zero."""
    texture = {"index": 0} | texture
    described = {"pbrMetallicRoughness": {"baseColorTexture": texture, "metallicFactor": 0.0}}
    return gltf(folder, [{"mesh": 0}], [described], textures=[{"source": 0}], images=[{"uri": name}])


def test_pictures_of_gltf_that_are_missing_or_broken(tmp_path):
    path = textured(tmp_path)
    with pytest.raises(SceneError, match=r"names picture\.png, which is missing or broken"):
        load(path)
    Image.fromarray(np.repeat(PICTURE, 50, 0)).save(tmp_path / "picture.png")
    load(path, size=SIZE)
    (tmp_path / "picture.png").write_bytes((tmp_path / "picture.png").read_bytes()[:45])
    with pytest.raises(SceneError, match="missing or broken"):
        load(path)


def test_what_is_not_read_of_gltf(tmp_path, caplog):
    Image.fromarray(PICTURE).save(tmp_path / "picture.png")
    load(textured(tmp_path, texCoord=1), size=SIZE)
    assert "second set of coordinates" in caplog.text
    with pytest.raises(SceneError, match="requires KHR_mesh_quantization"):
        load(gltf(tmp_path, [{"mesh": 0}], extensionsRequired=["KHR_mesh_quantization"]))


@pytest.mark.parametrize("binary", [False, True])
def test_materials_of_gltf_without_names(tmp_path, binary):
    """Each has its own factors, which are taken from the file in full precision."""
    surfaces = [{"pbrMetallicRoughness": {"roughnessFactor": r, "metallicFactor": 0.25}} for r in (0.3, 0.7)]
    path = gltf(tmp_path, [{"children": [1, 2]}, {"mesh": 0, "name": "a"}, {"mesh": 1, "name": "b"}], surfaces)
    if binary:
        file = json.loads(path.read_text())
        data = base64.b64decode(file["buffers"][0].pop("uri").split(",")[1])
        text = json.dumps(file).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
        path = tmp_path / "room.glb"
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    problem = load(path, size=SIZE)
    for name, roughness in (("a-", 0.3), ("b-", 0.7)):
        assert roughness in [round(value, 5) for value in material(problem, name)["uniformspectrum.value"]]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.obj", "", "has no faces|cannot be read"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no faces|cannot be read"),
        ("broken.glb", "glTF", "cannot be read"),
        ("broken.gltf", "{}", "cannot be read|has no faces"),
        ("broken.ply", "ply\n", "cannot be read"),
    ],
)
def test_broken_models(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(SceneError, match=message):
        load(tmp_path / name)
