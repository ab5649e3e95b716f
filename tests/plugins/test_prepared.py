"""What ``mi.render`` keeps between calls, and that an edit of the scene never meets a stale table."""

import gc
import weakref

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support.tables import thinned

import etendue
from etendue import methods, plugins
from etendue.scene import parameters

NAMES = [
    "auto",
    "guided",
    "vegas",
    "stratified_path",
    "light",
    "pm",
    "ppm",
    "sppm",
    "bpt",
    "bpm",
    "vcm",
    "pssmlt",
    "mmlt",
]


@pytest.fixture(autouse=True, scope="module")
def registered(variant):
    plugins.register()


@pytest.fixture(autouse=True)
def alone():
    """Scenes of the test before are gone: while they live, kernels have their materials, too, and are other ones."""
    gc.collect()


def room(integrator="vcm", size=8, **settings):
    """A box with a textured floor, lit by a mesh, a point and an environment that is a texture."""
    random = np.random.default_rng(3)
    look = mi.ScalarTransform4f().look_at
    camera = {"type": "perspective", "fov": 60, "film": {"type": "hdrfilm", "width": size, "height": size}}
    floor = mi.Bitmap(random.random((4, 4, 3), np.float32))
    sky = mi.Bitmap(0.1 * random.random((4, 8, 3), np.float32))
    down = mi.ScalarTransform4f().translate([0, 1.5, 0]).rotate([1, 0, 0], 90).scale(0.3)
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 3} | settings,
        "camera": camera | {"to_world": look([0, 1, 3], [0, 0.3, 0], [0, 1, 0])},
        "other": camera | {"to_world": look([2, 1, 2], [0, 0.3, 0], [0, 1, 0])},
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "bitmap": floor, "raw": True}},
        },
        "block": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().scale(0.2),
            "bsdf": {"type": "roughconductor", "alpha": 0.3},
        },
        "lamp": {
            "type": "cube",
            "to_world": down,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5.0}},
        },
        "bulb": {"type": "point", "position": [1, 1, 1], "intensity": {"type": "rgb", "value": 1.0}},
        "sky": {"type": "envmap", "bitmap": sky},
    }


def picture(scene, integrator=None, sensor=0, spp=1, seed=5):
    return np.array(mi.render(scene, integrator=integrator, sensor=sensor, spp=spp, seed=seed))


def fresh(scene, **how):
    """By an integrator that has not rendered before."""
    own = scene.integrator()
    return picture(scene, mi.load_dict({"type": own.plugin_name} | own.options), **how)


def same(a, b):
    """Equal but for the order of additions on the device."""
    return a.shape == b.shape and np.allclose(a, b, rtol=1e-3, atol=1e-5)


@pytest.fixture
def prepared(monkeypatch):
    """How often a method was prepared."""
    counted = []
    for cls in map(methods.get, ("bpt", "light", "vcm")):

        def counting(method, problem, seed, whole=cls.prepare):
            counted.append(method.name)
            whole(method, problem, seed)

        monkeypatch.setattr(cls, "prepare", counting)
    return counted


def test_a_scene_that_did_not_change_is_prepared_once(prepared):
    scene = mi.load_dict(room("bpt", samples_per_pass=1))
    picture(scene)
    assert prepared == ["bpt"]
    for seed in range(3):
        picture(scene, seed=seed)
        picture(scene, seed=seed, sensor=1)
    assert prepared == ["bpt", "bpt"]  # once a sensor


def write(params, key, change):
    params[key] = change(params[key])
    params.update()


def write_in_place(params, key, value):
    params[key][3] = value
    params.update()


def scatter(params, key, value):
    dr.scatter(params[key].array, value, mi.UInt32(7))
    params.set_dirty(key)
    params.update()


def attach(params, key, factor):
    params[key] = params[key] * factor
    dr.enable_grad(params[key])
    params.update()


def raised(positions):
    corners = dr.unravel(mi.Point3f, positions)
    corners.y += 0.3
    return dr.ravel(corners)


EDITS = {
    "radiance": lambda p: write(p, "lamp.emitter.radiance.value", lambda _: mi.Color3f(1.0, 20.0, 3.0)),
    "radiance, one channel": lambda p: write(p, "lamp.emitter.radiance.value", lambda c: mi.Color3f(c.x, 0.0, c.z)),
    "radiance with gradients": lambda p: attach(p, "lamp.emitter.radiance.value", 3.0),
    "lamp moved": lambda p: write(p, "lamp.vertex_positions", raised),
    "bulb moved": lambda p: write(p, "bulb.position", lambda _: mi.Point3f(-0.5, 0.4, 0.8)),
    "bulb brighter": lambda p: write(p, "bulb.intensity.value", lambda c: c * 50.0),
    "sky, a texel": lambda p: write_in_place(p, "sky.data", 400.0),
    "sky, scattered": lambda p: scatter(p, "sky.data", 900.0),
    "sky turned": lambda p: write(p, "sky.to_world", lambda t: mi.Transform4f().rotate([0, 1, 0], 90) @ t),
    "sky scaled": lambda p: write(p, "sky.scale", lambda s: 5.0 * s),
    "floor, a texel": lambda p: write_in_place(p, "floor.bsdf.reflectance.data", 0.9),
    "material": lambda p: write(p, "block.bsdf.alpha.value", lambda _: 0.05),
    "block larger, so the scene is": lambda p: write(p, "block.vertex_positions", lambda v: 5.0 * v),
    "camera moved": lambda p: write(
        p, "camera.to_world", lambda _: mi.ScalarTransform4f().look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
    ),
    "angle of view": lambda p: write(p, "camera.x_fov", lambda _: 80.0),
    "film": lambda p: write(p, "camera.film.size", lambda _: [10, 6]),
    "crop": lambda p: write(p, "camera.film.crop_size", lambda _: [6, 4]),
    "crop moved": lambda p: write(p, "camera.film.crop_offset", lambda _: [3, 2]),
}


@pytest.mark.parametrize(("name", "edits"), [("light", EDITS), ("vcm", ["block larger, so the scene is"])])
def test_an_edit_is_never_met_by_a_stale_table(name, edits, prepared):
    """Beside an integrator that sees the edited scene for the first time; each edit stays for those after it."""
    scene = mi.load_dict(room(name, samples_per_pass=8))
    params = mi.traverse(scene)
    before = picture(scene, spp=8)
    for edit in edits:
        prepared.clear()
        EDITS[edit](params)
        after = picture(scene, spp=8)
        assert prepared == [name], edit
        assert not same(before, after), f"'{edit}' cannot be seen, so this tests nothing"
        assert same(after, fresh(scene, spp=8)), edit
        before = after


def test_what_is_not_edited_has_the_same_parameters():
    scene = mi.load_dict(room())
    first = parameters(scene)
    picture(scene, mi.load_dict({"type": "path"}))
    dr.eval()
    params = mi.traverse(scene)
    params["camera.x_fov"] = 20.0  # a sensor is looked at by itself
    params.update()
    dr.enable_grad(params["lamp.emitter.radiance.value"])
    assert parameters(scene) == first
    assert parameters(mi.load_dict(room())) != first


@pytest.mark.parametrize("name", thinned([*NAMES, "bpt that learns"], ("light", "bpt that learns", "sppm")))
def test_the_seed_decides_whatever_came_before(name):
    settings = {"guide_emission": "on"} if name == "bpt that learns" else {}
    scene = mi.load_dict(room(name.split()[0], **settings))
    first = picture(scene, spp=2)
    picture(scene, spp=3, seed=6)
    other = picture(scene, spp=2, seed=6)
    assert not same(first, other)
    assert same(first, picture(scene, spp=2))
    assert same(other, fresh(scene, spp=2, seed=6))


def test_one_integrator_and_two_scenes():
    one, two = mi.load_dict(room("light")), mi.load_dict(room() | {"sky": {"type": "constant"}})
    integrator = one.integrator()
    pictures = [picture(scene, integrator) for scene in (one, two, one, two)]
    assert same(pictures[0], pictures[2]) and same(pictures[1], pictures[3])
    assert same(pictures[1], picture(two, mi.load_dict({"type": "light"} | one.integrator().options)))


@pytest.mark.parametrize("method", ["vcm", "sppm", "a pass that fails"])
def test_a_scene_is_freed(method, monkeypatch):
    """Also of a method that carries something on, and after a failure."""
    name = "vcm" if method == "a pass that fails" else method
    scene = mi.load_dict(room(name))
    with monkeypatch.context() as patch:
        if name != method:
            patch.setattr(methods.get(name), "step", lambda *_: 1 / 0)
            with pytest.raises(RuntimeError):
                picture(scene)
        else:
            picture(scene)
    integrator = weakref.ref(scene.integrator())
    del scene
    gc.collect()
    assert integrator() is None


def test_nothing_is_kept_of_a_picture_that_failed(monkeypatch, prepared):
    scene = mi.load_dict(room(samples_per_pass=1))
    first = picture(scene)
    with monkeypatch.context() as patch:
        patch.setattr(methods.get("vcm"), "step", lambda *_: 1 / 0)
        with pytest.raises(RuntimeError):
            picture(scene)
    prepared.clear()
    assert same(first, picture(scene))
    assert prepared == ["vcm"]


@pytest.mark.parametrize("name", thinned(NAMES, ("bpt", "sppm", "pssmlt")))
def test_lamps_that_are_switched_off_leave_a_black_picture(name):
    """And a picture as before once they are on again."""
    scene = mi.load_dict(room(name, **({"bootstrap": 1 << 12} if name in ("pssmlt", "mmlt") else {})))
    params, before = mi.traverse(scene), picture(scene)
    assert before.max() > 0.0
    keys = ("lamp.emitter.radiance.value", "bulb.intensity.value", "sky.data")
    lit = {key: type(params[key])(params[key]) for key in keys}
    for key in keys:
        params[key] = 0.0 * params[key]
    params.update()
    assert picture(scene).shape == before.shape and not picture(scene).any()
    assert not etendue.render(scene, name, spp=1).image.any() if name == "bpt" else True
    for key, value in lit.items():
        params[key] = value
    params.update()
    assert same(picture(scene), before)
