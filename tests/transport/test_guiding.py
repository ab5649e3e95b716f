"""The guide: directions and the square, and a mixture of guide and BSDF whose density is what it says."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.statistics import assert_mean
from support.tables import crossed

from etendue.core import IndependentSource
from etendue.transport import FITS, NOWHERE, Guide, direction_of, scatter_camera, scatter_uniform, square_of
from etendue.transport.guiding.guide import PER_STERADIAN, _fit

N = 400_000
MATERIALS = ("diffuse", "roughplastic", "roughconductor", "roughdielectric")
BOX = ([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])


def source(role: str = "guide", n: int = N) -> IndependentSource:
    return IndependentSource(dr.arange(mi.UInt32, n), 5, role, 0)


def uniform_square(n: int = N) -> Any:
    return mi.Point2f(*np.random.default_rng(3).random((2, n), dtype=np.float32))


def test_the_square_stands_for_the_sphere_area_by_area():
    direction = direction_of(uniform_square())
    x, y, z = (np.asarray(c, np.float64) for c in direction)
    np.testing.assert_allclose(x * x + y * y + z * z, 1.0, atol=1e-5)
    assert stats.kstest(z, stats.uniform(-1, 2).cdf).pvalue > 1e-4
    assert stats.kstest(np.arctan2(y, x), stats.uniform(-np.pi, 2 * np.pi).cdf).pvalue > 1e-4
    assert abs(np.corrcoef(z**2, np.cos(4 * np.arctan2(y, x)))[0, 1]) < 0.01


def test_square_and_direction_are_inverse():
    u = uniform_square()
    again = square_of(direction_of(u))
    np.testing.assert_allclose(np.asarray(again.x), np.asarray(u.x), atol=2e-4)
    np.testing.assert_allclose(np.asarray(again.y), np.asarray(u.y), atol=2e-4)
    axes = mi.Vector3f([1, -1, 0, 0, 0, 0], [0, 0, 1, -1, 0, 0], [0, 0, 0, 0, 1, -1])
    for before, after in zip(axes, direction_of(square_of(axes)), strict=True):
        np.testing.assert_allclose(np.asarray(after), np.asarray(before), atol=2e-3)
    places = np.stack([np.asarray(c) for c in square_of(axes)])
    assert ((places >= 0.0) & (places < 1.0)).all()


@lru_cache
def learned(share: float = 0.5) -> Guide:
    """A guide that has found light in one direction of every cell, and a little everywhere."""
    guide = Guide(*BOX)
    sun = np.array([0.3, 0.5, 0.81])
    random = np.random.default_rng(1)
    for _ in range(5):
        u = random.random((2, N), dtype=np.float32)
        cell = random.integers(guide.cells, size=N)
        _, place = guide._sampler.find(mi.UInt32(cell.astype(np.uint32)), mi.Point2f(u))
        direction = np.stack([np.asarray(c) for c in direction_of(mi.Point2f(u))])
        light = 0.05 + np.exp(40.0 * (sun @ direction / np.linalg.norm(sun) - 1.0))
        place = np.asarray(place)
        found = np.bincount(place, light, guide.places)
        samples = np.bincount(place, minlength=guide.places)
        guide.learn(found, samples, most=1e9, leaf_share=0.01, share=share)
    return guide


def scattered_by(guide: Guide, scene: Any, si: Any, *arguments: Any) -> Any:
    bsdf = scenes.material(scene, si)
    return guide.scatter(guide.locate(si, si.is_valid()), scatter_camera, bsdf, si, *arguments)


def surface(material: str, lanes: int = 1) -> tuple[Any, Any]:
    scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle", "bsdf": scenes.MATERIALS[material]()}})
    origin = mi.Point3f(dr.full(mi.Float, 0.1, lanes), 0.2, 1.0)
    si = scene.ray_intersect(mi.Ray3f(origin, dr.normalize(mi.Vector3f(0.4, 0.1, -1.0))))
    return scene, si


@pytest.mark.parametrize(("material", "scatter"), crossed(MATERIALS, [scatter_camera, scatter_uniform], 3))
def test_directions_follow_the_density_that_is_claimed(material, scatter):
    """Of scattered directions in each part of the square: the mean of 1 / p is its solid angle, and where light points
    ask for it the density is the same one."""
    guide = learned()
    scene, si = surface(material, N)
    bsdf = scenes.material(scene, si)
    toward = direction_of(uniform_square())
    active = dr.full(mi.Bool, True, N)
    scattered, (towards,) = guide.scatter(
        guide.locate(si, active), scatter, bsdf, si, source(), mi.UInt32(1), active, [(si.to_local(toward), active)]
    )
    place = np.stack([np.asarray(c) for c in square_of(scattered.direction)])
    pdf, taken = np.asarray(scattered.pdf, np.float64), np.asarray(scattered.active)
    # Only what is reflected: beyond the horizon nothing is taken, and the density there is the guide's.
    value = np.asarray(scattered.weight, np.float64)[0] * pdf
    column, row = (np.minimum(np.floor(place * 4), 3)).astype(int)
    asked = np.asarray(towards.pdf, np.float64)
    function = np.asarray(towards.value, np.float64)[0]
    u = np.stack([np.asarray(c) for c in square_of(toward)])
    asked_column, asked_row = (np.minimum(np.floor(u * 4), 3)).astype(int)
    for i in range(4):
        for j in range(4):
            mine, theirs = (column == i) & (row == j), (asked_column == i) & (asked_row == j)
            # Share of the samples that land there, against the integral of the density over it.
            drawn = (mine & taken).astype(float)
            expected = 4.0 * np.pi * asked * theirs * (function > 0.0)
            deviation = np.hypot(drawn.std(), expected.std()) / np.sqrt(N)
            assert abs(drawn.mean() - expected.mean()) < 4.5 * deviation + 1e-5, (i, j)
            # The light that a white sky sends by way of it: sampled, against evaluated.
            sampled = np.where(mine & taken, value / np.maximum(pdf, 1e-30), 0.0)
            evaluated = 4.0 * np.pi * function * theirs
            deviation = np.hypot(sampled.std(), evaluated.std()) / np.sqrt(N)
            assert abs(sampled.mean() - evaluated.mean()) < 4.5 * deviation + 1e-5, (i, j)


def test_the_density_integrates_to_one():
    guide = learned(share=0.7)
    scene, si = surface("diffuse", N)
    active = dr.full(mi.Bool, True, N)
    wo = si.to_local(direction_of(uniform_square()))
    _, (towards,) = scattered_by(guide, scene, si, source(), mi.UInt32(1), active, [(wo, active)])
    assert_mean(4.0 * np.pi * np.asarray(towards.pdf, np.float64), 1.0)


def test_delta_scattering_stays_with_the_bsdf():
    guide = learned()
    active = dr.full(mi.Bool, True, 1000)
    for material in ("conductor", "dielectric"):
        scene, si = surface(material, 1000)
        plain, _ = scatter_camera(scenes.material(scene, si), si, source(n=1000), mi.UInt32(1), active)
        mine, _ = scattered_by(guide, scene, si, source(n=1000), mi.UInt32(1), active)
        np.testing.assert_array_equal(np.asarray(mine.weight), np.asarray(plain.weight))
        np.testing.assert_array_equal(np.asarray(mine.direction), np.asarray(plain.direction))
        assert (np.asarray(mine.place) == NOWHERE).all()


def test_a_smooth_and_a_delta_component_share_what_the_guide_leaves():
    """Energy of each component over all directions is that of the BSDF alone."""
    guide = learned()
    scene, si = surface("plastic", N)
    active = dr.full(mi.Bool, True, N)

    def energies(scattered: Any) -> list[np.ndarray]:
        weight = np.where(np.asarray(scattered.active), np.asarray(scattered.weight, np.float64)[0], 0.0)
        delta = np.asarray(scattered.is_delta)
        return [np.where(delta, weight, 0.0), np.where(delta, 0.0, weight)]

    plain, _ = scatter_camera(scenes.material(scene, si), si, source(), mi.UInt32(1), active)
    mine, _ = scattered_by(guide, scene, si, source("other"), mi.UInt32(1), active)
    for a, b in zip(energies(plain), energies(mine), strict=True):
        assert a.mean() > 0.0
        assert abs(a.mean() - b.mean()) < 4.5 * np.hypot(a.std(), b.std()) / np.sqrt(N)


def test_a_guide_that_knows_nothing_changes_nothing():
    guide = Guide(*BOX)
    scene, si = surface("roughplastic", 1000)
    active = dr.full(mi.Bool, True, 1000)
    wo = [(mi.Vector3f(0.1, 0.2, 0.97), active)]
    plain, (before,) = scatter_camera(scenes.material(scene, si), si, source(n=1000), mi.UInt32(1), active, wo)
    mine, (after,) = scattered_by(guide, scene, si, source(n=1000), mi.UInt32(1), active, wo)
    for name in ("direction", "weight", "pdf", "eta", "active"):
        np.testing.assert_array_equal(np.asarray(getattr(mine, name)), np.asarray(getattr(plain, name)))
    np.testing.assert_array_equal(np.asarray(before.pdf), np.asarray(after.pdf))


def test_the_share_of_the_guide_is_that_of_least_divergence():
    """In each cell, up to the width of the classes and of the grid, beside minimising over the densities themselves."""
    guide, random, most = learned(), np.random.default_rng(2), 0.8
    again = Guide(*BOX)
    again.restore(guide.state())
    light, densities = random.random((guide.cells, 2000)), random.gamma(0.5, size=(2, guide.cells, 2000))
    light *= densities[0] ** np.linspace(-0.5, 1.0, guide.cells)[:, None]  # the guide fits ever better
    classes = np.asarray(_fit(*(mi.Float(x.ravel()) for x in (densities[0] / PER_STERADIAN, densities[1]))))
    at = np.repeat(np.arange(guide.cells), 2000) * FITS + classes
    fits = np.bincount(at, light.ravel(), guide.cells * FITS).reshape(guide.cells, FITS)
    none = np.zeros(guide.places)
    again.learn(none, none, most=1e9, leaf_share=0.01, share=most, fits=fits)
    found = again.state()["shares"]
    grid = np.linspace(0.1 * most, most, 400)
    by_both = [np.log(a * densities[0] + (1.0 - a) * densities[1]) for a in grid]
    best = grid[np.argmax([(light * value).sum(axis=1) for value in by_both], axis=0)]
    assert best.min() == grid[0] and best.max() > 0.7 * most
    np.testing.assert_allclose(found, best, atol=0.06)


def test_a_new_guide_starts_with_a_small_share():
    """How well it fits is not known before it is used."""
    guide = Guide(*BOX)
    found = np.ones(guide.places)
    guide.learn(found, found, most=1e9, leaf_share=0.01, share=0.6, fits=np.ones((guide.cells, FITS)))
    np.testing.assert_allclose(guide.state()["shares"], 0.06)


def test_the_guide_comes_back_from_its_state():
    guide = learned()
    again = Guide(*BOX)
    again.restore(guide.state())
    u, cell = uniform_square(1000), mi.UInt32(np.arange(1000, dtype=np.uint32) % guide.cells)
    for a, b in zip(guide._sampler.find(cell, u), again._sampler.find(cell, u), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
