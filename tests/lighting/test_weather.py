"""EPW files: a year that is written here, its skies, and files that are wrong."""

from __future__ import annotations

import numpy as np
import pytest
from support.weather import HEADING, written, year

from etendue.core import OptionError
from etendue.lighting import read_epw


@pytest.fixture(scope="module")
def hours() -> list[str]:
    return year()


@pytest.mark.parametrize(("end", "bom"), [("\n", ""), ("\r\n", "\ufeff")])
def test_year(hours, tmp_path, end, bom):
    weather = read_epw(written(tmp_path, hours, end=end, bom=bom))
    assert (weather.place, weather.latitude, weather.longitude) == ("Bern, CHE", 46.95, 7.45)
    assert (weather.time_zone, weather.elevation, len(weather.times)) == (1.0, 553.0, 8760)
    # Hour 13 of 21 June is from 12 to 13 o'clock of UTC + 1, so its middle is 11:30 universal time.
    number = 24 * 171 + 12
    assert str(weather.times[number]) == "2023-06-21T11:30"
    assert (weather.direct_normal[number], weather.diffuse_horizontal[number]) == (500.0, 100.0)
    assert np.isnan(weather.global_illuminance).all() and (weather.dew_point == 5.0).all()
    # The global irradiance was written with the sun at the middle of the hour.
    up = weather.sun()[:, 2]
    np.testing.assert_allclose(weather.global_horizontal, np.where(up > 0, 100.0 + 500.0 * up, 0.0), atol=1e-6)
    sky = weather.sky(number)
    assert sky is not None and weather.sky(number - 12) is None
    assert sky.sun == pytest.approx(weather.sun()[number], abs=1e-9)
    assert 90.0 < sky.sun_illuminance / 500.0 < 120.0 and 100.0 < sky.diffuse_illuminance / 100.0 < 150.0


@pytest.mark.slow
def test_leap_years(tmp_path):
    assert len(read_epw(written(tmp_path, year(2024, leap=True))).times) == 8784
    assert len(read_epw(written(tmp_path, year(2024))).times) == 8760  # a typical year without 29 February


def changed(hours: list[str], number: int, column: int, value: str) -> list[str]:
    row = hours[number].split(",")
    row[column] = value
    return [*hours[:number], ",".join(row), *hours[number + 1 :]]


def test_missing_values(hours, tmp_path):
    """A missing irradiance is NaN, and reported where it is needed; a missing dew point is replaced."""
    noon = 24 * 100 + 12
    weather = read_epw(written(tmp_path, changed(changed(hours, noon, 14, "9999"), noon + 1, 7, "99.9")))
    assert np.isnan(weather.direct_normal[noon]) and np.isnan(weather.dew_point[noon + 1])
    assert weather.sky(noon + 1) is not None
    with pytest.raises(
        OptionError, match=r"hour 2412 of Bern, CHE \(2023-04-11 12:30\) has no direct or diffuse"
    ) as caught:
        weather.sky(noon)
    assert "\n" not in str(caught.value)
    with pytest.raises(OptionError, match="hour 2412 of Bern"):
        weather.check()


def test_hours_of_sunrise_and_night(hours, tmp_path):
    """Light in an hour whose middle is before sunrise comes from a sun at the horizon; light at night is an error."""
    up = read_epw(written(tmp_path, hours)).sun()[:, 2]
    dawn = int(np.flatnonzero((up[:-1] < 0.0) & (up[1:] > 0.0) & (up[:-1] > -0.1))[0])
    weather = read_epw(written(tmp_path, changed(hours, dawn, 15, "12")))
    sky = weather.sky(dawn)
    assert sky is not None and sky.sun[2] == 0.0
    night = read_epw(written(tmp_path, changed(hours, 24 * 100, 15, "12")))
    with pytest.raises(OptionError, match="degrees below the horizon; correct longitude and time zone"):
        night.sky(24 * 100)
    with pytest.raises(OptionError, match=r"hour 2400 of Bern.* below the horizon"):
        night.check()
    weather.check()
    with pytest.raises(OptionError, match="hours 0 to 8759, not of hour 8760"):
        night.sky(8760)


def test_bad_files(hours, tmp_path):
    cut = [*hours[:50], ",".join(hours[50].split(",")[:10]), *hours[51:]]
    for message, rows, heading in (
        ("line 59 of .* has 10 columns", cut, HEADING),
        ("line 109 of .* is hour 6 of 5.1., which does not follow", hours[:100] + hours[101:], HEADING),
        ("line 33 of .* is hour 1 of 3.1., which does not follow", hours[:24] + hours[48:], HEADING),
        ("has 24 hours; a year has 8760", hours[:24], HEADING),
        ("line 9 of .* is hour 1 of 2.1., which does not follow", hours[24:], HEADING),
        ("line 9 of .* has 'x' as direct normal; give a number", changed(hours, 0, 14, "x"), HEADING),
        ("line 9 of .* has a negative diffuse horizontal", changed(hours, 0, 15, "-1"), HEADING),
        ("line 9 of .* has no date", changed(hours, 0, 1, "13"), HEADING),
        ("not an EPW file", hours, ("place Bern", *HEADING[1:])),
        ("has 'north' as latitude", hours, (HEADING[0].replace("46.95", "north"), *HEADING[1:])),
        ("no place on Earth", hours, (HEADING[0].replace("46.95", "146.95"), *HEADING[1:])),
        ("no line DATA PERIODS", hours, (*HEADING[:7], "COMMENTS 3")),
        ("one record an hour", hours, (*HEADING[:7], "DATA PERIODS,1,4,Data,Sunday, 1/ 1,12/31")),
    ):
        with pytest.raises(OptionError, match=message) as caught:
            read_epw(written(tmp_path, rows, heading))
        assert "\n" not in str(caught.value)
    with pytest.raises(OptionError, match="cannot read"):
        read_epw(tmp_path / "none.epw")
