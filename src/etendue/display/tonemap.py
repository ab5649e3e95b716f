"""From linear radiance to eight bits: exposure, a curve, the sRGB encoding."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError, suggest
from etendue.film import LUMINANCE

Array = NDArray[np.float64]

#: The grey to which the log-average luminance is scaled [Reinhard 2002, eq. 2].
MIDDLE_GREY: Final = 0.18


def _linear(x: Array) -> Array:
    return x


def _filmic(x: Array) -> Array:
    """Rational fit to the ACES reference curve, applied per channel [Narkowicz 2015]."""
    return (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)


#: Curves from exposed linear values to display-linear values, clipped to [0, 1] afterwards.
CURVES: Final[dict[str, Callable[[Array], Array]]] = {"srgb": _linear, "filmic": _filmic}


def srgb_encode(linear: ArrayLike) -> Array:
    """The sRGB transfer curve (IEC 61966-2-1) of values in [0, 1]; anything outside is clipped, NaN becomes 0."""
    x = np.clip(np.nan_to_num(np.asarray(linear, dtype=np.float64), nan=0.0), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def auto_exposure(image: ArrayLike, method: str = "log-average") -> float:
    """Exposure in stops that suits ``image``, (height, width, 3) linear RGB.

    ``log-average`` brings the log-average luminance to middle grey [Reinhard 2002, eq. 1], but never pushes the
    brightest tenth of the picture beyond white; ``percentile`` brings the 99th percentile to white. Non-finite and
    black pixels do not count; an image without any other has exposure 0.
    """
    if method not in ("log-average", "percentile"):
        raise OptionError(f"exposure is found by 'log-average' or 'percentile', not '{method}'")
    pixels = np.asarray(image, dtype=np.float64).reshape(-1, 3)
    luminance = pixels[np.isfinite(pixels).all(axis=1)] @ np.array(LUMINANCE)
    luminance = luminance[luminance > 0.0]
    if not len(luminance):
        return 0.0
    if method == "percentile":
        return float(-np.log2(np.percentile(luminance, 99.0)))
    key = float(np.log2(MIDDLE_GREY) - np.log2(luminance).mean())
    return min(key, float(-np.log2(np.percentile(luminance, 90.0))))


def tonemap(image: ArrayLike, exposure: float | str = 0.0, curve: str = "srgb") -> NDArray[np.uint8]:
    """``image``, (height, width, 3) linear RGB, as eight-bit sRGB of the same shape.

    ``exposure`` is in stops (+1 doubles), or ``"auto"`` for :func:`auto_exposure`; ``curve`` is ``"srgb"`` (clip) or
    ``"filmic"``. NaN and negative values become black, infinite ones white. Raises :class:`OptionError` on an unknown
    curve or exposure.
    """
    if curve not in CURVES:
        raise OptionError(f"no tone curve '{curve}'; {suggest(curve, CURVES)}")
    if isinstance(exposure, str):
        if exposure != "auto":
            raise OptionError(f"exposure is a number of stops or 'auto', not '{exposure}'")
        exposure = auto_exposure(image)
    if not np.isfinite(exposure):
        raise OptionError(f"exposure must be a finite number of stops, not {exposure}")
    # The bound keeps the rational curve finite; it is white at every practical exposure.
    x = np.nan_to_num(np.asarray(image, dtype=np.float64), nan=0.0, posinf=1e30, neginf=0.0)
    x = np.clip(x * 2.0**exposure, 0.0, 1e30)
    return np.round(srgb_encode(CURVES[curve](x)) * 255.0).astype(np.uint8)
