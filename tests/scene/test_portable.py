"""Scenes for another machine: what is restored has the fingerprint of what was described."""

from __future__ import annotations

import json
import os

import mitsuba as mi
import numpy as np
import pytest
from support.media import closed, clouds, smoke

from etendue.core import SceneError
from etendue.scene import PortableScene, load, portable, restored

pytestmark = pytest.mark.usefixtures("mitsuba_files")


def moved(source, folder, parameters=None, gone=()):
    """The scene of ``source``, loaded from a copy elsewhere when the folders ``gone`` are; and what was sent."""
    sent = portable(source, parameters)
    description = json.loads(json.dumps(sent.description))
    for place, path in sent.files.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        os.link(path, folder / place)
        assert (folder / place).resolve().is_relative_to(folder.resolve())
    for k, original in enumerate(gone):
        os.rename(original, folder / f"gone{k}")
    source, values = restored(PortableScene(description, sent.arrays), folder)
    return load(source, parameters=values or None), sent


def picture(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    mi.Bitmap(np.full((4, 4, 3), value, np.float32)).write(str(path))
    return path


XML = """<scene version="3.0.0"><default name="shade" value="0.5"/>
<sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/>
</film></sensor>
<include filename="parts/light.xml"/>
<shape type="sphere"><bsdf type="diffuse"><texture name="reflectance" type="bitmap">
<string name="filename" value="{beside}"/></texture></bsdf></shape>
<shape type="sphere"><point name="center" x="3" y="0" z="0"/><bsdf type="diffuse">
<texture name="reflectance" type="bitmap"><string name="filename" value="{absolute}"/></texture></bsdf></shape>
<shape type="sphere"><point name="center" x="6" y="0" z="0"/><bsdf type="diffuse">
<texture name="reflectance" type="bitmap"><string name="filename" value="$image"/></texture></bsdf></shape>
</scene>"""
LIGHT = """<scene version="3.0.0"><shape type="sphere"><point name="center" x="0" y="5" z="0"/><emitter type="area">
<rgb name="radiance" value="$shade"/></emitter></shape></scene>"""


def test_a_file_with_what_it_names_beside_above_and_elsewhere(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    picture(here / "textures" / "a.exr", 0.2)
    absolute = picture(tmp_path / "library" / "b.exr", 0.4)
    picture(here / "c.exr", 0.6)
    (here / "scenes" / "parts").mkdir(parents=True)
    main = here / "scenes" / "room.xml"
    main.write_text(XML.format(beside="../textures/a.exr", absolute=absolute))
    (main.parent / "parts" / "light.xml").write_text(LIGHT)
    values = {"image": "../c.exr", "shade": "0.7"}
    expected = load(main, parameters=values).fingerprint
    assert expected != load(main, parameters=values | {"shade": "0.8"}).fingerprint
    there.mkdir()
    copy, sent = moved(main, there, values, gone=(here, absolute.parent))
    assert copy.fingerprint == expected
    assert len(sent.files) == 5


def test_a_file_with_folders_to_search(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    picture(here / "textures" / "a.exr", 0.2)
    main = here / "room.xml"
    main.write_text(
        '<scene version="3.0.0"><path value="textures"/><sensor type="perspective"/><shape type="sphere">'
        '<bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" value="a.exr"/>'
        '</texture></bsdf><emitter type="area"/></shape></scene>'
    )
    expected = load(main).fingerprint
    there.mkdir()
    copy, _ = moved(main, there, gone=(here,))
    assert copy.fingerprint == expected


def test_a_dictionary_with_arrays_transforms_and_files(tmp_path):
    image = picture(tmp_path / "texture.exr", 0.3)
    scene = mi.cornell_box()
    scene["sensor"]["film"] |= {"width": 8, "height": 8}
    scene["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(np.random.default_rng(1).random((4, 8, 3), np.float32))}
    scene["ball"] = {
        "type": "sphere",
        "to_world": mi.ScalarTransform4f().translate([0.1, 0.2, 0.3]).scale(0.2),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": str(image)}},
    }
    scene["point"] = {"type": "point", "position": mi.ScalarPoint3f(0, 0.5, 0), "intensity": 2.0}
    (tmp_path / "there").mkdir()
    copy, sent = moved(scene, tmp_path / "there")
    assert copy.fingerprint == load(scene).fingerprint
    assert list(sent.files.values()) == [image]


def test_a_grid_in_memory(tmp_path):
    scene = closed(smoke(clouds(3)))
    copy, _ = moved(scene, tmp_path)
    assert copy.fingerprint == load(scene).fingerprint
    assert copy.fingerprint != load(closed(smoke(clouds(3, seed=1)))).fingerprint


def test_bundled_scenes_are_sent_by_name(tmp_path):
    copy, sent = moved("caustics", tmp_path)
    assert not sent.files
    assert copy.fingerprint == load("caustics").fingerprint


def test_objects_in_memory_are_refused():
    scene = mi.cornell_box()
    scene["light"]["emitter"] = mi.load_dict({"type": "area", "radiance": 1.0})
    with pytest.raises(SceneError, match=r"scene\.light\.emitter is an object in memory"):
        portable(scene)
    with pytest.raises(SceneError, match="a scene in memory cannot be sent"):
        portable(mi.load_dict(mi.cornell_box()))
