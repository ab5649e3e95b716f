"""Pictures of solutions: which patch is seen, smoothness, sheets, curved shapes, gathering, agreement with path."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.patches import box, joined
from support.scenes import camera, diffuse, mesh, rgb, transform

from etendue.core import EtendueError, OptionError, Replica, SceneError
from etendue.methods import Path
from etendue.points import OwenSobol
from etendue.products.patches import picture
from etendue.radiosity import ABuffer, Patches, RadiosityError, Solution, SurfaceError, scene_patches, solve
from etendue.scene import load

GREY = diffuse(0.5, 0.5, 0.5)


def above(z=4, size=(4, 4)):
    """A sensor that looks straight at the square from -1 to 1."""
    view = camera(sensor="orthographic", size=size)
    return view | {"to_world": transform().look_at([0, 0, z], [0, 0, 0], [0, 1, 0])}


def solved(patches, irradiance):
    """A solution whose irradiance is known."""
    irradiance = np.broadcast_to(irradiance, (len(patches), patches.channels)).astype(float)
    radiosity = patches.emission + patches.reflectance * irradiance
    return Solution(patches, radiosity, irradiance, np.zeros(len(patches)), (0.0,))


def hits(scene, size):
    """Points that are seen through the middles of pixels; NaN where none is."""
    x, y = np.meshgrid((np.arange(size[0]) + 0.5) / size[0], (np.arange(size[1]) + 0.5) / size[1])
    place = mi.Point2f(x.ravel().astype(np.float32), y.ravel().astype(np.float32))
    si = scene.ray_intersect(scene.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5))[0])
    return np.where(np.array(si.is_valid())[:, None], np.array(si.p).T, np.nan).reshape(size[1], size[0], 3)


def test_patches_as_they_are_and_smooth():
    """16 patches seen by 16 pixels; a linear irradiance is smooth over the patches between."""
    scene = mi.load_dict({"type": "scene", "sensor": above(), "wall": {"type": "rectangle", "bsdf": GREY}})
    patches = scene_patches(scene, max_area=0.25)
    assert len(patches) == 16
    values = np.random.default_rng(1).random((16, 3))
    seen = hits(scene, (4, 4))
    nearest = np.linalg.norm(patches.centres - seen.reshape(16, 1, 3), axis=2).argmin(axis=1)
    assert sorted(nearest) == list(range(16))
    flat = picture(solved(patches, values), scene, smooth=False)
    np.testing.assert_allclose(flat.image.reshape(16, 3), 0.5 * values[nearest] / np.pi, rtol=1e-5)
    linear = solved(patches, np.stack([2 + patches.centres[:, 0], 2 + patches.centres[:, 1], np.full(16, 2)], axis=1))
    smooth = picture(linear, scene, size=(12, 12), spp=64)
    inner = slice(3, 9)
    seen = hits(scene, (12, 12))[inner, inner]
    expected = 0.5 * np.stack([2 + seen[..., 0], 2 + seen[..., 1], np.full((6, 6), 2)], axis=2) / np.pi
    np.testing.assert_allclose(smooth.image[inner, inner], expected, rtol=5e-3)
    assert smooth.metadata["samples"] == 64 and flat.metadata["smooth"] is False


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "sphere", "radius": 0.9},
        {"type": "cylinder", "radius": 0.7, "p0": [0, -1, 0], "p1": [0, 1, 0]},
        {"type": "disk"},
        {"type": "cube"},
    ],
    ids=lambda shape: shape["type"],
)
def test_curved_shapes_have_no_holes(shape):
    """Faces are flat, shapes are not, and every point of them shows its patch; past them is the sky."""
    if shape["type"] == "cube":
        shape = shape | {"to_world": transform().rotate([1, 0, 0], 40).rotate([0, 0, 1], 30).scale(0.5)}
    sky = {"type": "constant", "radiance": rgb(0.1, 0.2, 0.3)}
    scene = mi.load_dict({"type": "scene", "sensor": above(), "sky": sky, "shape": shape | {"bsdf": GREY}})
    patches = scene_patches(scene)
    image = picture(solved(patches, 2.0), scene, size=(64, 64), spp=1).image
    values = np.unique(np.round(image.reshape(-1, 3), 5), axis=0)
    np.testing.assert_allclose(values, [[0.1, 0.2, 0.3], np.full(3, 1 / np.pi)], atol=1e-5)


def test_small_things_on_a_wide_plain():
    """Under a roof that is a ten-thousandth of the plain above it, and on a ball as small."""
    ground = {"type": "disk", "to_world": transform().scale(3000), "bsdf": GREY}
    roof = {"type": "cube", "to_world": transform().translate([0, 0, 0.3]).scale([1, 1, 0.1]), "bsdf": GREY}
    ball = {"type": "sphere", "center": [0, -1.2, 0.3], "radius": 0.2, "bsdf": GREY}
    view = camera(size=(48, 36)) | {"to_world": transform().look_at([0, -5, 0.5], [0, 0, 0.2], [0, 0, 1]), "fov": 25}
    scene = mi.load_dict({"type": "scene", "sensor": view, "ground": ground, "roof": roof, "ball": ball})
    image = picture(solved(scene_patches(scene), 2.0), scene).image
    low = ~np.isnan(hits(scene, (48, 36))[..., 0])
    np.testing.assert_allclose(image[low & np.roll(low, 1, axis=0)], 1 / np.pi, rtol=1e-5)


@pytest.mark.parametrize("front", [True, False])
@pytest.mark.parametrize("kind", ["twosided", "two faces"])
def test_each_side_of_a_sheet(kind, front):
    view = above(4 if front else -4)
    if kind == "twosided":
        wall = {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": GREY}}
        scene = mi.load_dict({"type": "scene", "sensor": view, "wall": wall})
    else:
        points = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
        scene = mi.load_dict({"type": "scene", "sensor": view, "wall": mesh(points, faces, GREY)})
    patches = scene_patches(scene)
    upward = (patches.normals[:, 2] > 0)[:, None]
    image = picture(solved(patches, np.where(upward, 1.0, 3.0)), scene, spp=1).image
    if kind == "two faces":  # the scene's rays may meet the face that looks away, whose own side is what they see
        assert set(np.round(2 * np.pi * np.unique(image), 4)) <= {1.0, 3.0}
    np.testing.assert_allclose(image, 0.5 * (1.0 if front else 3.0) / np.pi, rtol=1e-5)


def test_the_back_of_a_face_is_black():
    wall = {"type": "rectangle", "flip_normals": True, "bsdf": GREY}
    scene = mi.load_dict({"type": "scene", "sensor": above(), "wall": wall})
    assert not picture(solved(scene_patches(scene), 1.0), scene).image.any()


def enclosure(inner, emission=None):
    """The inside of a cube, every wall of which shines and reflects alike, and something in it."""
    emitter = {"type": "area", "radiance": rgb(1.0, 2.0, 3.0)}
    walls = {"type": "cube", "flip_normals": True, "bsdf": GREY, "emitter": emitter}
    view = camera((0.6, 0.5, 0.7), (-0.2, -0.3, -0.5), 70.0, size=(12, 9))
    return load({"type": "scene", "sensor": view, "walls": walls} | inner)


def test_gathering_in_a_furnace():
    """Every wall has L = L_e / (1 - rho): so has what is gathered there; and so a mirror, times what it reflects."""
    problem = enclosure({})
    patches = scene_patches(problem.scene)
    made = picture(solved(patches, 2 * patches.emission), problem, gather=256)
    np.testing.assert_allclose(made.image.mean(axis=(0, 1)), [2, 4, 6], rtol=5e-3)
    np.testing.assert_allclose(made.image / [2, 4, 6], 1.0, atol=0.15)
    mirror = {
        "type": "sphere",
        "center": [-0.2, -0.3, -0.5],
        "radius": 0.3,
        "bsdf": {"type": "conductor", "specular_reflectance": rgb(0.5, 0.5, 0.5), "material": "none"},
    }
    problem = enclosure({"ball": mirror})
    patches = scene_patches(problem.scene)
    emission = np.pi * np.array([1.0, 2.0, 3.0])
    made = picture(solved(patches, 2 * emission), problem, gather=256)
    middle = made.image[4, 6] / [2, 4, 6]
    np.testing.assert_allclose(middle, 0.5, atol=0.05)


def small_room():
    """A lamp that hangs in a grey room with a red wall and a block."""
    lamp = {
        "type": "rectangle",
        "to_world": transform().translate([0, 0.9, 0]).rotate([1, 0, 0], 90).scale(0.3),
        "bsdf": GREY,
        "emitter": {"type": "area", "radiance": rgb(8.0, 7.0, 6.0)},
    }

    def wall(place, *colour):
        return {"type": "rectangle", "to_world": place, "bsdf": diffuse(*colour)}

    t = transform()
    return {
        "type": "scene",
        "sensor": camera((0, 0, 3.4), (0, 0, 0), 40.0, size=(24, 24)),
        "floor": wall(t.translate([0, -1, 0]).rotate([1, 0, 0], -90), 0.6, 0.6, 0.6),
        "ceiling": wall(t.translate([0, 1, 0]).rotate([1, 0, 0], 90), 0.6, 0.6, 0.6),
        "back": wall(t.translate([0, 0, -1]), 0.6, 0.6, 0.6),
        "left": wall(t.translate([-1, 0, 0]).rotate([0, 1, 0], 90), 0.7, 0.1, 0.1),
        "right": wall(t.translate([1, 0, 0]).rotate([0, 1, 0], -90), 0.1, 0.7, 0.1),
        "block": {
            "type": "cube",
            "to_world": t.translate([0.3, -0.7, 0.2]).rotate([0, 1, 0], 20).scale(0.3),
            "bsdf": GREY,
        },
        "lamp": lamp,
    }


def path_picture(problem, passes, samples=16):
    method = Path(Path.Settings(samples_per_pass=samples))
    method.prepare(problem, 5)
    replica = Replica(method, 5)
    total = replica.step(0)
    for iteration in range(1, passes):
        total += replica.step(iteration)
    return replica.develop(total).image


def test_pictures_agree_with_path():
    """Gathered pictures as well as paths can tell (1.1 % a pixel, of which 0.8 % is their noise), the patches
    themselves to some per cent (2.6 to 3.2): there is no shadow in patches of 0.2 x 0.2."""
    problem = load(small_room())
    patches = scene_patches(problem.scene, max_area=0.04)
    segments = ABuffer(patches, OwenSobol(4, seed=2)).cast(512)
    solution = solve(patches, segments, "conjugate-gradient")
    expected = path_picture(problem, 32)
    scale = expected.mean()
    dark = expected.max(axis=2) < 5  # not the lamp
    gathered = picture(solution, problem, gather=256, irradiance_error=segments.gather_error(solution.radiosity))
    plain = picture(solution, problem, spp=256)
    flat = picture(solution, problem, spp=256, smooth=False)
    for made, whole, single in ((gathered, 0.006, 0.02), (plain, 0.015, 0.06), (flat, 0.015, 0.06)):
        difference = (made.image - expected)[dark]
        assert abs(difference.mean()) < whole * scale
        assert np.sqrt((difference**2).mean()) < single * scale
    error = gathered.layers["error"]
    assert error.shape == expected.shape and error.max() < 0.5 * scale and (error[8:16, 8:16] > 0).all()


def test_one_channel_and_other_meshes():
    """Patches of a mesh file's kind, seen through a sensor of a scene with the same mesh."""
    vertices, faces = joined(box((-1, -1, -1), (1, 1, 1), 1, inward=True), box((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3), 1))
    patches = Patches(vertices, faces, reflectance=0.5)
    halves = np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]])
    view = camera((0.8, 0.1, 0.9), (0, 0, 0), 50.0)
    scene = mi.load_dict({"type": "scene", "sensor": view, "mesh": mesh(vertices, halves, GREY)})
    image = picture(solved(patches, 2.0), scene).image
    np.testing.assert_allclose(image, 1 / np.pi, rtol=1e-5)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"spp": 0}, OptionError, "spp is a whole number of at least 1"),
        ({"gather": -1}, OptionError, "gather is a whole number of at least 0"),
        ({"irradiance_error": np.ones(3)}, RadiosityError, "have its shape"),
        ({"sensor": 3}, EtendueError, "no sensor 3"),
        ({"angle": 200}, SurfaceError, "0 to 180 degrees"),
    ],
)
def test_refusals(options, error, message):
    scene = mi.load_dict({"type": "scene", "sensor": above(), "wall": {"type": "rectangle", "bsdf": GREY}})
    patches = scene_patches(scene)
    with pytest.raises(error, match=message):
        picture(solved(patches, 1.0), scene, **options)
    with pytest.raises(OptionError, match="a loaded scene has its sensor and size"):
        picture(solved(patches, 1.0), load(scene, check=False), size=(8, 8))


def test_bands_are_no_colours_and_a_picture_needs_a_sensor():
    scene = mi.load_dict({"type": "scene", "wall": {"type": "rectangle", "bsdf": GREY}})
    patches = scene_patches(scene)
    bands = patches.with_properties([[0.5] * 4], [[1.0] * 4], 0.0)
    with pytest.raises(RadiosityError, match="one channel or three, not 4"):
        picture(solved(bands, 1.0), scene)
    if not scene.sensors():
        with pytest.raises(SceneError, match="has no sensor"):
            picture(solved(patches, 1.0), scene)
