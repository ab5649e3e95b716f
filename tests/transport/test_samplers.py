"""Samplers against the densities they claim.

For any set B of rays, the mean of 1_B / p over rays drawn with density p is the measure of B, whatever p is: so the
rays are sorted into sets whose measure is known, and each set is a test of the density on it.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.statistics import assert_mean
from support.tables import crossed, thinned

from etendue.core import IndependentSource
from etendue.scene import LightTable
from etendue.transport import (
    cosine_ratio,
    emission_of_hit,
    emit,
    evaluate_camera_end,
    evaluate_light_end,
    is_emissive,
    sample_direct,
    scatter_camera,
    scatter_light,
    scatter_light_uniform,
    scatter_uniform,
)

N = 200_000
#: Materials with a density to speak of.
SMOOTH = [
    m for m in scenes.MATERIALS if m not in ("conductor", "dielectric", "pane", "null") and not m.endswith("unflipped")
]


def speckled(shape: str) -> Any:
    """A turned lamp that is dark but for a few texels, or triangles that are lit at one corner."""
    place = scenes.transform().translate([0.3, 1.6, -0.2]).rotate([1, 0, 0], 150).rotate([0, 1, 0], 35)
    if shape == "attribute":
        corners = np.array([[-0.2, 1.6, -0.7], [0.8, 1.6, -0.7], [0.8, 1.7, 0.3], [-0.2, 1.9, 0.3]])
        colours = np.array([[0.1, 0.1, 0.1], [9.0, 6.0, 3.0], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1]])
        radiance = {"type": "mesh_attribute", "name": "vertex_color"}
        return scenes.mesh(
            corners,
            np.array([[0, 1, 2], [0, 2, 3]]),
            scenes.diffuse(0, 0, 0),
            colours=colours,
            emitter={"type": "area", "radiance": radiance},
        )
    pixels = np.full((16, 24, 3), 0.02)
    pixels[11, 5] = [60.0, 40.0, 20.0]
    pixels[2:4, 14:20] = [3.0, 9.0, 6.0]
    light = {"type": "area", "radiance": scenes.bitmap(pixels)}
    if shape == "focused":
        return {"type": "rectangle", "to_world": place.scale([0.5, 0.3, 1.0])} | {
            "emitter": light | {"type": "focusarea", "exponent": 3.0}
        }
    if shape == "cylinder":
        return {"type": shape, "to_world": place, "p0": [0, 0, 0], "p1": [0, 0.5, 0], "radius": 0.2, "emitter": light}
    size = [0.4, 0.4, 0.4] if shape == "sphere" else [0.5, 0.3, 0.2]
    return {"type": shape, "to_world": place.scale(size), "emitter": light}


#: Area lights whose radiance varies.
SPECKLED = ("rectangle", "disk", "cylinder", "sphere", "cube", "focused", "attribute")


def source(role: str, n: int = N) -> IndependentSource:
    return IndependentSource(dr.arange(mi.UInt32, n), 5, role, 0)


def stage(*emitters: str) -> tuple[Any, LightTable]:
    """A floor under the named emitters."""
    scene: dict[str, Any] = {"type": "scene", "sensor": scenes.camera()}
    for name in emitters:
        shape = name.removeprefix("speckled ")
        scene[name.replace(" ", "-")] = speckled(shape) if shape != name else scenes.EMITTERS[name]()["light"]
    floor = {"type": "rectangle", "to_world": scenes.transform().rotate([1, 0, 0], -90).scale(2.0)}
    scene["floor"] = floor | {"bsdf": scenes.diffuse(0.5, 0.5, 0.5)}
    problem = scenes.load(scene)
    return problem.scene, LightTable(problem.scene)


def rays(lights: LightTable) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """(emitted, 1 / density, directions, origins) of ``N`` emitted rays; inactive rays have 1 / density zero."""
    emitted = emit(lights, source("light"), dr.full(mi.Bool, True, N))
    dr.eval(emitted)  # once, or each array that is read would compile a kernel that draws the rays anew
    inverse = np.array(dr.select(emitted.active, dr.rcp(emitted.emission_density), 0.0), np.float64)
    shape = (3, N)
    direction = np.broadcast_to(np.array(emitted.ray.d, np.float64), shape)
    return emitted, np.broadcast_to(inverse, N), direction, np.broadcast_to(np.array(emitted.ray.o, np.float64), shape)


def octants(direction: np.ndarray) -> list[np.ndarray]:
    x, y, z = direction > 0
    return [(x == a) & (y == b) & (z == c) for a in (True, False) for b in (True, False) for c in (True, False)]


def polygon_area(name: str) -> float:
    """Area of the emitter's shape."""
    scene, _ = stage(name)
    return float(np.asarray(scene.emitters()[0].get_shape().surface_area()).ravel()[0])


@pytest.mark.parametrize(
    "name", ["rectangle", "disk", "sphere", "mesh", "textured", *(f"speckled {shape}" for shape in SPECKLED)]
)
def test_emission_of_area_lights(name):
    """E[cos / p] over rays is area times pi, in total and in every part of the shape and the hemisphere."""
    scene, lights = stage(name)
    emitted, inverse, _, origin = rays(lights)
    cos = np.array(emitted.cos_light, np.float64)
    area = polygon_area(name)
    assert_mean(cos * inverse, area * np.pi, name)
    for low, high in ((0.0, 0.3), (0.3, 0.6), (0.6, 0.9), (0.9, 1.0)):
        inside = (cos >= low) & (cos < high)
        assert_mean(inside * cos * inverse, area * np.pi * (high**2 - low**2), (name, low))
    centre = np.asarray(scene.emitters()[0].get_shape().bbox().center(), np.float64).ravel()
    if name not in ("mesh", "speckled attribute"):
        assert_mean((origin[0] > centre[0]) * cos * inverse, area * np.pi / 2, (name, "half"))
    # What a path carries is radiance cos / p.
    live = inverse > 0.0
    le = np.array(emitted.throughput, np.float64)[:, live] / (cos * inverse)[live]
    if name.startswith("speckled"):
        assert le.max() > 2.0
    elif name != "textured":
        expected = np.array(scenes.EMITTERS[name]()["light"]["emitter"]["radiance"]["value"], np.float64)
        np.testing.assert_allclose(le, np.broadcast_to(expected[:, None], le.shape), rtol=1e-3)
    else:
        assert le.min() > 2.9
        assert le.max() < 10.1


@pytest.mark.parametrize("shape", SPECKLED)
def test_points_are_drawn_where_the_light_is_bright(shape):
    """In proportion to the radiance of a cell, but for one in twenty: what rays carry hardly varies. A cell of a mesh
    is a triangle."""
    scene, lights = stage(f"speckled {shape}")
    emitted, _, _, _ = rays(lights)
    carried = np.array(dr.select(emitted.active, emitted.throughput, 0.0), np.float64).mean(0)
    emitter = scene.emitters()[0]
    if shape == "attribute":  # which a point drawn by Mitsuba has not
        assert carried.mean() == pytest.approx(lights.total_power, rel=0.05)
        return
    assert_mean(carried, lights.total_power, shape, sigmas=5.0)
    u = mi.Point2f(*source("light").next_2d(0, 1))
    si = mi.SurfaceInteraction3f(emitter.get_shape().sample_position(0.0, u), mi.Color0f())
    si.wi = mi.Vector3f(0.0, 0.0, 1.0)
    uniform = np.array(emitter.eval(si), np.float64).mean(0)
    gain = (uniform.std() / uniform.mean()) / (carried.std() / carried.mean())
    assert gain > (1.05 if shape == "cube" else 3.0), gain


def test_emission_of_a_point_light():
    _, lights = stage("point")
    emitted, inverse, direction, _ = rays(lights)
    for octant in octants(direction):
        assert_mean(octant * inverse, np.pi / 2)
    intensity = np.array(emitted.throughput, np.float64) / inverse
    np.testing.assert_allclose(intensity.mean(1), [6, 5, 4], rtol=1e-4)
    np.testing.assert_allclose(np.array(emitted.area_density), 1.0, rtol=1e-6)


def test_emission_of_a_spot():
    """The cone is 40 degrees wide, full within 20, and falls linearly in the angle between them."""
    _, lights = stage("spot")
    emitted, inverse, direction, _ = rays(lights)
    axis = np.array([0, 0, -0.2]) - [1.2, 2.6, 1.5]
    angle = np.arccos(np.clip(direction.T @ (axis / np.linalg.norm(axis)), -1, 1))
    for low, high in ((0, 10), (10, 20), (20, 30), (30, 38)):
        a, b = np.deg2rad([low, high])
        assert_mean((angle >= a) * (angle < b) * inverse, 2 * np.pi * (np.cos(a) - np.cos(b)), (low, high))
    lit = inverse > 0
    assert angle[lit].max() < np.deg2rad(40.1)
    intensity = np.array(emitted.throughput[0], np.float64)[lit] / inverse[lit]
    expected = 30 * np.clip((np.deg2rad(40) - angle[lit]) / np.deg2rad(20), 0, 1)
    np.testing.assert_allclose(intensity, expected, rtol=2e-2, atol=0.05)


@pytest.mark.parametrize("name", ["constant", "envmap"])
def test_emission_of_the_environment(name):
    """Directions over the sphere, points over a disc of the scene's radius across each."""
    _, lights = stage(name)
    _, inverse, direction, origin = rays(lights)
    disc = np.pi * lights.radius**2
    for octant in octants(direction):
        assert_mean(octant * inverse, np.pi / 2 * disc, name)
    centre = np.array(lights.centre, np.float64).reshape(3, 1)
    offset = origin - centre
    across = offset - (offset * direction).sum(0) * direction
    distance = np.linalg.norm(across, axis=0)
    assert distance.max() <= lights.radius * (1 + 1e-4)
    assert_mean((distance < 0.5 * lights.radius) * inverse, 4 * np.pi * disc / 4, name)


@pytest.mark.parametrize("names", [("rectangle", "sphere"), ("mesh", "spot", "constant"), ("point", "disk", "envmap")])
def test_several_emitters_are_picked_with_the_density_they_claim(names):
    """E[1 / p_A] over picks is the sum of the areas (and one for each light that is a point)."""
    _, lights = stage(*names)
    emitted, _, _, _ = rays(lights)
    area = np.array(dr.rcp(emitted.area_density), np.float64)
    infinite, delta = (np.broadcast_to(np.array(v), N) for v in (emitted.is_infinite, emitted.is_delta))
    live = np.array(emitted.active)
    surfaces = sum(polygon_area(n) for n in names if n in ("rectangle", "sphere", "mesh", "disk"))
    assert_mean(area * (~infinite & ~delta), surfaces, names)
    assert_mean(area * delta, sum(n in ("point", "spot") for n in names), names)
    if infinite.any():
        assert_mean(area * infinite * live, 4 * np.pi, names)  # density of the direction


def assert_close(computed: np.ndarray, expected: np.ndarray, share: float = 0.999) -> None:
    """Within two per cent, but for a few where rounding decides which face or lobe it is."""
    close = np.isclose(computed, expected, rtol=2e-2, atol=1e-3)
    assert close.mean() >= share, (close.mean(), computed[~close][:5], expected[~close][:5])


def floor_points(n: int = N) -> Any:
    """Points of the floor, facing up."""
    random = np.random.default_rng(3)
    origin = np.stack([random.uniform(-1, 1, n), np.full(n, 0.5), random.uniform(-1, 1, n)]).astype(np.float32)
    return mi.Ray3f(mi.Point3f(origin), mi.Vector3f(0.0, -1.0, 0.0))


@pytest.mark.parametrize(
    "names",
    [
        *(("rectangle",), ("sphere",), ("mesh",), ("textured",), ("constant",), ("envmap",), ("disk", "constant")),
        *((f"speckled {shape}",) for shape in ("cylinder", "sphere", "focused", "attribute")),
        ("speckled cube", "speckled disk", "rectangle"),
    ],
)
def test_next_event_and_hits_agree_about_densities(names):
    """A ray sent to where next event points meets the light; both give it the same densities and radiance."""
    scene, lights = stage(*names)
    si = scene.ray_intersect(floor_points())
    dr.eval(si)
    direct = sample_direct(lights, si, source("camera"), mi.UInt32(1), 0, si.is_valid())
    ray = si.spawn_ray(direct.direction)
    if not lights.has_infinite:  # from where it starts, a little beside the point
        ray.d = dr.normalize(direct.target - ray.o)
    hit = scene.ray_intersect(ray, direct.active)
    seen = direct.active & is_emissive(scene, hit)
    # The nearest light on the way is the one that was drawn: its distance says so.
    infinite = ~hit.is_valid()
    distance = dr.norm(direct.target - si.p)
    seen &= infinite | (dr.abs(hit.t - distance) < 1e-3 * distance)
    cos = dr.select(infinite, 1.0, dr.abs(dr.dot(hit.n, direct.direction)))
    # The ray starts a little off the floor: at a grazing angle it meets another point of the light.
    seen &= cos > 0.3
    radiance, area_density, emission_density = emission_of_hit(lights, scene, hit, seen, si.p)
    dr.eval(direct, hit, seen, cos, radiance, area_density, emission_density)
    pdf = dr.select(infinite, area_density, area_density * dr.square(hit.t) / cos)
    ratio = direct.light_ratio * direct.pdf * cos
    mask = np.array(seen)
    assert mask.mean() > 0.2
    pairs = ((pdf, direct.pdf), (emission_density, ratio), (radiance, direct.radiance * direct.pdf))
    for computed, expected in pairs:
        assert_close(np.array(computed)[..., mask], np.array(expected)[..., mask])


@pytest.mark.parametrize("name", ["sphere", "speckled sphere"])
def test_next_event_covers_the_cone_of_a_sphere(name):
    """Uniformly, from near and far: inside a circle around its middle the share is that of the solid angles, and no
    sample is lost."""
    _scene, lights = stage(name)
    x, y, z, radius = np.array(lights.row(mi.UInt32(0)).sphere, np.float64).ravel()
    random = np.random.default_rng(6)
    towards = random.normal(size=(3, N))
    towards /= np.linalg.norm(towards, axis=0)
    for factor in (1.01, 1.5, 4.0, 300.0):
        si = dr.zeros(mi.SurfaceInteraction3f, N)
        si.p = mi.Point3f((np.array([[x], [y], [z]]) + factor * radius * towards).astype(np.float32))
        direct = sample_direct(lights, si, source("camera"), mi.UInt32(1), 0, dr.full(mi.Bool, True, N))
        dr.eval(direct)
        active = np.array(direct.active)
        assert active.mean() > 0.999
        cosine = -(np.array(direct.direction, np.float64) * towards).sum(0)
        limit = np.sqrt(1.0 - 1.0 / factor**2)
        extent = 1.0 / factor**2 / (1.0 + limit)
        pdf = np.array(direct.pdf, np.float64)
        np.testing.assert_allclose(pdf[active], 1.0 / (2.0 * np.pi * extent), rtol=2e-3)
        if factor < 100.0:  # where a cosine says something
            for share in (0.1, 0.5, 0.9):
                assert_mean(active & (1.0 - cosine < share * extent), share, (name, factor, share))
        across = np.array(direct.direction, np.float64)[0] + towards[0] * cosine
        assert_mean(active & (across > 0.0), 0.5, (name, factor, "half"))
        away = np.linalg.norm(np.array(direct.target, np.float64) - [[x], [y], [z]], axis=0)
        np.testing.assert_allclose(away[active], radius, rtol=1e-3)


@pytest.mark.parametrize("name", ["constant", "envmap"])
def test_next_event_covers_the_sky(name):
    scene, lights = stage(name)
    si = scene.ray_intersect(floor_points())
    direct = sample_direct(lights, si, source("camera"), mi.UInt32(1), 0, si.is_valid())
    dr.eval(direct)
    inverse = np.array(dr.select(direct.active, dr.rcp(direct.pdf), 0.0), np.float64)
    for octant in octants(np.array(direct.direction, np.float64)):
        assert_mean(octant * inverse, np.pi / 2, name)


def balls(material: str, inside: bool = False) -> tuple[Any, Any]:
    """Interactions on a ball of a material, from all around or from within; and on a plate or tent, as the material has
    it."""
    problem = scenes.room("constant", (material,))
    random = np.random.default_rng(4)
    n = 20_000
    target = np.array([-0.9, 0.302, 0.45])[:, None]
    towards = random.normal(size=(3, n))
    towards /= np.linalg.norm(towards, axis=0)
    towards[1] = -np.abs(towards[1])
    origin = target - (0.0 if inside else 1.5) * towards + random.uniform(-0.15, 0.15, (3, n))
    ray = mi.Ray3f(mi.Point3f(origin.astype(np.float32)), mi.Vector3f(towards.astype(np.float32)))
    si = problem.scene.ray_intersect(ray)
    dr.eval(si)
    return problem.scene, si


@pytest.mark.parametrize("material", SMOOTH)
def test_scattering_gives_both_densities(material):
    """Density of the sampled direction, and the reverse: the BSDF's own for exchanged directions and transport."""
    scene, si = balls(material)
    bsdf = si.bsdf()
    active = si.is_valid()
    radiance, importance = mi.BSDFContext(), mi.BSDFContext(mi.TransportMode.Importance)
    for scatter, forward, backward in (
        (scatter_camera, radiance, importance),
        (scatter_light, importance, radiance),
    ):
        scattered, _ = scatter(scenes.material(scene, si), si, source("camera", dr.width(si)), mi.UInt32(1), active)
        wo = si.to_local(scattered.direction)
        swapped = mi.SurfaceInteraction3f(si)
        swapped.wi = wo
        smooth = scattered.active & ~scattered.is_delta
        pdf, reverse = bsdf.pdf(forward, si, wo, active), bsdf.pdf(backward, swapped, si.wi, active)
        dr.eval(scattered, smooth, pdf, reverse)
        smooth, pdf, reverse = np.array(smooth), np.array(pdf), np.array(reverse)
        # Mitsuba's rough glass samples and evaluates apart in one case of two hundred, near total reflection.
        share = 0.99 if material == "roughdielectric" else 0.999
        assert_close(np.array(scattered.pdf)[smooth], pdf[smooth], share)
        assert_close(np.array(scattered.reverse_pdf)[smooth], reverse[smooth], share)
        cos = np.abs(np.array(dr.dot(si.n, scattered.direction)))
        np.testing.assert_allclose(np.array(scattered.cos)[smooth], cos[smooth], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("material", [m for m in scenes.MATERIALS if m not in ("pane", "null")])
def test_both_ends_evaluate_one_function(material):
    """f(eye, light) |cos light| from the eye's side, and from the light's side the same function, exchanged."""
    scene, si = balls(material)
    bsdf, active = scenes.material(scene, si), si.is_valid()
    local = mi.warp.square_to_uniform_sphere(mi.Point2f(*source("camera", dr.width(si)).next_2d(1, 1)))
    camera = evaluate_camera_end(bsdf, si, local, active)
    exchanged = mi.SurfaceInteraction3f(si)
    exchanged.wi = local
    light = evaluate_light_end(bsdf, exchanged, si.wi, active)
    dr.eval(camera, light)
    mask = np.array(active)
    for a, b in ((camera.value, light.value), (camera.pdf, light.reverse_pdf), (camera.reverse_pdf, light.pdf)):
        np.testing.assert_allclose(np.array(a)[..., mask], np.array(b)[..., mask], rtol=1e-3, atol=1e-5)
    if material in SMOOTH:
        assert np.array(camera.value)[..., mask].max() > 0.01


@pytest.mark.parametrize("material", SMOOTH)
def test_the_weight_of_a_light_side_scattering(material):
    """Value over density, times the ratio of the geometric cosines."""
    scene, si = balls(material)
    bsdf, active = scenes.material(scene, si), si.is_valid()
    scattered, _ = scatter_light(bsdf, si, source("light", dr.width(si)), mi.UInt32(1), active)
    wo = si.to_local(scattered.direction)
    value = evaluate_light_end(bsdf, si, wo, active).value * cosine_ratio(si, scattered.direction)
    dr.eval(scattered, value)
    mask = np.array(scattered.active & ~scattered.is_delta & (scattered.pdf > 1e-2))
    weight, expected = np.array(scattered.weight * scattered.pdf)[:, mask], np.array(value)[:, mask]
    np.testing.assert_allclose(weight, expected, rtol=2e-2, atol=1e-3)


def test_a_mirror_keeps_the_flux():
    """Without shading normals the adjoint of a mirror or glass is the plain weight: no cosine is left over."""
    for material in ("conductor", "dielectric"):
        scene, si = balls(material)
        scattered, _ = scatter_light(
            scenes.material(scene, si), si, source("light", dr.width(si)), mi.UInt32(1), si.is_valid()
        )
        dr.eval(scattered)
        weight = np.array(scattered.weight)[:, np.array(scattered.active)]
        assert weight.max() < 1.001
        if material == "dielectric":
            np.testing.assert_allclose(weight, 1.0, rtol=1e-3)


@pytest.mark.parametrize(("material", "end"), crossed(SMOOTH, ["camera", "light"], 2))
def test_the_mean_weight_of_scattering_is_the_integral(material, end):
    """Mean weight of sampled directions against the value integrated over uniform ones: samples that a BSDF gives
    up (below the horizon, by a wrong half vector) must not come back with a weight."""
    # A map that flips invalid normals has one frame for each side it is seen from, so what is sampled from the light
    # side is not all that is seen from the eye side (docs/methods/light.md, limits).
    flips = material in ("bumpmap", "normalmap") and end == "light"
    scene, si = balls(f"{material} unflipped" if flips else material)
    bsdf, active = scenes.material(scene, si), si.is_valid()
    sampled, integrated = [], []
    for repeat in range(12):
        numbers = IndependentSource(dr.arange(mi.UInt32, dr.width(si)), 5, end, repeat)
        local = mi.warp.square_to_uniform_sphere(mi.Point2f(*numbers.next_2d(2, 1)))
        if end == "camera":
            scattered, _ = scatter_camera(bsdf, si, numbers, mi.UInt32(1), active)
            value = evaluate_camera_end(bsdf, si, local, active).value
        else:
            scattered, _ = scatter_light(bsdf, si, numbers, mi.UInt32(1), active)
            value = evaluate_light_end(bsdf, si, local, active).value * cosine_ratio(si, si.to_world(local))
        if material in ("bumpmap", "normalmap"):
            # They reflect to the eye below the horizon that the sampler, and a closed object, keep it from.
            value = dr.select(local.z * si.wi.z > 0.0, value, 0.0)
        # Delta lobes (of plastic) have no value to integrate.
        smooth = scattered.active & ~scattered.is_delta
        drawn, uniform = dr.select(smooth, scattered.weight.y, 0.0), dr.select(active, value.y * (4 * dr.pi), 0.0)
        dr.eval(drawn, uniform)
        sampled.append(np.array(drawn, np.float64).mean())
        integrated.append(np.array(uniform, np.float64).mean())
    difference = np.array(sampled) - np.array(integrated)
    assert np.mean(integrated) > 0.05
    assert_mean(difference, 0.0, (material, end, np.mean(sampled), np.mean(integrated)), sigmas=6.0)


@pytest.mark.parametrize(
    ("material", "inside"),
    thinned(
        [*((m, False) for m in (*scenes.MATERIALS, "frosted")), ("frosted", True)],
        [(m, False) for m in list(scenes.MATERIALS)[::3]],
    ),
)
@pytest.mark.parametrize(
    "pair", [(scatter_camera, scatter_uniform), (scatter_light, scatter_light_uniform)], ids=["camera", "light"]
)
def test_uniform_directions_carry_what_those_of_the_material_do(pair, material, inside, monkeypatch):
    """To either side of the surface. The frosted glass of `skylight` has a value in one direction of thousands."""
    frosted = {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.08}
    monkeypatch.setitem(scenes.MATERIALS, "frosted", lambda: frosted)
    # As in the test of mean weights: maps that flip invalid normals sample less from the light side.
    flips = material in ("bumpmap", "normalmap") and pair[0] is scatter_light
    scene, si = balls(f"{material} unflipped" if flips else material, inside)
    bsdf, active = scenes.material(scene, si), si.is_valid()
    differences: dict[str, list[np.ndarray]] = {"back": [], "on": []}
    means = []
    for repeat in range(60 if material == "frosted" else 12):
        weights = []
        for role, scatter in zip(("material", "uniform"), pair, strict=True):
            numbers = IndependentSource(dr.arange(mi.UInt32, dr.width(si)), 5, role, repeat)
            scattered, _ = scatter(bsdf, si, numbers, mi.UInt32(1), active)
            back = dr.dot(scattered.direction, si.n) * dr.dot(si.wi, si.to_local(si.n)) > 0.0
            weight = dr.select(scattered.active, scattered.weight.y, 0.0)
            dr.eval(back, weight)
            weights.append([np.array(dr.select(mask, weight, 0.0), np.float64) for mask in (back, ~back)])
        means.append(weights[0][0].mean() + weights[0][1].mean())
        for side, a, b in zip(differences, *weights, strict=True):
            differences[side].append(a - b)
    assert np.mean(means) > 0.05
    for side, parts in differences.items():
        assert_mean(np.concatenate(parts), 0.0, (material, side, np.mean(means)), sigmas=6.0)
