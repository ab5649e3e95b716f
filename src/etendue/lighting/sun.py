"""Where the sun stands.

The formula of the Astronomical Almanac [Michalsky 1988] is vectorised over the hours of a year and agrees with the
almanac to 0.01 degrees from 1950 to 2050. The position is geometric: refraction, which raises the sun by half a degree
at the horizon and by less than 0.02 degrees above 45 degrees, is left out, as in Radiance's programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from .errors import LightingError

#: Noon of 1 January 2000, the epoch of the formula.
_EPOCH = np.datetime64("2000-01-01T12:00:00", "ms")
_DAY = np.timedelta64(1, "D") / np.timedelta64(1, "ms")
#: Years for which the formula is accurate.
_YEARS = (1950, 2050)

#: A moment, or several: aware datetimes, their texts in ISO 8601, or NumPy's datetime64, which is universal time.
Times = datetime | str | Sequence[datetime | str] | NDArray[np.datetime64]


def sun_direction(latitude: float, longitude: float, times: Times) -> Array:
    """Unit vectors (n, 3) towards the sun, x east, y north, z up, at a place and n times.

    ``latitude`` in degrees north, ``longitude`` in degrees east. ``times``: a ``datetime`` with time zone, a text such
    as "2024-06-21T12:00+02:00", or a sequence of them; or a NumPy array of ``datetime64``, in universal time. Raises
    :class:`LightingError` for a time without zone or outside 1950 to 2050, and for a place that is not on Earth.
    """
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0):
        raise LightingError(
            f"there is no place at latitude {latitude}, longitude {longitude}; give degrees north and degrees east"
        )
    moments = _universal(times)
    years = moments.astype("datetime64[Y]").astype(int) + 1970
    if ((years < _YEARS[0]) | (years > _YEARS[1])).any():
        raise LightingError(f"the sun's position is known from {_YEARS[0]} to {_YEARS[1]}; give a time of these years")
    n = (moments - _EPOCH).astype(np.int64) / _DAY
    # [Michalsky 1988]: ecliptic longitude and obliquity, right ascension and declination, local hour angle.
    mean_longitude = np.deg2rad((280.460 + 0.9856474 * n) % 360.0)
    anomaly = np.deg2rad((357.528 + 0.9856003 * n) % 360.0)
    ecliptic = mean_longitude + np.deg2rad(1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    obliquity = np.deg2rad(23.439 - 4e-7 * n)
    ascension = np.arctan2(np.cos(obliquity) * np.sin(ecliptic), np.cos(ecliptic))
    sin_declination = np.sin(obliquity) * np.sin(ecliptic)
    hours = (n + 0.5) % 1.0 * 24.0
    sidereal = (6.697375 + 0.0657098242 * n + hours) * 15.0 + longitude  # in degrees
    hour_angle = np.deg2rad(sidereal % 360.0) - ascension

    cos_declination = np.sqrt(1.0 - sin_declination**2)
    north, up = np.sin(np.deg2rad(latitude)), np.cos(np.deg2rad(latitude))
    towards: Array = np.stack(
        [
            -cos_declination * np.sin(hour_angle),
            up * sin_declination - north * cos_declination * np.cos(hour_angle),
            north * sin_declination + up * cos_declination * np.cos(hour_angle),
        ],
        axis=-1,
    )
    return towards


def day_of_year(times: Times) -> Array:
    """Days (n,) from the beginning of the year in universal time, 1 on 1 January; for :func:`perez_sky`. Errors as
    :func:`sun_direction`."""
    moments = _universal(times)
    days: Array = 1.0 + (moments - moments.astype("datetime64[Y]")) / np.timedelta64(1, "D")
    return days


def _universal(times: Times) -> NDArray[np.datetime64]:
    """Times as ``datetime64`` (n,) in universal time, to the millisecond. Raises :class:`LightingError`."""
    if isinstance(times, (np.ndarray, np.datetime64)):
        found = np.atleast_1d(np.asarray(times))
        if found.dtype.kind != "M" or np.isnat(found).any():
            raise LightingError("times in an array are datetime64 in universal time; give such an array, or datetimes")
        return found.astype("datetime64[ms]")
    listed = [times] if isinstance(times, (datetime, str)) else list(times)
    return np.array([_moment(time) for time in listed], "datetime64[ms]")


def _moment(time: datetime | str) -> np.datetime64:
    try:
        moment = datetime.fromisoformat(time) if isinstance(time, str) else time
    except ValueError:
        raise LightingError(f"'{time}' is not a time; write it as 2024-06-21T12:00+02:00") from None
    if moment.utcoffset() is None:
        raise LightingError(f"the time {moment.isoformat()} has no time zone; add its offset, such as +01:00 or Z")
    return np.datetime64(moment.astimezone(UTC).replace(tzinfo=None), "ms")
