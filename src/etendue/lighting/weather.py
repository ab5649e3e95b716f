"""Weather of a year: EPW files of EnergyPlus, and the skies of their hours.

A file has eight lines of heading, of which the first (LOCATION) is read, and a line for each hour. Hour n of a day is
the time from n - 1 to n o'clock, local standard time; its irradiances are means over that time, so the sun is taken at
its middle. Missing values (9999 and others, by column) become NaN.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from .errors import LightingError
from .skies import GROUND, Sky, perez_sky
from .sun import day_of_year, sun_direction

#: Columns that are read, and the value from which on they are missing (EnergyPlus, Auxiliary Programs).
_COLUMNS = {
    "dry_bulb": (6, 99.9),
    "dew_point": (7, 99.9),
    "global_horizontal": (13, 9999.0),
    "direct_normal": (14, 9999.0),
    "diffuse_horizontal": (15, 9999.0),
    "global_illuminance": (16, 999900.0),
    "direct_illuminance": (17, 999900.0),
    "diffuse_illuminance": (18, 999900.0),
}
_TEMPERATURES = ("dry_bulb", "dew_point")
_HEADING = 8  #: lines
#: Sine of the altitude above which the sun comes within half an hour of the middle of an hour that it lights.
_LOWEST_SINE = float(np.sin(np.deg2rad(-7.6)))


@dataclass(frozen=True)
class Beam:
    """A vector towards the sun (x east, y north, z up), its irradiance normal to its rays (``direct``) and that of the
    sky on the horizontal (``diffuse``), in W/m^2."""

    sun: tuple[float, float, float]
    direct: float
    diffuse: float


@dataclass(frozen=True)
class Weather:
    """The hours of a year at a place, (n,) values each, n = 8760 or 8784.

    Irradiances are in W/m^2, illuminances in lux, temperatures in degrees C; values that the file lacks are NaN.
    """

    place: str
    latitude: float  #: degrees north
    longitude: float  #: degrees east
    time_zone: float  #: hours ahead of universal time
    elevation: float  #: metres above the sea
    times: NDArray[np.datetime64]  #: the middles of the hours, universal time
    dry_bulb: Array
    dew_point: Array
    global_horizontal: Array
    direct_normal: Array
    diffuse_horizontal: Array
    global_illuminance: Array
    direct_illuminance: Array
    diffuse_illuminance: Array

    def sun(self) -> Array:
        """Unit vectors (n, 3) towards the sun at the middles of the hours, x east, y north, z up."""
        return sun_direction(self.latitude, self.longitude, self.times)

    def beam(self, hour: int) -> Beam | None:
        """The sun and the irradiances of an hour, counted from 0; None if there is no light.

        In an hour of sunrise or sunset with the sun below the horizon at its middle, the sun is at the horizon. Raises
        :class:`LightingError` if an irradiance of the hour is missing, or not zero at night.
        """
        if not 0 <= hour < len(self.times):
            raise LightingError(f"{self.place} has weather of the hours 0 to {len(self.times) - 1}, not of hour {hour}")
        direct, diffuse = float(self.direct_normal[hour]), float(self.diffuse_horizontal[hour])
        when = f"hour {hour} of {self.place} ({self.local_time(hour)})"
        if np.isnan(direct) or np.isnan(diffuse):
            raise LightingError(f"{when} has no direct or diffuse irradiance; fill the gap in the EPW file")
        if direct + diffuse == 0.0:
            return None
        time = self.times[hour : hour + 1]
        x, y, z = sun_direction(self.latitude, self.longitude, time)[0].tolist()
        if z < _LOWEST_SINE:
            raise LightingError(
                f"{when} has {direct + diffuse:g} W/m^2 with the sun {-np.degrees(np.arcsin(z)):.0f} degrees below the "
                "horizon; correct longitude and time zone of the EPW file"
            )
        return Beam((x, y, max(z, 0.0)), direct, diffuse)

    def sky(self, hour: int, ground: float = GROUND) -> Sky | None:
        """The all-weather sky of an hour, counted from 0; None if the sky gives no light. Sun and errors are those of
        :meth:`beam`."""
        if (beam := self.beam(hour)) is None:
            return None
        dew_point = self.dew_point[hour]
        moist = {} if np.isnan(dew_point) else {"dew_point": float(dew_point)}
        day = float(day_of_year(self.times[hour : hour + 1])[0])
        return perez_sky(beam.sun, beam.direct, beam.diffuse, day=day, ground=ground, **moist)

    def check(self) -> None:
        """Raise the error of the first hour of which :meth:`sky` raises one: before a run that needs all skies."""
        light = self.direct_normal + self.diffuse_horizontal
        wrong = np.isnan(light) | ((light > 0.0) & (self.sun()[:, 2] < _LOWEST_SINE))
        if wrong.any():
            self.sky(int(np.argmax(wrong)))

    def local_time(self, hour: int) -> str:
        """The middle of an hour in local standard time, as "2023-06-21 11:30"."""
        shift = np.timedelta64(round(self.time_zone * 60.0), "m")
        return str((self.times[hour] + shift).astype("datetime64[m]")).replace("T", " ")


def read_epw(path: str | os.PathLike[str]) -> Weather:
    """The weather of an EPW file.

    Raises :class:`LightingError`, in one line with the number of the file's line, for a file that is not EPW, lacks
    columns or hours, or has values that are not numbers.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig", "replace")
    except OSError as error:
        raise LightingError(f"cannot read '{path}': {error.strerror}; give the path of an EPW file") from None
    lines = text.splitlines()
    head = [field.strip() for field in lines[0].split(",")] if lines else []
    if len(head) < 10 or head[0].upper() != "LOCATION":
        raise LightingError(f"'{path}' is not an EPW file: its first line is not LOCATION with ten fields; give one")
    place = ", ".join(field for field in head[1:4] if field and field != "-")
    latitude, longitude, zone, elevation = (
        _number(path, 1, what, value)
        for what, value in zip(("latitude", "longitude", "time zone", "elevation"), head[6:10], strict=True)
    )
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and abs(zone) <= 14.0):
        raise LightingError(f"line 1 of '{path}' has no place on Earth or no time zone; correct it")
    if (periods := next((line for line in lines[:_HEADING] if line.upper().startswith("DATA PERIODS")), None)) is None:
        raise LightingError(f"'{path}' has no line DATA PERIODS in its heading of eight lines; give a complete file")
    if periods.split(",")[1:3] and [p.strip() for p in periods.split(",")[1:3]] != ["1", "1"]:
        raise LightingError(f"'{path}' has not one period with one record an hour; give a file of hourly values")
    rows = [(n, line.split(",")) for n, line in enumerate(lines[_HEADING:], _HEADING + 1) if line.strip()]
    times = _times(path, rows) - np.timedelta64(round(zone * 60.0), "m")
    values = {name: _column(path, rows, name) for name in _COLUMNS}
    return Weather(place, latitude, longitude, zone, elevation, times, **values)


def _times(path: Path, rows: list[tuple[int, list[str]]]) -> NDArray[np.datetime64]:
    """The middles of the hours (n,), local standard time. The years of a typical year differ from month to month."""
    last = max(column for column, _ in _COLUMNS.values())
    found = np.zeros(len(rows), "datetime64[m]")
    previous, days = (0, 0), {(1, 1)}
    for k, (line, row) in enumerate(rows):
        if len(row) <= last:
            raise LightingError(f"line {line} of '{path}' has {len(row)} columns; an EPW file has at least {last + 1}")
        try:
            year, month, day, hour = (int(float(value)) for value in row[:4])
            date = np.datetime64(f"{year:04d}-{month:02d}-{day:02d}", "D")
        except ValueError:
            raise LightingError(f"line {line} of '{path}' has no date; correct it") from None
        wanted = k % 24 + 1
        follows = (month, day) in days if wanted == 1 else (month, day) == previous
        if hour != wanted or not follows:
            raise LightingError(
                f"line {line} of '{path}' is hour {hour} of {day}.{month}., which does not follow the line before; "
                "fill the gap, so that the file has every hour of a year"
            )
        previous = (month, day)
        days = _days_after(date)
        found[k] = date.astype("datetime64[m]") + np.timedelta64(60 * hour - 30, "m")
    if len(rows) not in (8760, 8784) or previous != (12, 31):
        raise LightingError(f"'{path}' has {len(rows)} hours; a year has 8760 or 8784, from 1 January to 31 December")
    return found


def _days_after(date: np.datetime64) -> set[tuple[int, int]]:
    """(month, day) that may follow a day: also 1 March on 28 February, as typical years have no leap day."""
    month, day = str(date + np.timedelta64(1, "D")).split("-")[1:]
    result = {(int(month), int(day))}
    return result | {(3, 1)} if result == {(2, 29)} else result


def _column(path: Path, rows: list[tuple[int, list[str]]], name: str) -> Array:
    column, missing = _COLUMNS[name]
    what = name.replace("_", " ")
    values = np.array([_number(path, line, what, row[column]) for line, row in rows])
    values[values >= missing] = np.nan
    if name not in _TEMPERATURES and (values < 0.0).any():
        line = rows[int(np.flatnonzero(values < 0.0)[0])][0]
        raise LightingError(f"line {line} of '{path}' has a negative {what}; correct it, or set it to {missing:g}")
    return values


def _number(path: Path, line: int, what: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise LightingError(f"line {line} of '{path}' has '{value.strip()}' as {what}; give a number")
    return number
