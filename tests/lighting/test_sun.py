"""The sun's position against published values, and times that are refused."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from etendue.lighting import LightingError, sun_direction


def angles(latitude: float, longitude: float, time: object) -> tuple[float, float]:
    """Altitude and azimuth (from north by east) in degrees."""
    x, y, z = sun_direction(latitude, longitude, time)[0]
    return float(np.rad2deg(np.arcsin(z))), float(np.rad2deg(np.arctan2(x, y)) % 360.0)


def test_example_of_the_solar_position_algorithm():
    """Reda and Andreas, Solar Position Algorithm (NREL/TP-560-34302, 2008), table A5.1: topocentric elevation without
    refraction 39.872046 and azimuth 194.340241 degrees; ours has no parallax, which is .0019 degrees there."""
    altitude, azimuth = angles(39.742476, -105.1786, "2003-10-17T12:30:30-07:00")
    assert altitude == pytest.approx(39.872046, abs=0.01)
    assert azimuth == pytest.approx(194.340241, abs=0.01)


@pytest.mark.parametrize(
    ("time", "declination"),
    [
        ("2024-06-20T20:51Z", 23.438),  # solstices: the obliquity of the ecliptic
        ("2024-12-21T09:20Z", -23.438),
        ("2024-03-20T03:06Z", 0.0),  # equinoxes
        ("2024-09-22T12:44Z", 0.0),
        ("1992-10-13T00:00Z", -7.785),  # Meeus, Astronomical Algorithms, example 25.a (a minute earlier)
    ],
)
def test_declination(time, declination):
    """At the north pole the altitude is the declination."""
    assert angles(90.0, 0.0, time)[0] == pytest.approx(declination, abs=0.01)


def test_rises_east_and_culminates_south():
    """On the day of an equinox the sun rises in the east, and at noon it is in the south at 90 degrees minus the
    latitude; in the southern hemisphere in the north. The equation of time is -7.4 minutes."""
    altitude, azimuth = angles(48.0, 0.0, "2024-03-20T12:07:24Z")
    assert (altitude, azimuth) == (pytest.approx(42.15, abs=0.05), pytest.approx(180.0, abs=0.1))
    altitude, azimuth = angles(48.0, 0.0, "2024-03-20T06:07:24Z")
    assert (altitude, azimuth) == (pytest.approx(0.05, abs=0.1), pytest.approx(90.0, abs=0.2))
    assert np.cos(np.deg2rad(angles(-35.0, 150.0, "2024-06-21T12:02+10:00")[1])) > 0.9999


def test_forms_of_times_agree():
    """Texts, datetimes and arrays in universal time; a year of hours at once."""
    zone = timezone(timedelta(hours=2))
    one = sun_direction(47.4, 8.5, "2024-06-21T12:00+02:00")
    for time in (
        datetime(2024, 6, 21, 12, tzinfo=zone),
        [datetime(2024, 6, 21, 10, tzinfo=UTC)],
        np.array(["2024-06-21T10:00"], "datetime64[m]"),
    ):
        np.testing.assert_array_equal(sun_direction(47.4, 8.5, time), one)
    hours = np.arange("2024-01-01T00:30", "2025-01-01T00:30", np.timedelta64(60, "m"), "datetime64[m]")
    all_year = sun_direction(47.4, 8.5, hours)
    np.testing.assert_allclose(np.linalg.norm(all_year, axis=1), 1.0, rtol=1e-12)
    assert all_year.shape == (8784, 3)
    assert (all_year[:, 2] > 0.0).sum() == pytest.approx(4410, abs=40)  # half of the year


def test_bad_times():
    for message, arguments in {
        "no time zone; add its offset": (47.0, 8.0, "2024-06-21T12:00"),
        "no time zone": (47.0, 8.0, datetime(2024, 6, 21, 12)),
        "is not a time": (47.0, 8.0, "noon"),
        "from 1950 to 2050": (47.0, 8.0, "2124-06-21T12:00Z"),
        "no place at latitude 95": (95.0, 8.0, "2024-06-21T12:00Z"),
        "datetime64 in universal time": (47.0, 8.0, np.array([1.0])),
    }.items():
        with pytest.raises(LightingError, match=message):
            sun_direction(*arguments)
