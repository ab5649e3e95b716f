"""CIE 171:2006: its references against independent closed forms, cheap cases, and all of them."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest
from support.experiments import tables_of

from etendue.lighting import cie_sky, read_photometry

references, masks, rooms, cases, suite = (
    importlib.import_module(f"benchmarks.cie171.{name}") for name in ("references", "masks", "rooms", "cases", "suite")
)
SUN = (0.0, -0.5, 0.75**0.5)
ROOF = [(2, (a, a, 3.0), (4 - a, 4 - a, 3.0)) for a in (1.5, 0.0)]


def corners(opening):
    x0, y0, z = opening.low
    x1, y1, _ = opening.high
    return [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]


def test_configuration_factors():
    # Of a rectangle a x b whose corner is above a parallel element, or above the edge of a perpendicular plane, at c.
    a, b, c = 1.3, 0.7, 0.9
    x, y = a / np.hypot(a, c), b / np.hypot(b, c)
    parallel = (x * np.arctan(b / np.hypot(a, c)) + y * np.arctan(a / np.hypot(b, c))) / (2 * np.pi)
    square = [(0, 0, c), (a, 0, c), (a, b, c), (0, b, c)]
    assert np.allclose(references.configuration_factor([0, 0, 0], rooms.Z, square), parallel, rtol=1e-12)
    upright = (np.arctan(a / c) - c / np.hypot(b, c) * np.arctan(a / np.hypot(b, c))) / (2 * np.pi)
    assert np.allclose(references.configuration_factor([0, 0, 0], rooms.Y, square), upright, rtol=1e-12)


@pytest.mark.parametrize("opening", [references.Opening(*o) for o in ROOF])
def test_integrals_of_a_uniform_sky_are_configuration_factors(opening):
    outside = references.Outside(references.GeneralSky(5, SUN))
    for points, normal in ((rooms.wall_points(0.0), rooms.Y), (rooms.floor_points(), rooms.Z)):
        for p in points.values():
            found = references.illuminance(p, normal, opening, outside.luminance, {})
            assert np.isclose(found, references.configuration_factor(p, normal, corners(opening))[0], rtol=1e-5)


def test_the_horizon_divides_a_facade():
    """A uniform sky above it and a uniform ground below, each by its configuration factor."""
    outside = references.Outside(references.GeneralSky(5, SUN), 0.3)
    opening = references.Opening(1, (0.0, 0.0, 0.0), (4.0, 0.0, 3.0))
    for p in rooms.wall_points(4.0).values():
        found = references.illuminance(p, -rooms.Y, opening, outside.luminance, {2: [p[2]]})
        sky, ground = (
            references.configuration_factor(p, -rooms.Y, [(0, 0, a), (4, 0, a), (4, 0, b), (0, 0, b)])[0]
            for a, b in ((p[2], 3.0), (0.0, p[2]))
        )
        assert np.isclose(found, sky + 0.3 * ground, rtol=1e-6)


@pytest.mark.parametrize("kind", [1, 8, 12, 15])
def test_integrals_converge(kind):
    outside = references.Outside(references.GeneralSky(kind, SUN), 0.3)
    opening = references.Opening(1, (1.0, 0.0, 1.0), (3.0, 0.0, 2.0))
    for p, normal in (((2.0, 4.0, 1.75), -rooms.Y), ((2.0, 0.25, 0.0), rooms.Z)):
        cuts = references.peak(p, opening, SUN)
        cuts[2] = [*cuts.get(2, ()), p[2]]
        coarse, fine = (
            references.illuminance(p, normal, opening, outside.luminance, cuts, True, panels=n) for n in (12, 24)
        )
        assert np.isclose(coarse, fine, rtol=1e-5)


def test_skies_are_those_of_the_library():
    rng = np.random.default_rng(0)
    d = rng.normal(size=(200, 3))
    d[:, 2] = np.abs(d[:, 2]) + 0.05
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    for kind in range(1, 16):
        sky = references.GeneralSky(kind, SUN)
        assert np.allclose(sky.luminance(d), cie_sky(kind, SUN, diffuse_illuminance=1.0).luminance(d), rtol=1e-4)
    assert np.isclose(references.GeneralSky(5, SUN).vertical(rooms.Y), 0.5, rtol=1e-10)


def test_glass():
    # At normal incidence R = ((n - 1) / (n + 1))^2; at Brewster's angle, tan = n, only light of one polarisation is
    # reflected: R = ((n^2 - 1) / (n^2 + 1))^2 / 2.
    n = references.INDEX
    brewster = 0.5 * ((n**2 - 1) / (n**2 + 1)) ** 2
    assert np.isclose(references.pane(1.0), 2 * n / (n**2 + 1), rtol=1e-12)
    assert np.isclose(references.twice_refracted(np.cos(np.arctan(n))), (1 - brewster) ** 2, rtol=1e-12)


@pytest.mark.parametrize(
    ("mask", "q", "normal"),
    [
        (masks.Mask(2.0, level=3.0), (5.0, -1.2, 3.0), (0, 0, -1)),
        (masks.Mask(6.0, top=9.0), (1.0, -6.0, 1.5), (0, 1, 0)),
        (masks.Mask(6.0, top=9.0), (-3.0, -6.0, 7.0), (0, 1, 0)),
    ],
)
def test_light_on_masks_beside_rays(mask, q, normal):
    """Rays with the density cos / pi; those that meet the box of the room see black."""
    outside = references.Outside(references.GeneralSky(12, SUN), 0.3)
    rng = np.random.default_rng(1)
    u, v = rng.random((2, 400_000))
    n = np.asarray(normal, float)
    a, b = (np.roll(np.abs(n), k) for k in (1, 2))
    r, phi = np.sqrt(u), 2 * np.pi * v
    d = (r * np.cos(phi))[:, None] * a + (r * np.sin(phi))[:, None] * b + np.sqrt(1 - u)[:, None] * n
    with np.errstate(divide="ignore"):
        ends = np.sort([(0.0 - np.array(q)) / d, (np.array([4.0, 4.0, 3.0]) - np.array(q)) / d], axis=0)
    near, far = ends[0].max(axis=1), ends[1].min(axis=1)
    lit = np.where((near < far) & (far > 1e-9), 0.0, outside.luminance(d)) * np.pi
    assert abs(mask.received(np.array([q]), outside)[0] - lit.mean()) < 4 * lit.std() / len(lit) ** 0.5
    assert ((near < far) & (far > 1e-9)).mean() > 0.01  # the room is in the way


def test_a_file_of_each_lamp_has_its_intensity(tmp_path):
    path = cases.photometric_file(tmp_path / "lobe.ies", cases._lobe, 181, 90)
    web = read_photometry(path)
    c, gamma = np.deg2rad([17.3, 201.9]), np.deg2rad([33.3, 71.7])
    d = np.stack([np.sin(gamma) * np.cos(c), np.sin(gamma) * np.sin(c), -np.cos(gamma)], axis=1)
    assert np.allclose(web.intensity(d), cases._lobe(c, gamma), rtol=3e-4)


def test_what_passes():
    def judged(value, error, expected=100.0):
        arrays = (np.array([x, y]) for x, y in ((value, 100.0), (error, 0.1), (expected, 100.0)))
        return suite._judged(("5.9", "row", "what", "path"), ["A", "B"], *arrays)[0]

    assert judged(100.4, 0.01).passed and judged(100.4, 0.01).is_settled
    assert judged(101.0, 0.4).passed and not judged(101.0, 0.4).is_settled
    assert not judged(101.0, 0.3).passed and not judged(100.0, 1.1).passed
    assert judged(0.0, 0.0, 0.0).passed and not judged(0.1, 0.01, 0.0).passed


@pytest.mark.parametrize(("number", "what", "method"), [("5.2", "lobe", "bpt"), ("5.9", "sky 12", "path")])
def test_cheap_cases(number, what, method, tmp_path):
    case = next(case for case in cases.cases([number], [12], tmp_path) if case.what == what)
    readings = suite.take(case, method)
    assert len(readings) == len(case.points) and all(reading.passed for reading in readings), readings


@pytest.mark.slow
def test_the_command(tmp_path, monkeypatch):
    words = ["cie171", "--cases", "5.3,5.5", "--quick", "--out", str(tmp_path)]
    (table,) = tables_of("", words, tmp_path, monkeypatch)
    assert [row[0] for row in table.rows] == ["5.3", "5.3", "5.5"]
    assert [row[-1] for row in table.rows] == ["14 of 14", "14 of 14", "21 of 21"]
    assert len(json.loads((tmp_path / "readings.json").read_text())) == 49


@pytest.mark.slow
def test_all_cases(tmp_path, monkeypatch):
    (table,) = tables_of("", ["cie171", "--out", str(tmp_path)], tmp_path, monkeypatch)
    for row in table.rows:
        passed, _, count = row[-1].partition(" of ")
        assert passed == count, row
