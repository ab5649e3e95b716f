"""What is let in, and what each refused element is told."""

import mitsuba as mi
import numpy as np
import pytest
from support.media import FLAKES

from etendue.core import BackendError, SceneError, UnsupportedError
from etendue.scene import check, load

DIFFUSE = {"type": "diffuse"}
AREA = {"type": "area", "radiance": 2.0}
MASK = {"type": "mask", "inner": DIFFUSE}
CHECKERS = {"type": "checkerboard"}


def scene(**parts):
    base = {
        "type": "scene",
        "light": {"type": "constant"},
        "camera": {"type": "perspective"},
        "floor": {"type": "disk"},
    }
    return base | parts


def ball(bsdf, **more):
    return {"type": "sphere", "bsdf": bsdf} | more


def bitmap(value=0.5):
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.full((2, 2, 3), value, np.float32)), "raw": True}


MATERIALS = {
    "diffuse": lambda: DIFFUSE,
    "textured": lambda: {"type": "diffuse", "reflectance": bitmap()},
    "checkerboard": lambda: {"type": "diffuse", "reflectance": CHECKERS},
    "dielectric": lambda: {"type": "dielectric"},
    "roughdielectric": lambda: {"type": "roughdielectric"},
    "conductor": lambda: {"type": "conductor"},
    "roughconductor": lambda: {"type": "roughconductor"},
    "plastic": lambda: {"type": "plastic"},
    "roughplastic": lambda: {"type": "roughplastic"},
    "pplastic": lambda: {"type": "pplastic"},
    "principled": lambda: {"type": "principled", "spec_trans": 0.5},
    "principledthin": lambda: {"type": "principledthin", "spec_trans": 0.5},
    "twosided": lambda: {"type": "twosided", "inner": DIFFUSE},
    "bumpmap": lambda: {"type": "bumpmap", "arbitrary": bitmap(), "inner": {"type": "roughplastic"}},
    "normalmap": lambda: {"type": "normalmap", "normalmap": bitmap(), "inner": DIFFUSE},
    "blend": lambda: {"type": "blendbsdf", "weight": 0.5, "a": DIFFUSE, "b": {"type": "conductor"}},
    "phong": lambda: {"type": "twosided", "inner": {"type": "phong"}},
    "ward": lambda: {"type": "bumpmap", "arbitrary": bitmap(), "inner": {"type": "ward"}},
}


@pytest.mark.parametrize("name", MATERIALS)
def test_materials_that_are_rendered(name):
    load(scene(ball=ball(MATERIALS[name]())))


LIGHTS = {
    "point": lambda: {"type": "point"},
    "spot": lambda: {"type": "spot"},
    "constant": lambda: {"type": "constant"},
    "environment": lambda: {"type": "envmap", "bitmap": mi.Bitmap(np.ones((8, 16, 3), np.float32))},
    "sphere": lambda: ball(DIFFUSE, emitter=AREA),
    "rectangle": lambda: {"type": "rectangle", "emitter": AREA},
    "disk": lambda: {"type": "disk", "emitter": AREA},
    "cylinder": lambda: {"type": "cylinder", "emitter": AREA},
    "cube": lambda: {"type": "cube", "emitter": AREA},
    "textured": lambda: {"type": "rectangle", "emitter": {"type": "area", "radiance": bitmap()}},
    "checkers": lambda: {"type": "rectangle", "emitter": {"type": "area", "radiance": CHECKERS}},
    "focused": lambda: {"type": "rectangle", "emitter": {"type": "focusarea", "exponent": 3.0}},
    "directional": lambda: {"type": "directional"},
    "projector": lambda: {"type": "projector", "irradiance": bitmap()},
    "beam": lambda: {"type": "rectangle", "emitter": {"type": "directionalarea"}},
    "sunsky": lambda: {"type": "sunsky"},
    "sky": lambda: {"type": "sky", "kind": 1, "zenith_luminance": 1000.0},
}


@pytest.mark.parametrize("name", LIGHTS)
def test_emitters_that_are_rendered(name):
    load(scene(light=LIGHTS[name]()))


SENSORS = {
    "thinlens": {"aperture_radius": 0.1, "focus_distance": 2.0},
    "orthographic": {},
    "spherical": {},
}


@pytest.mark.parametrize("name", SENSORS)
def test_sensors_that_render(name):
    load(scene(camera={"type": name} | SENSORS[name]))


def test_instances():
    load(scene(group=GROUP, one={"type": "instance", "g": {"type": "ref", "id": "group"}}))


PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
GROUP = {"type": "shapegroup", "leaf": ball(DIFFUSE)}
GROUP_OF_FOGGY = {"type": "shapegroup", "leaf": ball(DIFFUSE, interior=FLAKES)}

REFUSED = {
    "interior": (
        {"fog": ball({"type": "dielectric"}, interior=FLAKES)},
        "medium.*of type 'homogeneous'.*microflakes",
    ),
    "exterior": ({"fog": ball(DIFFUSE, exterior=FLAKES)}, "medium.*of type 'homogeneous'"),
    "foggy camera": ({"camera": {"type": "perspective", "medium": FLAKES}}, "medium.*of type 'homogeneous'"),
    "batch": ({"camera": {"type": "batch", "a": {"type": "perspective"}, "film": PIXEL}}, "'batch'"),
    "fog in a shape group": ({"group": GROUP_OF_FOGGY}, "medium.*of type 'homogeneous'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_elements_are_named(case):
    parts, text = REFUSED[case]
    with pytest.raises(UnsupportedError, match=text) as caught:
        load(scene(**parts))
    assert "\n" not in str(caught.value)
    assert load(scene(**parts), check=False).scene is not None


def test_ellipsoids():
    one = {"centers": np.zeros((1, 3)), "scales": np.ones((1, 3)), "quaternions": np.array([[0, 0, 0, 1]])}
    arrays = {name: mi.TensorXf(values.astype(np.float32)) for name, values in one.items()}
    with pytest.raises(UnsupportedError, match=r"shape 'blob' of type 'ellipsoids'.*mesh"):
        load(scene(blob={"type": "ellipsoids", **arrays}))


def test_a_lamp_of_another_shape():
    grid = mi.TensorXf(np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1))
    with pytest.raises(UnsupportedError, match=r"shape 'lamp' of type 'sdfgrid' emits.*sphere"):
        load(scene(lamp={"type": "sdfgrid", "grid": grid, "emitter": AREA}))


def test_a_radiance_that_is_no_number():
    with pytest.raises(SceneError, match=r"emitter 'light' of type 'point'.*NaN"):
        load(scene(light={"type": "point", "intensity": {"type": "rgb", "value": [1.0, float("nan"), 1.0]}}))


def test_a_texture_that_is_infinite():
    with pytest.raises(SceneError, match=r"texture of type 'bitmap' of shape 'ball'.*'data'"):
        load(scene(ball=ball({"type": "diffuse", "reflectance": bitmap(np.inf)})))


def test_a_projector_of_a_procedural_texture():
    with pytest.raises(UnsupportedError, match=r"emitter 'slide' of type 'projector'.*'checkerboard'.*use a 'bitmap'"):
        load(scene(slide={"type": "projector", "irradiance": {"type": "checkerboard"}}))


def test_a_film_that_samples_its_border():
    with pytest.raises(UnsupportedError, match="sample_border"):
        load(scene(camera={"type": "perspective", "film": {"type": "hdrfilm", "sample_border": True}}))


def test_a_lamp_without_area():
    mesh = mi.Mesh("sliver", 3, 1, props=lamp_properties())
    params = mi.traverse(mesh)
    params["vertex_positions"] = [0, 0, 0, 1, 0, 0, 2, 0, 0]
    params["faces"] = [0, 1, 2]
    params.update()
    with pytest.raises(SceneError, match=r"'sliver'.*emits light but has no area"):
        load(scene(sliver=mesh))


def lamp_properties():
    props = mi.Properties()
    props["lamp"] = mi.load_dict(AREA)
    return props


@pytest.mark.parametrize("other", ["scalar_rgb", "llvm_ad_spectral_polarized", "llvm_ad_mono_polarized"])
def test_other_variants(other):
    with mi.variant_context(other):
        loaded = mi.load_dict(scene())
        with pytest.raises(BackendError, match=f"'{other}' is not supported"):
            check(loaded, loaded.sensors()[0])
        with pytest.raises(BackendError, match=f"'{other}' is not supported"):
            load(loaded)
