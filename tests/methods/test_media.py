"""Participating media: closed forms, Mitsuba's ``volpath``, and what is refused."""

from __future__ import annotations

from itertools import product

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from support.media import BLACK, FOG, camera, closed, clouds, fog, grid, slab, smoke, volpath
from support.running import mitsuba_images, replicas, run
from support.scenes import rgb, transform
from support.statistics import assert_agree
from support.tables import thinned

import etendue
from etendue.core import SceneError, UnsupportedError
from etendue.scene import load
from etendue.transport import TransportFunctions

#: One row a method that renders media which scatter; merging has a radius that is small against the scenes.
SCATTERING = {
    "path": ("path", {}),
    "path power": ("path", {"heuristic": "power"}),
    "light": ("light", {"light_paths": 4.0}),
    "bpt": ("bpt", {}),
    "bpt path power": ("bpt", {"light_source": "path", "heuristic": "power", "connections": 2}),
    "bpt learned": ("bpt", {"guide_connections": True, "guide_emission": "on"}),
    "vcm": ("vcm", {}),
    "vcm power": ("vcm", {"heuristic": "power", "direct_light": "all"}),
    "bpm": ("bpm", {}),
    "sppm": ("sppm", {}),
    "sppm photons": ("sppm", {"direct": "photons"}),
    "guided": ("guided", {"cell_samples": 500}),
    "auto": ("auto", {}),
}
MERGING = ("vcm", "bpm", "sppm", "auto")
#: Passes of these depend on each other.
LEARNING = ("bpt learned", "guided", "auto")
#: All methods that render media which only absorb.
ABSORBING = ("path", "guided", "vegas", "stratified", "light", "pm", "ppm", "sppm", "bpt", "bpm", "vcm", "auto")
CHAINS = ("pssmlt", "mmlt", "film_metropolis")
COLOURED = fog((0.2, 0.5, 1.0), (0.9, 0.5, 0.9), scale=3.0)


def pictures(name: str, problem: object, passes: int = 6, samples: int = 256) -> np.ndarray:
    """Independent pictures by a row of ``SCATTERING``."""
    method, settings = SCATTERING[name]
    if method in MERGING:
        settings = settings | {"radius": 0.02, "radius_unit": "absolute"}
        settings |= {} if method == "auto" else {"volume_radius": 0.02}
    if name in LEARNING:
        return replicas(problem, method, passes, 2, samples, **settings)
    return run(problem, method, passes, samples, **settings).images


# ------------------------------------------------------------------------------------------------ absorption


@pytest.mark.parametrize(
    "method", thinned(ABSORBING + CHAINS, ("path", "guided", "vegas", "light", "bpt", "vcm", "pssmlt"))
)
def test_beer_and_lambert(method):
    """A lamp through a coloured slab."""
    scene = slab(fog((0.1, 0.5, 0.9), 0.0, scale=3.0))
    tolerance = 0.04 if method in (*CHAINS, "light") else 0.002  # of their noise
    picture = etendue.render(scene, method, spp=256, seed=1).image[..., :3]
    # The longer way of slanted rays: the mean over the pixels.
    x = (np.arange(64) + 0.5) / 32 - 1
    slant = np.sqrt(1 + np.tan(np.radians(5)) ** 2 * (x[:, None] ** 2 + x**2))
    expected = [np.exp(-3 * sigma * slant).mean() for sigma in (0.1, 0.5, 0.9)]
    np.testing.assert_allclose(picture.mean((0, 1)) / expected, 1.0, atol=tolerance)


@pytest.mark.parametrize("method", ["path", "light", "bpt"])
def test_nested_glass_and_media_around_camera_and_lamp(method):
    """The camera in one medium, the lamp in another, both behind boundaries: the product of the transmittances."""
    inner, outer = fog(0.4, 0.0), fog((0.3, 0.6, 0.9), 0.0)
    around = {"type": "ref", "id": "inner"}
    lamp = {"type": "rectangle", "to_world": transform().translate([0, 0, -3]).scale(0.4), "bsdf": BLACK}
    scene = {
        "type": "scene",
        "fog": outer,
        "inner": inner,
        "camera": camera((0, 0, 2), (0, 0, -1), 4, 4.0, medium=FOG),
        "lamp": lamp
        | {"emitter": {"type": "area", "radiance": rgb(1, 1, 1)}, "exterior": {"type": "ref", "id": "inner"}},
        "room": {"type": "cube", "to_world": transform().scale(10), "bsdf": {"type": "null"}, "interior": FOG},
        "ball": {
            "type": "sphere",
            "center": [0, 0, -3],
            "radius": 1.0,
            "bsdf": {"type": "null"},
            "interior": around,
            "exterior": FOG,
        },
    }
    picture = etendue.render(scene, method, spp=256, seed=1).image[..., :3]
    expected = np.exp(-np.array([0.3, 0.6, 0.9]) * 4.0 - 0.4)
    np.testing.assert_allclose(picture.mean((0, 1)) / expected, 1.0, atol=0.01 if method == "path" else 0.03)


@pytest.mark.parametrize("method", ["path", "light", "bpt"])
def test_a_sky_behind_the_fog_around_the_camera(method):
    scene = {
        "type": "scene",
        "fog": fog((0.3, 0.6, 0.9), 0.0),
        "camera": camera((0, 0, 0), (0, 0, -1), 4, 60.0, medium=FOG, near_clip=1e-4),
        "room": {"type": "sphere", "radius": 2.0, "bsdf": {"type": "null"}, "interior": FOG},
        "sky": {"type": "constant", "radiance": rgb(1, 1, 1)},
    }
    picture = etendue.render(scene, method, spp=4096, seed=1).image[..., :3]
    expected = np.exp(-2.0 * np.array([0.3, 0.6, 0.9]))
    np.testing.assert_allclose(picture.mean((0, 1)) / expected, 1.0, atol=0.03 if method == "light" else 0.001)


def test_tinted_glass():
    """Smooth and rough glass with an absorbing interior, as by Mitsuba: its ``volpath`` has no other techniques."""
    for bsdf in ({"type": "dielectric"}, {"type": "roughdielectric", "alpha": 0.2}):
        ball = {"type": "sphere", "radius": 0.5, "bsdf": bsdf, "interior": FOG}
        scene = {
            "type": "scene",
            "fog": fog((0.1, 0.4, 0.8), 0.0, scale=3.0),
            "camera": camera((0, 0, 3), (0, 0, 0), 8, 25.0),
            "sky": {"type": "constant"},
            "ball": ball,
        }
        problem = load(scene)
        reference = mitsuba_images(problem, volpath(), 6, 256, 1)
        for method in ("path", "bpt"):
            assert_agree(run(problem, method, 6, 256).images, reference, f"{bsdf['type']} {method}", block=2)


# ------------------------------------------------------------------------------------------------ scattering


@pytest.mark.parametrize("name", thinned(SCATTERING, ("path", "light", "bpt", "vcm", "guided")))
def test_furnace(name):
    """Nothing is absorbed in a closed surface of radiance 1: it is 1 everywhere."""
    problem = load(closed(fog(1.5, 1.0), emission=1.0, albedo=0.0))
    precision = 0.06 if name == "light" else 0.02
    if SCATTERING[name][0] in MERGING:  # photons outside of the walls are missing in the balls near them
        images = pictures(name, problem)
        assert abs(images.mean() - 1.0) < 0.02 + 4.0 * images.mean((1, 2, 3)).std() / 5**0.5
        return
    assert_agree(pictures(name, problem), 1.0, name, precision=precision)


REFERENCES: dict[str, np.ndarray] = {}
SCENES = {
    "grey": fog(1.0, 0.8),
    "forward": fog(1.0, 1.0, phase={"type": "hg", "g": 0.7}),
    "thin": fog(0.3, 1.0),
    "thick": fog(3.0, 0.8),
}


@pytest.mark.parametrize(
    ("name", "medium"),
    thinned(product(SCATTERING, SCENES), [(name, "forward") for name in ("path", "bpt", "sppm")]),
)
def test_a_box_of_fog(name, medium):
    problem = load(closed(SCENES[medium]))
    if medium not in REFERENCES:
        REFERENCES[medium] = mitsuba_images(problem, volpath(), 8, 1024, 1)
    images, reference = pictures(name, problem), REFERENCES[medium]
    if SCATTERING[name][0] in MERGING:
        error = np.hypot(images.mean((1, 2, 3)).std() / 6**0.5, reference.mean((1, 2, 3)).std() / 8**0.5)
        bias = 0.02 * reference.mean()  # photons outside of the walls are missing in the balls near them
        assert abs(images.mean() - reference.mean()) < bias + 4.0 * error
        return
    assert_agree(images, reference, f"{name} {medium}", precision=0.1 if name == "light" else 0.03)


@pytest.mark.parametrize("name", thinned(["bpt", "bpt path power", "vcm", "sppm photons", "light"], ["vcm"]))
def test_extinction_by_colour(name):
    """Against ``path``, whose noise is low; ``volpath`` draws a channel once for a path and is too noisy in two."""
    problem = load(closed(COLOURED))
    assert_agree(pictures(name, problem), run(problem, "path", 6, 2048, first=100).images, name, precision=0.08)


@pytest.mark.parametrize(
    ("name", "bsdf"),
    thinned(
        product(["path", "bpt", "vcm"], ["null", "dielectric", "thindielectric"]),
        [("path", "null"), ("bpt", "dielectric"), ("vcm", "thindielectric")],
    ),
)
def test_a_ball_of_fog_under_a_sky_and_a_lamp(name, bsdf):
    """The lamp is in fog that its shape does not name."""
    facing = transform().translate([0, 0.3, 0]).rotate([1, 0, 0], 90).scale(0.3)
    emitter = {"type": "area", "radiance": rgb(4.0, 4.0, 4.0)}
    scene = {
        "type": "scene",
        "fog": fog(2.0, 0.9),
        "camera": camera((0, 0, 4), (0, 0, 0), 8, 35.0),
        "sky": {"type": "constant", "radiance": rgb(0.3, 0.3, 0.3)},
        "ball": {"type": "sphere", "bsdf": {"type": bsdf}, "interior": FOG},
        "lamp": {"type": "rectangle", "to_world": facing, "bsdf": BLACK, "emitter": emitter},
    }
    problem = load(scene)
    reference = mitsuba_images(problem, volpath(), 8, 512, 1)
    assert_agree(pictures(name, problem, samples=512), reference, f"{name} {bsdf}", precision=0.04)


@pytest.mark.parametrize("name", thinned(["path", "bpt", "vcm"], ["path", "bpt"]))
def test_diffusion(name):
    r"""Deep in a medium that absorbs little, light falls as exp(-kappa r) / r, with kappa^2 = 3 sigma_a sigma_t in the
    limit of small absorption [Ishimaru 1978]: the ratio of the light seen at two depths behind a lit slab."""
    sigma, albedo = 8.0, 0.98
    kappa = diffusion_length(albedo) * sigma
    seen = []
    for depth in (1.0, 1.5):
        body = {"type": "cube", "to_world": transform().scale([40, 40, depth / 2]), "bsdf": {"type": "null"}}
        scene = {
            "type": "scene",
            "fog": fog(sigma, albedo),
            "camera": camera((0, 0, 5), (0, 0, 0), 1, 0.5),
            "slab": body | {"interior": FOG},
            "sun": {"type": "directional", "direction": [0, 0, 1], "irradiance": rgb(1, 1, 1)},
        }
        seen.append(pictures(name, load(scene), 8, 4096).mean((1, 2, 3)))
    ratio = seen[0].mean() / seen[1].mean()
    error = ratio * np.hypot(*(s.std() / len(s) ** 0.5 / s.mean() for s in seen))
    assert error < 0.1 * ratio
    assert abs(ratio - np.exp(0.5 * kappa)) < 4.0 * error + 0.02 * ratio


def diffusion_length(albedo: float) -> float:
    """The root nu of 1 = albedo / (2 nu) ln((1 + nu) / (1 - nu)): inverse diffusion length over extinction, exact for
    isotropic scattering."""
    return brentq(lambda nu: albedo / (2 * nu) * np.log((1 + nu) / (1 - nu)) - 1.0, 1e-6, 1 - 1e-9)


@pytest.mark.parametrize("method", ["path", "light", "bpt"])
def test_single_scattering_of_a_point_light(method):
    r"""L = \int sigma_s exp(-sigma_t (t + r)) I p / r^2 dt along a ray that passes the light at a distance."""
    sigma, albedo, height, reach = 0.7, 0.6, 0.8, 3.0
    scene = {
        "type": "scene",
        "fog": fog(sigma, albedo),
        "camera": camera((0, 0, 6), (0, 0, 0), 1, 0.5),
        "lamp": {"type": "point", "position": [0, height, 0], "intensity": rgb(1, 1, 1), "medium": FOG},
        "air": {"type": "cube", "to_world": transform().scale(reach), "bsdf": {"type": "null"}, "interior": FOG},
    }

    def source(z: float) -> float:
        r = np.hypot(z, height)
        return sigma * albedo * np.exp(-sigma * (reach - z + r)) / (4 * np.pi * r**2)

    expected = quad(source, -reach, reach)[0]
    more = {"light_paths": 64.0} if method == "light" else {}
    images = run(load(scene), method, 8, 4096, max_depth=2, **more).images
    assert_agree(images, expected, method, block=1, precision=0.1 if method == "light" else 0.02)


@pytest.mark.parametrize("depth", thinned((1, 2, 3), (2,)))
def test_boundaries_of_media_are_no_edges(depth):
    """As in ``volpath``: a path of two edges is seen through any number of them."""
    problem = load(slab(fog(1.0, 0.9), sky={"type": "constant"}))
    reference = mitsuba_images(problem, volpath(depth), 6, 256, 1)
    for method in ("path", "bpt"):
        images = run(problem, method, 6, 256, max_depth=depth).images
        assert_agree(images, reference, f"{method}, {depth} edges", block=2, precision=0.05)


def test_small_scenes_are_scaled_with_their_media():
    """A scene is scaled on load if it is small; extinction is per length."""
    picture = etendue.render(closed(fog(1.0, 0.8)), "path", spp=256, seed=1).image
    small = closed(fog(1000.0, 0.8))
    small = {name: dict(part) if isinstance(part, dict) else part for name, part in small.items()}
    for name in ("walls", "lamp"):
        own = small[name].get("to_world", transform())
        small[name]["to_world"] = transform().scale(1e-3) @ own
    small["camera"] = camera((0, 0, 0.95e-3), (0, 0, -1e-3), 8, 70.0, medium=FOG, near_clip=1e-5)
    np.testing.assert_allclose(etendue.render(small, "path", spp=256, seed=1).image.mean(), picture.mean(), rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["vcm", "sppm"])
def test_resumed(method, tmp_path):
    scene, file = closed(fog()), tmp_path / "run.ckpt"
    whole = etendue.render(scene, method, spp=32, samples_per_pass=8, seed=1).image
    etendue.render(scene, method, spp=16, samples_per_pass=8, seed=1, checkpoint=str(file))
    again = etendue.resume(str(file), scene=scene, spp=32).image
    np.testing.assert_allclose(again, whole, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("method", thinned(["path", "bpt", "vcm"], ["vcm"]))
def test_components_are_those_of_the_paths(method):
    """A collision is a scattering event: direct light is that of paths of two edges, all other light indirect."""
    scene = closed(fog())
    result = etendue.render(scene, method, spp=1024, seed=1, components=True)
    parts = sum(result.layers[name] for name in ("emission", "direct", "caustic", "indirect"))
    np.testing.assert_allclose(parts, result.image, rtol=1e-3, atol=1e-5)
    direct, indirect = (np.asarray(result.layers[name]).mean() for name in ("direct", "indirect"))
    short, whole = (etendue.render(scene, "path", spp=4096, seed=2, max_depth=d).image.mean() for d in (2, -1))
    np.testing.assert_allclose([direct, indirect], [short, whole - short], rtol=0.05)


def test_a_lamp_that_is_partly_in_fog():
    """And names no medium: the rays of its halves start in fog and outside of it."""
    emitter = {"type": "area", "radiance": rgb(4.0, 4.0, 4.0)}
    scene = {
        "type": "scene",
        "fog": fog(2.0, 0.9),
        "camera": camera((0, 0, 4), (0, 0, 0), 8, 35.0),
        "ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": FOG},
        "lamp": {"type": "sphere", "center": [0, 1, 0], "radius": 0.3, "bsdf": BLACK, "emitter": emitter},
    }
    problem = load(scene)
    reference = run(problem, "path", 6, 1024, seed=2).images
    assert_agree(run(problem, "bpt", 6, 512).images, reference, "bpt", block=2)
    splats = run(problem, "bpt", 6, 512, next_events=0, connections=0).images
    assert_agree(splats, reference, "hits and splats", block=2, precision=0.05)


# ------------------------------------------------------------------------------------------------ heterogeneous


@pytest.mark.parametrize(
    "method", thinned(["path", "vegas", "light", "bpt", "vcm", "pssmlt"], ["path", "light", "bpt"])
)
def test_a_grid_that_absorbs(method):
    """Extinction rises along the view, by colour: exp of its integral, in which null collisions have no share."""
    rising = np.linspace(0.0, 1.0, 9)[:, None, None, None] * [0.1, 0.3, 1.0]
    scene = slab(smoke(np.broadcast_to(rising, (9, 2, 2, 3)), 0.0), slab=box())
    picture = etendue.render(scene, method, spp=2048, seed=1).image[..., :3]
    expected = np.exp(-2.0 * rising.mean((0, 1, 2)))
    tolerance = 0.06 if method in ("pssmlt", "light") else 0.02  # of their noise
    np.testing.assert_allclose(picture.mean((0, 1)) / expected, 1.0, atol=tolerance)


def box() -> dict:
    return {"type": "cube", "bsdf": {"type": "null"}, "interior": FOG}


#: Media that are compared with Mitsuba's ``volpathmis``.
SMOKE = {
    "grey": lambda: smoke(clouds(), scale=4.0),
    "coloured": lambda: smoke(clouds(3), clouds(3, seed=1), scale=4.0),
    "forward": lambda: smoke(clouds(), 0.95, scale=4.0, phase={"type": "hg", "g": 0.7}),
    "albedos in fog": lambda: fog(1.0, grid(clouds(3))),
}


OF_SMOKE: dict[str, np.ndarray] = {}


@pytest.mark.parametrize(
    ("name", "kind"),
    thinned(
        product(["path", "light", "bpt", "bpt path power", "vcm", "vcm power", "sppm photons", "guided"], SMOKE),
        [*((name, "coloured") for name in ("path", "light", "bpt")), ("path", "albedos in fog")],
    ),
)
def test_a_box_of_smoke(name, kind):
    problem = load(closed(SMOKE[kind]()))
    if kind not in OF_SMOKE:
        integrator = mi.load_dict({"type": "volpathmis", "max_depth": -1, "rr_depth": 8})
        OF_SMOKE[kind] = mitsuba_images(problem, integrator, 8, 256, 1)
    images, reference = pictures(name, problem), OF_SMOKE[kind]
    if SCATTERING[name][0] in MERGING:
        error = np.hypot(images.mean((1, 2, 3)).std() / 6**0.5, reference.mean((1, 2, 3)).std() / 8**0.5)
        bias = 0.02 * reference.mean()
        assert abs(images.mean() - reference.mean()) < bias + 4.0 * error
        return
    assert_agree(images, reference, f"{name} {kind}", precision=0.1 if name == "light" else 0.04)


@pytest.mark.parametrize(
    "name", thinned(["path", "bpt", "vcm", "bpm", "sppm photons", "guided", "auto"], ["path", "bpt", "sppm photons"])
)
def test_furnace_of_smoke(name):
    problem = load(closed(smoke(clouds(3), 1.0, scale=3.0), emission=1.0, albedo=0.0))
    images = pictures(name, problem)
    assert abs(images.mean() - 1.0) < 0.02 + 4.0 * images.mean((1, 2, 3)).std() / 5**0.5


@pytest.mark.slow
def test_merging_in_sparse_smoke_has_no_rare_bright_photons():
    """Layers of smoke with haze between them, a thousandth as dense, in a furnace: everywhere 1. Few photons collide in
    the haze, and in a ball around a point of a layer they count a thousandfold if divided by the extinction where they
    are. So do photons of a layer around a point of the haze if divided by the extinction there. With four seeds, the
    variance of a pixel is from 0.0073 to 0.0084 by the mean of both extinctions, and above 0.075 by either alone. What
    balls lose at the ends of layers and at walls is in proportion to the radius."""
    layers = np.array([1.0, 1e-3, 1.0, 1e-3])[:, None, None, None] * np.ones((4, 2, 2, 1))
    extinction = grid(layers) | {"filter_type": "nearest"}
    medium = {"type": "heterogeneous", "sigma_t": extinction, "albedo": 1.0, "scale": 4.0}
    problem = load(closed(medium, emission=1.0, albedo=0.0))
    settings = {"radius": 0.02, "radius_unit": "absolute", "light_paths": 4.0}
    for radius in (0.15, 0.05):
        images = run(problem, "bpm", 12, 64, volume_radius=radius, **settings).images.mean(-1)
        if radius > 0.1:
            assert images.var(0, ddof=1).mean() < 0.02
        assert abs(images.mean() - 1.0) < 0.8 * radius + 4.0 * images.mean((1, 2)).std() / 11**0.5


@pytest.mark.slow
def test_a_constant_grid_is_fog():
    """Walks collide with the same density, whichever way they find a collision."""
    even = np.full((2, 2, 2, 3), [0.3, 1.0, 2.0])
    scene = closed(smoke(even, 0.8))
    fine = closed(fog((0.15, 0.5, 1.0), 0.8, scale=2.0))
    for method in ("path", "bpt"):
        images = run(load(scene), method, 6, 512).images
        assert_agree(images, run(load(fine), method, 6, 512, first=50).images, method, precision=0.04)


def test_grids_move_with_their_scene():
    """Far from the origin, and small: positions and lengths of volumes are those of the scene."""
    picture = etendue.render(closed(smoke(clouds(), scale=4.0)), "path", spp=512, seed=1).image
    moved = mi.ScalarTransform4d().translate([3e4, 0, 0]).scale(1e-2)
    scene = closed(smoke(clouds(), scale=400.0))
    for part in (scene["walls"], scene["lamp"], scene["fog"]["sigma_t"]):
        part["to_world"] = moved @ mi.ScalarTransform4d(part.get("to_world", transform()).matrix)
    scene["camera"] = camera((3e4, 0, 0.95e-2), (3e4, 0, -1e-2), 8, 70.0, medium=FOG, near_clip=1e-4)
    image = etendue.render(scene, "path", spp=512, seed=1).image
    np.testing.assert_allclose(image.mean((0, 1)), picture.mean((0, 1)), rtol=0.03)


# ------------------------------------------------------------------------------------------------ refusals


#: Functions, as no variant is set yet.
FAULTS = {
    "albedo": (lambda: closed(fog(1.0, 1.5)), "medium 'fog'.*albedo above 1"),
    "negative": (lambda: closed(fog(-1.0)), "medium 'fog'.*negative"),
    "nan": (lambda: closed(fog(float("nan"))), "medium 'fog'.*NaN"),
    "camera": (lambda: closed(fog(), camera=camera((0, 0, 0.95), (0, 0, -1))), "sensor 'camera'.*no medium.*'walls'"),
    "not closed": (lambda: closed(fog(), walls=wall()), "medium 'fog'.*not closed"),
    "no exterior": (
        lambda: closed(fog(), ball={"type": "sphere", "radius": 0.2, "bsdf": {"type": "null"}, "interior": FOG}),
        "shape 'ball'.*no medium",
    ),
    "grid of one extinction": (lambda: closed(fog(grid(clouds()))), "medium 'fog'.*homogeneous; make it 'het"),
    "grid with nan": (lambda: closed(smoke(clouds() * np.nan)), "medium 'fog'.*NaN"),
    "negative grid": (lambda: closed(smoke(-clouds())), "medium 'fog'.*negative 'sigma_t'"),
    "grid of albedos": (lambda: closed(smoke(1.0, 2.0 * clouds())), "medium 'fog'.*albedo above 1"),
    "microflakes": (
        lambda: closed(smoke(1.0, phase={"type": "sggx", "S": grid(np.ones((2, 2, 2, 6)))})),
        "medium 'fog'.*microflakes",
    ),
}


def wall() -> dict:
    """One side of the box."""
    behind = transform().translate([0, 0, -1]).scale(3)
    return {"type": "rectangle", "to_world": behind, "bsdf": BLACK, "exterior": FOG}


@pytest.mark.parametrize("case", FAULTS)
def test_faults_are_named(case):
    scene, text = FAULTS[case]
    with pytest.raises((SceneError, UnsupportedError), match=text) as caught:
        etendue.render(scene(), "path", spp=1)
    assert "\n" not in str(caught.value)


def test_glass_that_overlaps_with_what_it_contains_only_warns(caplog):
    """As in many models: the liquid reaches into the glass."""
    tint = {"type": "ref", "id": "tint"}
    ball = {"type": "sphere", "radius": 0.7, "bsdf": {"type": "null"}, "interior": tint}
    scene = slab(fog(0.5, 0.0)) | {"tint": fog(0.9, 0.0), "ball": ball}
    etendue.render(scene, "path", spp=1)
    assert "give each boundary the media of its two sides" in caplog.text


@pytest.mark.parametrize("method", ["vegas", "pm", "pssmlt", "irradiance_cache", "ambient_path"])
def test_methods_that_do_not_render_fog_say_so(method):
    with pytest.raises(UnsupportedError, match=f"medium 'fog'.*scatters.*'{method}'.*use"):
        etendue.render(closed(fog()), method, spp=1)


def test_other_wings_refuse_media():
    """Radiosity, particles and the functions of transport have no media: never a result that is silently wrong."""
    loaded = mi.load_dict(closed(fog()))
    for ask in (etendue.radiosity.scene_patches, TransportFunctions, etendue.trace_particles):
        with pytest.raises(UnsupportedError, match=r"know no participating media.*medium 'fog'"):
            ask(loaded)


def test_maps_are_refused(tmp_path):
    with pytest.raises(UnsupportedError, match="cannot end in a map"):
        etendue.render(closed(fog()), "path", spp=1, map=str(tmp_path / "none.npz"))


PHASES = {
    "isotropic": {},
    "rayleigh": {},
    "tabphase": {"values": "0.5, 1.0, 1.5"},
    "blendphase": {"weight": 0.4, "a": {"type": "hg", "g": 0.6}, "b": {"type": "hg", "g": -0.5}},
}


@pytest.mark.parametrize("name", thinned(PHASES, ("blendphase",)))
def test_phase_functions_by_mitsuba_s_name(name):
    """Each phase function of Mitsuba with one number for its shape, against ``volpath``."""
    problem = load(closed(fog(1.5, 0.9, phase={"type": name} | PHASES[name])))
    reference = mitsuba_images(problem, volpath(), 6, 512, 1)
    for method in ("path", "bpt"):
        assert_agree(run(problem, method, 6, 256).images, reference, f"{name} {method}", precision=0.04)


@pytest.mark.slow
def test_a_phase_function_in_python():
    """A third-party one."""

    class Forward(mi.PhaseFunction):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_flags = int(+mi.PhaseFunctionFlags.Anisotropic)

        def sample(self, ctx, mei, sample1, sample2, active=True):  # type: ignore[no-untyped-def]
            local = mi.warp.square_to_cosine_hemisphere(sample2)
            return -mei.to_world(local), mi.Spectrum(1.0), mi.warp.square_to_cosine_hemisphere_pdf(local)

        def eval_pdf(self, ctx, mei, wo, active=True):  # type: ignore[no-untyped-def]
            pdf = dr.maximum(mi.Frame3f.cos_theta(mei.to_local(-wo)), 0.0) * dr.inv_pi
            return mi.Spectrum(pdf), pdf

        def traverse(self, callback: mi.TraversalCallback) -> None:
            pass

    mi.register_phase("forward_cosine", Forward)
    problem = load(closed(fog(1.5, 0.9, phase={"type": "forward_cosine"})))
    images = [run(problem, method, 6, 512).images for method in ("path", "bpt")]
    assert_agree(images[1], images[0], "bpt and path", precision=0.04)
