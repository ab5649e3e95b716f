"""Floating-point pictures as text for a page's script: shared-exponent pixels [Ward 1991], deflated, in base64.

A page has room for a few megabytes. Where pictures need more, mantissas are rounded to fewer bits, which the eye does
not see (6 bits: steps of 1.6 to 3.1 %), and then blocks of pixels are averaged.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.film import ALBEDO, NORMAL, SHAPE

Image = NDArray[np.float32]

#: How the script shows a layer: with exposure and tone curve; from 0 to 1 as it is; a direction as a colour; in false
#: colours between two values; numbers that are names, such as those of patches; false colours of the squared relative
#: difference to the reference, which the script computes.
Kind = Literal["radiance", "albedo", "direction", "scalar", "label", "error"]
#: Bits of mantissas and sides of blocks, tried in turn.
_WAYS = ((8, 1), (7, 1), (6, 1), (7, 2), (6, 2), (6, 3), (6, 4), (6, 6), (6, 8), (6, 12), (6, 16))
#: Share of the room for the pictures themselves if there are layers, which are then shown at lower resolution.
_PICTURES_FIRST = 0.75
#: Factor on estimates of sizes.
_MARGIN = 1.05


@dataclass(frozen=True)
class Layer:
    """A layer of a picture. ``values``: (height, width, 3), or (height, width) for scalars and labels. ``scale``: the
    scalars shown as black and as yellow; by default the 1st and 99th percentile of positive values. ``unit``: of
    scalars, in the legend."""

    name: str
    kind: Kind
    values: Image
    scale: tuple[float, float] | None = None
    unit: str = ""

    @classmethod
    def of(cls, name: str, values: Image) -> Layer | None:
        """A layer of a result, shown as its name and channels suggest; ``None`` if it cannot be shown."""
        if values.ndim == 3 and values.shape[2] == 1:
            values = values[:, :, 0]
        if values.ndim == 2:
            return cls(name, "label" if name in SHAPE else "scalar", values)
        if values.ndim != 3 or values.shape[2] != 3:
            return None
        return cls(name, "albedo" if name in ALBEDO else "direction" if name in NORMAL else "radiance", values)

    @property
    def range(self) -> tuple[float, float]:
        """The scale of a scalar."""
        if self.scale is not None:
            return self.scale
        known = self.values[np.isfinite(self.values) & (self.values > 0)]
        if not known.size:
            return 0.1, 1.0
        low, high = (float(v) for v in np.percentile(known, [1.0, 99.0]))
        return (low, high) if high > 1.05 * low else (low / 2.0, 2.0 * low)

    def planes(self, bits: int, block: int) -> NDArray[np.uint8]:
        """Planes of bytes, (channels + 1, height, width)."""
        if self.kind == "label":  # three bytes of a whole number, exact and never averaged
            whole = np.nan_to_num(self.values[::block, ::block], nan=-1.0).astype(np.int64) + 1
            return shared_exponent(np.stack([whole >> 16 & 255, whole >> 8 & 255, whole & 255], axis=2))
        values = self.values if self.values.ndim == 3 else self.values[:, :, None]
        if self.kind == "direction":
            values = 0.5 * (values + 1.0)
        return shared_exponent(averaged(values, block), bits)


def packed(pictures: Sequence[Layer], layers: Sequence[Layer], room: int) -> tuple[list[Any], list[Any]]:
    """Data of pictures and of further layers for ``pictures.js``, in at most about ``room`` characters: ``{kind, name,
    channels, block, planes}``; layers that do not fit at the lowest resolution are ``None``."""
    shown = _fitted(pictures, int(_PICTURES_FIRST * room) if layers else room)
    left = room - _length(shown)
    others = _fitted(layers, left) if layers else []
    while others and _length(others) > left:  # too large even at their lowest resolution
        others.pop()
    return shown, [*others, *[None] * (len(layers) - len(others))]


def _fitted(layers: Sequence[Layer], room: int) -> list[Any]:
    """Data of layers, all made in the first way that fits, or else in the way with the smallest size."""
    ways = [way for way in _WAYS if sum(_estimate(layer, *way) for layer in layers) <= room] or list(_WAYS[-1:])
    for way in ways:
        made = [_data(layer, *way) for layer in layers]
        if _length(made) <= room:
            break
    return made


def _estimate(layer: Layer, bits: int, block: int) -> float:
    """Characters of a layer, from three bands of it."""
    height = len(layer.values)
    band = max(8 * block, height // 24)
    if height <= 6 * band:
        bands = layer.values
    else:
        bands = np.concatenate([layer.values[at : at + band] for at in (height // 6, height // 2, 5 * height // 6)])
    planes = replace(layer, values=bands).planes(bits, block)
    return _MARGIN * 4 / 3 * len(zlib.compress(planes.tobytes(), 6)) * height / len(bands)


def _length(made: Sequence[Any]) -> int:
    return sum(len(data["planes"]) for data in made)


def _data(layer: Layer, bits: int, block: int) -> dict[str, Any]:
    planes = layer.planes(bits, block)
    channels, height, width = planes.shape
    return {
        "name": layer.name,
        "kind": layer.kind,
        "channels": channels - 1,
        "block": block,
        "width": width,
        "height": height,
        **({"range": layer.range, "unit": layer.unit} if layer.kind == "scalar" else {}),
        "planes": base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode(),
    }


def averaged(values: ArrayLike, block: int) -> NDArray[np.float64]:
    """Means of blocks of (height, width, channels), also of incomplete blocks at the right and lower edge; values
    that are not finite do not count, and a block without finite values is NaN."""
    x = np.asarray(values, dtype=np.float64)
    if block == 1:
        return x
    known = np.isfinite(x)
    rows, columns = np.arange(0, x.shape[0], block), np.arange(0, x.shape[1], block)

    def sums(of: NDArray[Any]) -> NDArray[np.float64]:
        return np.add.reduceat(np.add.reduceat(of.astype(np.float64), rows, axis=0), columns, axis=1)

    count = sums(known)
    return np.where(count > 0, sums(np.where(known, x, 0.0)) / np.maximum(count, 1.0), np.nan)


def shared_exponent(image: ArrayLike, bits: int = 8) -> NDArray[np.uint8]:
    """Planes (c + 1, height, width) of c mantissas and an exponent: value = mantissa 2^(exponent - 136) [Ward 1991].

    Mantissas have 8 ``bits``, or are rounded to fewer. NaN and negative values become 0, values beyond the range the
    largest value.
    """
    x = np.nan_to_num(np.asarray(image, dtype=np.float64), nan=0.0, posinf=1e30, neginf=0.0).clip(0.0, 1e30)
    grain = 2 ** (8 - bits)
    most = 256 - grain
    # The exponent is one larger where the largest mantissa would round up to 256.
    _, exponent = np.frexp(x.max(axis=2) * (1.0 + 0.5 * grain / (256.0 - 0.5 * grain)))
    exponent = np.clip(exponent, -127, 127)
    mantissa = np.minimum(np.round(np.ldexp(x, 8 - exponent[:, :, None]) / grain) * grain, most)
    planes = np.concatenate([mantissa, (exponent + 128)[:, :, None]], axis=2).astype(np.uint8)
    return np.ascontiguousarray(np.moveaxis(planes, 2, 0))
