"""Layers of a pass, and of the picture that is developed from a measurement."""

from __future__ import annotations

import functools
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Measurement
from etendue.film import COMPONENTS, without_fireflies

V = TypeVar("V")

#: One pass's sums of a layer, (height, width, channels).
Layer = NDArray[np.float32]
#: Layers that are parts of the picture, by component or by family of techniques.
PARTS = {*COMPONENTS, "next_event", "connection", "merge", "splat"}
#: Fewer passes hardly tell a rare find from a highlight that few samples of a pixel meet.
_LEAST_PASSES = 4
#: Smallest share of paths whose mean is taken for what a pixel shows.
_LEAST_SHARE = 0.05
#: Relative change from which on a pixel counts as changed in the metadata.
_CHANGED = 0.1


def keep_finite(value: V) -> tuple[V, mi.Bool]:
    """(``value`` with non-finite lanes set to 0, mask of these lanes)."""
    good = dr.all(dr.isfinite(value))
    return dr.select(good, value, 0.0), ~good


def with_image(layers: dict[str, Layer]) -> dict[str, Layer]:
    """``layers`` with ``image`` added, as their sum, if it is missing."""
    if "image" in layers:
        return layers
    # In single precision, which is enough for one pass and needs less memory traffic.
    return {"image": functools.reduce(np.add, layers.values())} | layers


def seen(layers: dict[str, Layer]) -> dict[str, Layer]:
    """``layers`` with the means of :class:`FirstHits` over the paths that count, instead of their sums and share; where
    hardly any does, those of the first surfaces."""
    layers = dict(layers)
    if (share := layers.pop("seen_share", None)) is not None:
        for name in ("albedo", "normal"):
            layers[f"seen_{name}"] = np.divide(
                layers[f"seen_{name}"], share, out=layers[name].copy(), where=share > _LEAST_SHARE
            )
    return layers


def reweighted(
    layers: dict[str, Layer], measurement: Measurement, reach: int
) -> tuple[dict[str, Layer], dict[str, Any]]:
    """(``layers`` of a picture with fireflies reduced in the picture and its parts; facts for the metadata). After
    few passes, whose variance says little, nothing is reduced. ``reach``: see :func:`without_fireflies`."""
    whole = layers["image"]
    changed = dict(layers)
    if len(measurement.iterations) >= _LEAST_PASSES:
        parts = {name: layer for name, layer in layers.items() if name in PARTS} or {"image": whole}
        parts = without_fireflies(parts, measurement.variance_of_mean(), reach)
        changed |= parts | {"image": functools.reduce(np.add, parts.values())}
    loss = np.abs(whole - changed["image"])
    pixels = int((loss.max(axis=2) > _CHANGED * np.abs(whole).max(axis=2)).sum())
    light = float(loss.sum(dtype=np.float64) / max(np.abs(whole).sum(dtype=np.float64), 1e-300))
    return changed, {"pixels": pixels, "light": light}


def total(values: mi.UInt32 | mi.Bool) -> float:
    """Sum over all lanes of an evaluated array of counts or flags."""
    return float(np.asarray(values).sum(dtype=np.float64))
