"""Closed forms: a furnace is L / (1 - albedo) in every pixel, a plane under a uniform sky is albedo L."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.running import run
from support.scenes import field, furnace
from support.statistics import assert_agree
from support.tables import thinned

from etendue.scene import Problem

RADIANCE, ALBEDO = 0.8, 0.5
#: One row an unbiased estimator: method, settings.
UNBIASED = {
    "path naive": ("path", {"mode": "naive"}),
    "path next event": ("path", {"mode": "next_event"}),
    "path mis": ("path", {"mode": "mis"}),
    "path mis power": ("path", {"mode": "mis", "heuristic": "power"}),
    "light": ("light", {}),
    "light, more paths": ("light", {"light_paths": 2.5}),
    "bpt cache": ("bpt", {}),
    "bpt path": ("bpt", {"light_source": "path"}),
    "bpt power": ("bpt", {"heuristic": "power"}),
    "bpt path power": ("bpt", {"light_source": "path", "heuristic": "power"}),
    "bpt counts": ("bpt", {"connections": 3, "next_events": 2}),
    "bpt roulette by albedo": ("bpt", {"roulette": "albedo", "rr_depth": 1}),
    "bpt few light paths": ("bpt", {"light_paths": 0.3, "next_events": 0}),
}
#: Merging: the disc must be small against the sphere's curvature.
MERGING = {
    "vcm": ("vcm", {}),
    "vcm path power": ("vcm", {"light_source": "path", "heuristic": "power"}),
    "vcm late": ("vcm", {"merge_first": False, "eta_discount": 0.1}),
    "vcm many light paths": ("vcm", {"light_paths": 2.0, "connections": 0}),
    "bpm": ("bpm", {}),
    "bpm late": ("bpm", {"merge_first": False}),
    "sppm": ("sppm", {}),
    "sppm photons": ("sppm", {"direct": "photons"}),
    "sppm cone": ("sppm", {"direct": "photons", "kernel": "cone", "alpha": 0.7}),
    "sppm biweight": ("sppm", {"direct": "photons", "kernel": "biweight", "light_paths": 2.0}),
    "ppm": ("ppm", {"direct": "photons", "kernel": "epanechnikov", "alpha": 0.5}),
}
ON_A_PLANE = [name for name in MERGING if "late" not in name]
#: The nearest photons: as many of them as stay in a small disc.
NEAREST = {
    "pm": {},
    "pm photons": {"direct": "photons"},
    "pm few neighbours": {"direct": "photons", "neighbours": 5},
    "pm epanechnikov": {"direct": "photons", "neighbours": 12, "kernel": "epanechnikov"},
    "pm final gather": {"final_gather": True},
}


@pytest.mark.parametrize(
    "name", thinned(UNBIASED, ("path naive", "path mis", "light", "bpt cache", "bpt path power", "bpt counts"))
)
def test_inside_a_sphere(name):
    method, settings = UNBIASED[name]
    result = run(furnace("sphere", RADIANCE, ALBEDO), method, passes=6, samples=256, **settings)
    assert_agree(result.images, RADIANCE / (1 - ALBEDO), name, block=1)


@pytest.mark.parametrize(
    "name", thinned(["path mis", "light", "bpt cache", "bpt path power"], ["path mis", "bpt cache"])
)
def test_inside_a_box(name):
    method, settings = UNBIASED[name]
    result = run(furnace("box", RADIANCE, 0.7), method, passes=6, samples=256, **settings)
    assert_agree(result.images, RADIANCE / 0.3, name, block=1)


@pytest.mark.parametrize("name", thinned(MERGING, ("vcm", "bpm", "sppm photons", "ppm")))
def test_merging_inside_a_sphere(name):
    method, settings = MERGING[name]
    settings = {"radius": 0.01, "radius_unit": "absolute", "alpha": 1.0} | settings
    result = run(furnace("sphere", RADIANCE, ALBEDO), method, passes=6, samples=256, **settings)
    assert_agree(result.images, RADIANCE / (1 - ALBEDO), name, block=2)


#: Every way to gather, of photons that bring all the light there is but the lamp's own.
AT_EDGES = {
    "vcm": ("vcm", {"connections": 0, "next_events": 0}),
    "bpm": ("bpm", {}),
    "bpm late": ("bpm", {"merge_first": False}),
    "sppm photons": ("sppm", {"direct": "photons"}),
    "sppm cone": ("sppm", {"direct": "photons", "kernel": "cone"}),
    "pm photons": ("pm", {"direct": "photons", "photons": 20_000, "neighbours": 60}),
    "vegas maps": ("vegas", {"maps": 1}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", AT_EDGES)
def test_merging_at_edges(name):
    """Inside a cube, with a radius of a tenth of its side: photons of the next wall are as good as those of a plane
    that goes on. Where three walls meet there is less wall than on a plane; pixels that see it are left out."""
    radius = 0.2
    method, settings = AT_EDGES[name]
    settings = {"radius": radius, "radius_unit": "absolute"} | ({} if method == "pm" else {"alpha": 1.0}) | settings
    problem = furnace("box", RADIANCE, ALBEDO, (16, 16))
    result = run(problem, method, passes=6, samples=48, **settings)
    expected = RADIANCE / (1 - ALBEDO)
    edges, corners = (seen_near(problem, radius, walls) for walls in (2, 3))
    assert edges.sum() > 40, "the view must show edges"
    images = np.where(corners[..., None], expected, result.images)
    assert_agree(images, expected, name, block=1)
    assert_agree(np.where((edges & ~corners)[..., None], images, expected), expected, name, block=16)


def seen_near(problem: Problem, distance: float, walls: int) -> np.ndarray:
    """Pixels that see a point of the cube from -1 to 1 closer than ``distance`` to so many of its walls."""
    width, height = problem.size
    lane = np.arange(width * height * 64)
    u = (lane % 64 % 8 + 0.5) / 8, (lane % 64 // 8 + 0.5) / 8
    x, y = (lane // 64 % width + u[0]) / width, (lane // 64 // width + u[1]) / height
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    near = np.array(problem.scene.ray_intersect(ray).p)
    close = (np.abs(near) > 1.0 - distance).sum(0) >= walls
    return close.reshape(height, width, 64).any(-1)


@pytest.mark.parametrize("name", thinned(ON_A_PLANE, ON_A_PLANE[::2]))
def test_merging_on_a_plane_of_constant_irradiance(name):
    """However wide the disc, it sees one plane and one irradiance: no bias at all."""
    method, settings = MERGING[name]
    settings = {"radius": 0.15, "radius_unit": "absolute", "alpha": 1.0} | settings
    result = run(field(0.5, 1.3), method, passes=6, samples=256, **settings)
    assert_agree(result.images, 0.5 * 1.3, name, block=2)


@pytest.mark.slow
@pytest.mark.parametrize("name", NEAREST)
def test_nearest_photons_inside_a_sphere(name):
    settings = {"photons": 200_000, "neighbours": 12} | NEAREST[name]
    result = run(furnace("sphere", RADIANCE, ALBEDO), "pm", passes=6, samples=256, **settings)
    assert_agree(result.images, RADIANCE / (1 - ALBEDO), name, block=2)


@pytest.mark.parametrize("name", thinned(NEAREST, ("pm photons", "pm few neighbours", "pm final gather")))
def test_nearest_photons_on_a_plane_of_constant_irradiance(name):
    """The k-th photon ends the disc: counted in full it would make five neighbours a quarter too bright."""
    settings = {"photons": 30_000} | NEAREST[name]
    result = run(field(0.5, 1.3), "pm", passes=6, samples=256, **settings)
    assert_agree(result.images, 0.5 * 1.3, name, block=2)


@pytest.mark.parametrize("albedo", [0.2, 0.8])
@pytest.mark.parametrize("name", ["path mis", "bpt cache", "light"])
def test_a_plane_under_a_uniform_sky(name, albedo):
    method, settings = UNBIASED[name]
    result = run(field(albedo, 1.3), method, passes=6, samples=512 if method == "light" else 128, **settings)
    assert_agree(result.images, albedo * 1.3, name, block=2)


def test_a_wrong_picture_is_told_apart():
    """The statistics have teeth: two per cent off, or a tenth in one corner, is found."""
    images = run(furnace("sphere", RADIANCE, ALBEDO), "path", passes=6, samples=256).images
    with pytest.raises(AssertionError, match="z of the sum"):
        assert_agree(images * 1.02, RADIANCE / (1 - ALBEDO), block=1)
    corner = np.ones_like(images[:1])
    corner[:, :2, :2] = 1.2
    with pytest.raises(AssertionError, match="z of the sum"):
        assert_agree(images * corner, RADIANCE / (1 - ALBEDO), block=1)


def test_roulette_by_albedo_makes_paths_as_long_as_those_of_light():
    """1 / (1 - a) vertices in the mean; the number has the variance a / (1 - a)^2."""
    albedo, paths = 0.75, 64 * 1024
    settings = {"roulette": "albedo", "rr_depth": 1, "light_paths": 1.0}
    result = run(furnace("sphere", 0.5, albedo), "bpt", passes=1, samples=1024, **settings)
    error = albedo**0.5 / (1.0 - albedo) / paths**0.5
    mean = result.measurement.counters["light_vertices"] / paths
    assert mean == pytest.approx(1.0 / (1.0 - albedo), abs=4.5 * error)
