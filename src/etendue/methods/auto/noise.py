"""The noise of path tracing, measured by a few camera paths before the first pass."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import RELATIVE_EPSILON

from ..base import ImageMethod
from ..path import Trace, light_of_paths

#: Consecutive pixels that are measured together, and most groups of them, all over the picture.
_GROUP, _GROUPS = 64, 512
#: Number of the first of two passes whose paths are traced: those of pictures have smaller ones.
_FIRST = 1 << 31


def noise_of_paths(method: ImageMethod, trace: Trace, seed: int) -> float:
    """Relative mean square error of a picture of one path per pixel, traced as in ``path_pass``. The kernel is that of
    such passes. Its unit is the mean brightness, so that no scale of the light changes it."""
    pixels, samples = method.camera.pixels, method.samples_per_iteration
    size = min(_GROUP, pixels)
    groups = min(_GROUPS, pixels // size)
    path = dr.arange(mi.UInt32, groups * size)
    group = path // size
    step = dr.opaque(mi.Float, (pixels - size) / max(1, groups - 1))
    lanes = (mi.UInt32(mi.Float(group) * step) + path % size) * dr.opaque(mi.UInt32, samples)
    dr.eval(lanes)
    method.take_wavelengths(0, seed)
    found = []
    for iteration in (_FIRST, _FIRST + 1):
        layers, _, _ = light_of_paths(method, lanes, iteration, seed, samples, trace)
        light = sum(np.asarray(layer, np.float64).mean(axis=0) for layer in layers.values())
        found.append(np.reshape(light, (groups, size)))
    variance = np.square(found[0] - found[1]).mean(axis=1) / 2.0
    level = np.mean(found, axis=(0, 2))
    least = RELATIVE_EPSILON * level.mean() ** 2
    return float(np.mean(variance / np.maximum(np.square(level) + least, 1e-30)))
