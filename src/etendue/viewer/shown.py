"""From the layers of a picture to the image on a page: a layer, denoised, with exposure and tone curve, encoded."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, is_number
from etendue.display import (
    CURVES,
    DENOISERS,
    Filter,
    auto_exposure,
    check_tone,
    develop,
    false_colour,
    in_pyramid,
    parse_filters,
)
from etendue.film import ALBEDO, NORMAL, SHAPE, is_matte, is_variance
from etendue.lighting import EFFICACY, photometric

from .protocol import number, text

Picture = NDArray[np.float32]
#: What is chosen as a layer to see luminance in false colours.
LUMINANCE_LAYER = "luminance in cd/m²"
Bytes = NDArray[np.uint8]

#: Automatic exposures use about so many pixels.
_SAMPLES = 1 << 14
#: Quality of JPEG while the camera moves, and afterwards.
_MOVING_QUALITY, _QUALITY = 80, 92
#: Black and yellow of luminance: these powers of two of the luminance that the exposure makes white.
_LUMINANCES = -9, 3
#: Relative squared errors and variances shown as black and as yellow.
_SQUARES = 1e-4, 1.0


@dataclass(frozen=True)
class Show:
    """How the picture is shown: layer, denoising, tone curve and exposure."""

    layer: str = "image"
    denoise: str = ""
    radius: int = 5
    strength: float = 1.0
    curve: str = "srgb"
    exposure: float | str = "auto"

    def changed(self, message: Mapping[str, Any]) -> Show:
        """A copy with the values of a ``show`` message. Raises :class:`OptionError`."""
        values: dict[str, Any] = {key: text(message, key) for key in ("layer", "denoise", "curve") if key in message}
        if "radius" in message:
            values["radius"] = message["radius"]
        if "strength" in message:
            values["strength"] = number(message, "strength")
        if "exposure" in message:
            exposure = message["exposure"]
            if exposure != "auto" and not (is_number(exposure) and abs(exposure) <= 60):
                raise OptionError(f"exposure is a number of stops or auto, not {exposure!r}")
            values["exposure"] = exposure
        shown = replace(self, **values)
        check_tone(shown.exposure, shown.curve)
        shown.filters()
        return shown

    def filters(self) -> dict[str, Filter]:
        """The filters by component; "" is that of all others."""
        return parse_filters(self.denoise or None, self.radius, self.strength)

    def colours(self, layers: Mapping[str, Picture], stops: float) -> Bytes:
        """The layer that is shown, as eight-bit colours. A missing layer is replaced by the picture."""
        if self.layer == LUMINANCE_LAYER:
            return false_colour(photometric(self.picture(layers)), *luminances(stops))
        name = self.layer if self.layer in layers else "image"
        if name == "image":
            return toned(self.picture(layers), stops, self.curve)
        layer = layers[name]
        if name in NORMAL and layer.shape[2] >= 3:
            return _bytes(0.5 + 0.5 * layer[:, :, :3])
        if name in SHAPE:
            return _hashed(layer[:, :, 0])
        if is_matte(name):
            return _hashed(np.ascontiguousarray(layer[:, :, 0]).view(np.uint32))
        if name in ALBEDO and layer.shape[2] >= 3:
            return toned(layer[:, :, :3], 0.0, "srgb")
        if is_variance(name):
            mean = np.square(layers["image"].astype(np.float64)).mean(axis=2) + 0.01
            return false_colour(layer.astype(np.float64).mean(axis=2) / mean, *_SQUARES)
        if layer.shape[2] < 3:
            return _greys(layer[:, :, 0])
        return toned(layer[:, :, :3], stops, self.curve)

    def picture(self, layers: Mapping[str, Picture]) -> Picture:
        """The picture, linear, denoised if asked. Raises the errors of :func:`etendue.display.develop`."""
        if not self.denoise:
            return layers["image"]
        return develop(layers, self.denoise, radius=self.radius, strength=self.strength, tell=lambda _: None)

    def stops(self, picture: Picture) -> float:
        """The exposure in stops."""
        if not isinstance(self.exposure, str):
            return float(self.exposure)
        pixels = picture.reshape(-1, 3)
        return auto_exposure(pixels[:: max(1, len(pixels) // _SAMPLES)])


def choices() -> dict[str, Any]:
    """Tone curves and denoisers, for the page."""
    return {
        "curves": [{"name": c.name, "about": c.about} for c in CURVES.values()],
        "luminance": {"layer": LUMINANCE_LAYER, "ends": luminances(0.0)},
        "denoisers": [{"name": d.name, "about": d.about, "needs": d.needs, "uses": d.uses} for d in DENOISERS.values()],
    }


def luminances(stops: float) -> tuple[float, float]:
    """The luminances in cd/m^2 that are black and yellow in false colours at an exposure."""
    low, high = (EFFICACY * 2.0 ** (power - stops) for power in _LUMINANCES)
    return low, high


def layer_names(layers: Mapping[str, Picture]) -> list[str]:
    """The layers that can be shown, the picture and its luminance first, without the techniques of a pyramid."""
    names = [name for name in layers if not in_pyramid(name)] or ["image"]  # there is a preview before all layers
    return [*names[:1], LUMINANCE_LAYER, *names[1:]]


def toned(picture: Picture, stops: float, curve: str) -> Bytes:
    """As :func:`etendue.display.tonemap`, by tables over half-precision numbers: precise enough for eight bits, and ten
    times as fast."""
    tone, curved = CURVES[curve], _tables(curve)
    with np.errstate(over="ignore", invalid="ignore"):
        x = picture * np.float32(2.0**stops)
        if tone.before is not None:
            x = np.nan_to_num(x, nan=0.0, posinf=6e4) @ tone.before.T.astype(np.float32)
        if tone.after is None:
            shown: Bytes = curved[1][x.astype(np.float16).view(np.uint16)]
            return shown
        y = curved[0][x.astype(np.float16).view(np.uint16)] @ tone.after.T.astype(np.float32)
        return _bytes(tone.encode(np.clip(y, 0.0, 1.0)))


@lru_cache(maxsize=16)
def _tables(curve: str) -> tuple[Picture, Bytes]:
    """``f``, and ``f`` encoded in eight bits, for every number of half precision. Negative ones and NaN are black."""
    every = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float64)
    x = np.clip(np.nan_to_num(every, nan=0.0, posinf=1e30, neginf=0.0), 0.0, None)
    tone = CURVES[curve]
    values = tone.f(x)
    return values.astype(np.float32), _bytes(tone.encode(np.clip(values, 0.0, 1.0)))


def encoded(picture: Bytes, moving: bool = False) -> tuple[bytes, str]:
    """(a picture (height, width, 3) as a file for pages, its MIME type)."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(
        buffer, "JPEG", quality=_MOVING_QUALITY if moving else _QUALITY, subsampling=2 if moving else 0
    )
    return buffer.getvalue(), "image/jpeg"


def error_map(squared: NDArray[Any]) -> Bytes:
    """Relative squared errors (height, width) in false colours."""
    return false_colour(squared, *_SQUARES)


def _bytes(values: NDArray[Any]) -> Bytes:
    whole: Bytes = (np.clip(np.nan_to_num(values), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    return whole


def _greys(values: Picture) -> Bytes:
    """Grey values, from the 1st percentile (black) to the 99th (white)."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (1, 99)) if finite.size else (0.0, 1.0)
    scaled = (values - low) / (high - low if high > low and math.isfinite(high - low) else 1.0)
    return _bytes(np.repeat(scaled[:, :, None], 3, axis=2))


def _hashed(values: Picture) -> Bytes:
    """A colour for each number; 0 is black."""
    keys = np.nan_to_num(values).astype(np.int64).astype(np.uint32)
    mixed = (keys * np.uint32(0x9E3779B1)) ^ (keys * np.uint32(0x85EBCA77) >> np.uint32(13))
    colours = np.stack([(mixed >> np.uint32(s)) & np.uint32(0xFF) for s in (0, 9, 18)], axis=2).astype(np.uint8)
    colours[keys == 0] = 0
    return colours
