"""Patches of the sky: Tregenza's 145 and their subdivisions by Reinhart, in the order of Radiance.

Seven rows of equal height are subdivided m times in altitude and azimuth; the rest is a cap around the zenith. Patch 0
is the ground. Patches 1, 2, ... follow from the horizon up, in each row from north by east; the first patch of a row is
centred at north. With m = 1 (MF:1) there are 144 + 1 patches and the ground [Tregenza 1987], with m = 4 2305 and the
ground [Bourgeois 2008]. These are the rows of ``rfluxmtx`` and ``gendaymtx``.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array

from .errors import LightingError
from .skies import Sky

#: Patches in the seven rows of Tregenza.
_IN_ROW = (30, 30, 24, 24, 18, 12, 6)
#: Points along each axis of a patch for its mean luminance.
_POINTS = 4
#: Patches that share the sun, and the number that keeps their weights finite, as in ``gendaymtx``.
_NEAREST, _SOFTENING = 4, 1.002


class SkyPatches:
    """The ground and 144 m^2 + 1 patches of the sky. Raises :class:`LightingError` unless ``m`` is a whole number of at
    least 1.

    Attributes: ``count`` of patches with the ground; ``directions`` (count, 3), unit vectors to their centres, x east,
    y north, z up; ``solid_angles`` (count,) in steradians, 2 pi for the ground. Rows from the horizon up have the
    height ``row_height`` in radians, ``in_row`` patches each, and the ``first`` of these; the last row is the cap.
    """

    def __init__(self, m: int = 1) -> None:
        if isinstance(m, bool) or not isinstance(m, (int, np.integer)) or m < 1:
            raise LightingError(f"sky patches are subdivided 1, 2, ... times, not {m!r}; 1 gives those of Tregenza")
        self.m = int(m)
        in_row = np.repeat(_IN_ROW, self.m) * self.m
        #: Height of a row in radians; the cap has half of it as radius.
        self.row_height = 0.5 * np.pi / (len(in_row) + 0.5)
        self.in_row = np.append(in_row, 1)
        self.first = np.concatenate([[0], np.cumsum(self.in_row)[:-1]]) + 1
        self.count = 1 + int(self.in_row.sum())
        row = np.repeat(np.arange(len(self.in_row)), self.in_row)
        column = np.arange(1, self.count) - self.first[row]
        low, high = row * self.row_height, np.minimum((row + 1.0) * self.row_height, 0.5 * np.pi)
        width = 2.0 * np.pi / self.in_row[row]
        #: (count - 1, 2) limits of altitude, and middle and width of azimuth.
        self._altitude, self._azimuth = np.stack([low, high], -1), np.stack([column * width, width], -1)
        self.solid_angles: Array = np.append(2.0 * np.pi, width * (np.sin(high) - np.sin(low)))
        middle = np.where(row == len(in_row), 0.5 * np.pi, 0.5 * (low + high))
        self.directions: Array = np.concatenate([[[0.0, 0.0, -1.0]], _vectors(np.sin(middle), column * width)])

    def number_of(self, directions: ArrayLike) -> NDArray[np.int64]:
        """Numbers (k,) of the patches that contain directions (k, 3), of unit length; 0 below the horizon."""
        d = np.asarray(directions, np.float64)
        altitude = np.arcsin(np.clip(d[:, 2], -1.0, 1.0))
        row = np.clip((altitude / self.row_height).astype(np.int64), 0, len(self.in_row) - 1)
        turn = np.arctan2(d[:, 0], d[:, 1]) / (2.0 * np.pi) * self.in_row[row]
        column = np.floor(turn + 0.5).astype(np.int64) % self.in_row[row]
        return np.where(altitude > 0.0, self.first[row] + column, 0)

    def luminance(self, sky: Sky, sun: bool = True) -> Array:
        """Mean luminance (count,) of a sky in the patches, in cd/m^2, and of the ground.

        With ``sun``, its illuminance is added as luminance of the four patches whose centres are nearest to it, as
        ``gendaymtx`` does: normal to the sun's rays it is kept, on other planes the sun is at those centres.
        """
        directions, weights = self._points
        values = (sky.luminance(directions.reshape(-1, 3)).reshape(directions.shape[:2]) * weights).sum(axis=1)
        result: Array = np.append(sky.ground_luminance, values)
        if sun and sky.sun_illuminance > 0.0:
            near = self.directions @ np.asarray(sky.sun)
            nearest = 1 + np.argsort(-near[1:], kind="stable")[:_NEAREST]
            share = 1.0 / (_SOFTENING - near[nearest])
            result[nearest] += sky.sun_illuminance * share / (share.sum() * self.solid_angles[nearest])
        return result

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        """Directions (patches, points, 3) and weights of the points of a mean over each patch of the sky; uniform in
        azimuth and in the sine of the altitude."""
        x, weight = np.polynomial.legendre.leggauss(_POINTS)
        sines = np.sin(self._altitude)
        z = sines.mean(axis=1, keepdims=True) + 0.5 * (sines[:, 1:] - sines[:, :1]) * x
        azimuth = self._azimuth[:, :1] + 0.5 * self._azimuth[:, 1:] * x
        both = np.repeat(z, _POINTS, axis=1), np.tile(azimuth, (1, _POINTS))
        return _vectors(*both), np.outer(weight, weight).ravel() / 4.0


def _vectors(z: Array, azimuth: Array) -> Array:
    across = np.sqrt(np.maximum(1.0 - z**2, 0.0))
    result: Array = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), z], axis=-1)
    return result
