"""Every door into a Problem, and what each says of a broken scene."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from etendue.core import OptionError, SceneError
from etendue.scene import bundled_scene, integrator_of, load, locate

SENSOR = '<sensor type="perspective"><film type="hdrfilm"/></sensor>'
LIGHT = '<emitter type="constant"/><shape type="sphere"/>'


def xml(tmp_path, body, version="3.0.0", name="scene.xml"):
    path = tmp_path / name
    path.write_text(f'<scene version="{version}">\n{body}\n</scene>')
    return path


def camera_rays(problem):
    """Directions through the corners of the picture."""
    corners = mi.Point2f([0.0, 1.0, 0.0, 1.0, 0.37], [0.0, 0.0, 1.0, 1.0, 0.81])
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, corners, mi.Point2f(0.5))
    return np.concatenate([np.array(ray.o), np.array(ray.d)])


def test_what_a_scene_asked_for_is_reported(tmp_path):
    path = xml(
        tmp_path,
        '<default name="depth" value="5"/><integrator type="path"><integer name="max_depth" value="$depth"/>'
        '<integer name="rr_depth" value="9"/></integrator>' + LIGHT + '<sensor type="perspective">'
        '<sampler type="independent"><integer name="sample_count" value="37"/></sampler>'
        '<film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="30"/></film></sensor>',
    )
    problem = load(path)
    assert (problem.size, problem.spp, problem.max_depth) == ((40, 30), 37, 5)
    assert (problem.integrator, problem.integrator_options) == ("path", {"rr_depth": 9})
    assert problem.source == str(path)
    assert load(path, parameters={"depth": 11}).max_depth == 11
    assert load(str(path), memory=1 << 20).memory == 1 << 20


@pytest.mark.parametrize("integrator", ["path_guiding_integrator", "ptracer", "vcm"])
def test_a_scene_written_for_another_integrator_loads(tmp_path, integrator):
    options = '<integer name="max_depth" value="7"/><float name="strength" value="2.5"/>'
    problem = load(xml(tmp_path, f'<integrator type="{integrator}">{options}</integrator>{LIGHT}{SENSOR}'))
    assert (problem.integrator, problem.max_depth) == (integrator, 7)
    assert problem.integrator_options == {"strength": 2.5}
    described = {"type": integrator, "max_depth": 7, "strength": 2.5}
    problem = load(
        {
            "type": "scene",
            "integrator": described,
            "l": {"type": "constant"},
            "b": {"type": "sphere"},
            "s": {"type": "perspective"},
        }
    )
    assert (problem.integrator, problem.max_depth, problem.integrator_options) == (integrator, 7, {"strength": 2.5})


def test_the_integrator_is_known_without_building_the_scene(tmp_path):
    path = xml(tmp_path, '<integrator type="bpt"/><shape type="ply"><string name="filename" value="no.ply"/></shape>')
    assert integrator_of(path) == "bpt"
    scene = mi.cornell_box()
    assert integrator_of(scene) == integrator_of(mi.load_dict(scene)) == integrator_of("cornell-box") == "path"
    del scene["integrator"]
    assert integrator_of(scene) == ""


def test_an_undefined_variable_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"give it a value \(-P depth=VALUE, or `parameters`\)"):
        load(xml(tmp_path, '<integrator type="path"><integer name="max_depth" value="$depth"/></integrator>'))


def test_a_wrapped_integrator_is_found(tmp_path):
    inner = '<integrator type="volpath"><integer name="max_depth" value="3"/></integrator>'
    body = f'<integrator type="aov"><string name="aovs" value="d:depth"/>{inner}</integrator>{LIGHT}{SENSOR}'
    problem = load(xml(tmp_path, body))
    assert (problem.integrator, problem.max_depth) == ("volpath", 3)


def test_old_scene_files_are_upgraded(tmp_path):
    old = (
        LIGHT + '<sensor type="perspective"><transform name="toWorld"><lookat origin="0,0,4" target="0,0,0"/>'
        '</transform><film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="16"/>'
        '<integer name="cropOffsetX" value="8"/><integer name="cropOffsetY" value="4"/>'
        '<integer name="cropWidth" value="16"/><integer name="cropHeight" value="8"/></film></sensor>'
    )
    path = xml(tmp_path, old, version="0.5.0")
    assert load(path).size == (16, 8)
    assert load(path, size=(64, 32)).size == (32, 16)


def film_variants():
    for axis in ("x", "y", "smaller", "larger", "diagonal"):
        yield pytest.param({"fov": 40.0, "fov_axis": axis}, {}, id=axis)
    yield pytest.param({"focal_length": "35mm"}, {}, id="focal-length")
    yield pytest.param({"fov": 40.0, "principal_point_offset_x": 0.1, "principal_point_offset_y": -0.05}, {}, id="pp")
    crop = {"crop_offset_x": 12, "crop_offset_y": 6, "crop_width": 24, "crop_height": 18}
    yield pytest.param({"fov": 40.0, "fov_axis": "y"}, crop, id="crop")


@pytest.mark.parametrize(("lens", "crop"), list(film_variants()))
def test_another_size_is_what_the_file_would_have_meant(lens, crop):
    def scene(width, height, scale):
        film = {"type": "hdrfilm", "width": width, "height": height} | {k: v * scale for k, v in crop.items()}
        to_world = mi.ScalarTransform4f().look_at([3, 1, 2], [0, 0, 0], [0, 1, 0])
        sensor = {"type": "perspective", "to_world": to_world, "film": film} | lens
        return {"type": "scene", "light": {"type": "constant"}, "ball": {"type": "sphere"}, "sensor": sensor}

    written = load(scene(120, 90, 2))
    resized = load(scene(60, 45, 1), size=(120, 90))
    assert resized.size == written.size
    np.testing.assert_allclose(camera_rays(resized), camera_rays(written), atol=1e-6)
    assert resized.fingerprint == written.fingerprint
    # another aspect: the axis of the field of view decides
    if not crop:
        np.testing.assert_allclose(
            camera_rays(load(scene(60, 45, 1), size=(30, 70))), camera_rays(load(scene(30, 70, 1))), atol=1e-6
        )


@pytest.mark.parametrize("kind", ["perspective", "thinlens"])
def test_a_loaded_scene_is_resized_in_a_copy(kind):
    def scene(size):
        film = {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "tent"}}
        sensor = {"type": kind, "fov": 33.0, "near_clip": 0.5, "film": film}
        sensor["to_world"] = mi.ScalarTransform4f().look_at([3, 1, 2], [0, 0, 0], [0, 1, 0])
        if kind == "thinlens":
            sensor |= {"aperture_radius": 0.2, "focus_distance": 3.5}
        else:
            sensor |= {"principal_point_offset_x": 0.1}
        return mi.load_dict({"type": "scene", "l": {"type": "constant"}, "b": {"type": "sphere"}, "s": sensor})

    small, wide = scene((40, 30)), scene((90, 20))
    problem = load(small, size=(90, 20))
    assert problem.scene is small and tuple(small.sensors()[0].film().size()) == (40, 30)
    assert problem.size == (90, 20)
    np.testing.assert_allclose(camera_rays(problem), camera_rays(load(wide)), atol=1e-6)
    assert problem.fingerprint == load(wide).fingerprint
    point = dict(ref=mi.Interaction3f, sample=mi.Point2f(0.3, 0.6))
    it = point["ref"]()
    it.p = mi.Point3f(0.1, 0.2, -0.1)
    ours, _ = problem.sensor.sample_direction(it, point["sample"])
    theirs, _ = wide.sensors()[0].sample_direction(it, point["sample"])
    np.testing.assert_allclose(np.array(ours.uv), np.array(theirs.uv), rtol=1e-5)


def test_a_loaded_scene_reports_its_integrator():
    scene = mi.load_dict(mi.cornell_box())
    problem = load(scene)
    assert (problem.scene, problem.sensor) == (scene, scene.sensors()[0])
    assert (problem.integrator, problem.max_depth, problem.spp) == ("path", 8, 64)


def test_the_second_sensor(tmp_path):
    second = '<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="9"/></film></sensor>'
    path = xml(tmp_path, LIGHT + SENSOR + second)
    assert load(path, sensor=1).size == (9, 576)
    with pytest.raises(OptionError, match="no sensor 2; choose one of 0 to 1"):
        load(path, sensor=2)


def test_a_sensor_without_film_can_be_resized(tmp_path):
    assert load(xml(tmp_path, LIGHT + '<sensor type="perspective"/>'), size=(7, 5)).size == (7, 5)


PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 {z}
0 1 0
3 0 1 {last}
"""

BROKEN = {
    "end tag": ('<shape type="sphere">', SceneError, r"Parsing .* \(line \d+, col \d+\)"),
    "texture": (
        '<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        '<string name="filename" value="none.png"/></texture></bsdf></shape>',
        SceneError,
        r"line 2.*none\.png.*put the file there",
    ),
    "mesh": (
        '<shape type="ply"><string name="filename" value="none.ply"/></shape>',
        SceneError,
        r"none\.ply.*put the file there",
    ),
    "plugin": ('<shape type="spehre"/>', SceneError, r'line 2.*"spehre" not found.*correct the name'),
    "property": ('<shape type="sphere"><float name="radios" value="1"/></shape>', SceneError, r'"radios".*remove it'),
    "number": ('<shape type="sphere"><float name="radius" value="big"/></shape>', SceneError, r'line 2.*"big"'),
    "reference": ('<shape type="sphere"><ref id="nobody"/></shape>', SceneError, r'unresolved reference to "nobody"'),
    "variable": ('<integrator type="$which"/>', SceneError, r"undefined parameter: \$which.*<default>"),
    "no sensor": (LIGHT, SceneError, r"has no sensor.*add a 'perspective'"),
    "no emitter": (SENSOR + '<shape type="sphere"/>', SceneError, r"no emitter.*black"),
    "no shape": (SENSOR + '<emitter type="constant"/>', SceneError, r"no shape.*add geometry"),
    "no pixels": (
        LIGHT + '<sensor type="perspective"><film type="hdrfilm"><integer name="height" value="0"/></film></sensor>',
        SceneError,
        r"film's height is 0",
    ),
    "NaN radiance": (
        '<emitter type="point" id="lamp"><rgb name="intensity" value="1, nan, 1"/></emitter>' + LIGHT + SENSOR,
        SceneError,
        r"'lamp' of type 'point'.*NaN.*'value'",
    ),
    "NaN material": (
        '<shape type="sphere" id="ball"><bsdf type="roughconductor"><float name="alpha" value="nan"/></bsdf></shape>'
        + LIGHT
        + SENSOR,
        SceneError,
        r"shape 'ball'.*NaN",
    ),
    "infinite vertex": (
        '<shape type="ply" id="leaf"><string name="filename" value="inf.ply"/></shape>' + LIGHT + SENSOR,
        SceneError,
        r"(inf\.ply|'leaf').*",
    ),
    "index": (
        '<shape type="ply" id="leaf"><string name="filename" value="index.ply"/></shape>'
        '<shape type="ply"><string name="filename" value="fine.ply"/></shape>' + LIGHT + SENSOR,
        SceneError,
        r"'leaf' of type 'ply' has a face \(0\) with vertex 7, but only 3 vertices",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_files_get_one_line(tmp_path, case):
    (tmp_path / "inf.ply").write_text(PLY.format(z="inf", last=2))
    (tmp_path / "index.ply").write_text(PLY.format(z=0, last=7))
    (tmp_path / "fine.ply").write_text(PLY.format(z=0, last=2))
    body, error, text = BROKEN[case]
    with pytest.raises(error, match=text) as caught:
        load(xml(tmp_path, body))
    assert "\n" not in str(caught.value) and ".cpp:" not in str(caught.value)


def test_nan_in_a_mesh_is_named():
    mesh = mi.Mesh("torn", 3, 1)
    params = mi.traverse(mesh)
    params["vertex_positions"] = [0, 0, 0, 1, 0, 0, 0, float("nan"), 0]
    params["faces"] = [0, 1, 2]
    params.update()
    scene = {
        "type": "scene",
        "torn": mesh,
        "l": {"type": "constant"},
        "b": {"type": "sphere"},
        "s": {"type": "perspective"},
    }
    with pytest.raises(SceneError, match=r"'torn'.*NaN.*vertex_positions of vertex 2"):
        load(scene)


@pytest.mark.parametrize(
    ("beside", "taken", "said"),
    [
        ([], "bundled", None),
        (["stage/"], "bundled", "read as the bundled scene; the folder of that name has no scene.xml"),
        (["stage/", "stage/scene.xml"], "stage/scene.xml", "read as the file stage/scene.xml, not as the bundled"),
        (["stage"], "stage", "read as the file stage, not as the bundled scene"),
        (["stage.xml"], "bundled", None),
    ],
)
def test_a_file_goes_before_a_bundled_scene_and_a_bare_folder_after(beside, taken, said, tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    caplog.set_level("INFO")
    small = SENSOR.replace("/></sensor>", '><integer name="width" value="7"/></film></sensor>')
    for name in beside:
        if name.endswith("/"):
            (tmp_path / name).mkdir()
        else:
            xml(tmp_path, LIGHT + small, name=name)
    found = locate("stage")
    assert found == (bundled_scene("stage") if taken == "bundled" else Path(taken))
    messages = [m for m in caplog.messages if "is read as" in m]
    assert [said in m for m in messages] == ([] if said is None else [True])
    caplog.clear()
    assert (integrator_of("stage"), load("stage").size[0]) == (("vcm", 512) if taken == "bundled" else ("", 7))
    assert len([m for m in caplog.messages if "is read as" in m]) == (said is not None)
    # What is named without ambiguity is what is meant.
    assert load(bundled_scene("stage")).source == "stage"
    if "stage/" in beside and taken != "bundled":
        assert load("./stage").size[0] == load(tmp_path / "stage").size[0] == 7


def test_a_bundled_scene_that_is_none():
    with pytest.raises(SceneError, match=r"no bundled scene 'stag'; did you mean 'stage'\?"):
        bundled_scene("stag")


def arguments():
    yield "nowhere.xml", {}, SceneError, "no scene file 'nowhere.xml'.*bundled scenes: .*cornell-box"
    yield "cornell-bax", {}, SceneError, "did you mean 'cornell-box'"
    yield ".", {}, SceneError, "is a folder without a scene.xml; name the scene file in it"
    yield __file__, {}, SceneError, "is not a scene file"
    yield "cornell-box", {"size": (0, 5)}, OptionError, "at least one pixel"
    yield "cornell-box", {"size": (99999, 99999)}, OptionError, "at most 2\\^30 pixels"
    yield "cornell-box", {"size": "big"}, OptionError, "width, height"
    yield "cornell-box", {"memory": 0}, OptionError, "above zero"
    yield "cornell-box", {"sensor": -1}, OptionError, "no sensor -1"
    yield "cornell-box", {"parameters": {"a": 1}}, OptionError, "variables"
    yield {"type": "scene"}, {"parameters": {"a": 1}}, OptionError, "variables"
    yield {"type": "diffuse"}, {}, SceneError, "'diffuse', not a scene"
    yield {"type": "scene", "a": {"radius": 1}}, {}, SceneError, "missing 'type'"


@pytest.mark.parametrize(("source", "options", "error", "text"), list(arguments()))
def test_wrong_arguments(source, options, error, text):
    with pytest.raises(error, match=text) as caught:
        load(source, **options)
    assert "\n" not in str(caught.value)


def test_unknown_variable_is_an_option_error(tmp_path):
    with pytest.raises(OptionError, match=r"no such \$variable: \$sppp=3"):
        load(xml(tmp_path, LIGHT + SENSOR), parameters={"sppp": 3})


@pytest.mark.parametrize("built", [False, True], ids=["described", "built"])
@pytest.mark.parametrize("kind", ["area", "focusarea"])
def test_lamps_on_meshes_of_a_dictionary(kind, built, tmp_path):
    """Equal lamps stay two, and their meshes are not merged: the emitters would change their order."""
    mesh = mi.Mesh("corner", 3, 1)
    params = mi.traverse(mesh)
    params["vertex_positions"], params["faces"] = [0.0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 1, 2]
    params.update()
    mesh.write_ply(str(tmp_path / "corner.ply"))

    def shape(x, **extra):
        moved = mi.ScalarTransform4d().translate([x, 0, 0])
        return {"type": "ply", "filename": str(tmp_path / "corner.ply"), "to_world": moved} | extra

    def lamp():
        lamp = {"type": kind, "radiance": {"type": "rgb", "value": 1.0}}
        return mi.load_dict(lamp) if built else lamp

    lamps = {f"lamp {x}": shape(x, emitter=lamp()) for x in (1, 2)}
    others = {f"wall {x}": shape(x, bsdf={"type": "diffuse"}) for x in (3, 4)}
    problem = load({"type": "scene", "sensor": {"type": "perspective"}} | lamps | others)
    assert len(problem.scene.emitters()) == 2
    emitting = [s for s in problem.scene.shapes() if s.is_emitter()]
    assert [s.bbox().min.x for s in emitting] == [1.0, 2.0]
    assert len(problem.scene.shapes()) == 3  # the walls are one


def test_a_scene_of_another_variant(variant):
    with mi.variant_context("scalar_rgb"):
        scene = mi.load_dict(
            {"type": "scene", "l": {"type": "constant"}, "b": {"type": "sphere"}, "s": {"type": "perspective"}}
        )
    with pytest.raises(SceneError, match=f"'scalar_rgb' but '{variant}'"):
        load(scene)


def test_many_meshes(scenes_dir):
    problem = load(scenes_dir / "soda-shoppe" / "scene.xml", check=False)
    assert len(problem.scene.shapes()) < 81  # meshes of one material are joined
    assert [e.get_shape().id() for e in problem.scene.emitters()]  # those that emit keep their name
