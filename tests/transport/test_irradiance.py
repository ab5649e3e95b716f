"""Irradiance and its gradients against closed forms, and the cache that interpolates them."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest

from etendue.core import OptionError
from etendue.transport import (
    IrradianceCache,
    TransportFunctions,
    irradiance_gradients,
    stratified_hemispheres,
)

STRATA = (64, 192)
COPIES = 12


def ball(normal, centre, radius, seed=0):
    """What a hemisphere at the origin finds of a ball of radiance (1, 2, 0) before a distant, dark background."""
    normals = np.tile(normal, (COPIES, 1))
    d = stratified_hemispheres(normals, STRATA, seed)
    along = d @ centre
    reach = along**2 - (centre @ centre - radius**2)
    hit = (reach > 0) & (along > 0)
    distance = np.where(hit, along - np.sqrt(np.maximum(reach, 0)), 1e12)
    return np.where(hit, 1.0, 0.0)[..., None] * np.array([1.0, 2.0, 0.0]), distance, normals


def assert_within(copies, expected, bias=0.0):
    """The mean of independent copies is as expected, within 4.5 of their standard errors and the relative ``bias``."""
    error = np.linalg.norm(copies.std(axis=0, ddof=1)) / math.sqrt(len(copies))
    assert np.linalg.norm(copies.mean(axis=0) - expected) < 4.5 * error + bias * np.linalg.norm(expected)
    assert error < 0.02 * np.linalg.norm(expected)


def unit(*v):
    return np.array(v, dtype=float) / np.linalg.norm(v)


@pytest.mark.parametrize("normal", [unit(0, 0, 1), unit(1, 0.2, -0.3)])
@pytest.mark.parametrize("direction", [(0.6, -0.3, 1.0), (-0.8, 0.1, 0.8)])
def test_irradiance_of_a_ball(normal, direction):
    """E = pi (s / d)^2 cos, whose gradients are known, for a ball of radius s at distance d."""
    tangent = np.cross([0.0, 1.0, 0.0], normal)
    tangent /= np.linalg.norm(tangent)
    axes = np.array([tangent, np.cross(normal, tangent), normal])
    centre, radius = 2.0 * unit(*direction) @ axes, 0.2
    d = np.linalg.norm(centre)
    irradiance, rotation, translation = irradiance_gradients(*ball(normal, centre, radius))
    exact = math.pi * (radius / d) ** 2 * normal @ centre / d
    assert_within(irradiance[:, 0], exact)
    assert irradiance[:, 1] == pytest.approx(2 * irradiance[:, 0]) and not irradiance[:, 2].any()

    turn = math.pi * (radius / d) ** 2 * np.cross(normal, centre / d)
    assert rotation.shape == (COPIES, 3, 3) and rotation[:, 1] == pytest.approx(2 * rotation[:, 0])
    assert_within(rotation[:, 0], turn)

    # Distances are those of the middle of strata, a little less than that of the edge of the ball: 5 % of bias.
    move = math.pi * radius**2 * (3 * (normal @ centre) * centre / d**5 - normal / d**3)
    move -= (move @ normal) * normal  # hemispheres know what happens in the surface
    assert_within(translation[:, 0], move, bias=0.05)
    assert np.abs(translation[:, 2]).max() == 0 and np.abs(translation @ normal).max() < 1e-12


def test_directions_lie_one_in_each_stratum():
    normals = np.array([unit(0, 0, 1), unit(-1, 2, 0.5)])
    d = stratified_hemispheres(normals, (4, 6), 1)
    assert np.linalg.norm(d, axis=-1) == pytest.approx(np.ones((2, 4, 6)))
    sine2 = 1 - np.einsum("njkc,nc->njk", d, normals) ** 2
    assert (np.floor(sine2 * 4).astype(int) == np.arange(4)[:, None]).all()


def planted(**options):
    """A cache with one record at the origin of the plane z = 0, below a ball, and what it should say."""
    cache = IrradianceCache((0.2, 0.5), accuracy=0.5, strata=STRATA, **options)
    radiance, distance, normals = ball(unit(0, 0, 1), np.array([1.0, 0.5, 1.5]), 0.5)
    cache.add(np.zeros((1, 3)), normals[:1], radiance[:1], distance[:1])
    return cache, irradiance_gradients(radiance[:1], distance[:1], normals[:1])


def test_a_record_is_carried_along_its_gradients():
    cache, (irradiance, rotation, translation) = planted()
    position = np.array([[0, 0, 0], [0.1, 0.05, 0], [0, 0, 0]], dtype=float)
    tilted = unit(0.05, -0.02, 1)
    normal = np.array([[0, 0, 1], [0, 0, 1], tilted])
    values, weight = cache(position, normal)
    assert (weight > 0).all()
    expected = np.stack(
        [
            irradiance[0],
            irradiance[0] + translation[0] @ position[1],
            irradiance[0] + rotation[0] @ np.cross([0, 0, 1], tilted),
        ]
    )
    assert values == pytest.approx(expected, rel=1e-4, abs=1e-6)
    cache.gradients = False
    assert cache(position, normal)[0] == pytest.approx(np.tile(irradiance[0], (3, 1)), rel=1e-4, abs=1e-6)


def test_a_record_ends():
    cache, _ = planted()
    reach = cache.records[0, 27]
    assert 0.2 <= reach <= 0.5
    normal = np.tile([0.0, 0, 1], (4, 1))
    position = np.array([[0.99 * reach, 0, 0], [1.01 * reach, 0, 0], [0, 0, -0.1], [0, 0, 0.1]])
    weight = cache(position, normal)[1]
    assert (weight[[0, 3]] > 0).all() and weight[1] == 0  # and not for points that it lies in front of
    assert weight[2] == 0
    assert cache(np.zeros((1, 3)), np.array([[1.0, 0, 0]]))[1][0] == 0


def test_an_empty_cache_and_what_it_refuses():
    cache = IrradianceCache((0.1, 1.0))
    values, weight = cache(np.zeros((5, 3)), np.tile([0.0, 0, 1], (5, 1)))
    assert len(cache) == cache.rays == 0 and not values.any() and not weight.any()
    with pytest.raises(OptionError, match="above zero"):
        IrradianceCache((0.0, 1.0))
    with pytest.raises(OptionError, match="2 rings"):
        IrradianceCache((0.1, 1.0), strata=(1, 8))


@pytest.mark.parametrize(("size", "away"), [(1e-4, 0.0), (1.0, 0.0), (1e4, 0.0), (1.0, 500.0)])
def test_rays_start_as_near_as_the_scene_wants(size, away):
    """Between a floor and a ceiling of radiance 1, which leave 1e-4 of the sky free, the irradiance is pi: at half a
    unit of height, whatever the unit; and no ray meets the floor that it starts on."""
    turn = mi.ScalarTransform4d().translate([away, away, away]).rotate([0.3, 1, 0.2], 50)
    plane = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective"},
            "floor": plane | {"to_world": turn.scale(50 * size)},
            "ceiling": plane
            | {"to_world": turn.translate([0, 0, size / 2]).rotate([1, 0, 0], 180).scale(50 * size)}
            | {"emitter": {"type": "area", "radiance": 1.0}},
        }
    )
    functions = TransportFunctions(scene)
    cache = IrradianceCache((0.1 * size, size), strata=(8, 24))
    matrix = np.array(turn.matrix, dtype=float)
    x, y = np.meshgrid(np.linspace(-3.3, 3.1, 8) * size, np.linspace(-2.9, 3.7, 8) * size)
    position = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    normal = np.broadcast_to(matrix[:3, 2], position.shape)
    cache.compute(functions.emitted, functions.distance, position, normal, 1)
    assert cache.records[:, 6:9] == pytest.approx(np.pi, rel=1.01 / 192)  # but for one ray
