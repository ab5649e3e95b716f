"""Splats filtered once a pass instead of one by one.

A splat reaches many pixels, 16 with Mitsuba's Gaussian, and these additions at random places are its largest cost.
Therefore a splat is added to one cell of a grid that is finer than the pixels and shifted at random from pass to pass;
at the end of the pass the grid is convolved to pixels. In cells of ``h`` pixels a contribution at ``x`` is in a cell
whose upper edge lies uniformly between ``x`` and ``x + h``, so that its expected weight is that of the film's filter
``f``, exactly, if the weight ``g`` of a cell with its upper edge at ``y`` fulfils

    f(x) = 1/h integral of g(y) for y from x to x + h,   that is   g(y) = g(y - h) + h f'(y - h).

As ``f`` sums to 1 over pixels and ``h`` divides a pixel, ``g`` has no wider support than ``f``. The mean square of a
splat's weights grows by that of ``g`` over that of ``f``: with cells of half a pixel, over both axes, by 9 % for the
Gaussian, by 11 to 14 % for cubic splines and Lanczos' filter.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

#: Cells per pixel along an axis.
PER_PIXEL = 2
#: Accepted growth of the mean square of a splat's weights along an axis. A tent filter's
#: growth is 1.12, and cells would save it three additions only.
_MOST_GROWTH = 1.08


def cell_weights(values: NDArray[np.float64], bins: int) -> NDArray[np.float64] | None:
    """Values of ``g``, one per bin, for upper edges of cells from ``h`` after the start of the support of ``f`` on.
    ``values``: means of ``f`` in bins, of which a cell has ``bins``. ``None`` if ``g`` adds too much noise."""
    steps = bins * np.diff(values, prepend=0.0).reshape(-1, bins)
    weights: NDArray[np.float64] = steps.cumsum(axis=0).ravel()
    return weights if np.square(weights).sum() <= _MOST_GROWTH * np.square(values).sum() else None


class CellAxis:
    """The cells along an axis of the film. ``weights``: :func:`cell_weights`; ``inverse_integral``: 1 / Z of each
    pixel; ``u``: the shift, in [0, 1) cells."""

    def __init__(self, weights: NDArray[np.float64], bins: int, inverse_integral: mi.Float, u: float) -> None:
        size = dr.width(inverse_integral)
        self.count = PER_PIXEL * size + 1  # the first begins before the film, the last ends after it
        shift = min(int(u * bins), bins - 1)
        self._shift = dr.opaque(mi.Float, shift / bins)
        self._weights = [dr.opaque(mi.Float, float(weight)) for weight in weights[shift::bins]]
        self._inverse_integral = inverse_integral

    def cell(self, position: mi.Float) -> mi.UInt32:
        """The cell of a film position, in pixels."""
        return mi.UInt32(mi.Int32(dr.floor(position * PER_PIXEL - self._shift)) + 1)

    def convolve(self, packets: mi.Float, first: mi.UInt32, stride: mi.UInt32, pixel: mi.UInt32) -> mi.Vector4f:
        """The value of ``pixel`` from the cells of its line, which begins at the packet ``first`` and has a cell every
        ``stride`` packets."""
        count, start = dr.opaque(mi.Int32, self.count), PER_PIXEL - len(self._weights) // 2
        result = mi.Vector4f(0.0)
        for index, weight in enumerate(self._weights):
            cell = mi.Int32(pixel) * PER_PIXEL + (start + index)
            inside = (cell >= 0) & (cell < count)
            value = dr.gather(mi.Vector4f, packets, first + mi.UInt32(cell) * stride, inside)
            result = dr.fma(value, weight, result)
        return result * dr.gather(mi.Float, self._inverse_integral, pixel)


class CellGrid:
    """The cells of a film under one shift, and the pixels that they make."""

    def __init__(self, across: CellAxis, down: CellAxis, width: int, height: int) -> None:
        self._across, self._down = across, down
        self._size = width, height
        self.count = across.count * down.count

    def cell(self, x: mi.Float, y: mi.Float) -> mi.UInt32:
        """Index of the cell of a position on the film, in pixels."""
        return self._down.cell(y) * dr.opaque(mi.UInt32, self._across.count) + self._across.cell(x)

    def pixels(self, packets: mi.Float) -> mi.Vector4f:
        """The pixels of the cells ``packets`` of one picture or of several in turn, one lane each. Evaluates
        ``packets``."""
        dr.eval(packets)
        width, height = (dr.opaque(mi.UInt32, n) for n in self._size)
        lines = dr.width(packets) // (4 * self._across.count)
        lane = dr.arange(mi.UInt32, lines * self._size[0])
        line = lane // width
        stride = dr.opaque(mi.UInt32, self._across.count)
        rows = dr.ravel(self._across.convolve(packets, line * stride, mi.UInt32(1), lane - line * width))
        dr.eval(rows)
        pictures = lines // self._down.count
        lane = dr.arange(mi.UInt32, pictures * self._size[0] * self._size[1])
        line = lane // width
        picture = line // height
        first = picture * dr.opaque(mi.UInt32, self._down.count) * width + (lane - line * width)
        return self._down.convolve(rows, first, width, line - picture * height)
