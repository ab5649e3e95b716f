"""Rays of skies and suns through learned places: as bright as all over the disc, with densities that all know."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.statistics import assert_mean

from etendue.core import IndependentSource
from etendue.density import LineCells, LineDensity
from etendue.scene import LightTable
from etendue.transport import emission_of_hit, emit, sample_direct, surroundings

N = 1 << 17
SKIES = ("constant", "envmap", "sunsky", "directional")


def table(*emitters: str, share: float = 0.75) -> tuple[mi.Scene, LightTable]:
    """Lights whose rays pass a random density in the middle of a scene."""
    scene = scenes.hut(*emitters).scene
    mass = np.random.default_rng(4).exponential(size=(3, 4, 5)) ** 3
    cells = LineCells(np.array([-0.5, -0.5, -0.5]), np.array([0.8, 0.4, 0.6]), mass / mass.sum())
    return scene, LightTable(scene).through(LineDensity(cells), share)


def numbers(role: str, count: int = N) -> IndependentSource:
    return IndependentSource(dr.arange(mi.UInt32, count), 5, role, 0)


@pytest.mark.parametrize("emitters", [*((name,) for name in SKIES), ("sunsky", "directional")])
def test_they_bring_the_same_light(emitters):
    """The flux through balls inside and outside of the density, against rays from all over the disc."""
    scene, lights = table(*emitters)
    plain = LightTable(scene)
    for centre, radius in (([0.1, 0.0, 0.1], 0.8), ([-2.0, 0.5, 1.0], 1.0)):
        flux = []
        for which in (lights, plain):
            emitted = emit(which, numbers("emit"), mi.Bool(True))
            offset = mi.Point3f(*centre) - emitted.ray.o
            beside = dr.norm(offset - emitted.ray.d * dr.dot(offset, emitted.ray.d))
            flux.append(np.array(dr.select((beside < radius) & emitted.active, mi.luminance(emitted.throughput), 0.0)))
        learned, even = (np.asarray(f, np.float64) for f in flux)
        assert_mean(np.concatenate([learned, -even]) * 2.0, 0.0, (emitters, centre))


@pytest.mark.parametrize("emitter", ("constant", "envmap", "sunsky"))
def test_a_hit_knows_the_density_of_emission(emitter):
    """Rays back to where others came from."""
    scene, lights = table(emitter)
    emitted = emit(lights, numbers("emit"), mi.Bool(True))
    back = mi.Ray3f(emitted.ray.o + emitted.ray.d * 3.0, -emitted.ray.d)
    si = dr.zeros(mi.SurfaceInteraction3f, N)
    si.t, si.wi = dr.inf, -back.d
    with_sky = si.emitter(scene)
    assert np.array(dr.reinterpret_array(mi.UInt32, with_sky) != 0).all()
    _, area, both = emission_of_hit(lights, scene, si, emitted.active, back.o)
    active = np.array(emitted.active)
    for there, here in ((both, emitted.emission_density), (area, emitted.area_density)):
        there, here = (np.broadcast_to(np.array(value, np.float64), active.shape)[active] for value in (there, here))
        # The places of the rays are exact to single precision, and cells have edges.
        assert np.mean(np.abs(there / here - 1.0) < 1e-3) > 0.999


@pytest.mark.parametrize("emitter", SKIES)
def test_next_event_knows_the_density_of_emission(emitter):
    _, lights = table(emitter)
    si = dr.zeros(mi.SurfaceInteraction3f, N)
    source = numbers("direct")
    si.p = mi.Point3f(source.next_1d(9, 0), source.next_1d(9, 1), source.next_1d(9, 2)) - 0.5
    si.n = si.sh_frame.n = mi.Normal3f(0.0, 1.0, 0.0)
    found = sample_direct(lights, si, numbers("light"), mi.UInt32(1), 0, mi.Bool(True))
    line = lights.lines[0].along(si.p, found.direction, mi.Bool(True))
    expected = 0.75 * np.array(line, np.float64) + 0.25 / (np.pi * lights.radius**2)
    active = np.array(found.active)
    np.testing.assert_allclose(np.array(found.light_ratio)[active], expected[active], rtol=1e-4)


def test_how_much_sky_is_seen():
    """All of it over a plate, none in a box, 1 where there is nothing to see it from."""

    def seen(problem: Any, o: tuple[float, float, float], d: tuple[float, float, float]) -> float:
        ray = mi.Ray3f(mi.Point3f(*(dr.full(mi.Float, x, 4096) for x in o)), mi.Vector3f(*d))
        return surroundings(problem.scene, ray, numbers("sky", 4096)).sky

    field, hut = scenes.field(0.5, 1.0), scenes.hut("constant")
    assert seen(field, (0.0, 2.0, 0.0), (0.0, -1.0, 0.0)) == 1.0
    assert seen(field, (0.0, -2.0, 0.0), (0.0, 1.0, 0.0)) == 1.0
    assert seen(field, (0.0, 2.0, 0.0), (0.0, 1.0, 0.0)) == 1.0
    assert 0.0 < seen(hut, (0.0, 0.0, 0.0), (-0.6, -0.8, 0.0)) < 0.1
    assert seen(scenes.furnace("cube", 1.0, 0.5), (0.1, 0.0, 0.0), (0.0, 1.0, 0.0)) == 0.0


def test_the_box_of_what_is_seen():
    """A room on a wide plain: the box is the room's, whatever there is outside."""
    problem, source = scenes.hut("constant"), numbers("rays", 4096)
    ray, _ = problem.sensor.sample_ray(0.0, 0.0, mi.Point2f(*source.next_2d(0, 0)), mi.Point2f(0.5))
    found = surroundings(problem.scene, ray, source)
    np.testing.assert_allclose(found.lower, [-1.0, -0.9, -1.0], atol=0.1)
    np.testing.assert_allclose(found.upper, [1.0, 0.9, 1.0], atol=0.1)
    nothing = surroundings(scenes.field(0.5, 1.0).scene, mi.Ray3f(mi.Point3f(0, 5, 0), mi.Vector3f(0, 1, 0)), source)
    np.testing.assert_allclose(nothing.upper - nothing.lower, [2.0, 0.0, 2.0], atol=1e-5)
