"""Which variants scenes need: by their names, descriptions and files."""

import json
import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest
from support.running import run
from support.spectral import spectral_variant
from support.tables import thinned

from etendue.core import UnsupportedError
from etendue.scene import SceneEditor, bundled_scene, colours_of, load, name_elements
from etendue.scene.lamps.radiance import is_black

GLASS = {"type": "scene", "ball": {"type": "sphere", "bsdf": {"type": "mask", "nested": {"type": "roughdispersive"}}}}
XML = '<scene version="3.0.0"><shape type="sphere"><bsdf type="{}"/></shape></scene>'


def test_scenes_with_dispersive_glass_need_wavelengths(tmp_path):
    files = {"glass.xml": XML.format("dispersive"), "plain.xml": XML.format("dielectric")}
    files["glass film.xml"] = '<scene version="3.0.0"><sensor type="thinlens"><film type="specfilm"/></sensor></scene>'
    files["glass.gltf"] = json.dumps({"extensionsUsed": ["KHR_materials_dispersion"]})
    files["plain.gltf"] = json.dumps({"meshes": []})
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        assert colours_of(tmp_path / name) == ("spectral" if name.startswith("glass") else "rgb"), name
    assert colours_of("prism") == colours_of(bundled_scene("diamond")) == colours_of(GLASS) == "spectral"
    for other in ("cornell-box", "no such scene", {"type": "scene"}, None, tmp_path / "missing.xml"):
        assert colours_of(other) == "rgb"


ENTRIES = {
    "render": "etendue.render(SCENE, 'path', spp=1)",
    "check": "assert etendue.check(SCENE, quick=True).ok",
    "view": "with etendue.view(SCENE, 'path', spp=1) as v: v.loaded(60); assert v._session.problem is not None",
    "load": "etendue.scene.load(SCENE)",
    "integrator": "etendue.scene.integrator_of(SCENE)",
}


@pytest.mark.parametrize("entry", thinned(ENTRIES, ("render", "view")))
def test_python_chooses_the_variant_of_a_scene(entry):
    """In a process of its own, since a variant that is set stays."""
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 2, "height": 2}},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", "center": [0, 0, -5], "bsdf": {"type": "dispersive"}},
    }
    code = ENTRIES[entry].replace("SCENE", repr(scene))
    program = f"import etendue, etendue.scene, mitsuba as mi\n{code}\nassert 'spectral' in mi.variant(), mi.variant()"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


def raw_picture():
    return {"type": "bitmap", "data": mi.TensorXf([0.5] * 12, (2, 2, 3)), "raw": True}


REFUSED = {
    "'reflectance' of material .* has no spectrum: set 'raw'": lambda: {
        "type": "diffuse",
        "reflectance": raw_picture(),
    },
    "blends a material that disperses light": lambda: {
        "type": "blendbsdf",
        "weight": 0.5,
        "a": {"type": "dispersive"},
        "b": {"type": "dielectric"},
    },
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_wavelengths_do_not_allow_is_named(message):
    with spectral_variant(), pytest.raises(UnsupportedError, match=message):
        scene = {"type": "scene", "sensor": {"type": "perspective"}, "sky": {"type": "constant"}}
        load(scene | {"ball": ball(REFUSED[message]())})


def ball(bsdf):
    return {"type": "sphere", "bsdf": bsdf}


def test_raw_numbers_and_normals_are_allowed():
    with spectral_variant():
        numbers = {"type": "bitmap", "data": mi.TensorXf([0.3] * 4, (2, 2, 1)), "raw": True}
        normals = {"type": "bitmap", "data": mi.TensorXf([0.5, 0.5, 1.0] * 4, (2, 2, 3)), "raw": True}
        rough = {"type": "roughconductor", "material": "Au", "alpha": numbers}
        mapped = {"type": "normalmap", "normalmap": normals, "bsdf": rough}
        look = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
        scene = {"type": "scene", "sky": {"type": "constant"}, "ball": ball(mapped)}
        problem = load(scene | {"sensor": {"type": "perspective", "to_world": look}}, size=(4, 4))
        assert run(problem, "path", passes=4, samples=16).mean.min() > 0.2


def lit_by(texture):
    return {"type": "rectangle", "emitter": {"type": "area", "radiance": texture}}


@pytest.mark.parametrize(("level", "black"), [(0.0, True), (0.1, False), (0.5, False), (1.0, False)])
def test_a_grey_lamp_is_not_black(level, black):
    """Coefficients of a grey spectrum are zero, or negative."""
    with spectral_variant():
        picture = mi.Bitmap(np.full((2, 2, 3), level, np.float32))
        lamp = mi.load_dict(lit_by({"type": "bitmap", "bitmap": picture}))
        assert is_black(lamp.emitter()) == black


def test_what_has_spectra_is_not_edited_as_a_colour():
    with spectral_variant():
        problem = load("diamond", change=name_elements)
        found = {one.key: one.kind for one in SceneEditor(problem.scene).list()}
    assert "colour" not in found.values()
    assert "lamp-0.to_world" in found and "diamond.bsdf.specular_reflectance.value" in found
    assert not [key for key in found if "_index_" in key]  # a file has no such parameters
