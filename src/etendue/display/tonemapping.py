"""From linear radiance to eight bits: exposure, a tone curve, the encoding of the display."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import OptionError, is_number
from etendue.film import LUMINANCE

from .curves import MIDDLE_GREY, tone_curve

#: Bound of values, which keeps the rational curves finite; a pixel at the bound is white at every practical exposure.
_BRIGHTEST: Final = 1e30
#: Luminance, relative to the usual one of a picture, at which a pixel counts half for the exposure.
_FLOOR: Final = 1e-3
#: Exposures beyond it, in stops, make no picture of numbers in single precision.
_MOST_STOPS: Final = 300.0


def auto_exposure(image: ArrayLike, method: str = "log-average") -> float:
    """Exposure in stops that suits ``image``, (height, width, 3) linear RGB.

    ``log-average`` brings the log-average luminance to middle grey [Reinhard 2002, eq. 1, 2], but never pushes the
    brightest tenth of the picture beyond white; ``percentile`` brings the 99th percentile to white. Non-finite and
    black pixels do not count, and nearly black ones the less the darker they are: a pixel of luminance L has the weight
    L / (L + f), in which f is a thousandth of the usual luminance. An image without any other pixels has exposure 0.
    """
    if method not in ("log-average", "percentile"):
        raise OptionError(f"exposure is found by 'log-average' or 'percentile', not '{method}'")
    pixels = np.asarray(image, dtype=np.float64).reshape(-1, 3)
    luminance = pixels[np.isfinite(pixels).all(axis=1)] @ np.array(LUMINANCE)
    luminance = np.sort(luminance[luminance > 0.0])
    if not len(luminance):
        return 0.0
    # The median by the root of the luminance: neither dark pixels nor a lamp in the picture move it.
    floor = _FLOOR * _quantile(luminance, np.sqrt(luminance), 0.5)
    weights = luminance / (luminance + floor)
    if method == "percentile":
        return float(-np.log2(_quantile(luminance, weights, 0.99)))
    key = float(np.log2(MIDDLE_GREY) - np.average(np.log2(luminance), weights=weights))
    return min(key, float(-np.log2(_quantile(luminance, weights, 0.9))))


def _quantile(ascending: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """The value up to which ``ascending`` values have this share of the weights."""
    below = np.cumsum(weights)
    return float(ascending[np.searchsorted(below, share * below[-1])])


def check_tone(exposure: float | str, curve: str) -> None:
    """Raise :class:`OptionError` for an exposure or a curve that :func:`tonemap` does not know."""
    tone_curve(curve)
    if isinstance(exposure, str):
        if exposure != "auto":
            raise OptionError(f"exposure is a number of stops or 'auto', not '{exposure}'")
    elif not (is_number(exposure) and abs(exposure) <= _MOST_STOPS):
        raise OptionError(f"exposure is a number of stops from -{_MOST_STOPS:g} to {_MOST_STOPS:g}, not {exposure!r}")


def tonemap(
    image: ArrayLike, exposure: float | str = 0.0, curve: str = "srgb", alpha: ArrayLike | None = None
) -> NDArray[np.uint8]:
    """``image``, (height, width, 3) linear RGB, as eight-bit sRGB of the same shape; or with a fourth one, ``alpha``
    (height, width, 1), by which the colours of ``image`` are multiplied and those of the result are not.

    ``exposure`` is in stops (+1 doubles), or ``"auto"`` for :func:`auto_exposure`; ``curve`` is a name of
    :data:`CURVES`. NaN and negative values become black, infinite ones white. Raises :class:`OptionError` on an unknown
    curve or exposure.
    """
    check_tone(exposure, curve)
    stops = auto_exposure(image) if isinstance(exposure, str) else exposure
    x = np.nan_to_num(np.asarray(image, dtype=np.float64), nan=0.0, posinf=_BRIGHTEST, neginf=0.0)
    if alpha is not None:
        covered = np.clip(np.asarray(alpha, dtype=np.float64), 0.0, 1.0)
        x = np.divide(x, covered, out=np.zeros_like(x), where=covered > 0.0)
    x = tone_curve(curve)(np.clip(x * 2.0**stops, 0.0, _BRIGHTEST))
    if alpha is not None:
        x = np.concatenate([x, covered], axis=2)
    return np.round(x * 255.0).astype(np.uint8)
