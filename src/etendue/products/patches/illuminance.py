"""Illuminance of a solution: in words, and as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from etendue.display import false_colour_picture
from etendue.lighting import photometric

if TYPE_CHECKING:
    from etendue.core import Result
    from etendue.radiosity import Solution


def illuminance_text(solution: Solution) -> str:
    """``illuminance 0 to 910 lx, mean 412``, the mean over the surface."""
    areas = solution.patches.areas
    values = solution.illuminance[areas > 0.0]
    mean = float(np.average(values, weights=areas[areas > 0.0]))
    return f"illuminance {values.min():.4g} to {values.max():.4g} lx, mean {mean:.4g}"


def illuminance_picture(made: Result, low: float | None = None, high: float | None = None) -> NDArray[np.uint8]:
    """A picture of irradiance as illuminance in false colours with isolines. ``low``, ``high``: the ends of the scale,
    see :func:`etendue.display.false_colour_picture`."""
    return false_colour_picture(photometric(made.image), "lx", low, high, lines=True)
