"""Rays of skies and suns through learned places, and directions to them: as bright as all others, with densities that
all know."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from support import scenes
from support.statistics import assert_mean

from etendue.core import IndependentSource
from etendue.density import BoxDensity, Boxes, LineCells, LineDensity
from etendue.scene import LightTable
from etendue.transport import emission_of_hit, emit, sample_direct, seen_through, surroundings

N = 1 << 17
SKIES = ("constant", "envmap", "sunsky", "sky", "directional")


def table(*emitters: str, share: float = 0.75) -> tuple[mi.Scene, LightTable]:
    """A scene, and its lights, whose rays pass :func:`middle`."""
    scene = scenes.hut(*emitters).scene
    return scene, LightTable(scene).through(LineDensity(middle()), share)


def middle() -> LineCells:
    """A random density in the middle of a scene."""
    mass = np.random.default_rng(4).exponential(size=(3, 4, 5)) ** 3
    return LineCells(np.array([-0.5, -0.5, -0.5]), np.array([0.8, 0.4, 0.6]), mass / mass.sum())


def numbers(role: str, count: int = N) -> IndependentSource:
    return IndependentSource(dr.arange(mi.UInt32, count), 5, role, 0)


def flux(lights: LightTable, centre: tuple[float, float, float], radius: float) -> np.ndarray:
    """What each of N rays brings to a ball that nothing hides, (N, 3)."""
    emitted = emit(lights, numbers("emit"), mi.Bool(True))
    offset = mi.Point3f(*centre) - emitted.ray.o
    beside = dr.norm(offset - emitted.ray.d * dr.dot(offset, emitted.ray.d))
    return np.array(dr.select((beside < radius) & emitted.active, emitted.throughput, 0.0), np.float64).T


#: Balls in the middle of the learned density, beside it, and far from it.
BALLS = [((0.1, 0.0, 0.1), 0.5), ((0.6, 0.3, -0.4), 0.7), ((-2.0, 0.5, 1.0), 1.0)]


@pytest.mark.parametrize("share", (0.25, 0.75))
@pytest.mark.parametrize(("centre", "radius"), BALLS)
def test_a_sky_brings_its_light(centre, radius, share):
    """A ball under even radiance L gets pi L times its surface."""
    _, lights = table("constant", share=share)
    for channel, radiance in zip(flux(lights, centre, radius).T, (0.7, 0.8, 1.0), strict=True):
        assert_mean(channel, np.pi * radiance * 4.0 * np.pi * radius**2, (centre, share))


@pytest.mark.parametrize("direction", [[-0.5, -1.0, -0.6], [0.0, -1.0, 0.0], [-1.0, -0.5, 0.0], [0.0, -0.3, 1.0]])
@pytest.mark.parametrize(("centre", "radius"), BALLS)
def test_a_sun_brings_its_light(centre, radius, direction):
    """A ball of cross-section A gets A E; also along the planes between cells."""
    scene = scenes.hut("directional").scene
    change = mi.traverse(scene)
    way = mi.ScalarVector3f(direction)
    up = mi.ScalarVector3f([1.0, 0.0, 0.0]) if abs(direction[0]) < 0.5 else mi.ScalarVector3f([0.0, 0.0, 1.0])
    change["directional-light.to_world"] = mi.Transform4f().look_at([0, 0, 0], list(way), list(up))
    change.update()
    lights = LightTable(scene).through(LineDensity(middle()), 0.75)
    for channel, irradiance in zip(flux(lights, centre, radius).T, (3.0, 2.0, 2.0), strict=True):
        assert_mean(channel, irradiance * np.pi * radius**2, (centre, direction))


def test_lights_of_several_kinds():
    """Picked with other probabilities; the density goes along."""
    _, lights = table("directional", "constant")
    lights = lights.picked_by(np.array([0.3, 0.7]), np.array([0.8, 0.2]))
    expected = np.pi * 0.25 * np.array([3.0, 2.0, 2.0]) + np.pi * np.array([0.7, 0.8, 1.0]) * np.pi
    for channel, value in zip(flux(lights, (0.1, 0.0, 0.1), 0.5).T, expected, strict=True):
        assert_mean(channel, value)


def test_a_room_on_a_wide_plain():
    """Cells that are small beside the scene: rays from far away still know their density."""
    scene = scenes.field(0.5, 1.0, side=3e4).scene
    lights = LightTable(scene).through(LineDensity(middle()), 0.75)
    inside = (0.1, 0.0, 0.1), 0.3  # what lies outside of the density hardly any ray finds
    assert_mean(flux(lights, *inside)[:, 0], np.pi * 4.0 * np.pi * 0.3**2)


@pytest.mark.parametrize("emitter", ("constant", "envmap", "sunsky", "sky"))
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


def windows() -> Boxes:
    """Two, one before the other, with three quarters of the directions."""
    lower, upper = np.array([[1.0, -0.5, -0.5], [0.5, 0.0, 0.0]]), np.array([[1.05, 0.5, 0.5], [1.5, 0.3, 0.4]])
    return Boxes(lower, upper, np.array([0.5, 0.25]))


def at(p: tuple[float, float, float]) -> mi.SurfaceInteraction3f:
    """A surface whose normal points upwards."""
    si = dr.zeros(mi.SurfaceInteraction3f, N)
    si.p = mi.Point3f(*p)
    si.n = si.sh_frame.n = mi.Normal3f(0.0, 1.0, 0.0)
    return si


@pytest.mark.parametrize("p", [(0.0, -0.8, 0.0), (0.7, 0.1, 0.2)])
@pytest.mark.parametrize("emitters", ["constant", "envmap", "sunsky", "sky", "directional constant"])
def test_directions_through_windows_bring_the_light_of_the_sky(emitters, p):
    """The fluence, which nothing hides, and its part that passes a window, are those without windows; also beside a
    sun that one direction leads to."""
    scene = scenes.hut(*emitters.split()).scene
    lights = LightTable(scene)
    found = [
        sample_direct(table, at(p), numbers("light"), mi.UInt32(1), 0, mi.Bool(True))
        for table in (lights, lights.seen_through(windows()))
    ]
    for part in (False, True):
        sums = []
        for one in found:
            value = dr.select(one.active, dr.mean(one.radiance), 0.0)
            if part:
                value = dr.select(BoxDensity(windows()).towards(at(p).p, one.direction) > 0.0, value, 0.0)
            sums.append(np.array(value, np.float64))
        error = np.hypot(*(value.std() / N**0.5 for value in sums))
        assert abs(sums[0].mean() - sums[1].mean()) < 4.5 * error, (emitters, p, part)


@pytest.mark.parametrize("emitter", SKIES)
def test_all_know_the_density_of_directions_through_windows(emitter):
    """Next event itself, a hit, and a light path that ends where next event began."""
    scene = scenes.hut(emitter).scene
    lights, p = LightTable(scene).seen_through(windows()), (0.0, -0.8, 0.0)
    found = sample_direct(lights, at(p), numbers("light"), mi.UInt32(1), 0, mi.Bool(True))
    light = lights.at(at(p).p).row(found.light, found.active)
    si, ds = dr.zeros(mi.SurfaceInteraction3f, N), dr.zeros(mi.DirectionSample3f, N)
    si.t, si.wi, ds.d = dr.inf, -found.direction, found.direction
    own = light.call("infinite", mi.Emitter.pdf_direction, dr.zeros(mi.Interaction3f), ds, active=found.active)
    own = dr.select(light.is_delta, 1.0, own)
    by_light_path = seen_through(lights, light, at(p).p, found.direction, own, found.active)
    active = np.array(found.active)
    np.testing.assert_allclose(np.array(by_light_path)[active], np.array(found.pdf)[active], rtol=1e-3)
    if emitter != "directional":
        _, by_hit, _ = emission_of_hit(lights, scene, si, found.active, at(p).p)
        np.testing.assert_allclose(np.array(by_hit)[active], np.array(found.pdf)[active], rtol=1e-3)


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
