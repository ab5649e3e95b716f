r"""Pictures from samples on the film, at any resolution: density estimation [Leeson 2001, sec. 5.7.5 to 5.7.8].

A sample is a place (x, y) and a colour c. The picture of n samples is the density of their colours,

.. math:: L(x, y) = \frac{1}{n} \sum_i c_i K_i(x - x_i, y - y_i),

by the pixels of a histogram, by Gaussians of one width or of a width that depends on the density at the sample, or by
the nearest samples. Near the border of the region with samples, kernels reach beyond the region and pictures become
dark. Remedies: samples in a margin around the picture, or a picture of the middle of the film only (``inset``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, OptionError, free_memory, is_number, is_whole
from etendue.density import NearestNeighbours, Samples, relative_widths

from .errors import LUMINANCE

#: Columns of a sample: place in the unit square of the picture, red, green, blue.
FILM_COLUMNS = 5
ESTIMATORS = ("histogram", "kernel", "variable", "nearest")
#: Cells of the fine grid in a pixel, along an axis; reach of a Gaussian in its standard deviations.
_FINE, _REACH = 2, 4.0
#: Widths of the variable kernel: the factor between two steps, and the largest factor from ``bandwidth``, up or down.
_STEP, _WIDEST = math.sqrt(2.0), 8.0
#: The widest margin with samples around a picture, as a share of the picture's side.
_MARGIN = 0.5
#: Memory in bytes: of a cell of the fine grid and its transform, more where kernels reach further than the grid; and of
#: a sample of ``nearest``.
_CELL_BYTES, _WIDE_CELL_BYTES, _NEAREST_BYTES = 150, 300, 160


@dataclass(frozen=True)
class Development:
    """How a picture is made from samples on the film.

    size: (width, height) in pixels. estimator: one of ``histogram``, ``kernel``, ``variable``, ``nearest``. bandwidth:
    standard deviation of the Gaussian in pixels, of the mean density for ``variable``. neighbours: of ``nearest``.
    inset: share of the width and height that is left out at each side.
    """

    size: tuple[int, int]
    estimator: str = "histogram"
    bandwidth: float = 0.7
    neighbours: int = 50
    inset: float = 0.0

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise OptionError(f"estimator must be one of {', '.join(ESTIMATORS)}, not '{self.estimator}'")
        if len(self.size) != 2 or not all(is_whole(n) and 1 <= n <= 1 << 14 for n in self.size):
            raise OptionError(f"the size of a picture is its width and height in pixels, not {self.size!r}")
        if not is_number(self.bandwidth) or not 0.0 < self.bandwidth <= 1000.0:
            raise OptionError(f"bandwidth must be a number of pixels above 0 and up to 1000, not {self.bandwidth!r}")
        if not is_whole(self.neighbours) or self.neighbours < 1:
            raise OptionError(f"neighbours must be a whole number of at least 1, not {self.neighbours!r}")
        if not is_number(self.inset) or not 0.0 <= self.inset < 0.5:
            raise OptionError(f"inset must be at least 0 and below 0.5, not {self.inset!r}")

    def picture(self, samples: Iterable[NDArray[Any]], count: float) -> NDArray[np.float32]:
        """The picture, (height, width, 3). samples: parts (m, ``FILM_COLUMNS``); count: n, including samples
        without colour, which ``samples`` may omit."""
        makers: dict[str, Callable[[Iterable[NDArray[Any]]], Array]] = {
            "histogram": lambda parts: self._sums(parts, 1, 0)[0],
            "kernel": self._kernel,
            "variable": self._variable,
            "nearest": self._nearest,
        }
        scale = self.size[0] * self.size[1] / (1.0 - 2.0 * self.inset) ** 2 / count
        return (makers[self.estimator](samples) * scale).astype(np.float32)

    # ------------------------------------------------------------------ estimators: sums per pixel

    def _sums(self, parts: Iterable[NDArray[Any]], fine: int, pad: int) -> tuple[Array, Array]:
        """(sums of colours, numbers of samples) in cells: ``fine`` cells per pixel along an axis, with ``pad`` rows and
        columns around the picture."""
        width, height = (n * fine + 2 * pad for n in self.size)
        sums, counts = np.zeros((height * width, 3)), np.zeros(height * width)
        for part in parts:
            places = self._places(part) * (np.array(self.size) * fine) + pad
            x, y = np.floor(places).astype(np.int64).T
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            cell = (y * width + x)[inside]
            counts += np.bincount(cell, minlength=len(counts))
            for channel in range(3):
                sums[:, channel] += np.bincount(cell, part[inside, 2 + channel], len(counts))
        return sums.reshape(height, width, 3), counts.reshape(height, width)

    def _places(self, part: NDArray[Any]) -> Array:
        """Places in the unit square of the picture that is made."""
        places: Array = (part[:, :2].astype(np.float64) - self.inset) / (1.0 - 2.0 * self.inset)
        return places

    def _pad(self, width: float) -> int:
        """Number of cells around the picture from which kernels reach it and in which there may be samples."""
        most = (_MARGIN + self.inset) / (1.0 - 2.0 * self.inset) * max(self.size)
        pad = math.ceil(_FINE * min(_REACH * width, most))
        each = _CELL_BYTES if _REACH * width <= most else _WIDE_CELL_BYTES
        needed = each * math.prod(n * _FINE + 2 * pad for n in self.size)
        free = free_memory()
        if free is not None and needed > free:
            raise OptionError(
                f"a picture of {self.size[0]} x {self.size[1]} pixels with estimator={self.estimator} and "
                f"bandwidth={self.bandwidth:g} needs {needed / 1e9:.1f} GB, more than is free; lower its size, or "
                "bandwidth or inset"
            )
        return pad

    def _kernel(self, parts: Iterable[NDArray[Any]]) -> Array:
        pad = self._pad(self.bandwidth)
        sums, _ = self._sums(parts, _FINE, pad)
        return self._pixels(blurred(sums, self.bandwidth * _FINE, pad), pad)

    def _variable(self, parts: Iterable[NDArray[Any]]) -> Array:
        """Widths h (f / g)^(-1/2) with the density f of luminance by a fixed kernel of width 2 h, and its geometric
        mean g over the samples [Abramson 1982]."""
        pad = self._pad(self.bandwidth * _WIDEST)
        sums, counts = self._sums(parts, _FINE, pad)
        density = blurred(sums @ np.array(LUMINANCE), 2.0 * self.bandwidth * _FINE, pad)
        lit = (counts > 0) & (density > 0.0)
        if not lit.any():
            return self._pixels(sums, pad)
        ratio = np.clip(relative_widths(density[lit], counts[lit]), 1.0 / _WIDEST, _WIDEST)
        level = np.full(density.shape, round(math.log(_WIDEST) / math.log(_STEP)))
        level[lit] = np.round(np.log(ratio) / math.log(_STEP))
        total = np.zeros_like(sums)
        for one in np.unique(level[counts > 0]):
            chosen = (level == one)[:, :, None] * sums
            total += blurred(chosen, self.bandwidth * _STEP**one * _FINE, pad)
        return self._pixels(total, pad)

    def _nearest(self, parts: Iterable[NDArray[Any]]) -> Array:
        kept, count, free = [np.zeros((0, FILM_COLUMNS), np.float32)], 0, free_memory()
        for part in parts:
            kept.append(part[(part[:, 2:] > 0.0).any(axis=1)])
            count += len(kept[-1])
            if free is not None and _NEAREST_BYTES * count > free:
                raise OptionError(
                    f"estimator=nearest holds all samples in memory: {count} and more of them need over "
                    f"{_NEAREST_BYTES * count / 1e9:.1f} GB, more than is free; use another estimator"
                )
        rows = np.concatenate(kept)
        width, height = self.size
        result = np.zeros((height, width, 3))
        if not len(rows):
            return result
        y, x = np.mgrid[0:height, 0:width] + 0.5
        centres = np.stack([x.ravel(), y.ravel()], axis=1)
        # In pixels, so that the discs are round.
        places = self._places(rows) * np.array(self.size)
        for channel in range(3):
            weights = np.maximum(rows[:, 2 + channel], 0.0)
            if weights.any():
                found = Samples(places, weights, float(weights.sum()))
                nearest = NearestNeighbours(found, min(self.neighbours, len(found)), "epanechnikov")
                result[:, :, channel] = nearest(centres).reshape(height, width)
        return result

    def _pixels(self, fine: Array, pad: int) -> Array:
        """Sums over the cells of pixels, without the cells around the picture."""
        width, height = self.size
        inner = fine[pad : pad + height * _FINE, pad : pad + width * _FINE]
        sums: Array = inner.reshape(height, _FINE, width, _FINE, 3).sum(axis=(1, 3))
        return np.maximum(sums, 0.0)


def blurred(values: Array, width: float, pad: int) -> Array:
    """A grid convolved with a Gaussian of standard deviation ``width`` in cells. ``pad``: rows and columns at each side
    of the inner part; if the Gaussian reaches no further, the result is right in the inner part only."""
    factors, shape = [], []
    for cells in values.shape[:2]:
        if pad >= _REACH * width:
            count = cells  # values carried around the ends do not reach the inner part
            factors.append(np.exp(-2.0 * (np.pi * width * np.fft.fftfreq(count)) ** 2))
        else:
            count = 2 * cells  # so that no kernel reaches around the ends of the grid
            edges = (np.arange(-cells, cells + 1) - 0.5) / (width * math.sqrt(2.0))
            shares = 0.5 * np.diff([math.erf(edge) for edge in edges])
            factors.append(np.fft.fft(np.roll(shares, -cells)).real)
        shape.append(count)
    transform = np.fft.rfft2(values, shape, axes=(0, 1))
    factor = np.multiply.outer(factors[0], factors[1][: shape[1] // 2 + 1])
    transform *= factor.reshape(factor.shape + (1,) * (values.ndim - 2))
    result: Array = np.fft.irfft2(transform, shape, axes=(0, 1))[: values.shape[0], : values.shape[1]]
    return result
