"""Skies against closed forms and published formulas, and the integrals of all of them."""

from __future__ import annotations

import numpy as np
import pytest

from etendue.core import OptionError
from etendue.lighting import SUN_DIAMETER, cie_sky, perez_sky

SUN = np.array([0.3, -0.6, 0.5]) / np.sqrt(0.7)
KINDS = range(1, 17)
#: Direct normal and diffuse horizontal irradiance, from overcast to clear.
WEATHERS = ((0.0, 100.0), (60.0, 150.0), (200.0, 150.0), (300.0, 120.0), (500.0, 150.0), (800.0, 90.0), (900.0, 70.0))


def grid(rows: int = 500, columns: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) of the upper hemisphere, at the middles of equal cells of azimuth and angle to the zenith, and
    their solid angles times the cosine."""
    zenith = 0.5 * np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    across, z = np.sin(zenith), np.cos(zenith)
    parts = np.outer(across, np.sin(turn)), np.outer(across, np.cos(turn)), np.repeat(z, columns)
    weights = np.repeat(across * z, columns) * np.pi**2 / (rows * columns)
    return np.stack([part.ravel() for part in parts], axis=-1), weights


def exponential_integral(x: float) -> float:
    """E_3(x), the integral of mu exp(-x / mu) over mu from 0 to 1."""
    mu = (np.arange(200_000) + 0.5) / 200_000
    return float((mu * np.exp(-x / mu)).mean())


@pytest.mark.parametrize(("kind", "a", "b"), [(1, 4.0, 0.7), (3, 1.1, 0.8), (5, 0.0, 1.0)])
def test_skies_without_sun(kind, a, b):
    """L / Lz = (1 + a exp(-b / cos Z)) / (1 + a exp(-b)), E = pi Lz (1 + 2 a E_3(b)) / (1 + a exp(-b))."""
    sky = cie_sky(kind, zenith_luminance=5000.0)
    zenith = 1.0 + a * np.exp(-b)
    z = np.linspace(0.02, 1.0, 50)
    found = sky.luminance(np.stack([np.sqrt(1 - z**2), 0 * z, z], -1))
    np.testing.assert_allclose(found, 5000.0 * (1.0 + a * np.exp(-b / z)) / zenith, rtol=1e-12)
    expected = np.pi * 5000.0 * (1.0 + 2.0 * a * exponential_integral(b)) / zenith
    assert sky.diffuse_illuminance == pytest.approx(expected, rel=1e-8)
    assert sky.illuminance == sky.diffuse_illuminance


def test_traditional_overcast_sky():
    """L = Lz (1 + 2 cos Z) / 3, E = 7 pi Lz / 9; a third of the zenith's luminance at the horizon."""
    sky = cie_sky(16, diffuse_illuminance=10_000.0)
    assert sky.zenith_luminance == pytest.approx(90_000.0 / (7.0 * np.pi), rel=1e-6)
    across = sky.luminance([[0.8, 0.0, 0.6], [0.0, 1.0, 1e-9]])
    np.testing.assert_allclose(across / sky.zenith_luminance, [2.2 / 3.0, 1.02 / 3.0], rtol=1e-6)


@pytest.mark.parametrize(("kind", "f"), [(12, (0.91, 10.0, 0.45)), (13, (0.856, 16.0, 0.3))])
def test_clear_skies_of_earlier_standards(kind, f):
    """The clear sky of CIE 22 (1973) after Kittler, and the turbid one after Gusev, with constants of two or three
    digits: (1 - exp(-.32 / cos Z)) (f0 + f1 exp(-3 chi) + f2 cos^2 chi)."""
    directions, _ = grid(20, 30)
    chi = np.arccos(directions @ SUN)

    def old(z, chi):
        return (1.0 - np.exp(-0.32 / z)) * (f[0] + f[1] * np.exp(-3.0 * chi) + f[2] * np.cos(chi) ** 2)

    sky = cie_sky(kind, SUN, zenith_luminance=1.0)
    np.testing.assert_allclose(
        sky.luminance(directions), old(directions[:, 2], chi) / old(1.0, np.arccos(SUN[2])), rtol=1e-3
    )


@pytest.mark.parametrize("kind", KINDS)
def test_normalisation(kind):
    """The midpoint rule over 300,000 directions gives the illuminance that was asked for, and the zenith's luminance
    leads back to it."""
    sky = cie_sky(kind, SUN, diffuse_illuminance=12_000.0, sun_illuminance=40_000.0, ground=0.3)
    directions, weights = grid()
    assert (sky.luminance(directions) * weights).sum() == pytest.approx(12_000.0, rel=2e-5)
    again = cie_sky(kind, SUN, zenith_luminance=sky.zenith_luminance)
    assert again.diffuse_illuminance == pytest.approx(12_000.0, rel=1e-9)
    assert sky.illuminance == pytest.approx(12_000.0 + 40_000.0 * SUN[2], rel=1e-9)
    np.testing.assert_allclose(sky.luminance([[0, 0.6, -0.8], [0, 0, -1]]), 0.3 * sky.illuminance / np.pi)
    radius = np.deg2rad(0.5 * SUN_DIAMETER)
    assert sky.sun_luminance * np.pi * np.sin(radius) ** 2 == pytest.approx(40_000.0)


@pytest.mark.parametrize(
    "sky", [cie_sky(12, SUN, zenith_luminance=1e3), perez_sky(SUN, 800.0, 90.0)], ids=["cie", "perez"]
)
def test_symmetry_about_the_sun(sky):
    """Directions mirrored at the vertical plane through the sun are equally bright; the brightest is towards the sun at
    its height."""
    directions, _ = grid(20, 40)
    normal = np.array([SUN[1], -SUN[0], 0.0]) / np.hypot(SUN[0], SUN[1])
    mirrored = directions - 2.0 * np.outer(directions @ normal, normal)
    np.testing.assert_allclose(sky.luminance(directions), sky.luminance(mirrored), rtol=1e-9)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    ring = np.stack([np.sin(turn), np.cos(turn)], -1) * np.hypot(SUN[0], SUN[1])
    row = sky.luminance(np.column_stack([ring, np.full(361, SUN[2])]))
    assert np.rad2deg(turn[np.argmax(row)]) == pytest.approx(np.rad2deg(np.arctan2(SUN[0], SUN[1])) % 360, abs=1.0)


@pytest.mark.parametrize("altitude", [3.0, 20.0, 60.0, 90.0])
@pytest.mark.parametrize("weather", WEATHERS)
def test_perez_integrates_to_its_illuminance(weather, altitude):
    """The midpoint rule gives the diffuse illuminance; no direction is negative or not finite, at any height of the
    sun: some gradations grow beyond all bounds at the horizon, and are limited there."""
    angle = np.deg2rad(altitude)
    sky = perez_sky([0.0, -np.cos(angle), np.sin(angle)], *weather)
    directions, weights = grid()
    luminance = sky.luminance(directions)
    assert np.isfinite(luminance).all() and (luminance >= 0.0).all()
    assert (luminance * weights).sum() == pytest.approx(sky.diffuse_illuminance, rel=2e-4)
    efficacy = sky.diffuse_illuminance / weather[1]
    assert 90.0 < efficacy < 170.0  # lm/W: the range of [Perez 1990, fig. 8]


def test_sun_without_sky():
    """Some files have hours with direct and without diffuse light: the sun shines from a black sky."""
    sky = perez_sky(SUN, 100.0, 0.0)
    assert sky.zenith_luminance == 0.0 and sky.illuminance == pytest.approx(sky.sun_illuminance * SUN[2])
    assert 80.0 < sky.sun_illuminance / 100.0 < 110.0


def test_sky_that_the_model_makes_negative():
    """A dim sky below a sun at the zenith, far from all measurements: uniform, with the right illuminance."""
    sky = perez_sky([0.0, 0.0, 1.0], 30.0, 10.0)
    directions, weights = grid(100, 100)
    luminance = sky.luminance(directions)
    np.testing.assert_allclose(luminance, luminance[0])
    assert (luminance * weights).sum() == pytest.approx(sky.diffuse_illuminance, rel=1e-4)
    assert sky.diffuse_illuminance > 500.0


def test_bad_skies():
    for message, make in {
        "choose 1 to 15": lambda: cie_sky(17, SUN, zenith_luminance=1.0),
        "needs the direction": lambda: cie_sky(12, zenith_luminance=1.0),
        "give one of them": lambda: cie_sky(1, zenith_luminance=1.0, diffuse_illuminance=1.0),
        "either a zenith": lambda: cie_sky(1),
        "zenith luminance of a sky is -1": lambda: cie_sky(1, zenith_luminance=-1.0),
        "11.5 degrees below the horizon": lambda: cie_sky(12, [1.0, 0.0, -0.204], zenith_luminance=1.0),
        "below the horizon": lambda: perez_sky([0.0, 1.0, -0.1], 100.0, 100.0),
        "three numbers": lambda: perez_sky([0.0, 1.0], 100.0, 100.0),
        "direct irradiance of a sky is nan": lambda: perez_sky(SUN, np.nan, 100.0),
        "neither direct nor diffuse": lambda: perez_sky(SUN, 0.0, 0.0),
        "reflectance of the ground": lambda: perez_sky(SUN, 100.0, 100.0, ground=1.2),
        "dew point": lambda: perez_sky(SUN, 100.0, 100.0, dew_point=99.9),
    }.items():
        with pytest.raises(OptionError, match=message) as caught:
            make()
        assert "\n" not in str(caught.value)
