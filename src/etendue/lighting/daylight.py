"""Daylight coefficients: what each patch of the sky contributes at each meter, and what follows for a year."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, short_repr
from etendue.film import LUMINANCE

from .errors import LightingError
from .meters import Meters
from .patches import SkyPatches
from .skies import GROUND
from .weather import Weather

#: Hours of the day in which LM-83 counts daylight, local standard time.
_OCCUPIED = 8, 18
#: EN 17037: levels of illuminance (target of half the plane, minimum of 95 % of it), in lux, and their names.
_LEVELS = (("minimum", 300.0, 100.0), ("medium", 500.0, 300.0), ("high", 750.0, 500.0))
_TARGET_SHARE, _MINIMUM_SHARE = 0.5, 0.95


@short_repr
@dataclass(frozen=True)
class DaylightCoefficients:
    """Irradiance (or radiance) at meters by the radiance of sky patches: E = C L.

    Attributes
    ----------
    meters: n meters.
    patches: p patches of the sky, the ground first.
    values, errors: (n, p, 3), in steradians for irradiance, by channel of linear RGB, and their standard errors.
    metadata: scene, seed, paths, seconds and more.
    """

    meters: Meters
    patches: SkyPatches
    values: Array
    errors: Array
    metadata: dict[str, Any] = field(default_factory=dict)

    @cached_property
    def luminous(self) -> Array:
        """(n, p) illuminance by luminance of white light."""
        result: Array = self.values @ np.array(LUMINANCE)
        return result

    def illuminance(self, luminances: ArrayLike) -> Array:
        """(n, ...) lux at the meters (cd/m^2 for meters of radiance) under skies whose patches have white luminances
        (p, ...). Raises :class:`LightingError` for another number of patches."""
        sky = np.asarray(luminances, np.float64)
        if sky.shape[:1] != (self.patches.count,):
            raise LightingError(f"there are coefficients of {self.patches.count} patches, not {sky.shape[:1]}")
        return np.tensordot(self.luminous, sky, 1)

    def annual(self, weather: Weather, ground: float = GROUND) -> AnnualDaylight:
        """The illuminance of every hour of a year, by Perez's skies; the sun is in the four patches nearest to it.

        ``ground``: reflectance of what patch 0 shows. Raises :class:`LightingError` for hours without irradiance.
        """
        hours = len(weather.times)
        sky = np.zeros((self.patches.count, hours))
        for hour in range(hours):
            if (found := weather.sky(hour, ground)) is not None:
                sky[:, hour] = self.patches.luminance(found)
        return AnnualDaylight(self.meters, weather, self.illuminance(sky))

    def write_matrix(self, path: Path) -> None:
        """Write a matrix that Radiance's ``dctimestep`` reads: a row for each meter, a column for each patch, three
        components, as text."""
        n, p, components = self.values.shape
        head = f"#?RADIANCE\nNCOMP={components}\nNROWS={n}\nNCOLS={p}\nFORMAT=ascii\n\n"
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(head)
            np.savetxt(file, self.values.reshape(n, -1), fmt="%.7g", delimiter=" ")


@short_repr
@dataclass(frozen=True)
class AnnualDaylight:
    """Illuminance at n meters in the hours of a year, (n, hours) lux."""

    meters: Meters
    weather: Weather
    illuminance: Array

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """(hours,) those from 8 to 18 o'clock, local standard time."""
        shift = np.timedelta64(round(self.weather.time_zone * 60.0), "m")
        local = self.weather.times + shift
        hour = (local - local.astype("datetime64[D]")) / np.timedelta64(1, "h")
        result: NDArray[np.bool_] = (hour > _OCCUPIED[0]) & (hour < _OCCUPIED[1])
        return result

    @cached_property
    def daylit(self) -> NDArray[np.bool_]:
        """(hours,) those with the sun above the horizon at their middle."""
        result: NDArray[np.bool_] = self.weather.sun()[:, 2] > 0.0
        return result

    def autonomy(self, lux: float = 300.0) -> Array:
        """(n,) share of the occupied hours with at least so many lux."""
        return np.mean(self.illuminance[:, self.occupied] >= lux, axis=1)

    def spatial_autonomy(self, lux: float = 300.0, hours: float = 0.5) -> float:
        """sDA: share of the meters with so many lux for a share of the ``hours`` [IES 2012]. sDA 300/50 by default;
        blinds are not closed."""
        return float(np.mean(self.autonomy(lux) >= hours))

    def useful(self, low: float = 100.0, high: float = 3000.0) -> Array:
        """(n,) useful daylight illuminance: share of the occupied hours within limits [Nabil 2005]."""
        found = self.illuminance[:, self.occupied]
        return np.mean((found >= low) & (found <= high), axis=1)

    def en17037(self) -> str:
        """The level of EN 17037 [CEN 2018] for openings in walls: ``high``, ``medium``, ``minimum`` or ``none``.

        In half of the hours with the sun above the horizon, at least the target illuminance on half of the meters and
        at least the minimum on 95 % of them: 300 and 100 lx for ``minimum``, 500 and 300, 750 and 500. Meters should be
        a grid at 0.85 m, half a metre away from walls.
        """
        middle = np.median(self.illuminance[:, self.daylit], axis=1)
        level = "none"
        for name, target, least in _LEVELS:
            if np.mean(middle >= target) >= _TARGET_SHARE and np.mean(middle >= least) >= _MINIMUM_SHARE:
                level = name
        return level

    def table(self) -> tuple[Sequence[str], Array]:
        """Names of columns, and a row for each meter: point, direction, median of the daylit hours, autonomy at 300
        lx, and useful daylight."""
        middle = np.median(self.illuminance[:, self.daylit], axis=1)
        heads = ("x", "y", "z", "nx", "ny", "nz", "median [lx]", "autonomy_300", "useful_100_3000")
        columns = (self.meters.points, self.meters.directions, middle, self.autonomy(), self.useful())
        return heads, np.column_stack(columns)
