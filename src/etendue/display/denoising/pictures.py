"""Input of denoisers: components of a picture, features of its first surfaces, and the variance of its pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError
from etendue.film import ALBEDO, NORMAL, Technique, is_matte, is_variance, variance_of

Picture = NDArray[np.float32]

#: Layer of the emission of first surfaces, which no denoiser uses.
_EMITTED: Final = "emitted"
#: Largest difference between a picture and the sum of its components, relative to the picture's mean.
_SUM_TOLERANCE: Final = 1e-3


@dataclass(frozen=True)
class Features:
    """Layers (height, width, 3) that guide a denoiser, with finite values only; ``None`` for a missing layer.

    ``variance`` is the variance of the pixels, which are means over samples.
    """

    albedo: Picture | None = None
    normal: Picture | None = None
    variance: Picture | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features that exist."""
        return tuple(name for name in ("albedo", "normal", "variance") if getattr(self, name) is not None)


def find_features(layers: Mapping[str, Picture], albedo: str | None = None, normal: str | None = None) -> Features:
    """The features among ``layers``, by their usual names or the names given.

    Raises :class:`OptionError` if a given layer does not exist or has fewer than three channels.
    """
    found = {}
    for what, given, usual in (
        ("albedo", albedo, ALBEDO),
        ("normal", normal, NORMAL),
        ("variance", None, (variance_of("image"),)),
    ):
        name = next((n for n in usual if n in layers), None) if given is None else given
        if given is not None and given not in layers:
            raise OptionError(f"there is no layer '{given}' for --{what}; there are: {', '.join(layers)}")
        if name is None:
            continue
        feature = _feature(layers[name])
        if feature is None:
            if given is None:
                continue  # a layer of this name with another meaning
            raise OptionError(f"layer '{given}' for --{what} has {layers[name][0, 0].size} channels, not 3")
        found[what] = feature
    return Features(**found)


def find_variance(layers: Mapping[str, Picture], name: str) -> Picture | None:
    """The variance of the pixels of a layer, as a feature; ``None`` if it is not among ``layers``."""
    return _feature(layers[variance_of(name)]) if variance_of(name) in layers else None


def _feature(layer: Picture) -> Picture | None:
    if layer.ndim != 3 or layer.shape[2] < 3:
        return None
    return np.ascontiguousarray(np.nan_to_num(layer[:, :, :3], posinf=0.0, neginf=0.0), dtype=np.float32)


def component_names(layers: Mapping[str, Picture], chosen: Sequence[str] = ()) -> tuple[str, ...]:
    """Layers that are denoised separately and then summed: the ``chosen`` layers, or layers whose sum is the picture
    (such as ``components`` or ``split_layers`` make), or the picture alone.

    Raises :class:`OptionError` for a layer that does not exist or is not a colour, and if there is no picture.
    """
    for name in chosen:
        if name not in layers or not _is_colour(layers[name]):
            known = [key for key, layer in layers.items() if _is_colour(layer)]
            raise OptionError(f"there is no colour layer '{name}'; there are: {', '.join(known)}")
    if chosen:
        return tuple(chosen)
    if "image" not in layers or not layers["image"].size:
        raise OptionError(f"the file has no R, G, B channels, only layers: {', '.join(layers)}; name some by --layers")
    parts = part_names(layers)
    whole = layers["image"]
    if len(parts) > 1 and _is_colour(whole):
        with np.errstate(invalid="ignore"):
            difference = np.abs(sum(layers[name][:, :, :3].astype(np.float64) for name in parts) - whole[:, :, :3])
        finite = np.isfinite(difference)
        if finite.any() and difference[finite].max() <= _SUM_TOLERANCE * np.abs(whole[:, :, :3][finite]).mean():
            return parts
    return ("image",)


def part_names(layers: Mapping[str, Picture]) -> tuple[str, ...]:
    """Layers that are parts of the picture, as their names and channels suggest."""
    return tuple(name for name, layer in layers.items() if _is_part(name, layer))


def _is_part(name: str, layer: Picture) -> bool:
    if name in ("image", _EMITTED, *ALBEDO, *NORMAL) or is_variance(name) or is_matte(name):
        return False
    return _is_colour(layer) and Technique.of_layer(name) is None


def _is_colour(layer: Picture) -> bool:
    return layer.ndim == 3 and layer.shape[2] in (3, 4)


def colours(layer: Picture) -> Picture:
    """The layer as (height, width, 3), each pixel that is not finite replaced by the mean of its finite neighbours."""
    x = np.repeat(layer[:, :, :1], 3, axis=2) if layer.shape[2] < 3 else layer[:, :, :3]
    x = np.array(x, dtype=np.float32, order="C")
    bad = np.asarray(~np.isfinite(x).all(axis=2))
    for row, column in zip(*np.nonzero(bad), strict=True):
        around = (slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
        good = x[around][~bad[around]]
        x[row, column] = good.mean(axis=0) if len(good) else 0.0
    return x
