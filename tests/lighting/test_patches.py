"""Patches of the sky, and skies in them as Radiance's ``gendaymtx`` puts them there."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from etendue.lighting import LightingError, SkyPatches, cie_sky, perez_sky

RADIANCE = 179.0  #: lm/W, Radiance's own convention


@pytest.mark.parametrize("m", [1, 2, 4])
def test_partition(m):
    """144 m^2 + 1 patches and the ground cover the sphere; directions fall in them in proportion to solid angle;
    centres are in their own patches."""
    patches = SkyPatches(m)
    assert patches.count == 144 * m**2 + 2
    assert patches.solid_angles[1:].sum() == pytest.approx(2.0 * np.pi, rel=1e-12)
    np.testing.assert_array_equal(patches.number_of(patches.directions), np.arange(patches.count))
    np.testing.assert_allclose(np.linalg.norm(patches.directions, axis=1), 1.0)
    d = np.random.default_rng(1).normal(size=(400_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    found = np.bincount(patches.number_of(d), minlength=patches.count)
    expected = len(d) * patches.solid_angles / (4.0 * np.pi)
    statistic = ((found - expected) ** 2 / expected).sum()
    assert abs(statistic - patches.count) < 5.0 * np.sqrt(2.0 * patches.count)


def test_order_of_tregenza():
    """Rows of 30, 30, 24, 24, 18, 12, 6 and 1 from the horizon up, each from north by east, all 12 degrees high."""
    patches = SkyPatches()
    altitude = np.rad2deg(np.arcsin(patches.directions[:, 2]))
    np.testing.assert_allclose(np.unique(altitude.round(6)), [-90, 6, 18, 30, 42, 54, 66, 78, 90])
    first = np.cumsum([1, 30, 30, 24, 24, 18, 12])
    np.testing.assert_allclose(patches.directions[first, 0], 0.0, atol=1e-12)
    assert (patches.directions[first, 1] > 0.0).all()  # north
    assert np.rad2deg(np.arctan2(*patches.directions[2, :2])) == pytest.approx(12.0)  # east of it
    np.testing.assert_array_equal(patches.number_of([[1e-3, 1, 0.01], [-1e-3, 1, 0.01], [0, 0.1, -1]]), [1, 1, 0])


def test_mean_luminance():
    """The sky's flux through the patches is the integral of its luminance; a uniform sky is uniform in them."""
    np.testing.assert_allclose(SkyPatches().luminance(cie_sky(5, zenith_luminance=7.0, ground=0.0))[1:], 7.0)
    sky = cie_sky(13, [0.4, 0.5, 0.6], zenith_luminance=1000.0)
    patches = SkyPatches(2)
    d = np.random.default_rng(2).normal(size=(2_000_000, 3))
    d[:, 2] = np.abs(d[:, 2])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    luminance, number = sky.luminance(d), patches.number_of(d)
    count = np.bincount(number, minlength=patches.count)[1:]
    mean = np.bincount(number, luminance, patches.count)[1:] / count
    spread = np.sqrt(np.maximum(np.bincount(number, luminance**2, patches.count)[1:] / count - mean**2, 0.0) / count)
    z = (mean - patches.luminance(sky)[1:]) / np.maximum(spread, 1e-9)
    assert np.abs(z).max() < 5.0 and z.std() < 1.2


def gendaymtx() -> str | None:
    """Radiance's program, of the package ``pyradiance`` or in the path."""
    found = importlib.util.find_spec("pyradiance")
    inside = Path(found.origin).parent / "bin" / "gendaymtx" if found is not None and found.origin else None
    return str(inside) if inside is not None and inside.exists() else shutil.which("gendaymtx")


@pytest.mark.skipif(gendaymtx() is None, reason="needs Radiance (pip install pyradiance)")
@pytest.mark.parametrize("m", [1, 4])
def test_skies_of_radiance(m, tmp_path):
    """Perez's sky of ``gendaymtx`` in eight kinds of weather. Radiance takes the luminance of the centres of patches
    and normalises their sum, so that it differs from ours by a factor near 1, the same for all patches of a sky. The
    ground and the sun's light, and its patches, have no such factor."""
    rows = [
        (3, 21, 9.5, 0, 80),
        (3, 21, 12.5, 100, 200),
        (6, 21, 10.5, 300, 200),
        (6, 21, 12.5, 600, 150),
        (6, 21, 8.5, 800, 90),
        (6, 21, 12.5, 900, 70),
        (12, 21, 9.5, 500, 50),
        (6, 21, 6.5, 200, 120),
    ]
    head = "place X\nlatitude 47\nlongitude -8\ntime_zone -15\nsite_elevation 400\nweather_data_file_units 1\n"
    (tmp_path / "x.wea").write_text(head + "".join(" ".join(map(str, row)) + "\n" for row in rows))

    def matrix(*options: str) -> np.ndarray:
        command = [gendaymtx() or "", "-h", "-od", "-m", str(m), "-c", "1", "1", "1", *options, "x.wea"]
        done = subprocess.run(command, capture_output=True, check=True, cwd=tmp_path)
        return RADIANCE * np.frombuffer(done.stdout, np.float64).reshape(-1, len(rows), 3)[:, :, 1]

    whole, sky_only = matrix("-D", "suns"), matrix("-s")
    lines = (tmp_path / "suns").read_text().splitlines()
    suns = [[float(v) for v in line.split()[1:4]] for line in lines if line.startswith("4 ")]
    patches = SkyPatches(m)
    for k, (month, day, _, direct, diffuse) in enumerate(rows):
        sky = perez_sky(suns[k], direct, diffuse, day=date(2001, month, day).timetuple().tm_yday)
        assert sky.ground_luminance == pytest.approx(sky_only[0, k], rel=1e-5)
        ratio = sky.luminance(patches.directions[1:]) / sky_only[1:, k]
        np.testing.assert_allclose(ratio, ratio.mean(), rtol=1e-4)
        assert ratio.mean() == pytest.approx(1.0, abs=0.04 / m**2)
        sun = patches.luminance(sky) - patches.luminance(sky, sun=False)
        np.testing.assert_allclose(sun, whole[:, k] - sky_only[:, k], rtol=1e-4, atol=0.1)


def test_sun_in_its_patches():
    """Four patches share the sun; its illuminance normal to the rays is kept."""
    patches = SkyPatches()
    sun = np.array([0.3, -0.5, 0.6]) / np.sqrt(0.7)
    sky = cie_sky(12, sun, zenith_luminance=1000.0, sun_illuminance=50_000.0)
    extra = (patches.luminance(sky) - patches.luminance(sky, sun=False)) * patches.solid_angles
    assert extra.sum() == pytest.approx(50_000.0, rel=1e-9)
    near = np.flatnonzero(extra > 1.0)
    assert len(near) == 4 and patches.number_of(sun[None])[0] in near
    assert (patches.directions[near] @ sun).min() > np.cos(np.deg2rad(20.0))


@pytest.mark.parametrize("m", [0, 1.5, True, "2"])
def test_bad_subdivision(m):
    with pytest.raises(LightingError, match="subdivided 1, 2"):
        SkyPatches(m)
