"""How much of each pixel surfaces and media cover: the alpha of a picture."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import IndependentSource

from .camera import CameraSampler
from .visibility import Visibility

#: Rays per pixel, and of these the rays of one part, which limits memory.
_RAYS, _PART = 32, 8


def coverage(
    camera: CameraSampler, visibility: Visibility, take: Callable[[int], object] = lambda part: None
) -> NDArray[np.float32]:
    """(height, width, 1): 1 - the transmittance of camera rays that end nowhere, by the film's filter. Masks, other
    null surfaces and media cover a pixel in part, glass and mirrors wholly. An environment covers all of it, unless
    lights are hidden. ``take`` takes the wavelengths of a part, from number 0 on, under a spectral variant: the result
    is a mean over those of all parts."""
    shape = camera.height, camera.width, 1
    if visibility.scene.environment() is not None and not visibility.hides_lights:
        return np.ones(shape, np.float32)
    covered = mi.Float(0.0)
    for part in range(_RAYS // _PART):
        take(part)
        first = dr.opaque(mi.UInt32, part * _PART)
        lanes = dr.arange(mi.UInt32, camera.pixels * _PART)
        pixel = lanes // _PART
        place = _place(first + (lanes - pixel * _PART))
        y = pixel // camera.width
        position = mi.Point2f(mi.Float(pixel - y * camera.width), mi.Float(y)) + place
        numbers = IndependentSource(lanes + first * camera.pixels, 0, "coverage", 0)
        ray, _, _ = camera.through(position, numbers)
        medium = None if visibility.media is None else visibility.media.of_sensor
        sight = visibility.along(ray, mi.UInt32(1 << 30), mi.Bool(True), medium, visibility.hidden)
        passes = dr.select(sight.visible, dr.mean(mi.Spectrum(sight.transmittance)), 0.0)
        places = _place(first + dr.arange(mi.UInt32, _PART))
        dr.eval(passes, places)
        covered += camera.filter.spread(1.0 - passes, places.x, places.y)
        dr.eval(covered)
    return np.array(dr.clip(covered / _RAYS, 0.0, 1.0), np.float32).reshape(shape)


def _place(number: mi.UInt32) -> mi.Point2f:
    """Offsets of rays in their pixels: the Kronecker sequence of the plastic number, which is uniform along edges of
    any direction, unlike a grid."""
    place = mi.Point2f(0.5 + mi.Float(number) * 0.7548777, 0.5 + mi.Float(number) * 0.5698403)
    return place - dr.floor(place)
