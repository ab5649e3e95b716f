"""Skies: the CIE general skies and the all-weather sky of Perez, as luminance over directions.

Both are a gradation from the zenith to the horizon times an indicatrix of scattered sunlight [CIE-S011, eqs. 2 to 4;
Perez 1993, eq. 1]:

    L(w) = s phi(Z) f(chi),    phi = 1 + a exp(b / cos Z) + t cos Z,    f = 1 + c (exp(d chi) - h) + e cos^2 chi

Z: angle to the zenith; chi: angle to the sun; h = exp(d pi / 2) for CIE, 0 for Perez; t = 2 with a = 0 for the
traditional overcast sky, else 0. Directions are (x east, y north, z up).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array

from .errors import LightingError

#: Angular diameter of the sun, in degrees.
SUN_DIAMETER = 0.533
#: Reflectance of the ground below a sky unless another is given.
GROUND = 0.2

#: Parameters (a, b) of six gradations and (c, d, e) of six indicatrices, and their numbers for the types 1 to 15
#: [CIE 2003, table 1].
_GRADATIONS = ((4.0, -0.7), (1.1, -0.8), (0.0, -1.0), (-1.0, -0.55), (-1.0, -0.32), (-1.0, -0.15))
_INDICATRICES = (
    (0.0, -1.0, 0.0),
    (2.0, -1.5, 0.15),
    (5.0, -2.5, 0.3),
    (10.0, -3.0, 0.45),
    (16.0, -3.0, 0.3),
    (24.0, -2.8, 0.15),
)
_TYPES = ("11", "12", "21", "22", "31", "32", "33", "34", "42", "43", "44", "54", "55", "65", "66")
#: The traditional overcast sky, (1 + 2 cos Z) / 3.
_TRADITIONAL = 16
#: Smallest cosine in the gradation, where exp(b / cos) is zero for b < 0; and for b > 0, which occurs in clear skies of
#: Perez with a low sun and has no limit at the horizon: that of 6 degrees, the lowest row of the measured skies.
_LEAST_COSINE, _LEAST_FITTED = 0.01, float(np.sin(np.deg2rad(6.0)))
#: Gauss points of the normalisation: angles to the zenith, in each part, and azimuths from the sun.
_ANGLES, _AZIMUTHS = 24, 32


@dataclass(frozen=True)
class Sky:
    """The luminance of a sky and of the ground below it, and the sun.

    ``gradation`` are (a, b, t), ``indicatrix`` (c, d, e, h) and ``scale`` s of the equations above, in cd/m^2.
    ``sun`` points towards the sun (of unit length), ``sun_illuminance`` is that normal to its rays, in lux. ``ground``:
    reflectance of the ground, which is uniform. Made by :func:`cie_sky` and :func:`perez_sky`.
    """

    gradation: tuple[float, float, float]
    indicatrix: tuple[float, float, float, float]
    scale: float
    sun: tuple[float, float, float]
    sun_illuminance: float = 0.0
    ground: float = GROUND

    def luminance(self, directions: ArrayLike) -> Array:
        """Luminance (k,) in cd/m^2 from unit vectors (k, 3), without the sun's disc: that of the sky above the horizon,
        of the ground below."""
        directions = np.asarray(directions, np.float64)
        above = directions[:, 2] > 0.0
        sky = self.scale * self._relative(directions[:, 2], directions @ np.asarray(self.sun))
        result: Array = np.where(above, sky, self.ground_luminance)
        return result

    @cached_property
    def diffuse_illuminance(self) -> float:
        """Horizontal illuminance of the sky without the sun, in lux."""
        return self.scale * self._relative_illuminance

    @property
    def illuminance(self) -> float:
        """Horizontal illuminance of sky and sun, in lux."""
        return self.diffuse_illuminance + self.sun_illuminance * max(self.sun[2], 0.0)

    @property
    def zenith_luminance(self) -> float:
        """Luminance of the zenith, in cd/m^2."""
        return float(self.luminance([[0.0, 0.0, 1.0]])[0])

    @property
    def sun_luminance(self) -> float:
        """Luminance of the sun's disc, which is uniform, in cd/m^2."""
        return float(self.sun_illuminance / (np.pi * np.sin(np.deg2rad(0.5 * SUN_DIAMETER)) ** 2))

    @property
    def ground_luminance(self) -> float:
        """Luminance of the ground, lit by sky and sun, in cd/m^2."""
        return self.ground * self.illuminance / np.pi

    @property
    def least_cosine(self) -> float:
        """Cosine of Z below which the gradation is constant."""
        return _LEAST_FITTED if self.gradation[1] > 0.0 else _LEAST_COSINE

    def _relative(self, cos_zenith: Array, cos_sun: Array) -> Array:
        a, b, t = self.gradation
        c, d, e, h = self.indicatrix
        cos_zenith, cos_sun = np.maximum(cos_zenith, self.least_cosine), np.clip(cos_sun, -1.0, 1.0)
        phi = 1.0 + a * np.exp(b / cos_zenith) + t * cos_zenith
        f = 1.0 + c * (np.exp(d * np.arccos(cos_sun)) - h) + e * cos_sun**2
        # Some of Perez's skies are negative far from the sun.
        result: Array = np.maximum(phi * f, 0.0)
        return result

    @cached_property
    def _relative_illuminance(self) -> float:
        """Integral of phi f cos Z over the hemisphere. The indicatrix has a kink at the sun: it is at a corner of parts
        of the domain, where Gauss's rule converges fast."""
        azimuth, width = _gauss(_AZIMUTHS, 0.0, np.pi)
        inner = (np.arccos(np.clip(self.sun[2], 0.0, 1.0)), np.arccos(self.least_cosine))
        edges = np.unique([0.0, *inner, 0.5 * np.pi])
        total = 0.0
        for low, high in pairwise(edges.tolist()):
            angle, height = _gauss(_ANGLES, low, high)
            cos, sin = np.cos(angle), np.sin(angle)
            sines = sin[:, None] * np.sqrt(max(1.0 - self.sun[2] ** 2, 0.0))
            cos_sun = cos[:, None] * self.sun[2] + sines * np.cos(azimuth)
            values = self._relative(cos[:, None], cos_sun) * (sin * cos * height)[:, None] * width
            total += 2.0 * float(values.sum())
        return total


def cie_sky(
    kind: int,
    sun: ArrayLike | None = None,
    *,
    zenith_luminance: float | None = None,
    diffuse_illuminance: float | None = None,
    sun_illuminance: float = 0.0,
    ground: float = GROUND,
) -> Sky:
    """A CIE general sky of type 1 (overcast) to 15 (clear, white and turbid) [CIE 2003], or 16, the traditional
    overcast sky of luminance (1 + 2 cos Z) / 3.

    ``sun``: vector towards the sun (x east, y north, z up); the types 1, 3, 5 and 16 need none. One of
    ``zenith_luminance`` in cd/m^2 and ``diffuse_illuminance`` on the horizontal, in lux, is given. Raises
    :class:`LightingError` for values that are out of range.
    """
    if isinstance(kind, bool) or kind not in range(1, _TRADITIONAL + 1):
        raise LightingError(f"there is no CIE sky of type {kind!r}; choose 1 to 15, or 16 (traditional overcast)")
    if kind == _TRADITIONAL:
        gradation, (c, d, e) = (0.0, -1.0, 2.0), _INDICATRICES[0]
    else:
        first, second = (int(digit) - 1 for digit in _TYPES[kind - 1])
        gradation, (c, d, e) = (*_GRADATIONS[first], 0.0), _INDICATRICES[second]
    if sun is None and (c != 0.0 or sun_illuminance > 0.0):
        raise LightingError(f"a CIE sky of type {kind} needs the direction of the sun; give it")
    towards = (0.0, 0.0, 1.0) if sun is None else _checked_sun(sun, must_be_up=c != 0.0 or sun_illuminance > 0.0)
    if (zenith_luminance is None) == (diffuse_illuminance is None):
        raise LightingError("a CIE sky has either a zenith luminance or a diffuse illuminance; give one of them")
    wanted = _positive("zenith luminance", zenith_luminance) if diffuse_illuminance is None else 0.0
    lux = _positive("diffuse illuminance", diffuse_illuminance) if zenith_luminance is None else 0.0
    direct = _positive("illuminance of the sun", sun_illuminance)
    indicatrix = (c, d, e, float(np.exp(0.5 * np.pi * d)))
    unit = Sky(gradation, indicatrix, 1.0, towards)
    scale = lux / unit._relative_illuminance if zenith_luminance is None else wanted / unit.zenith_luminance
    return Sky(gradation, indicatrix, scale, towards, direct, _checked_ground(ground))


_legendre = cache(np.polynomial.legendre.leggauss)


def _gauss(count: int, low: float, high: float) -> tuple[Array, Array]:
    """Points and weights of Gauss's rule on an interval."""
    x, weight = _legendre(count)
    return low + 0.5 * (high - low) * (x + 1.0), 0.5 * (high - low) * weight


def _positive(what: str, value: float | None) -> float:
    if value is None or not np.isfinite(value) or value < 0.0:
        raise LightingError(f"the {what} of a sky is {value}; give a number of at least 0")
    return float(value)


def _checked_ground(value: float) -> float:
    if not 0.0 <= value <= 1.0:
        raise LightingError(f"the reflectance of the ground is {value}; give a number from 0 to 1")
    return float(value)


def _checked_sun(sun: ArrayLike, must_be_up: bool = True) -> tuple[float, float, float]:
    """A vector towards the sun, of unit length."""
    vector = np.asarray(sun, np.float64)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else 0.0
    if not 0.0 < length < np.inf:
        raise LightingError(f"the direction of the sun is {sun!r}; give a vector of three numbers (east, north, up)")
    x, y, z = (vector / length).tolist()
    if must_be_up and z < 0.0:
        raise LightingError(
            f"the sun is {np.degrees(-np.arcsin(z)):.1f} degrees below the horizon, where this sky has no meaning; "
            "give a time of day, or a sky of type 1, 3, 5 or 16 without sun"
        )
    return x, y, z


# ----------------------------------------------------------------------------------------------------------- Perez

#: Upper limits of seven of the eight bins of clearness [Perez 1990, table 1].
_CLEARNESS = (1.065, 1.23, 1.5, 1.95, 2.8, 4.5, 6.2)
#: Coefficients of a, b, c, d, e, four each, by clearness [Perez 1993, table 1, with the erratum].
_COEFFICIENTS = (
    "1.3525 -.2576 -.2690 -1.4366  -.7670 .0007 1.2734 -.1233  2.8 .6004 1.2375 1  1.8734 .6297 .9738 .2809  "
    ".0356 -.1246 -.5718 .9938",
    "-1.2219 -.7730 1.4148 1.1016  -.2054 .0367 -3.9128 .9156  6.975 .1774 6.4477 -.1239  -1.5798 -.5081 -1.7812 .1080"
    "  .2624 .0672 -.2190 -.4285",
    "-1.1 -.2515 .8952 .0156  .2782 -.1812 -4.5 1.1766  24.7219 -13.0812 -37.7 34.8438  -5 1.5218 3.9229 -2.6204  "
    "-.0156 .1597 .4199 -.5562",
    "-.5484 -.6654 -.2672 .7117  .7234 -.6219 -5.6812 2.6297  33.3389 -18.3 -62.25 52.0781  -3.5 .0016 1.1477 .1062  "
    ".4659 -.3296 -.0876 -.0329",
    "-.6 -.3566 -2.5 2.325  .2937 .0496 -5.6812 1.8415  21 -4.7656 -21.5906 7.2492  -3.5 -.1554 1.4062 .3988  "
    ".0032 .0766 -.0656 -.1294",
    "-1.0156 -.3670 1.0078 1.4051  .2875 -.5328 -3.85 3.375  14 -.9999 -7.1406 7.5469  -3.4 -.1078 -1.075 1.5702  "
    "-.0672 .4016 .3017 -.4844",
    "-1 .0211 .5025 -.5119  -.3 .1922 .7023 -1.6317  19 -5 1.2438 -1.9094  -4 .025 .3844 .2656  "
    "1.0468 -.3788 -2.4517 1.4656",
    "-1.05 .0289 .4260 .3590  -.3250 .1156 .7781 .0025  31.0625 -14.5 -46.1148 55.3750  -7.2312 .4050 13.35 .6234  "
    "1.5 -.6426 1.8564 .5636",
)
#: Luminous efficacy of diffuse and of direct light [Perez 1990, table 4, eqs. 7 and 8].
_DIFFUSE = (
    (97.24, -0.46, 12.0, -8.91),
    (107.22, 1.15, 0.59, -3.95),
    (104.97, 2.96, -5.53, -8.77),
    (102.39, 5.59, -13.95, -13.9),
    (100.71, 5.94, -22.75, -23.74),
    (106.42, 3.83, -36.15, -28.83),
    (141.88, 1.9, -53.24, -14.03),
    (152.23, 0.35, -45.27, -7.98),
)
_DIRECT = (
    (57.2, -4.55, -2.98, 117.12),
    (98.99, -3.46, -1.21, 12.38),
    (109.83, -4.9, -1.71, -8.81),
    (110.34, -5.84, -1.99, -4.56),
    (106.36, -3.97, -1.75, -6.16),
    (107.19, -1.25, -1.51, -26.73),
    (105.75, 0.77, -1.26, -34.44),
    (101.18, 1.58, -1.1, -8.29),
)
_SOLAR_CONSTANT = 1367.0  #: W/m^2
#: Ranges of clearness and brightness outside which the tables are not used, as in Radiance's programs.
_CLEAR, _BRIGHT = (1.0, 11.9), (0.01, 0.6)
_UNIFORM = (0.0, -1.0, 0.0), (0.0, -1.0, 0.0, 0.0)


def perez_sky(
    sun: ArrayLike,
    direct_normal: float,
    diffuse_horizontal: float,
    *,
    day: float | None = None,
    dew_point: float = 11.0,
    ground: float = GROUND,
) -> Sky:
    """The all-weather sky of Perez et al. [Perez 1993] of two irradiances in W/m^2.

    ``sun``: vector towards the sun (x east, y north, z up). ``direct_normal``: irradiance of the sun normal to its
    rays; ``diffuse_horizontal``: irradiance of the sky on the horizontal. ``day`` of the year, from 1, for the distance
    of the sun; without, the mean distance. ``dew_point`` in degrees C, for the luminous efficacies [Perez 1990].
    The sky is normalised to the diffuse illuminance; clearness and brightness are limited, and a sky that would be
    negative everywhere is uniform, as in Radiance's ``gendaymtx``. Raises :class:`LightingError` for
    values that are out of range.
    """
    towards = _checked_sun(sun)
    direct, diffuse = _positive("direct irradiance", direct_normal), _positive("diffuse irradiance", diffuse_horizontal)
    if diffuse + direct == 0.0:
        raise LightingError("a Perez sky has neither direct nor diffuse irradiance; give one above 0")
    if not -90.0 < dew_point < 90.0:
        raise LightingError(f"the dew point is {dew_point} degrees C; give a number from -90 to 90")
    z = float(np.arccos(min(towards[2], 1.0)))
    cubed = 1.041 * z**3
    ratio = (diffuse + direct) / diffuse if diffuse > 0.0 else np.inf
    clearness = float(np.clip((ratio + cubed) / (1.0 + cubed), *_CLEAR))  # [Perez 1990, eq. 1]
    air_mass = 1.0 / (np.cos(z) + 0.15 * (93.885 - np.degrees(z)) ** -1.253)  # [Kasten 1966]
    extraterrestrial = _SOLAR_CONSTANT * (1.0 if day is None else _eccentricity(day))
    brightness = float(np.clip(diffuse * air_mass / extraterrestrial, *_BRIGHT))  # [Perez 1990, eq. 2]
    row = int(np.searchsorted(_CLEARNESS, clearness, side="right"))

    water = np.exp(0.07 * dew_point - 0.075)  # [Perez 1990, eq. 3]
    a, b, c, d = _DIFFUSE[row]
    lux = diffuse * (a + b * water + c * np.cos(z) + d * np.log(brightness))  # [Perez 1990, eq. 7]
    a, b, c, d = _DIRECT[row]
    efficacy = max(a + b * water + c * np.exp(5.73 * z - 5.0) + d * brightness, 0.0)  # [Perez 1990, eq. 8]
    gradation, indicatrix = _distribution(row, z, brightness)
    unit = Sky(gradation, indicatrix, 1.0, towards)
    if unit._relative_illuminance <= 0.0:  # nowhere positive, in weather that was not measured
        gradation, indicatrix = _UNIFORM
        unit = Sky(gradation, indicatrix, 1.0, towards)
    scale = float(lux) / unit._relative_illuminance
    return Sky(gradation, indicatrix, scale, towards, float(direct * efficacy), _checked_ground(ground))


def _distribution(
    row: int, z: float, brightness: float
) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Gradation and indicatrix by bin of clearness, the sun's zenith angle, brightness [Perez 1993, eqs. 6 to 8]."""
    if 0 < row < 5:  # clearness from 1.065 to 2.8
        brightness = max(brightness, 0.2)
    x: list[list[float]] = np.array(_COEFFICIENTS[row].split(), np.float64).reshape(5, 4).tolist()
    a, b, c, d, e = (k[0] + k[1] * z + brightness * (k[2] + k[3] * z) for k in x)
    if row == 0:
        c = float(np.exp((brightness * (x[2][0] + x[2][1] * z)) ** x[2][2]) - x[2][3])
        d = float(-np.exp(brightness * (x[3][0] + x[3][1] * z)) + x[3][2] + brightness * x[3][3])
    return (a, b, 0.0), (c, d, e, 0.0)


def _eccentricity(day: float) -> float:
    """Squared ratio of mean and actual distance of the sun [Spencer 1971]."""
    angle = 2.0 * np.pi * (day - 1.0) / 365.0
    return float(
        1.00011
        + 0.034221 * np.cos(angle)
        + 0.00128 * np.sin(angle)
        + 0.000719 * np.cos(2.0 * angle)
        + 0.000077 * np.sin(2.0 * angle)
    )
