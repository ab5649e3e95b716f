"""Transforms of every kind of element: used as Mitsuba's `path` uses them, corrected, or refused by name."""

import logging

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import etendue
from etendue.core import OptionError, SceneError
from etendue.scene import SceneEditor, load, scene_xml, uniform_point

CHANGES = ("rotation", "mirror", "scale", "stretch", "shear", "flat", "long axis")
#: The outcome for each change: "y" as it is, "1" without its scale, "n" refused.
OUTCOMES = {
    "envmap": "yy1nnnn",
    "sunsky": "yy1nnnn",
    "sky": "yy1nnnn",
    "directional": "yy1nnnn",
    "spot": "yy1nnnn",
    "projector": "yy1nnnn",
    "point": "yyyyyyy",
    "perspective": "yynnnnn",
    "thinlens": "yynnnnn",
    "spherical": "yynnnnn",
    "orthographic": "yyyyynn",
    "rectangle": "yyyyynn",
    "disk": "yyyyynn",
    "cube": "yyyyynn",
    "ply": "yyyyynn",
    "instance": "yyyyynn",
    "shapegroup": "yyyyynn",
    "sphere": "yyynnnn",
    "cylinder": "yyynnnn",
    "lit sphere": "yyynnnn",
    "lit cylinder": "ynynnnn",
    "texture": "yyyyyyn",
}
LIGHTS = ("envmap", "sunsky", "sky", "directional", "spot", "projector", "point")
SENSORS = ("perspective", "thinlens", "spherical", "orthographic")


def T(*matrix):
    return mi.ScalarTransform4d(*matrix)


def transform(change):
    sheared = np.eye(4)
    sheared[0, 1] = 0.7
    return {
        "none": T(),
        "rotation": T().rotate([0.6, 0, 0.8], 50),
        "mirror": T().scale([-1, 1, 1]),
        "scale": T().scale(3),
        "stretch": T().scale([2, 1, 1]),
        "shear": T(sheared),
        "flat": T().scale([1, 1, 0]),
        "long axis": T().rotate([1, 1, 0], 50),
    }[change]


def picture():
    return mi.Bitmap(np.random.default_rng(5).random((4, 8, 3)).astype(np.float32))


def described(kind, change, folder):
    """A scene with an element 'it' of a kind."""
    cube, it = {"type": "cube"}, {"type": kind.split()[-1], "to_world": change}
    scene = {"type": "scene", "floor": {"type": "rectangle"}, "it": it}
    if kind.startswith("lit "):
        it["emitter"] = {"type": "area"}
    match kind:
        case "envmap":
            it["bitmap"] = picture()
        case "sky":
            it |= {"kind": 1, "zenith_luminance": 683.0}
        case "projector":
            it["irradiance"] = {"type": "bitmap", "bitmap": picture()}
        case "thinlens":
            it["aperture_radius"] = 0.1
        case "instance":
            scene |= {"group": {"type": "shapegroup", "cube": cube}, "it": it | {"group": reference("group")}}
        case "shapegroup":
            group = {"type": "shapegroup", "it": cube | {"to_world": change}}
            scene |= {"group": group, "it": {"type": "instance", "group": reference("group")}}
        case "texture":
            texture = {"type": "checkerboard", "id": "it too", "to_uv": change}
            scene["it"] = {"type": "disk", "bsdf": {"type": "diffuse", "reflectance": texture}}
        case "ply":
            it["filename"] = str(folder / "it.ply")
            mi.load_dict(cube).write_ply(it["filename"])
    if kind not in SENSORS:
        scene["camera"] = {"type": "perspective"}
    if kind not in LIGHTS:
        scene["light"] = {"type": "constant"}
    return scene


def reference(name):
    return {"type": "ref", "id": name}


@pytest.mark.parametrize("kind", OUTCOMES)
def test_transforms_of_every_kind_of_element(kind, tmp_path):
    for name, outcome in zip(CHANGES, OUTCOMES[kind], strict=True):
        change = transform(name)
        scene = described(kind, change, tmp_path)
        if outcome == "n":
            with pytest.raises(SceneError, match=r"\bit\b|sensor"):
                load(scene)
            continue
        problem = load(scene)
        if kind in LIGHTS and kind != "point":
            matrix = np.asarray(mi.traverse(problem.scene)["it.to_world"].matrix, float).reshape(4, 4)
            expected = np.eye(4) if outcome == "1" else np.asarray(change.matrix)
            assert np.allclose(matrix, expected, atol=1e-6), name


@pytest.mark.parametrize(
    "kind", ["envmap", "sunsky", "sky", "directional", "spot", "instance", "lit sphere", "lit cylinder"]
)
def test_transforms_of_loaded_scenes(kind, tmp_path):
    for name, outcome in zip(CHANGES, OUTCOMES[kind], strict=True):
        loaded = mi.load_dict(described(kind, transform(name), tmp_path))
        if outcome == "y":
            load(loaded)
        else:
            with pytest.raises(SceneError, match=r"'it' of type .*'to_world'"):
                load(loaded)


@pytest.mark.slow
def test_the_scale_of_an_environment_changes_no_picture(tmp_path, caplog):
    pictures = {}
    for scale in (1.0, 4.0, 0.2):  # a warning is given once for each text
        turn = T().rotate([1, 0, 0], 70).scale(scale)
        scene = described("envmap", turn, tmp_path)
        scene["camera"] |= {"to_world": T().look_at([0, -4, 3], [0, 0, 0], [0, 0, 1])}
        with caplog.at_level(logging.WARNING, "etendue"):
            caplog.clear()
            for method in ("path", "bpt"):
                result = etendue.render(scene, method=method, size=(8, 8), spp=16, max_depth=3, seed=1)
                pictures.setdefault(method, []).append(np.asarray(result.image))
        assert len([r for r in caplog.records if "'it' of type 'envmap' has a scale" in r.message]) == (scale != 1.0)
    for found in pictures.values():
        assert np.allclose(found[0], found[1], rtol=1e-4)
        assert np.allclose(found[0], found[2], rtol=1e-4)


def test_rounded_numbers_are_accepted(tmp_path):
    turn = np.round(np.asarray(T().rotate([0.6, 0, 0.8], 50).matrix), 4)
    axis = T().rotate([0.577, 0.577, 0.577], 120)
    for kind in ("envmap", "spot", "rectangle", "sphere", "cylinder", "instance"):
        for change in (T(turn), axis):
            problem = load(described(kind, change, tmp_path))
            stored = mi.traverse(problem.scene)["it.to_world"]
            both = np.asarray(stored.matrix, float).reshape(4, 4) @ np.asarray(stored.inverse().matrix).reshape(4, 4)
            assert np.allclose(both, np.eye(4), atol=1e-5)


@pytest.mark.usefixtures("mitsuba_files")
def test_scenes_in_xml(tmp_path):
    turn = '<rotate x="1" y="1" angle="50"/>'
    text = """<scene version="3.0.0"><sensor type="perspective"/><shape type="sphere"/><emitter type="envmap" id="sky">
      <string name="filename" value="sky.exr"/><transform name="to_world">{}</transform></emitter></scene>"""
    picture().write(str(tmp_path / "sky.exr"))
    (tmp_path / "scene.xml").write_text(text.format(turn))
    with pytest.raises(SceneError, match="emitter 'sky' of type 'envmap' has a 'to_world' whose inverse"):
        load(tmp_path / "scene.xml")
    (tmp_path / "scene.xml").write_text(text.format('<scale value="3"/>'))
    problem = load(tmp_path / "scene.xml")
    written = tmp_path / "written.xml"
    written.write_text(scene_xml(tmp_path / "scene.xml"))
    for found in (problem, load(written)):
        assert np.allclose(np.asarray(mi.traverse(found.scene)["sky.to_world"].matrix).reshape(4, 4), np.eye(4))


def test_a_cylinder_may_be_stretched_along_its_axis_only(tmp_path):
    scene = described("lit cylinder", T().scale([4, 1, 1]), tmp_path)
    load(scene | {"it": scene["it"] | {"p0": [-1, 0, 0], "p1": [1, 0, 0]}})
    with pytest.raises(SceneError, match=r"'it' of type 'cylinder'.*elliptic"):
        load(scene)


def test_edited_transforms_are_checked(tmp_path):
    for kind, change, why in (("envmap", "scale", "scales"), ("sphere", "shear", "ellipsoid")):
        editor = SceneEditor(load(described(kind, T(), tmp_path), change=lambda state: None).scene)
        with pytest.raises(OptionError, match=f"'it' .*{why}"):
            editor.set({"it.to_world": np.asarray(transform(change).matrix).ravel().tolist()})


@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "cylinder", "cube"])
def test_points_of_lamps_are_points_of_what_rays_hit(kind, tmp_path):
    rng = np.random.default_rng(2)
    outcomes = OUTCOMES[f"lit {kind}" if kind in ("sphere", "cylinder") else kind]
    for name in (name for name, outcome in zip(CHANGES, outcomes, strict=True) if outcome == "y"):
        for flip in (False, True):
            shape = mi.load_dict({"type": kind, "to_world": transform(name), "flip_normals": flip})
            alone = mi.load_dict({"type": "scene", "shape": shape})
            place = uniform_point(shape, mi.Point2f(rng.random((2, 64), np.float32)))
            si = alone.ray_intersect(mi.Ray3f(place.p + 0.01 * place.n, -mi.Vector3f(place.n)))
            assert np.allclose(np.asarray(si.t), 0.01, atol=1e-4)
            assert np.allclose(np.asarray(dr.dot(si.sh_frame.n, place.n)), 1.0, atol=1e-4)
