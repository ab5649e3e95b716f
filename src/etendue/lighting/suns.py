"""Lists of suns: directions with the irradiance of their beams, from a file, of times at a place, or of a year."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from etendue.core import Array

from .errors import LightingError
from .sun import Times, sun_direction
from .weather import Weather

#: Columns of a file: a vector, or two angles in degrees; and what may be beside them.
_VECTOR, _ANGLES, _MORE = ("x", "y", "z"), ("azimuth", "altitude"), ("direct_normal", "name")


@dataclass(frozen=True)
class Suns:
    """k suns.

    ``directions``: (k, 3) unit vectors towards them, x east, y north, z up. ``direct_normal``: (k,) irradiance normal
    to their rays, in W/m^2. ``names``: one for each, such as its time. Raises :class:`LightingError` for other arrays,
    values that are not finite or negative, and directions of length 0. Suns below the horizon light nothing.
    """

    directions: Array
    direct_normal: Array
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        ways = np.atleast_2d(np.asarray(self.directions, np.float64))
        if ways.ndim != 2 or ways.shape[1] != 3 or not len(ways) or not np.isfinite(ways).all():
            raise LightingError(f"suns are vectors of three finite numbers, (k, 3), not an array of shape {ways.shape}")
        length = np.linalg.norm(ways, axis=1, keepdims=True)
        if not length.all():
            raise LightingError(f"sun {int(np.argmin(length))} has a direction of length 0; give a vector towards it")
        try:
            beam = np.broadcast_to(np.asarray(self.direct_normal, np.float64), (len(ways),))
        except ValueError:
            raise LightingError(f"direct_normal is a number, or one for each of {len(ways)} suns") from None
        if not (np.isfinite(beam) & (beam >= 0)).all():
            raise LightingError(f"sun {int(np.argmin(beam >= 0))} has the irradiance {beam.min()}; give one from 0 on")
        names = self.names or tuple(map(str, range(len(ways))))
        if len(names) != len(ways):
            raise LightingError(f"there are {len(ways)} suns, but {len(names)} names")
        for name, value in (("directions", ways / length), ("direct_normal", beam), ("names", tuple(names))):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.directions)

    @classmethod
    def at(cls, latitude: float, longitude: float, times: Times, direct_normal: float = 1.0) -> Suns:
        """The sun at a place and times, see :func:`sun_direction`."""
        names = tuple(map(str, np.atleast_1d(np.asarray(times, object))))
        return cls(sun_direction(latitude, longitude, times), np.array(direct_normal), names)

    @classmethod
    def of_weather(cls, weather: Weather, hours: range | None = None) -> Suns:
        """The suns of all hours with direct light, or of those among ``hours``, counted from 0. Names are the middles
        of the hours, local standard time. Errors are those of :meth:`Weather.beam`, and
        :class:`LightingError` if there are none."""
        chosen = range(len(weather.times)) if hours is None else hours
        found = [(hour, beam) for hour in chosen if (beam := weather.beam(hour)) is not None and beam.direct > 0.0]
        if not found:
            raise LightingError(f"{weather.place} has no direct light of the sun in these hours; ask for others")
        names = tuple(weather.local_time(hour) for hour, _ in found)
        return cls(np.array([beam.sun for _, beam in found]), np.array([beam.direct for _, beam in found]), names)

    @classmethod
    def read(cls, path: Path) -> Suns:
        """Suns of a table (CSV): a first line of names, then a line for each. The columns are ``x,y,z``, a vector
        towards the sun (east, north, up), or ``azimuth,altitude`` in degrees (from north by east, above the horizon),
        and perhaps ``direct_normal`` in W/m^2 (1 without) and ``name``. Raises :class:`LightingError`."""
        try:
            with path.open(encoding="utf-8-sig", newline="") as file:
                rows = [row for row in csv.reader(file, skipinitialspace=True) if any(cell.strip() for cell in row)]
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "it is not text"
            raise LightingError(f"cannot read the suns in '{path}': {reason}") from error
        heads = [cell.strip().lower() for cell in rows[0]] if rows else []
        kind = next((columns for columns in (_VECTOR, _ANGLES) if set(columns) <= set(heads)), None)
        if kind is None or len(rows) < 2:
            raise LightingError(f"'{path}' has no suns; its first line is x,y,z or azimuth,altitude, then one for each")
        column = {name: heads.index(name) for name in (*kind, *_MORE) if name in heads}
        values, names = [], []
        for number, row in enumerate(rows[1:], 1):
            try:
                values.append([float(row[k]) for name, k in column.items() if name != "name"])
                names.append(row[column["name"]].strip() if "name" in column else str(number - 1))
            except (IndexError, ValueError):
                raise LightingError(
                    f"sun {number} of '{path}' is {','.join(row)[:40]!r}; it has a number for each of "
                    f"{', '.join(name for name in column if name != 'name')}"
                ) from None
        found = np.array(values)
        ways = found[:, : len(kind)]
        if kind == _ANGLES:
            azimuth, altitude = np.deg2rad(ways).T
            if (np.abs(ways[:, 1]) > 90).any():
                raise LightingError(f"'{path}' has an altitude beyond 90 degrees; correct it")
            across = np.cos(altitude)
            ways = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.sin(altitude)], axis=1)
        beam = found[:, len(kind)] if "direct_normal" in column else np.array(1.0)
        return cls(ways, beam, tuple(names))
