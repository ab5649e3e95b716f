"""Temperatures and heat flows that others have published: View3D, MOOSE, and Ingersoll's crater in its geometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.patches import factors_of, squares

from etendue.radiosity import (
    STEFAN_BOLTZMANN as SIGMA,
    ABuffer,
    Conditions,
    Patches,
    exact_form_factors,
    form_factors,
    heat_balance,
    read_patches,
    solve,
)

MESHES = Path(__file__).parents[2].parent / "shared" / "meshes"


@pytest.mark.skipif(not MESHES.is_dir(), reason="the meshes of other projects are not there")
def test_the_l_shaped_room_of_pinney_and_bean():
    """Heat that ViewHT, which belongs to View3D, gives for its walls: all at 20 C but the third, at 10 C. It computes
    with sigma = 5.6697e-8, and prints five digits."""
    room = read_patches(MESHES / "view3d" / "test4.vs3")
    temperature = np.full(8, 293.15)
    temperature[2] = 283.15
    factors = form_factors(ABuffer(room).cast(4096), "reciprocal").repaired()
    made = heat_balance(room, factors, Conditions(emissivity=1 - room.reflectance, temperature=temperature))
    received = [-153.50, -44.483, 284.88, -2.0060, -1.2114, -15.920, -33.878, -33.878]
    np.testing.assert_allclose(-made.heat[:, 0] * 5.6697e-8 / SIGMA, received, atol=0.02)
    assert made.imbalance[0] < 1e-6


def test_a_cavity_of_moose():
    """Four surfaces with given view factors, two of them adiabatic: MOOSE's gold file of its grey Lambert cavity. It
    normalises the rows, and computes with sigma = 5.67036713e-8."""
    bottom, top, left, right = (
        [0, 0.123, 0.6928, 0.1841],
        [0.123, 0, 0.1841, 0.6928],
        [0.2771, 0.0736, 0.4458, 0.2035],
        [0.0736, 0.2771, 0.2035, 0.4458],
    )
    matrix = np.array([bottom, top, left, right])
    patches = squares(1, 1, 2.5, 2.5)
    factors = factors_of(patches, matrix / matrix.sum(axis=1, keepdims=True))
    conditions = Conditions(emissivity=[1, 0.75, 0.75, 0.75], temperature=[550, 300, np.nan, np.nan])
    made = heat_balance(patches, factors, conditions)
    np.testing.assert_allclose(made.temperature[:, 0], [550, 300, 505.52787653, 463.29646698], atol=1e-3)
    gold = np.array([5188.7402029, 1127.0276961, 3703.3231043, 2612.4447948]) * SIGMA / 5.67036713e-8
    np.testing.assert_allclose(made.radiosity[:, 0], gold, rtol=1e-7)
    flux = made.radiosity[:, 0] - made.irradiance[:, 0]
    np.testing.assert_allclose(flux, [2003.1865, -2003.1865, 0, 0], atol=2e-3)


#: The sun's irradiance, its height, the crater's half angle; reflectance of sunlight, emissivity of the ground.
SUN, HEIGHT, ANGLE, ALBEDO, EMISSIVITY = 1000.0, np.deg2rad(15), np.deg2rad(40), 0.3, 0.99


def crater(rings):
    """A cap of the unit sphere, inside up, in rings of 4 rings trapezoids, and the share of each that the sun lights.
    The innermost ring is one patch, a polygon."""
    sectors = 4 * rings
    a, phi = np.meshgrid(
        ANGLE * np.arange(1, rings + 1) / rings, 2 * np.pi * np.arange(sectors) / sectors, indexing="ij"
    )
    vertices = np.stack([np.sin(a) * np.cos(phi), np.sin(a) * np.sin(phi), -np.cos(a)], axis=-1).reshape(-1, 3)
    j = np.arange(sectors)
    k = (j + 1) % sectors
    faces = [[0, x, x + 1, x + 1] for x in range(1, sectors - 1)]
    for low in sectors * np.arange(rings - 1):
        faces += np.stack([low + j, low + sectors + j, low + sectors + k, low + k], axis=1).tolist()
    ids = np.maximum(np.arange(len(faces)) - (sectors - 3), 0)
    # A point is in shadow if the ray to the sun meets the sphere again below the rim.
    u, v = (x.ravel() for x in np.meshgrid(*[(np.arange(8) + 0.5) / 8] * 2))
    weights = np.stack([(1 - u) * (1 - v), u * (1 - v), u * v, (1 - u) * v])
    points = np.einsum("cs,fcx->fsx", weights, vertices[np.array(faces)])
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    sun = np.array([np.cos(HEIGHT), 0, np.sin(HEIGHT)])
    along = -2 * points @ sun
    lit = (points + along[..., None] * sun)[..., 2] >= -np.cos(ANGLE)
    share = np.bincount(ids, lit.mean(axis=1)) / np.bincount(ids)
    return Patches(vertices, faces, ids=ids), share, sun


def test_a_crater_of_ingersoll():
    """All of the shadow has one temperature, 148.86 K [Ingersoll 1992]: of sunlight that the rest reflects, and of its
    heat."""
    patches, share, sun = crater(16)
    factors = exact_form_factors(patches)
    direct = SUN * share * np.maximum(patches.normals @ sun, 0)
    light = solve(patches.with_properties(ALBEDO, ALBEDO * direct), factors, "conjugate-gradient", tolerance=1e-9)
    absorbed = (1 - ALBEDO) * (direct + light.irradiance[:, 0])
    made = heat_balance(patches, factors, Conditions(emissivity=EMISSIVITY, flux=absorbed))
    f = (1 - np.cos(ANGLE)) / 2
    power = SUN * np.sin(HEIGHT) * f * (1 - ALBEDO) / (1 - ALBEDO * f) * (1 + ALBEDO * (1 - f) / EMISSIVITY)
    exact, shadow = (power / SIGMA) ** 0.25, made.temperature[share == 0, 0]
    assert exact == pytest.approx(148.857, abs=1e-3) and len(shadow) > 500
    np.testing.assert_allclose(shadow, exact, atol=0.3)
    assert np.sqrt(np.mean((shadow - exact) ** 2)) < 0.1 and abs(shadow.mean() - exact) < 0.03
