"""Weights of contributions in training: relative to the brightness of the picture around their pixel."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, copied_to_device

#: Sums are of integers, so that they do not depend on the order of the additions: units of a contribution, and of its
#: square, per mean contribution; and the largest contribution of a path, in mean contributions.
UNITS, SQUARES, _MOST = 1 << 16, 1 << 10, 1 << 10
#: Size of a block of lanes, and the stride of the blocks whose camera paths are counted.
_BLOCK, _STRIDE = 16, 4
#: Side of the blocks of pixels whose brightness is known.
BLOCK = 16
#: Share of the picture's mean brightness that is added to that of a block.
_LEAST_LEVEL = 0.25


class Worth:
    """Factors on contributions to the pixels.

    Parameters
    ----------
    unit: mean contribution to a pixel; 0: no contribution counts, in the same kernels.
    levels: (blocks,) brightness of the picture in blocks of :data:`BLOCK` x :data:`BLOCK` pixels, relative to ``unit``.
    width: of the picture, in pixels.
    """

    def __init__(self, unit: float, levels: Array, width: int) -> None:
        worth = 1.0 / (np.maximum(levels, 0.0) + _LEAST_LEVEL)
        self._worth = copied_to_device(mi.Float, worth.astype(np.float32))
        self._width, self._across = dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, -(-width // BLOCK))
        self.learns = unit > 0.0
        self._unit = dr.opaque(mi.Float, 1.0 / unit if self.learns else 0.0)

    def worth_of_lane(self, pixel: mi.UInt32, lane: mi.UInt32) -> mi.Float:
        """Factor on the luminance of contributions of camera paths to their pixels. Only some blocks of lanes count,
        since additions take time; they differ between rows of pixels, so that they are spread over the picture."""
        counts = (lane // _BLOCK + pixel // self._width) % _STRIDE == 0
        return dr.select(counts, _STRIDE * self.worth(pixel, counts), 0.0)

    def worth(self, pixel: mi.UInt32, active: mi.Bool) -> mi.Float:
        """Factor on the luminance of contributions to a pixel; 0 where not ``active``."""
        y = pixel // self._width
        block = (y // BLOCK) * self._across + (pixel - y * self._width) // BLOCK
        return dr.select(active, dr.gather(mi.Float, self._worth, block, active) * self._unit, 0.0)


def capped(value: mi.Float) -> mi.Float:
    """A contribution, in mean contributions, limited to the largest that counts."""
    return dr.minimum(dr.select(value > 0.0, value, 0.0), float(_MOST))


def in_units(value: mi.Float, scale: int) -> mi.UInt64:
    """A value that is not negative as an integer; 0 if it is not finite."""
    return mi.UInt64(dr.select(dr.isfinite(value), dr.maximum(value, 0.0), 0.0) * float(scale))
