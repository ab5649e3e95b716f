"""Factors by which a tilted luminaire gives other light, since its lamp burns in another position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array

from .errors import LightingError
from .web import check_angles

#: Positions of the lamp in a luminaire that is aimed at the nadir: vertical; horizontal, across the plane C = 0, in
#: which the luminaire is tilted, so that the lamp turns about its axis; horizontal, in this plane.
_VERTICAL, _ACROSS, _ALONG = 1, 2, 3


@dataclass(frozen=True, eq=False)
class Tilt:
    """Factors of intensity by the tilt of a luminaire, of ``TILT=`` in IES LM-63.

    Parameters
    ----------
    geometry: position of the lamp in a luminaire aimed at the nadir: 1 vertical; 2 horizontal, along C = 90; 3
        horizontal, along C = 0.
    angles: (n,) degrees, ascending, from 0 to 180.
    factors: (n,), at least 0; linear between the angles.

    Raises :class:`LightingError` for other values.
    """

    geometry: float
    angles: Array
    factors: Array

    def __post_init__(self) -> None:
        for key in ("angles", "factors"):
            object.__setattr__(self, key, np.array(getattr(self, key), np.float64))
        if self.geometry not in (_VERTICAL, _ACROSS, _ALONG):
            raise LightingError(
                f"the lamp-to-luminaire geometry is {self.geometry:g}; it is 1 (vertical lamp), 2 or 3 (horizontal)"
            )
        check_angles("tilt angles", self.angles)
        if self.angles[0] < 0.0 or self.angles[-1] > 180.0:
            raise LightingError(
                f"tilt angles go from {self.angles[0]:g} to {self.angles[-1]:g} degrees; they are from 0 to 180"
            )
        if not (np.isfinite(self.factors).all() and (self.factors >= 0.0).all()):
            raise LightingError("a tilt factor is negative or not finite; correct it")

    def angle(self, up: ArrayLike) -> float:
        """The tilt in degrees, from 0 to 180, of a luminaire in whose own coordinates ``up`` (3,) is the vertical.

        Of a vertical lamp it is the angle between the luminaire's axis and the vertical. A horizontal lamp is tilted
        only by turns that take its own axis out of the horizontal, as in Radiance's ``ies2rad``.
        """
        x, y, z = (float(v) for v in np.asarray(up, np.float64))
        across = {_VERTICAL: np.hypot(x, y), _ACROSS: abs(y), _ALONG: abs(x)}[int(self.geometry)]
        return float(np.rad2deg(np.arctan2(across, z)))

    def factor(self, up: ArrayLike) -> float:
        """The factor of a luminaire in whose own coordinates ``up`` is the vertical. If the angles end at 90 degrees or
        before, base up and base down are alike. Raises :class:`LightingError` for a tilt without factors."""
        angle = self.angle(up)
        if self.angles[-1] <= 90.0:
            angle = min(angle, 180.0 - angle)
        low, high = self.angles[[0, -1]]
        if not low - 1e-3 <= angle <= high + 1e-3:
            raise LightingError(
                f"the luminaire is tilted by {angle:.4g} degrees, and its file has factors from {low:g} to {high:g} "
                "degrees; turn it back, or take another file"
            )
        return float(np.interp(angle, self.angles, self.factors))
