"""East, north and up in the coordinates of a scene."""

from __future__ import annotations

import numpy as np

from etendue.core import Array

from .errors import LightingError


def compass(up: str = "z", north: float = 0.0) -> Array:
    """(3, 3), rows east, north and up in the coordinates of a scene: ``directions @ compass(...).T`` are those of skies
    and suns.

    ``up``: the axis that is up, ``y`` or ``z``. ``north``: its direction in degrees from the axis +y (up: z) or -z (up:
    y), clockwise seen from above. Raises :class:`LightingError` for another axis, and a direction that is not finite.
    """
    if up not in ("y", "z") or not np.isfinite(north):
        raise LightingError(f"the axis up is y or z and north a number of degrees, not {up!r} and {north!r}")
    turn = np.deg2rad(north)
    east = np.array([np.cos(turn), -np.sin(turn), 0.0])
    to_north = np.array([np.sin(turn), np.cos(turn), 0.0])
    rows: Array = np.stack([east, to_north, [0.0, 0.0, 1.0]])
    # With y up, east is x, and what is north of a plan is -z.
    return rows if up == "z" else np.stack([rows[:, 0], rows[:, 2], -rows[:, 1]], axis=1)
