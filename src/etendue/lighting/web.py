"""Photometric webs: the luminous intensity of a luminaire over the sphere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array

from .errors import LightingError

if TYPE_CHECKING:
    from .tilt import Tilt

#: Degrees by which angles of files are rounded.
_ROUNDING = 1e-3


@dataclass(frozen=True, eq=False)
class PhotometricWeb:
    """The luminous intensity of a luminaire, of type C: half-planes C through the luminaire's axis, and in each the
    angle gamma to the axis. Between the planes and angles it is interpolated bilinearly.

    In the luminaire's own coordinates, the direction (C, gamma) is

        (sin gamma cos C, sin gamma sin C, -cos gamma):

    gamma = 0 is the nadir, -z; C = 0 is the half-plane of +x, C = 90 that of +y, counterclockwise seen from above.

    Parameters
    ----------
    c: (planes,) degrees, ascending from 0 to 360.
    gamma: (angles,) degrees, ascending, at least two from 0 or 90 to 90 or 180; or to where the intensity is 0. Beyond
        them there is no light.
    candela: (planes, angles) intensities in cd.
    lamp_flux: of the bare lamps, in lm; None for absolute photometry.
    power: electrical, in W; None if it is not known.
    opening: extent of the luminous opening along x (C = 0), y (C = 90) and z, in m; 0: not known, or none.
    is_round: whether the opening is a disc or a cylinder around the axis.
    name: of the luminaire.
    tilt: factors of the intensities, which are those of a luminaire aimed at the nadir, if it is tilted; None: 1.

    Raises :class:`LightingError` for angles or intensities that are not as described, and if all intensities are 0.
    """

    c: Array
    gamma: Array
    candela: Array
    lamp_flux: float | None = None
    power: float | None = None
    opening: tuple[float, float, float] = (0.0, 0.0, 0.0)
    is_round: bool = False
    name: str = ""
    tilt: Tilt | None = None

    def __post_init__(self) -> None:
        for key in ("c", "gamma", "candela"):
            object.__setattr__(self, key, np.array(getattr(self, key), np.float64))
        check_angles("C angles", self.c)
        check_angles("gamma angles", self.gamma)
        if self.candela.shape != (shape := (len(self.c), len(self.gamma))):
            raise LightingError(f"intensities are an array of {shape} planes and angles, not {self.candela.shape}")
        if len(self.c) < 2 or self.c[0] != 0.0 or self.c[-1] != 360.0:
            raise LightingError("C angles go from 0 to 360; give the planes of all directions")
        if not np.isfinite(self.candela).all() or (self.candela < 0.0).any():
            bad = self.candela[~(np.isfinite(self.candela) & (self.candela >= 0.0))][0]
            raise LightingError(f"an intensity is {bad:g}; intensities are finite and not negative, so correct it")
        if not self.candela.any():
            raise LightingError("all intensities are 0, so the luminaire gives no light; take another file")
        if len(self.gamma) < 2 or self.gamma[0] < 0.0 or self.gamma[-1] > 180.0:
            raise LightingError("gamma angles are at least two, between 0 and 180 degrees")
        for end, whole in ((0, (0.0, 90.0)), (-1, (90.0, 180.0))):
            if self.gamma[end] not in whole and self.candela[:, end].any():
                raise LightingError(
                    f"intensities {'above' if end else 'below'} gamma = {self.gamma[end]:g} degrees are missing, and "
                    f"those there are not 0; give the angles to {whole[0]:g} or {whole[1]:g} degrees"
                )

    @cached_property
    def zonal_flux(self) -> Array:
        """(angles - 1,) luminous flux between every two angles gamma, in lm: the exact integral of the interpolated
        intensity."""
        gamma = np.deg2rad(self.gamma)
        low, high, step = gamma[:-1], gamma[1:], np.diff(gamma)
        mean = np.diff(np.sin(gamma)) / step
        ring = 0.5 * np.deg2rad(np.diff(self.c)) @ (self.candela[:-1] + self.candela[1:])
        result: Array = ring[:-1] * (np.cos(low) - mean) + ring[1:] * (mean - np.cos(high))
        return result

    @property
    def flux(self) -> float:
        """Luminous flux in lm: the integral of the interpolated intensity over the sphere."""
        return float(self.zonal_flux.sum())

    def intensity(self, directions: ArrayLike) -> Array:
        """Intensities in cd towards directions (..., 3) of any length, in the luminaire's own coordinates."""
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        gamma = np.rad2deg(np.arctan2(np.hypot(x, y), -z))
        i, s = _place(self.c, np.rad2deg(np.arctan2(y, x)) % 360.0)
        j, t = _place(self.gamma, gamma)
        low, high = ((1.0 - s) * self.candela[i, j + k] + s * self.candela[i + 1, j + k] for k in (0, 1))
        inside = (gamma >= self.gamma[0]) & (gamma <= self.gamma[-1])
        result: Array = np.where(inside, (1.0 - t) * low + t * high, 0.0)
        return result

    def subdivided(self, step: float) -> PhotometricWeb:
        """The same web with more angles gamma, no two of them farther apart than ``step`` degrees."""
        parts = np.ceil(np.diff(self.gamma) / step).astype(int)
        pieces = [
            np.linspace(low, high, n + 1)[:-1] for low, high, n in zip(self.gamma, self.gamma[1:], parts, strict=False)
        ]
        gamma = np.concatenate([*pieces, self.gamma[-1:]])
        return replace(self, gamma=gamma, candela=np.stack([np.interp(gamma, self.gamma, row) for row in self.candela]))


def whole_circle(c: ArrayLike, candela: ArrayLike) -> tuple[Array, Array]:
    """Planes and intensities of all directions, from those of a part whose symmetry its planes tell: one plane, of a
    luminaire with rotational symmetry; 0 to 90 degrees (symmetric to the planes 0-180 and 90-270); 0 to 180 (to
    0-180); -90 to 90 or 90 to 270 (to 90-270); or 0 to 360.

    Parameters
    ----------
    c: (planes,) degrees, ascending.
    candela: (planes, angles).

    Raises :class:`LightingError` for other planes.
    """
    angles, values = np.array(c, np.float64), np.array(candela, np.float64)
    check_angles("C angles", angles)
    if len(angles) == 1:
        return np.array([0.0, 360.0]), np.repeat(values, 2, axis=0)
    first, last = np.round(angles[[0, -1]] / _ROUNDING) * _ROUNDING
    angles[0], angles[-1] = first, last
    if (first, last) == (90.0, 270.0):
        angles, values = (180.0 - angles)[::-1], values[::-1]
        first, last = -90.0, 90.0
    if (first, last) == (-90.0, 90.0):
        angles, values = _mirrored(angles, values)  # to 270
        angles, values = np.append(angles, angles[1:] + 360.0), np.concatenate([values, values[1:]])
        return _between(angles, values)
    if (first, last) == (0.0, 90.0):
        angles, values = _mirrored(angles, values)
        last = 180.0
    if (first, last) == (0.0, 180.0):
        angles, values = _mirrored(angles, values)
        last = 360.0
    if (first, last) != (0.0, 360.0):
        raise LightingError(
            f"C angles go from {first:g} to {last:g} degrees, which is no symmetry; they go from 0 to 90, 180 or 360, "
            "or from 90 to 270"
        )
    return angles, values


def check_angles(what: str, angles: Array) -> None:
    """Raise :class:`LightingError` unless angles, in degrees, are a finite, ascending sequence."""
    if not len(angles):
        raise LightingError(f"there are no {what}; give at least one")
    if not np.isfinite(angles).all():
        raise LightingError(f"the {what} contain {angles[~np.isfinite(angles)][0]}; they are finite numbers of degrees")
    if (falls := np.diff(angles) <= 0.0).any():
        k = int(np.argmax(falls))
        raise LightingError(
            f"the {what} do not ascend: {angles[k + 1]:g} comes after {angles[k]:g}; correct their order"
        )


def _mirrored(angles: Array, values: Array) -> tuple[Array, Array]:
    """Planes followed by their reflections in the last one."""
    return np.append(angles, 2.0 * angles[-1] - angles[-2::-1]), np.concatenate([values, values[-2::-1]])


def _between(angles: Array, values: Array) -> tuple[Array, Array]:
    """The planes from 0 to 360 of planes from -90 to 630, of which 0 need not be one."""
    at = np.unique(np.concatenate([[0.0, 360.0], angles[(angles > 0.0) & (angles < 360.0)]]))
    return at, np.stack([np.interp(at, angles, column) for column in values.T], axis=1)


def _place(table: Array, values: Array) -> tuple[NDArray[np.intp], Array]:
    """The interval of an ascending ``table`` that each value is in, and how far, from 0 to 1."""
    index = np.clip(np.searchsorted(table, values, side="right") - 1, 0, len(table) - 2)
    return index, np.clip((values - table[index]) / (table[index + 1] - table[index]), 0.0, 1.0)
