"""Non-local means with the measured variance of pixels [Rousselle 2012]."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .filters import Frame, packets, unpacked
from .pictures import Features, Picture

#: Radius of the patches that are compared.
_PATCH = 3
#: Share of the variance that is subtracted from squared differences, and the difference over which a weight decays.
_CANCEL, _DAMPING = 1.0, 0.45
_SMALL = 1e-10


def non_local_means(component: Picture, features: Features, radius: int, strength: float) -> Picture:
    """Mean of the pixels of the window, with weights by the difference of the patches around them, beyond what their
    variance explains [Rousselle 2012, eq. 5 to 7]. ``strength`` multiplies the accepted difference. Additional
    weights by albedo and normal did not reduce the error.

    The variance is smoothed over 3x3 pixels, because it is noisy after few passes.
    """
    assert features.variance is not None  # the registry checks it
    height, width = component.shape[:2]
    frame = Frame(width, height)
    value = packets(component)
    variance = [packets(np.maximum(features.variance, 0.0))]
    for vertical in (False, True):
        variance = frame.along(vertical, 1, variance)
    noise = variance[0]
    dr.eval(value, noise)
    own, own_noise = (dr.gather(mi.Vector4f, layer, frame.lane) for layer in (value, noise))
    dr.eval(own, own_noise)
    damping = dr.opaque(mi.Float, (_DAMPING * max(strength, 1e-6)) ** 2)
    total, weight = dr.zeros(mi.Vector4f, width * height), dr.zeros(mi.Float, width * height)
    for down in range(-radius, radius + 1):
        for across in range(-radius, radius + 1):
            x, y = dr.opaque(mi.Int32, across), dr.opaque(mi.Int32, down)
            place, inside = frame.at(x, y)
            other, its_noise = (dr.gather(mi.Vector4f, layer, place, inside) for layer in (value, noise))
            excess = dr.square(own - other) - _CANCEL * (own_noise + dr.minimum(own_noise, its_noise))
            relative = excess / (_SMALL + damping * (own_noise + its_noise))
            channel = (relative.x + relative.y + relative.z) * (1.0 / 3.0)
            distance = mi.Vector4f(dr.select(inside, channel, 0.0), dr.select(inside, mi.Float(1.0), 0.0), 0.0, 0.0)
            patches = [dr.ravel(distance)]
            for vertical in (False, True):
                patches = frame.along(vertical, _PATCH, patches)
            patch = dr.gather(mi.Vector4f, patches[0], frame.lane)  # means of differences, and shares in the picture
            exponent = dr.maximum(patch.x / dr.maximum(patch.y, 1e-6), 0.0)
            w = dr.select(inside, dr.exp(-exponent), 0.0)
            total, weight = dr.fma(other, w, total), weight + w
            dr.eval(total, weight)
    return unpacked(dr.ravel(total / weight), height, width)
