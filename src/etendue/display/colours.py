"""False colours for scalar images."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Nine equidistant colours of the perceptually uniform map "inferno" (Smith and van der Walt, CC0).
_INFERNO = np.array(
    [
        [0, 0, 4],
        [31, 12, 72],
        [85, 15, 109],
        [136, 34, 106],
        [186, 54, 85],
        [227, 89, 51],
        [249, 140, 10],
        [249, 201, 50],
        [252, 255, 164],
    ],
    dtype=np.float64,
)
#: NaN is shown in a colour that the map does not contain.
_NOT_FINITE = (0, 200, 220)


def false_colour(values: ArrayLike, low: float, high: float, *, logarithmic: bool = True) -> NDArray[np.uint8]:
    """``values``, (height, width), on a logarithmic or linear scale from ``low`` (black) to ``high`` (yellow), as sRGB
    bytes. :func:`false_colour_picture` adds a legend.

    Values outside are clipped to the ends; NaN is turquoise.
    """
    x = np.asarray(values, dtype=np.float64)
    known = ~np.isnan(x)
    x = np.clip(np.where(known, x, low), low, high)
    position = np.log(x / low) / np.log(high / low) if logarithmic else (x - low) / (high - low)
    stops = np.linspace(0.0, 1.0, len(_INFERNO))
    rgb = np.stack([np.interp(position, stops, _INFERNO[:, k]) for k in range(3)], axis=-1)
    rgb[~known] = _NOT_FINITE
    return np.round(rgb).astype(np.uint8)


def false_colour_stops() -> list[list[int]]:
    """The colours of the scale at equal distances, as sRGB bytes."""
    return [[int(value) for value in row] for row in _INFERNO]


def css_gradient() -> str:
    """The same scale as a CSS gradient from left to right."""
    colours = ", ".join("rgb({:.0f} {:.0f} {:.0f})".format(*row) for row in _INFERNO)
    return f"linear-gradient(to right, {colours})"
