"""Tone curves: the table that PNG files, pages and the command line share.

A curve maps exposed linear sRGB ``x`` to the values of a display, ``encode(after f(before x))`` with 3x3 matrices
``before`` and ``after`` (the identity for most) and functions ``f`` and ``encode`` of a channel. A page has ``f`` and
``encode`` as tables (:meth:`ToneCurve.tables`), so that no formula is written twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, suggest

Array = NDArray[np.float64]
Function = Callable[[Array], Array]

#: The grey of a card, which the curves ``logarithmic`` and ``s-curve`` keep.
MIDDLE_GREY: Final = 0.18
#: White of ``reinhard`` and of ``logarithmic``, relative to the white of ``srgb``.
_REINHARD_WHITE, _LOG_WHITE = 4.0, 8.0
_LOG_SCALE = 5.449834863693495  # log(1 + 0.18 s) / log(1 + 8 s) = 0.18
_S_POWER = 1.4  # slope 1.15 at the grey, on logarithmic axes
#: Tables of a page: powers of two at the ends, entries for a power of two, entries of ``encode``.
TABLE_RANGE, TABLE_STEPS, ENCODE_STEPS = (-16, 16), 16, 1024


def srgb_encode(linear: Array) -> Array:
    """The sRGB transfer curve (IEC 61966-2-1) of values in [0, 1]; anything outside is clipped, NaN becomes 0."""
    x = np.clip(np.nan_to_num(np.asarray(linear, dtype=np.float64), nan=0.0), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


@dataclass(frozen=True)
class ToneCurve:
    """``encode(after f(before x))``. ``white``: the smallest grey that is shown as white, infinite if none is."""

    name: str
    about: str
    f: Function
    white: float
    before: Array | None = None
    after: Array | None = None
    encode: Function = srgb_encode

    def __call__(self, x: Array) -> Array:
        """Values of the display in [0, 1] for ``x``, (..., 3), not negative."""
        y = self.f(x if self.before is None else x @ self.before.T)
        return self.encode(np.clip(y if self.after is None else y @ self.after.T, 0.0, 1.0))

    def tables(self) -> dict[str, Any]:
        """``f`` at equal steps of log2 x, ``encode`` at squares of equal steps in [0, 1], and matrices, for JSON."""
        low, high = TABLE_RANGE
        x = 2.0 ** np.linspace(low, high, (high - low) * TABLE_STEPS + 1)
        inside = np.linspace(0.0, 1.0, ENCODE_STEPS + 1) ** 2  # finer at the dark end, where encodings are steep
        return {
            "f": [float(f"{v:.6g}") for v in self.f(x)],
            "encode": [float(f"{v:.6g}") for v in self.encode(inside)],
            "before": None if self.before is None else self.before.tolist(),
            "after": None if self.after is None else self.after.tolist(),
        }


def _filmic(x: Array) -> Array:
    return (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)


def _aces(x: Array) -> Array:
    """By the fit [Hill 2017] black is 0.0004 below 0."""
    y = (x * (x + 0.0245786) - 0.000090537) / (x * (0.983729 * x + 0.4329510) + 0.238081)
    return np.maximum(y, 0.0)


def _logarithmic(x: Array) -> Array:
    return np.log1p(_LOG_SCALE * x) / np.log1p(_LOG_SCALE * _LOG_WHITE)


def _s_curve(x: Array) -> Array:
    power = x**_S_POWER
    return power / (power + MIDDLE_GREY**_S_POWER * (1.0 / MIDDLE_GREY - 1.0))


def _reinhard(x: Array) -> Array:
    return x * (1.0 + x / _REINHARD_WHITE**2) / (1.0 + x)


#: AgX: range in powers of two around middle grey, value and slope there, and the bend of toe and shoulder.
_AGX_RANGE, _AGX_GREY, _AGX_SLOPE, _AGX_BEND = (-10.0, 6.5), 0.5, 2.0, (3.0, 3.25)


def _agx(x: Array) -> Array:
    """A sigmoid of log2 x through (0, 0), middle grey and (1, 1)."""
    low, high = _AGX_RANGE
    grey = low / (low - high)
    place = np.clip((np.log2(np.maximum(x, 1e-30) / MIDDLE_GREY) - low) / (high - low), 0.0, 1.0)

    def branch(width: float, height: float, bend: float) -> Array:
        """Distance from the grey value, towards an end at ``width`` and ``height`` from the grey."""
        t = np.minimum(np.abs(place - grey), width) * _AGX_SLOPE
        # t / (1 + (t / s)^bend)^(1 / bend), with s such that it is the height at the end
        scale = ((width * _AGX_SLOPE / height) ** bend - 1.0) / (width * _AGX_SLOPE) ** bend
        return t / (1.0 + scale * t**bend) ** (1.0 / bend)

    toe = _AGX_GREY - branch(grey, _AGX_GREY, _AGX_BEND[0])
    shoulder = _AGX_GREY + branch(1.0 - grey, 1.0 - _AGX_GREY, _AGX_BEND[1])
    return np.where(place < grey, toe, shoulder)


#: sRGB to the primaries in which ACES works, and back, with the desaturation of its two transforms [Hill 2017].
_ACES_BEFORE = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_ACES_AFTER = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
#: sRGB to primaries that contain it [Sobotka 2022], which takes saturation out of bright colours.
_AGX_BEFORE = np.array(
    [
        [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
        [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
        [0.0423756549057051, 0.0784336, 0.879142973793104],
    ]
)
for _matrix in (_ACES_BEFORE, _ACES_AFTER, _AGX_BEFORE):
    _matrix /= _matrix.sum(axis=1, keepdims=True)  # by 0.0001 at most, so that grey stays grey

_CURVES = (
    ToneCurve("srgb", "as it is; brighter than white is white", lambda x: x, 1.0),
    ToneCurve("gamma", "as it is, for a display of gamma 2.2", lambda x: x, 1.0, encode=lambda x: x ** (1.0 / 2.2)),
    ToneCurve(
        "logarithmic", "log(1 + s x), white at 8 times that of srgb; keeps middle grey", _logarithmic, _LOG_WHITE
    ),
    ToneCurve("exponential", "1 - exp(-x)", lambda x: -np.expm1(-x), np.inf),
    ToneCurve(
        "s-curve", "x^n / (x^n + c), as of receptors of the eye [Naka 1966]; keeps middle grey", _s_curve, np.inf
    ),
    ToneCurve("reinhard", "x (1 + x / 16) / (1 + x), white at 4 [Reinhard 2002, eq. 4]", _reinhard, _REINHARD_WHITE),
    ToneCurve("filmic", "a fit to the ACES curve, by channel [Narkowicz 2015]", _filmic, 7.2417),
    ToneCurve("aces", "ACES 1 for displays, fitted; bright colours fade", _aces, 25.67, _ACES_BEFORE, _ACES_AFTER),
    ToneCurve(
        "agx",
        "AgX, a sigmoid over 16.5 powers of two; bright colours fade most [Sobotka 2022]",
        _agx,
        MIDDLE_GREY * 2.0 ** _AGX_RANGE[1],
        _AGX_BEFORE,
        np.linalg.inv(_AGX_BEFORE),
        encode=lambda x: x,
    ),
)
#: All tone curves by name.
CURVES: Final[dict[str, ToneCurve]] = {curve.name: curve for curve in _CURVES}


def tone_curve(name: str) -> ToneCurve:
    """The tone curve of that name. Raises :class:`OptionError` for an unknown one."""
    if not isinstance(name, str) or name not in CURVES:
        raise OptionError(f"no tone curve '{name}'; {suggest(name, CURVES)}")
    return CURVES[name]
