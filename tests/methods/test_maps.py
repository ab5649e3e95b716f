"""Paths that end in maps: exact maps give the pictures of ``path``; final gather; mixed materials; other methods."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.running import Run, Stepped, go, prepared, run
from support.scenes import camera, diffuse, field, furnace, rgb
from support.tables import thinned

from etendue import methods, radiosity, trace_particles
from etendue.core import CheckpointError, OptionError
from etendue.film import relative_mse
from etendue.integration import Integrand, integral
from etendue.methods import photon_hits
from etendue.scene import load
from etendue.surfaces import (
    HistogramBuilder,
    KernelBuilder,
    MapSurfaces,
    NearestMap,
    PatchMap,
    SurfaceError,
    irradiance_at,
    read_map,
    save_map,
    scene_patches,
    solution_map,
)
from etendue.transport import CacheMap, IrradianceCache, TransportFunctions

RADIANCE, ALBEDO = 0.8, 0.5
#: Of the parameters of a ray.
BOX = [(-10.0, 10.0)] * 6
ENDING = ("path", "vegas", "stratified", "guided")


def ended(problem, method, made, seed=1, passes=6, samples=64, **settings) -> Run:
    """Passes of a method whose paths end in a map that is in memory."""
    cls = methods.get(method)
    chosen = cls(cls.Settings.from_mapping({"samples_per_pass": samples, "sampler": "independent"} | settings))
    chosen.map = made
    chosen.prepare(problem, seed)
    return go(Stepped(chosen), passes, seed)


def even(problem, value, cells=200):
    """The same irradiance everywhere."""
    surfaces = MapSurfaces(problem, cells)
    n = len(surfaces.patches)
    return PatchMap(surfaces.places, np.full((n, 1), value), smooth=False, space=problem.space)


@pytest.mark.parametrize("method", ENDING)
def test_the_map_of_a_furnace(method):
    """L / (1 - rho) in every pixel: without noise where the camera sees the map, within its noise by final gather."""
    problem = furnace("box", RADIANCE, ALBEDO)
    exact = RADIANCE / (1 - ALBEDO)
    made = even(problem, np.pi * exact)
    np.testing.assert_allclose(ended(problem, method, made, passes=2).mean, exact, rtol=1e-5)
    pictures = ended(problem, method, made, passes=8, map_after=1).images.mean(axis=(1, 2, 3))
    assert abs(pictures.mean() - exact) < 4 * pictures.std(ddof=1) / np.sqrt(len(pictures)) + 1e-5
    assert pictures.std() < 0.02


@pytest.mark.parametrize("method", thinned([*ENDING[:1], ENDING[3]], ENDING[:1]))
def test_materials_that_also_mirror_or_gloss(method):
    """A ball under an even sky, E = pi L: paths go on through its coat, and along glossy reflections. Z-test."""
    for bsdf in (
        {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2)},
        {"type": "roughplastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2), "alpha": 0.2},
    ):
        sky = {"type": "constant", "radiance": rgb(1.0, 0.5, 0.25)}
        view = camera((0, 0, 4), (0, 0, 0), 20.0, size=(8, 8))
        problem = load({"type": "scene", "sky": sky, "ball": {"type": "sphere", "bsdf": bsdf}, "sensor": view})
        surfaces = MapSurfaces(problem, 200)
        light = np.pi * np.array([[1.0, 0.5, 0.25]]) * np.ones((len(surfaces.patches), 1))
        made = PatchMap(surfaces.places, light, smooth=False, space=problem.space)
        plain = run(problem, method, passes=6, samples=64, seed=7).images.mean(axis=(1, 2))
        mapped = ended(problem, method, made, passes=6).images.mean(axis=(1, 2))
        spread = np.sqrt((plain.var(axis=0, ddof=1) + mapped.var(axis=0, ddof=1)) / 6)
        assert (np.abs(plain.mean(axis=0) - mapped.mean(axis=0)) < 5 * spread + 1e-4).all(), bsdf["type"]


def test_a_first_hit_shows_the_map():
    """Pixel by pixel what the map says at the centre of each, times albedo over pi."""
    problem = field(0.5, 1.0, size=(16, 16))
    surfaces = MapSurfaces(problem, 4)
    made = PatchMap(surfaces.places, np.arange(1.0, 5.0)[:, None], smooth=False)
    picture = ended(problem, "path", made, passes=2).mean
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f([0.3, 0.7, 0.3, 0.7], [0.3, 0.3, 0.7, 0.7]), 0.5)
    points = np.array(problem.scene.ray_intersect(ray).p).T
    seen = irradiance_at(made, points, np.tile([0.0, 1.0, 0.0], (4, 1)))[0]
    assert len(set(seen[:, 0])) == 4
    np.testing.assert_allclose(picture[[4, 4, 11, 11], [4, 11, 4, 11]], 0.5 / np.pi * seen, rtol=1e-4)


@pytest.fixture(scope="module")
def box():
    """The Cornell box, a histogram of its photons, and its picture by ``path``."""
    problem = load("cornell-box", size=(24, 24))
    surfaces = MapSurfaces(problem, 3000)
    builder = HistogramBuilder(surfaces)
    builder.add(trace_particles("cornell-box", particles=50_000).particles)
    return problem, builder.build(), run(problem, "path", passes=2, samples=512).mean


def test_final_gather_hides_the_noise_of_a_map(box):
    problem, made, exact = box
    direct, gathered = (ended(problem, "path", made, passes=2, samples=256, map_after=n).mean for n in (0, 1))
    errors = relative_mse(direct, exact), relative_mse(gathered, exact)
    assert errors[1] < 0.3 * errors[0]
    for picture in (direct, gathered):
        assert abs(picture.mean() / exact.mean() - 1) < 0.02


def test_other_methods_end_in_the_same_map(box):
    """The pictures of the four methods with one map are the same within their noise."""
    problem, made, _ = box
    means, errors = [], []
    for method in ENDING:
        pictures = ended(problem, method, made, passes=6, samples=64, map_after=1).images.mean(axis=(1, 2, 3))
        means.append(pictures.mean())
        errors.append(pictures.std(ddof=1) / np.sqrt(len(pictures)))
    for mean, error in zip(means[1:], errors[1:], strict=True):
        assert abs(mean - means[0]) < 4 * np.hypot(error, errors[0])


def test_a_map_in_a_file(box, tmp_path):
    problem, made, _ = box
    save_map(tmp_path / "map.npz", made)
    inside = ended(problem, "path", made, passes=1, samples=16)
    loaded = run(problem, "path", passes=1, samples=16, map=str(tmp_path / "map.npz"))
    np.testing.assert_allclose(loaded.mean, inside.mean, rtol=1e-5)


@pytest.mark.parametrize("method", thinned([*ENDING[:1], ENDING[3]], ENDING[3:4]))
def test_mirrors_and_null_surfaces_do_not_count(method):
    """Final gather at a floor that is seen through a mask and in a mirror is that of the floor seen directly: its light
    by the lamp, not by the map, which has none."""
    lamp = {"type": "point", "position": [1.5, 1.0, 0.0], "intensity": rgb(1.0, 1.0, 1.0)}
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    floor = {"type": "rectangle", "to_world": turn, "bsdf": diffuse(0.5, 0.5, 0.5)}
    null = {"type": "mask", "opacity": 0.0, "bsdf": diffuse(0.5, 0.5, 0.5)}
    above = mi.ScalarTransform4f().translate([0, 0.5, 0]) @ turn
    mirror = {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": {"type": "conductor"}}}
    mirror |= {"to_world": mi.ScalarTransform4f().translate([0, 0.5, 0]) @ turn.scale(0.2)}
    scene = {"type": "scene", "lamp": lamp, "floor": floor}
    through = {"above": {"type": "rectangle", "bsdf": null, "to_world": above}}
    down, up = (camera((0, y, 0.001), (0, aim, 0), 20.0, size=(4, 4)) for y, aim in ((1, 0), (0.2, 0.5)))
    # The mirror lights the floor, too, but on longer paths.
    for view, more, longest in ((down, through, -1), (up, {"mirror": mirror}, 3)):
        problem = load(scene | {"sensor": view} | more)
        plain = run(problem, method, passes=1, samples=64, max_depth=longest).mean
        gathered = ended(problem, method, even(problem, 0.0, 4), passes=1, map_after=1).mean
        assert plain.max() > 0.01
        np.testing.assert_allclose(gathered, plain, rtol=1e-3)
        assert ended(problem, method, even(problem, 0.0, 4), passes=1).mean.max() == 0.0


def test_a_map_that_lacks_a_surface_says_so(caplog):
    """Once: the ball at the side is black."""
    scene = {
        "type": "scene",
        "sky": {"type": "constant", "radiance": rgb(1.0, 1.0, 1.0)},
        "floor": {"type": "rectangle", "bsdf": diffuse(0.5, 0.5, 0.5)},
        "sensor": camera((0, 0.1, 4), (0, 0, 0), 30.0, size=(16, 16)),
    }
    made = even(load(scene), np.pi)
    ball = {"type": "sphere", "center": [0.5, 0.0, 0.5], "radius": 0.3, "bsdf": diffuse(0.5, 0.5, 0.5)}
    problem = load(scene | {"ball": ball})
    ended(problem, "path", made, passes=3, samples=4)
    assert caplog.text.count("% of the paths end; they are black there") == 1
    caplog.clear()
    ended(load(scene), "path", made, passes=1, samples=4)
    assert not caplog.text


def test_bad_input(box, tmp_path):
    problem, made, _ = box
    with pytest.raises(SurfaceError, match="there is no file of a map"):
        run(problem, "path", passes=1, samples=1, map=str(tmp_path / "none.npz"))
    other = furnace("sphere", RADIANCE, ALBEDO)
    with pytest.raises(OptionError, match="has no surface where"):
        ended(other, "path", made, passes=1, samples=1)
    with pytest.raises(OptionError, match="not in both"):
        ended(problem, "stratified", made, passes=1, samples=1, maps=1)
    with pytest.raises(OptionError, match="one_path=true cannot be combined"):
        run(problem, "vegas", passes=1, samples=1, one_path=True, map="map.npz")


@pytest.mark.parametrize("method", ENDING)
def test_a_run_is_resumed_with_its_map_only(method, tmp_path):
    problem = furnace("box", RADIANCE, ALBEDO)
    path = tmp_path / "map.npz"
    save_map(path, even(problem, 1.0))
    first = prepared(problem, method, map=str(path), samples_per_pass=1)
    first.step(0, 1)
    prepared(problem, method, map=str(path), samples_per_pass=1).restore(first.state())
    save_map(path, even(problem, 2.0))
    with pytest.raises(CheckpointError, match="is not the one the checkpoint was made with: restore the file"):
        prepared(problem, method, map=str(path), samples_per_pass=1).restore(first.state())


def mean_of(problem, made):
    """Of the picture that a map shows."""
    return ended(problem, "path", made, passes=1, samples=128).mean.mean()


def test_maps_of_all_kinds_agree(box, tmp_path):
    """The mean picture of the diffuse Cornell box as maps show it: histogram, kernels, photon map and radiosity, within
    5 % of path tracing and of each other."""
    problem, made, exact = box
    surfaces = MapSurfaces(problem, 1500)
    builder = KernelBuilder(surfaces, 0.15)
    builder.add(trace_particles("cornell-box", particles=50_000).particles)
    photons = photon_hits(prepared(problem, "pm", photons=50_000).shoot(0, 1), problem)
    patches = scene_patches(problem, max_area=0.05)
    solution = radiosity.solve(patches, radiosity.ABuffer(patches).cast(200))
    radiosity.save_solution(tmp_path / "solution.npz", solution)
    read = read_map(tmp_path / "solution.npz", problem)
    np.testing.assert_array_equal(read.values, solution.irradiance)
    assert read.kind == "radiosity"
    every = [made, builder.build(), NearestMap(surfaces, photons, 50), solution_map(solution, space=problem.space)]
    means = np.array([mean_of(problem, each) for each in every])
    assert np.abs(means / exact.mean() - 1).max() < 0.05
    assert np.ptp(means) < 0.05 * exact.mean()


def test_a_cache_as_a_map():
    """In even light every record is the same, and where none is valid one is made."""
    problem = furnace("box", RADIANCE, ALBEDO)
    even_light = Integrand(lambda x: [0 * x[0] + c for c in (1.0, 2.0, 3.0)], BOX, on="device", values=3)
    light = TransportFunctions(problem.scene)
    cache = IrradianceCache((0.3, 2.0), 0.5, strata=(4, 8))
    made = CacheMap(cache, even_light, light.distance, problem.space)
    points = np.array([[0.1, 1.0, 0.2], [0.3, -1.0, 0.9], [1.0, 0.0, 0.0]])
    value, error = irradiance_at(made, points, -np.sign(points) * (np.abs(points) == 1))
    np.testing.assert_allclose(value, np.pi * np.array([[1.0, 2.0, 3.0]] * 3), rtol=1e-5)
    assert np.isnan(error).all()
    records = len(cache)
    assert 0 < records <= 3
    irradiance_at(made, points, -np.sign(points) * (np.abs(points) == 1))
    assert len(cache) == records
    np.testing.assert_allclose(
        ended(problem, "path", made, passes=1, samples=1).mean.mean(axis=(0, 1)),
        [RADIANCE + ALBEDO * c for c in (1.0, 2.0, 3.0)],
        rtol=1e-4,
    )


@pytest.mark.slow
def test_a_cache_agrees_with_the_other_maps(box):
    """Of radiance along paths of up to eight edges: the rest is 1 %."""
    problem, made, _ = box
    light = TransportFunctions(problem.scene)
    direct = integral(light.direct, [6, 7], samples=1, seed=1)
    reflected = direct
    for bounce in range(6):
        onward = light.weight * reflected.compose(light.scatter)
        reflected = direct + integral(onward, [6, 7, 8], samples=1, seed=2 + bounce)
    cache = IrradianceCache((0.15, 1.0), 0.5, strata=(12, 36))
    found = CacheMap(cache, light.emitted + reflected, light.distance, problem.space)
    # Of the same few points, as each asks all records.
    means = [ended(problem, "path", each, passes=1, samples=8).mean.mean() for each in (found, made)]
    assert abs(means[0] / means[1] - 1) < 0.05


@pytest.fixture(scope="module")
def jewel():
    """A small board far from the origin below a lamp, which is rendered in larger coordinates."""
    side, centre = 0.05, [64.0, 0.0, 0.0]
    place = mi.ScalarTransform4f().translate(centre)
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(side)
    over = mi.ScalarTransform4f().translate([0, side, 0]).rotate([1, 0, 0], 90).scale(side)
    board = {"type": "rectangle", "bsdf": diffuse(0.5, 0.5, 0.5)}
    lamp = board | {"emitter": {"type": "area", "radiance": rgb(3.0, 2.0, 1.0)}, "bsdf": diffuse(0.0, 0.0, 0.0)}
    scene = {
        "type": "scene",
        "board": board | {"to_world": place @ turn},
        "lamp": lamp | {"to_world": place @ over},
        "sensor": camera([64.0, 0.02, 0.2], centre, size=(8, 8)),
    }
    problem = load(scene)
    assert problem.space.scale > 1
    return scene, problem


def test_photons_have_the_power_of_the_scene(jewel):
    """In a scene that is scaled for rendering: the board's light, as particles have it."""
    scene, problem = jewel
    photons = photon_hits(prepared(problem, "pm", photons=20_000).shoot(0, 1), problem)
    particles = trace_particles(scene, particles=20_000).particles
    on_board = photons.position[:, 1] < 0.01
    traced = particles.power[particles.position[:, 1] < 0.01].sum(axis=0)
    np.testing.assert_allclose(photons.power[on_board].sum(axis=0), traced, rtol=0.03)


def test_a_cache_has_the_lengths_of_the_scene(jewel):
    """Two points a hundredth apart share a record of reach 0.02, but have one each of reach 0.002."""
    _, problem = jewel
    points = np.array([[64.0, 0.0, 0.0], [64.01, 0.0, 0.0]])
    up = np.tile([0.0, 1.0, 0.0], (2, 1))
    light = TransportFunctions(problem.scene)
    for reach, records in ((0.02, 1), (0.002, 2)):
        cache = IrradianceCache((reach, reach), 1.0, strata=(24, 72))
        made = CacheMap(cache, light.emitted, light.distance, problem.space)
        irradiance_at(made, points[:1], up[:1])
        value = irradiance_at(made, points, up)[0]
        assert len(cache) == records
        # Of the form factor of a square, seen from below its centre at half its width.
        expected = 4 * np.sqrt(0.5) * np.arctan(np.sqrt(0.5)) * np.array([3.0, 2.0, 1.0])
        np.testing.assert_allclose(value[0], expected, rtol=0.03)
        np.testing.assert_allclose(cache.records[:, :3], points[:records], atol=1e-7)


def test_particles_are_reflected_by_their_directions():
    """A rough metal plate under a lamp: with their directions, the nearest particles give the light of ``path``, which
    has a highlight on the plate."""
    up, down = (mi.ScalarTransform4f().rotate([1, 0, 0], angle) for angle in (-90, 90))
    metal = {"type": "roughconductor", "material": "none", "alpha": 0.4}
    over = mi.ScalarTransform4f().translate([0, 1, 0]) @ down
    lamp = {"type": "rectangle", "to_world": over.scale(0.4), "bsdf": diffuse(0.0, 0.0, 0.0)}
    scene = {
        "type": "scene",
        "plate": {"type": "rectangle", "to_world": up, "bsdf": metal},
        "lamp": lamp | {"emitter": {"type": "area", "radiance": rgb(3.0, 2.0, 1.0)}},
        "sensor": camera([0.0, 0.6, 2.0], [0, 0, 0], 25.0, size=(6, 6)),
    }
    problem = load(scene)
    exact = run(problem, "path", passes=2, samples=2048).mean[1:5, 1:5]
    particles = trace_particles(scene, particles=60_000).particles
    made = NearestMap(MapSurfaces(problem, 100), particles, 400)
    found = ended(problem, "path", made, passes=1, samples=64, map_glossy=True).mean[1:5, 1:5]
    assert exact.max() > 2 * exact.min() > 0
    np.testing.assert_allclose(found.mean(axis=(0, 1)), exact.mean(axis=(0, 1)), rtol=0.03)
    assert np.abs(found - exact).max() < 0.05 * exact.max()  # measured: 0.03


def test_directions_are_those_of_the_nearest_particles():
    problem = furnace("box", RADIANCE, ALBEDO)
    with pytest.raises(OptionError, match="map_glossy=true is for maps of the nearest particles"):
        ended(problem, "path", even(problem, 1.0), map_glossy=True)
