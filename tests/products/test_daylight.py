"""Daylight coefficients against closed forms, and the metrics of a year."""

from __future__ import annotations

import csv

import mitsuba as mi
import numpy as np
import pytest

import etendue
from etendue.core import OptionError
from etendue.lighting import AnnualDaylight, LightingError, Meters, SkyPatches, Weather, cie_sky
from etendue.methods import SkySettings

UP = [[0.0, 0.0, 1.0]]


def grey(value):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def plane(reflectance=0.5, **more):
    ground = {"type": "rectangle", "to_world": mi.ScalarTransform4f().scale(1000), "bsdf": grey(reflectance)}
    return {"type": "scene", "ground": ground, **more}


def weather(direct=0.0, diffuse=100.0):
    """A year with the same sky in all hours with the sun up."""
    times = np.datetime64("2024-01-01T00:30") + np.arange(8784) * np.timedelta64(1, "h")
    nothing = np.full(len(times), np.nan)
    found = Weather("Quito", -0.2, -78.5, -5.0, 2800.0, times + np.timedelta64(5, "h"), *[nothing] * 8)
    up = found.sun()[:, 2] > 0.05
    for name, value in (("direct_normal", direct), ("diffuse_horizontal", diffuse)):
        object.__setattr__(found, name, np.where(up, value, 0.0))
    return found


def test_an_open_place():
    # The integral of the cosine over a patch between altitudes: (sin^2 high - sin^2 low) / 2 times its width.
    found = etendue.daylight(plane(), [[0, 0, 0]], UP, spp=1 << 18).coefficients
    p = found.patches
    row = np.repeat(np.arange(len(p.in_row)), p.in_row)
    low, high = row * p.row_height, np.minimum((row + 1) * p.row_height, np.pi / 2)
    expected = (np.sin(high) ** 2 - np.sin(low) ** 2) * np.pi / p.in_row[row]
    assert found.values[0, 0] == pytest.approx([0, 0, 0])  # the ground is a surface of the scene
    z = (found.values[0, 1:, 0] - expected) / found.errors[0, 1:, 0]
    assert np.abs(z).max() < 6 and np.mean(z**2) < 2  # 32 passes of one sequence
    assert np.abs(found.values[0, 1:, 0] / expected - 1).max() < 0.02


def test_reflections_and_the_ground_below():
    # A vertical meter over a plane: half of the sky, and rho times what the plane receives, seen under half.
    found = etendue.daylight(plane(0.5), [[0, 0, 1]], [[0, 1, 0]], spp=1 << 16).coefficients
    assert found.values[0].sum(axis=0) == pytest.approx(np.pi / 2 + 0.5 * np.pi / 2, rel=2e-3)
    small = {"type": "scene", "mote": {"type": "sphere", "center": [0, 0, -50], "radius": 0.01, "bsdf": grey(0.5)}}
    found = etendue.daylight(small, [[0, 0, 1]], [[0, 1, 0]], spp=1 << 16).coefficients
    assert found.values[0, 0] == pytest.approx([np.pi / 2] * 3, rel=2e-3)


@pytest.mark.parametrize(("up", "east"), [("z", (1, 0, 0)), ("y", (1, 0, 0))])
def test_directions_of_the_compass(up, east):
    # A narrow view to the east finds the patches there; with north turned by 90 degrees, it looks north.
    meters = Meters([[0, 0, 2]] if up == "z" else [[0, 2, 0]], [east], "radiance")
    scene = {"type": "scene", "mote": {"type": "sphere", "center": [0, -50, -50], "radius": 0.01, "bsdf": grey(0.5)}}
    for north, azimuth in ((0.0, 90.0), (90.0, 0.0)):
        frame = SkySettings(up=up, north=north).frame
        assert np.allclose(frame @ frame.T, np.eye(3)) and np.linalg.det(frame) == pytest.approx(1.0)
        inside = np.array(east) + 0.05 * frame[2]
        view = Meters(meters.points, [inside], "radiance")
        found = etendue.daylight(scene, view, spp=64, up=up, north=north).coefficients
        number = int(np.argmax(found.values[0, :, 0]))
        direction = found.patches.directions[number]
        assert found.values[0, number] == pytest.approx([1, 1, 1])
        assert np.rad2deg(np.arctan2(direction[0], direction[1])) == pytest.approx(azimuth, abs=12.1)


def test_a_uniform_sky_agrees_with_meters():
    # Under two roofs with a gap: coefficients times luminances, and meters under the emitter.
    lid = [
        {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([x, 0, 2]).scale([1, 3, 1]),
            "bsdf": {"type": "twosided", "bsdf": grey(0.6)},
        }
        for x in (-2.0, 2.0)
    ]
    scene = plane(0.3, left=lid[0], right=lid[1])
    points = [[0, 0, 0], [1, 0.5, 0], [2, 0, 0.5]]
    sky = cie_sky(5, zenith_luminance=1000.0, ground=0.0)
    found = etendue.daylight(scene, points, UP, spp=1 << 15).coefficients
    by_patches = found.illuminance(found.patches.luminance(sky))
    emitter = {"type": "sky", "kind": 5, "zenith_luminance": 1000.0, "ground_reflectance": 0.0}
    read = etendue.measure(scene | {"sky": emitter}, points, UP, spp=1 << 13)
    error = np.hypot(read.photometric_error, 1000 * np.sqrt((found.errors**2).sum(axis=1)) @ [0.2126, 0.7152, 0.0722])
    assert (np.abs(by_patches - read.photometric) < 4.5 * error + 1e-4 * by_patches).all()
    assert (error < 0.02 * by_patches).all()


def test_a_year(tmp_path):
    # In the open, the illuminance of each hour is that of its sky.
    year, files = weather(direct=300.0), [tmp_path / name for name in ("c.mtx", "c.npz", "c.csv")]
    found = etendue.daylight(plane(), [[0, 0, 0], [1, 0, 0]], UP, year, spp=1 << 14, save=files)
    hour = 24 * 80 + 10
    sky = year.sky(hour)
    assert found.annual.illuminance[0, hour] == pytest.approx(sky.illuminance, rel=0.03)  # four patches for the sun
    assert (found.annual.illuminance[:, ~found.annual.daylit] < 1e4).all() and "sDA" in found.summary()
    head, _, body = files[0].read_text().partition("\n\n")
    assert "NROWS=2" in head and "NCOLS=146" in head and "NCOMP=3" in head
    numbers = np.array(body.split(), float).reshape(2, 146, 3)
    assert np.allclose(numbers, found.coefficients.values, rtol=1e-6)
    with np.load(files[1]) as arrays:
        assert arrays["illuminance"].shape == (2, 8784) and arrays["coefficients"].shape == (2, 146, 3)
    rows = list(csv.DictReader(files[2].open()))
    assert float(rows[0]["autonomy_300"]) == pytest.approx(found.annual.autonomy()[0], rel=1e-6)


def test_gaps_of_the_weather_are_told_before_the_run():
    year = weather()
    year.direct_normal[4000] = np.nan
    passes: list[object] = []
    with pytest.raises(LightingError, match=r"hour 4000 of Quito .* fill the gap"):
        etendue.daylight(plane(), [[0, 0, 0]], UP, year, spp=1 << 10, callback=passes.append)
    assert not passes


def test_meters_that_see_no_sky(caplog):
    """Inside of a solid that is white from both sides, which is no other than a room without windows."""
    white = {"type": "twosided", "bsdf": grey(0.5)}
    block = {"type": "cube", "bsdf": white}
    found = etendue.daylight(plane(block=block), [[0, 0, 0.5], [3, 0, 0]], UP, spp=1 << 10)
    assert "1 of 2 meters see nothing of the sky, as number 0 at [0.0, 0.0, 0.5]" in caplog.text
    assert found.coefficients.values[1].any()


def test_metrics():
    year = weather()
    meters = Meters(np.zeros((100, 3)), UP)
    hours, lit = len(year.times), year.sun()[:, 2] > 0.0

    def daylit(lux):
        return AnnualDaylight(meters, year, np.asarray(lux)[:, None] * lit)

    half = daylit(np.where(np.arange(100) < 50, 320.0, 120.0))
    assert half.occupied.sum() == hours * 10 // 24
    assert half.spatial_autonomy() == pytest.approx(0.5) and half.en17037() == "minimum"
    assert daylit(np.where(np.arange(100) < 49, 320.0, 120.0)).en17037() == "none"
    assert daylit(np.where(np.arange(100) < 50, 320.0, np.where(np.arange(100) < 94, 120.0, 90.0))).en17037() == "none"
    assert daylit(np.full(100, 800.0)).en17037() == "high"
    # At Quito the sun is up in all hours between 8 and 18, but for the last minutes.
    assert daylit(np.full(100, 2900.0)).useful().min() > 0.9 and daylit(np.full(100, 3100.0)).useful().max() == 0.0


def test_bad_requests(tmp_path):
    with pytest.raises(OptionError, match="give the weather"):
        etendue.daylight(plane(), [[0, 0, 0]], save=tmp_path / "a.csv")
    with pytest.raises(OptionError, match="written as"):
        etendue.daylight(plane(), [[0, 0, 0]], save=tmp_path / "a.exr")
    with pytest.raises(OptionError, match="up"):
        etendue.daylight(plane(), [[0, 0, 0]], up="x")
    found = etendue.daylight(plane(), [[0, 0, 0]], spp=16).coefficients
    with pytest.raises(LightingError, match="146 patches"):
        found.illuminance(np.ones(145))
    assert SkyPatches(2).count == 578
