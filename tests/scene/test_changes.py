"""Changes of scenes: in place, of the file, and written as XML, all the same picture."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support.media import FOG, closed, fog
from support.tables import RGB_SCENES, thinned

import etendue
from etendue import methods
from etendue.core import OptionError, SceneError
from etendue.scene import (
    LightEdits,
    ParameterChanges,
    Problem,
    SceneEditor,
    load,
    name_elements,
    scene_xml,
)


def room() -> dict[str, Any]:
    """Parameters of every kind: colours, numbers, transforms, a vector; with and without a name in the file."""
    look = mi.ScalarTransform4f().look_at([0, 1, 5], [0, 1, 0], [0, 1, 0])
    return {
        "type": "scene",
        "camera": {"type": "perspective", "fov": 50, "to_world": look, "film": {"type": "hdrfilm"}},
        "white": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}}},
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "ref", "id": "white"},
        },
        "ball": {"type": "sphere", "center": [0.8, 0.6, 0], "radius": 0.6, "bsdf": {"type": "dielectric"}},
        "metal": {
            "type": "sphere",
            "center": [-0.8, 0.6, 0],
            "radius": 0.6,
            "bsdf": {"type": "roughconductor", "material": "Au", "alpha": 0.2},
        },
        "lamp": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 3, 0]).rotate([1, 0, 0], 90).scale(0.5),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [8, 7, 6]}},
        },
        "bulb": {"type": "point", "position": [2, 2, 2], "intensity": {"type": "rgb", "value": 3}},
    }


VALUES: dict[str, Any] = {
    "white.brdf_0.reflectance.value": [0.7, 0.2, 0.1],
    "ball.bsdf.eta": 1.2,
    "ball.to_world": [0.4, 0, 0, 0.8, 0, 0.4, 0, 0.9, 0, 0, 0.4, 0.2, 0, 0, 0, 1],
    "metal.bsdf.alpha.value": 0.4,
    "metal.bsdf.eta.value": [1.0, 2.0, 3.0],
    "metal.bsdf.k.value": [4.0, 3.0, 2.0],
    "lamp.emitter.radiance.value": [0.5, 0.0, 20.0],
    "lamp.to_world": [1, 0, 0, 1, 0, 0, -1, 3.5, 0, 1, 0, 0, 0, 0, 0, 1],
    "bulb.position": [-2.0, 1.0, 2.0],
    "bulb.intensity.value": [0.0, 9.0, 1.0],
}


def picture(problem: Problem, method: str = "bpt", **settings: Any) -> np.ndarray:
    kind = methods.get(method)
    made = kind(kind.Settings(samples_per_pass=4, max_depth=4, **settings))
    made.prepare(problem, 1)
    return made.develop(made.step(0, 1, made.start()).measurement, {}).image


@pytest.fixture(scope="module")
def changed() -> np.ndarray:
    """The picture of a scene that is read with the changes."""
    return picture(load(room(), size=(24, 16), change=ParameterChanges(VALUES)))


def test_values_in_place_give_the_picture_of_a_scene_read_with_them(changed: np.ndarray) -> None:
    problem = load(room(), size=(24, 16), change=ParameterChanges())
    before = picture(problem)
    editor = SceneEditor(problem.scene)
    assert {p.key for p in editor.list()} >= set(VALUES)
    originals = {key: editor.get(key).value for key in VALUES}
    editor.set(VALUES)
    after = picture(replace(problem))
    np.testing.assert_allclose(after, changed, rtol=2e-4, atol=1e-5)
    assert np.abs(after - before).max() > 0.1
    editor.set(originals)
    np.testing.assert_allclose(picture(replace(problem)), before, rtol=2e-4, atol=1e-5)


def test_media(tmp_path: Path) -> None:
    """In place and in the description: numbers, colours and a phase function, in a medium and below a shape."""
    medium = fog((0.3, 0.4, 0.5), 0.8, phase={"type": "hg", "g": 0.1})
    scene = {"type": "scene", "fog": medium} | closed(medium)
    own = {"type": "homogeneous", "sigma_t": {"type": "constvolume", "value": 0.4}, "albedo": 0.2}
    glass = {"type": "sphere", "radius": 0.4, "bsdf": {"type": "dielectric"}}
    scene["ball"] = glass | {"interior": own, "exterior": FOG}
    values: dict[str, Any] = {
        "fog.scale": 2.0,
        "fog.albedo.value.value": 0.5,
        "fog.sigma_t.value.value": [0.5, 0.4, 0.2],
        "fog.phase_function.g": -0.3,
        "ball.interior_medium.sigma_t.value.value": 0.9,
        "ball.interior_medium.albedo.value.value": 0.7,
    }
    problem = load(scene, size=(8, 8), change=name_elements)
    editor = SceneEditor(problem.scene)
    found = {p.key: p for p in editor.list() if p.group == "medium"}
    assert values.keys() <= found.keys()
    assert {p.label for p in found.values()} >= {"scale", "albedo", "sigma_t", "interior_medium.albedo"}
    assert {p.plugin for p in found.values()} == {"homogeneous", "hg"}
    editor.set(values)
    (tmp_path / "fog.xml").write_text(scene_xml(scene, None, ParameterChanges(values)))
    expected = picture(load(scene, size=(8, 8), change=ParameterChanges(values)))
    for other in (replace(problem), load(tmp_path / "fog.xml", size=(8, 8))):
        np.testing.assert_allclose(picture(other), expected, rtol=1e-3, atol=1e-4)
    for key, value in (("fog.albedo.value.value", 1.5), ("fog.scale", -1.0), ("fog.phase_function.g", 1.0)):
        with pytest.raises(OptionError):
            editor.check(key, value)


def test_a_prepared_method_has_old_tables_of_lights() -> None:
    """What a caller that does not prepare anew would get: the test above can fail."""
    problem = load(room(), size=(24, 16), change=ParameterChanges())
    kind = methods.get("bpt")
    made = kind(kind.Settings(samples_per_pass=4, max_depth=4))
    made.prepare(problem, 1)
    SceneEditor(problem.scene).set({"lamp.to_world": VALUES["lamp.to_world"]})
    stale = made.develop(made.step(0, 1, made.start()).measurement, {}).image
    fresh = picture(replace(problem))
    assert not np.allclose(stale, fresh, rtol=1e-2)


def test_the_written_scene_has_the_changes(changed: np.ndarray, tmp_path: Path) -> None:
    file = tmp_path / "room.xml"
    mi.parser.write_file(_parsed(room(), ParameterChanges(VALUES)), str(file))
    np.testing.assert_allclose(picture(load(file, size=(24, 16))), changed, rtol=2e-3, atol=1e-4)


def test_plugins_in_python_are_written() -> None:
    scene = room() | {"integrator": {"type": "vcm", "max_depth": 5}}
    scene["metal"]["bsdf"] = {"type": "phong"}
    text = scene_xml(scene, None, ParameterChanges({"bulb.position": (1.0, 2.0, 3.0)}))
    assert re.search(r'name="position" [^/]*1[^/]*2[^/]*3', text)
    assert '<integrator type="vcm"' in text and '<bsdf type="phong"' in text


def _parsed(scene: dict[str, Any], change: ParameterChanges) -> mi.parser.ParserState:
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_dict(config, scene)
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve(config, state)
    change(state)
    return state


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("white.brdf_0.reflectance.value", [0.5, math.nan, 0.5], "numbers, not nan"),
        ("white.brdf_0.reflectance.value", [0.5, 1.5, 0.5], "at most 1"),
        ("white.brdf_0.reflectance.value", [0.5, 0.5], "3 numbers"),
        ("lamp.emitter.radiance.value", [-1, 0, 0], "at least 0"),
        ("metal.bsdf.alpha.value", 0.0, "above 0"),
        ("metal.bsdf.alpha.value", "rough", "a number"),
        ("ball.to_world", [0.0] * 15 + [1.0], "flat"),
        ("white.brdf_0.reflektance", [1, 1, 1], "did you mean"),
    ],
)
def test_a_value_that_is_refused_changes_nothing(key: str, value: Any, words: str) -> None:
    problem = load(room(), size=(8, 8), change=ParameterChanges())
    editor = SceneEditor(problem.scene)
    before = [p.value for p in editor.list()]
    with pytest.raises(OptionError, match=words) as error:
        editor.set({"bulb.intensity.value": [1, 1, 1], key: value})
    assert "\n" not in str(error.value)
    assert [p.value for p in editor.list()] == before


def test_elements_without_a_name_get_one_that_a_removed_light_does_not_change() -> None:
    text = """<scene version="3.0.0"><sensor type="perspective"/>
        <shape type="sphere"><emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
        <emitter type="constant"/><emitter type="point"/>
        <shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape></scene>"""
    for removed in (set(), {0}, {2}):  # the constant light, the first sphere's
        state = mi.parser.parse_string(config := mi.parser.ParserConfig(mi.variant()), text)
        mi.parser.transform_resolve(config, state)
        LightEdits(frozenset(removed))(state)
        ParameterChanges({"sphere-2.bsdf.reflectance.value": [0.1, 0.2, 0.3], "point-1.position": [1, 2, 3]})(state)
        editor = SceneEditor(mi.parser.instantiate(config, state))
        assert editor.get("sphere-2.bsdf.reflectance.value").value == pytest.approx([0.1, 0.2, 0.3])
        assert editor.get("point-1.position").value == [1, 2, 3]


@pytest.mark.parametrize("metal", ["conductor", "roughconductor"])
def test_a_perfect_mirror_can_become_another_metal(metal: str) -> None:
    """Without a material its constants are numbers, which are not those of glass."""
    scene = room()
    scene["metal"]["bsdf"] = {"type": metal, "material": "none"}
    scene["spot"] = {"type": "spot", "to_world": mi.ScalarTransform4f().look_at([0, 3, 0], [0, 0, 0], [1, 0, 0])}
    keys = [p.key for p in SceneEditor(load(scene, change=ParameterChanges()).scene).list()]
    assert not any("texture" in key for key in keys)  # a file cannot give the spot light a plain one
    key = next(key for key in keys if key.startswith("metal.bsdf.eta"))
    changed = SceneEditor(load(scene, change=ParameterChanges({key: 0.25, key.replace(".eta", ".k"): 2.0})).scene)
    assert changed.get(key).value == 0.25


def test_an_added_light_does_not_replace_one_of_the_file(tmp_path: Path) -> None:
    """As in a scene that was written with an added light; the parameters of both can be changed."""
    lamp = {"id": "added-light-1", "type": "point", "position": [0.0, 2.0, 0.0]}
    path = tmp_path / "lit.xml"
    path.write_text(scene_xml(room(), None, LightEdits(added=(lamp,))))
    before = len(load(path).scene.emitters())
    again = load(path, change=LightEdits(added=({**lamp, "position": [0.0, 1.0, 0.0]},)))
    assert len(again.scene.emitters()) == before + 1
    found = [p.value for p in SceneEditor(again.scene).list() if p.key.endswith(".position")]
    assert sorted(value[1] for value in found) == [1.0, 2.0, 2.0]  # the room has one, too
    # A name stays when the light before is removed.
    two = (lamp, {**lamp, "id": "added-light-2"})
    for added in (two, two[1:]):
        edited = load(room(), change=LightEdits(added=added))
        assert "added-light-2.position" in {p.key for p in SceneEditor(edited.scene).list()}


@pytest.mark.usefixtures("mitsuba_files")
def test_a_texture_by_file(tmp_path: Path) -> None:
    """The picture of a texture in a changed scene is that of a scene with the other file; and of a sky."""
    scene = room()
    for name, value in (("dark", 0.1), ("red", 0.8)):
        pixels = np.full((4, 8, 3), value, np.float32) * [1.0, 0.2, 0.1]
        mi.Bitmap(pixels.astype(np.float32)).write(str(tmp_path / f"{name}.exr"))
    dark, red = (str(tmp_path / f"{name}.exr") for name in ("dark", "red"))
    scene["white"]["bsdf"]["reflectance"] = {"type": "bitmap", "filename": dark}
    scene["sky"] = {"type": "envmap", "filename": dark}
    editor = SceneEditor(load(scene, size=(8, 8), change=ParameterChanges()).scene)
    texture, sky = "white.brdf_0.reflectance.data", "sky.data"
    assert (editor.get(texture).kind, editor.get(texture).value) == ("texture", "8 x 4")
    with pytest.raises(OptionError, match="no"):
        editor.check(texture, str(tmp_path / "missing.png"))
    changed = load(scene, size=(8, 8), change=ParameterChanges({texture: red, sky: red}))
    scene["white"]["bsdf"]["reflectance"]["filename"] = scene["sky"]["filename"] = red
    np.testing.assert_allclose(picture(changed, "path"), picture(load(scene, size=(8, 8)), "path"), rtol=1e-3)


def _parameters(problem: Problem) -> dict[str, Any]:
    """Numbers of all that a scene has, by name; what XML does not name is numbered in the order of the scene."""
    values = mi.traverse(problem.scene)
    found = {key: getattr(values[key], "matrix", values[key]) for key in values.keys()}  # noqa: SIM118
    return {key: np.asarray(value, float).ravel() for key, value in found.items() if value is not None}


@pytest.mark.parametrize("name", thinned(RGB_SCENES, ("caustics", "cornell-box", "yard", "stage", "fog")))
def test_bundled_scenes_as_xml(name: str, tmp_path: Path) -> None:
    """Meshes and bitmaps in memory become files; nothing is lost but the last digits."""
    (tmp_path / "scene.xml").write_text(scene_xml(name, folder=tmp_path / "scene-files"))
    one, other = (load(source, change=name_elements) for source in (name, tmp_path / "scene.xml"))
    assert (one.size, one.max_depth, one.integrator, one.spp) == (
        other.size,
        other.max_depth,
        other.integrator,
        other.spp,
    )
    before, after = ([values for _, values in sorted(_parameters(p).items())] for p in (one, other))
    sizes = [sorted(values.size for values in found) for found in (before, after)]
    assert sizes[0] == sizes[1]
    total, again = (np.sort([np.abs(values).sum() for values in found]) for found in (before, after))
    np.testing.assert_allclose(again, total, rtol=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 0.01, 1.0, 45.0, 400.0, 1e5])
def test_scales_as_xml(scale: float, tmp_path: Path) -> None:
    """A matrix is read as it was written, in a shape and in a texture of its material."""
    turned = mi.ScalarTransform4d().translate([1, 2, 3]).rotate([0.6, 0.8, 0], 40).scale([scale, scale, 2 * scale])
    checks = {"type": "checkerboard", "to_uv": mi.ScalarTransform4d().scale([scale, 3 * scale, 1])}
    plate = {"type": "rectangle", "to_world": turned, "bsdf": {"type": "diffuse", "reflectance": checks}}
    scene = room() | {"plate": plate}
    (tmp_path / "scene.xml").write_text(scene_xml(scene))
    one, other = (_parameters(load(source, change=name_elements)) for source in (scene, tmp_path / "scene.xml"))
    for end in ("plate.to_world", "to_uv"):
        (key,) = [name for name in one if name.endswith(end)]
        np.testing.assert_allclose(other[key], one[key], rtol=1e-5, atol=1e-6 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("name", RGB_SCENES)
def test_bundled_scenes_as_xml_give_the_same_picture(name: str, tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(scene_xml(name, folder=tmp_path / "scene-files"))
    settings = {"spp": 16, "size": (48, 36), "max_depth": 4, "seed": 3}
    one, other = (etendue.render(source, "path", **settings).image for source in (name, tmp_path / "scene.xml"))
    assert np.mean(other) == pytest.approx(np.mean(one), rel=2e-3)
    assert np.median(np.abs(other - one)) <= 1e-3 * np.mean(one)


def test_objects_in_memory_need_a_folder_and_unknown_ones_are_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="the mesh 'water' in memory"):
        scene_xml("caustics")
    scene = room() | {"own": mi.load_dict({"type": "sphere"})}
    with pytest.raises(SceneError, match="object in memory"):
        scene_xml(scene, folder=tmp_path / "files")
    assert not (tmp_path / "files").exists()


@pytest.mark.parametrize("is_raw", [False, True])
def test_a_bitmap_in_memory_is_the_same_texture(is_raw: bool, tmp_path: Path) -> None:
    """Eight bits with the sRGB curve, which a raw texture does not undo."""
    pixels = np.random.default_rng(2).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    scene = room()
    scene["white"]["bsdf"]["reflectance"] = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": is_raw}
    (tmp_path / "scene.xml").write_text(scene_xml(scene, folder=tmp_path / "files"))
    found = []
    for source in (scene, tmp_path / "scene.xml"):
        values = mi.traverse(load(source).scene)
        found.append(np.asarray(next(values[k] for k in values.keys() if k.endswith("reflectance.data"))))  # noqa: SIM118
    np.testing.assert_allclose(found[1], found[0], rtol=2e-3, atol=1e-6)
