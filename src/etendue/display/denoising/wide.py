"""A filter of what other denoisers leave: blotches, wider than their windows and fainter than the noise was.

Noise of low frequency looks like faint structure, so a denoiser keeps it. This filter takes means over windows of about
a hundred pixels, but only of pixels that differ by less than a share of the noise of the picture before, which is known
from its passes: an edge of light that stood out from the noise stays.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from .filters import Frame, packets, unpacked
from .pictures import Features, Picture

#: Weights of a window of five pixels along a line, which come near a Gaussian [Dammertz 2010].
_KERNEL = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)
_TAPS = len(_KERNEL)
#: Levels; the distance of the pixels of a window doubles from one to the next.
_LEVELS = 5
#: Differences at which a weight is exp(-1/2): light, as a share of the deviation of a pixel before it was denoised;
#: albedo and normal.
_SHARE, _ALBEDO, _NORMAL = 0.2, 0.1, 0.2
#: Radius over which the variance is averaged, since few passes measure it badly.
_STEADY = 4
#: Albedo that is added before light is divided by it.
_BLACK = 0.05
_SMALL = 1e-12


def wide(picture: Picture, features: Features, strength: float) -> Picture:
    """``picture`` without blotches, by an edge-avoiding wavelet of the light divided by the albedo [Dammertz 2010].

    Weights fall with the differences of albedo and normal, and with that of the light relative to the standard
    deviation that ``features.variance`` tells of the picture before it was denoised. ``strength`` multiplies the
    accepted difference of the light. Where the variance is 0, nothing changes.
    """
    assert features.variance is not None  # the registry checks it
    height, width = picture.shape[:2]
    frame = Frame(width, height)
    albedo = np.zeros_like(picture) if features.albedo is None else np.clip(features.albedo, 0.0, 1.0)
    colour = albedo + np.float32(_BLACK)
    noise = [packets(np.maximum(features.variance, 0.0) / np.square(colour))]
    for vertical in (False, True):
        noise = frame.along(vertical, _STEADY, noise)
    variance = dr.gather(mi.Vector4f, noise[0], frame.lane)
    guides = [packets(albedo / np.float32(_ALBEDO))]
    if features.normal is not None:
        guides.append(packets(features.normal / np.float32(_NORMAL)))
    light = dr.gather(mi.Vector4f, packets(picture / colour), frame.lane)
    light.w = variance.x + variance.y + variance.z
    values = dr.ravel(light)
    for level in range(_LEVELS):
        values = _level(frame, values, guides, 1 << level, _SHARE * strength)
    return unpacked(values, height, width) * colour


def _level(frame: Frame, values: mi.Float, guides: list[mi.Float], step: int, share: float) -> mi.Float:
    """The means of five by five pixels that are ``step`` apart; the fourth channel, the variance, stays."""
    dr.eval(values, guides)
    table, far = mi.Float(_KERNEL), dr.opaque(mi.Int32, step)
    accepted = dr.opaque(mi.Float, share * share)
    own = dr.gather(mi.Vector4f, values, frame.lane)
    mine = [dr.gather(mi.Vector4f, guide, frame.lane) for guide in guides]

    def tap(across: mi.Int32, down: mi.Int32, total: mi.Vector4f) -> tuple[mi.Int32, mi.Int32, mi.Vector4f]:
        place, inside = frame.at((across - _TAPS // 2) * far, (down - _TAPS // 2) * far)
        other = dr.gather(mi.Vector4f, values, place, inside)
        apart = dr.squared_norm(mi.Vector3f(other.x - own.x, other.y - own.y, other.z - own.z))
        exponent = apart / (_SMALL + accepted * 2.0 * dr.minimum(own.w, other.w))
        for guide, here in zip(guides, mine, strict=True):
            exponent += dr.squared_norm(dr.gather(mi.Vector4f, guide, place, inside) - here)
        w = dr.gather(mi.Float, table, mi.UInt32(across)) * dr.gather(mi.Float, table, mi.UInt32(down))
        w = dr.select(inside, w * dr.exp(-0.5 * exponent), 0.0)
        total += w * mi.Vector4f(other.x, other.y, other.z, 1.0)
        ends = across == _TAPS - 1
        return dr.select(ends, 0, across + 1), dr.select(ends, down + 1, down), total

    start = (mi.Int32(0), mi.Int32(0), mi.Vector4f(0.0))
    _, _, total = dr.while_loop(start, lambda across, down, total: down < _TAPS, tap)
    result = total / total.w
    result.w = own.w
    kept: mi.Float = dr.ravel(result)
    dr.eval(kept)
    return kept
