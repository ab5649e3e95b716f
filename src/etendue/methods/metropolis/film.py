"""A factor on the target of chains, by which bright parts of the film get fewer samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import RELATIVE_EPSILON, on_device

#: Samples of the bootstrap in a cell of the map, and most cells along an axis.
_PER_CELL = 128
_MOST_CELLS = 64
#: Contributions are clipped to this many times the mean, so that one of them does not darken a cell.
_MOST_OVER_MEAN = 50.0


class BrightnessMap:
    """A factor on the target of the chains, by film position.

    A target in proportion to luminance gives bright pixels most samples, and dark ones relative errors that grow
    without limit. If the variance of a pixel of luminance L with n samples is in proportion to L^2 / n, the error
    measure ``mean(variance / (L^2 + 0.01))`` is the least with n in proportion to L / sqrt(L^2 + 0.01). The factor is
    therefore ``1 / sqrt(L^2 + 0.01)``, with L from a coarse picture, linear between its cells [Veach 1997, sec. 11.4;
    Hoberock 2010]. Any positive factor leaves the expectation of the picture unchanged.

    ``values``: (rows, columns), positive.
    """

    def __init__(self, values: NDArray[np.float32], size: tuple[int, int]) -> None:
        self.values, self._size = values, size
        self._device = on_device(mi.Float, np.ascontiguousarray(values).ravel())

    @classmethod
    def flat(cls, size: tuple[int, int]) -> BrightnessMap:
        """The factor 1."""
        return cls(np.ones((1, 1), np.float32), size)

    @classmethod
    def measured(cls, parts: Sequence[NDArray[np.float32]], size: tuple[int, int]) -> BrightnessMap:
        """The factor from contributions: each part is an array (3, contributions of a sample, samples) of x and y, in
        pixels, and luminance."""
        width, height = size
        samples = sum(part.shape[2] for part in parts)
        cells = max(1.0, min(samples / _PER_CELL, width * height / 4))
        columns = min(_MOST_CELLS, max(1, round(math.sqrt(cells * width / height))))
        rows = min(_MOST_CELLS, max(1, round(cells / columns)))
        mean = sum(part[2].sum(dtype=np.float64) for part in parts) / samples
        sums = np.zeros(rows * columns)
        for x, y, luminance in parts:
            column = np.clip(x.ravel() * (columns / width), 0, columns - 1).astype(np.int64)
            row = np.clip(y.ravel() * (rows / height), 0, rows - 1).astype(np.int64)
            kept = np.minimum(luminance.ravel(), _MOST_OVER_MEAN * mean)
            sums += np.bincount(row * columns + column, kept, rows * columns)
        found = np.asarray(sums * (rows * columns / samples), np.float64).reshape(rows, columns)
        return cls((1.0 / np.sqrt(_blurred(found) ** 2 + RELATIVE_EPSILON)).astype(np.float32), size)

    @cached_property
    def of_pixels(self) -> NDArray[np.float64]:
        """The factor at the centres of the pixels, (height, width)."""
        width, height = self._size
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        return self.on_host(x, y)

    def on_host(self, x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
        """The factor at film positions."""
        rows, columns = self.values.shape
        axes = zip((x, y), (columns, rows), self._size, strict=True)
        at = [np.clip(p * (n / size) - 0.5, 0.0, n - 1.0) for p, n, size in axes]
        low = [np.minimum(p.astype(np.int64), n - 1) for p, n in zip(at, (columns, rows), strict=True)]
        high = [np.minimum(p + 1, n - 1) for p, n in zip(low, (columns, rows), strict=True)]
        (tx, ty), values = (p - q for p, q in zip(at, low, strict=True)), self.values.astype(np.float64)
        above = values[low[1], low[0]] * (1.0 - tx) + values[low[1], high[0]] * tx
        below = values[high[1], low[0]] * (1.0 - tx) + values[high[1], high[0]] * tx
        result: NDArray[np.float64] = above * (1.0 - ty) + below * ty
        return result

    def at(self, position: mi.Point2f) -> mi.Float:
        """The factor at film positions."""
        rows, columns = self.values.shape
        if rows * columns == 1:
            return mi.Float(1.0)
        low, high, t = [], [], []
        for p, n, size in zip((position.x, position.y), (columns, rows), self._size, strict=True):
            p = dr.clip(p * (n / size) - 0.5, 0.0, n - 1.0)
            cell = dr.minimum(mi.UInt32(p), n - 1)
            low.append(cell)
            high.append(dr.minimum(cell + 1, n - 1))
            t.append(p - mi.Float(cell))

        def value(column: mi.UInt32, row: mi.UInt32) -> mi.Float:
            return dr.gather(mi.Float, self._device, row * columns + column)

        above = dr.lerp(value(low[0], low[1]), value(high[0], low[1]), t[0])
        below = dr.lerp(value(low[0], high[1]), value(high[0], high[1]), t[0])
        return dr.lerp(above, below, t[1])


def _blurred(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of 3 x 3 cells, the border repeated."""
    padded = np.pad(values, 1, mode="edge")
    rows, columns = values.shape
    shifted: Sequence[NDArray[np.float64]] = [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    result: NDArray[np.float64] = np.mean(shifted, axis=0)
    return result
