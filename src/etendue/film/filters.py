"""The reconstruction filter of a film, for camera paths and light splats alike.

Pixel ``c`` of a film is

    I_c = 1/Z_c  integral over the film of f(x - c - 1/2) L(x) dx,    Z_c = integral over the film of f(x - c - 1/2),

which is what Mitsuba's film converges to: it divides by the filter weights of its samples, and has no samples outside
the film (``sample_border`` off). There are these estimators of this integral:

- Camera paths with the same offsets in all pixels: every path contributes to all pixels within the filter's radius, and
  the sum is a convolution with weights that depend only on the offsets (:meth:`PixelFilter.spread`). Near the border
  the sum is divided by the weights of the samples of the pass.
- A path at an arbitrary film position contributes to all pixels within the radius (:meth:`PixelFilter.taps`), or to a
  cell of a grid that is convolved at the end of the pass (:meth:`PixelFilter.cells`).
- Independent pixels, as denoisers need: a camera path samples its film position from ``|f|`` around its pixel
  [Ernst 2006] (:meth:`PixelFilter.camera`), a splat samples one of the pixels within the radius
  (:meth:`PixelFilter.splat`).

All read the same table of ``f``, or weights derived from it. The table is constant on bins, and the film's border is an
edge of bins, so that the expectations are equal, except for the first estimator near the border. In the table ``f`` is
divided by its sum over all pixels, so that the weights of a sample sum to 1 and a constant picture stays constant; for
tents, cubic splines and boxes this sum is 1, for Mitsuba's Gaussian it is 1 within 1.5 %.

Filters are separable, so everything is computed per axis. The weight has the sign of negative lobes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, on_device

from .cells import PER_PIXEL, CellAxis, CellGrid, cell_weights

V = TypeVar("V")

#: Bins of the table per pixel: a filter of radius 1 has this many on either side.
BINS_PER_PIXEL = 1024
_BINS_PER_CELL = BINS_PER_PIXEL // PER_PIXEL
#: A filter is divided by its sum over pixels if this is within 0.5 of 1; narrower filters leave gaps between pixels.
_NEAR_ONE = 0.5
#: Points of the midpoint rule in a bin, whose value is the mean of the filter.
_POINTS_PER_BIN = 4


class FilterTable:
    """A reconstruction filter on the host: ``values[i]`` is its mean over bin ``i`` of ``[-reach, reach]``.

    ``reach`` is the radius rounded up to half pixels, so that pixel edges are bin edges.
    """

    def __init__(self, rfilter: mi.ReconstructionFilter) -> None:
        radius = float(rfilter.radius())
        self.reach = max(math.ceil(2.0 * radius - 1e-6), 1) / 2.0
        count = round(2.0 * self.reach * BINS_PER_PIXEL)
        points = (np.arange(count * _POINTS_PER_BIN) + 0.5) / (_POINTS_PER_BIN * BINS_PER_PIXEL) - self.reach
        sampled = np.array(rfilter.eval(on_device(mi.Float, points)), dtype=np.float64)
        # Filters that are fitted polynomials have arbitrary values outside their radius.
        sampled[np.abs(points) > radius] = 0.0
        self.values: NDArray[np.float64] = sampled.reshape(count, _POINTS_PER_BIN).mean(axis=1)
        if not np.isfinite(self.values).all() or not np.abs(self.values).sum() > 0.0:
            raise OptionError("the film's reconstruction filter has no finite, non-zero values; use another rfilter")
        self.values /= self.values.sum() / BINS_PER_PIXEL  # unit integral, against overflow in single precision
        over_pixels = self.values.reshape(-1, BINS_PER_PIXEL).sum(axis=0)
        #: Whether some film positions are outside the radius of all pixels.
        self.has_gaps = bool(np.abs(over_pixels - 1.0).max() >= _NEAR_ONE)
        if not self.has_gaps:
            self.values /= np.tile(over_pixels, self.candidates)

    @property
    def candidates(self) -> int:
        """Pixels within the radius of one film position, along one axis."""
        return round(2.0 * self.reach)

    def truncation(self, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First bin and end bin (excluded) on the film, for each of ``size`` pixels of an axis."""
        pixel = np.arange(size)
        half = BINS_PER_PIXEL // 2
        to_left, to_right = pixel * BINS_PER_PIXEL + half, (size - pixel) * BINS_PER_PIXEL - half
        zero = len(self.values) // 2
        return np.maximum(zero - to_left, 0), np.minimum(zero + to_right, len(self.values))

    def integrals(self, size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """``Z`` and ``A``: the integrals of ``f`` and of ``|f|`` over the film, for each of ``size`` pixels."""
        first, end = self.truncation(size)
        signed = np.concatenate([[0.0], np.cumsum(self.values)]) / BINS_PER_PIXEL
        absolute = np.concatenate([[0.0], np.cumsum(np.abs(self.values))]) / BINS_PER_PIXEL
        return signed[end] - signed[first], absolute[end] - absolute[first]


class _Axis:
    """The filter along one axis of ``size`` pixels: tables and lookups."""

    def __init__(self, table: FilterTable, size: int) -> None:
        self.size = size
        self.bins = len(table.values)
        self.reach = table.reach
        self.candidates = table.candidates
        integral, magnitude = table.integrals(size)
        cumulative = np.concatenate([[0.0], np.cumsum(np.abs(table.values))]) / BINS_PER_PIXEL
        self.cumulative = on_device(mi.Float, cumulative)
        self.values = on_device(mi.Float, table.values)
        self.host_values = table.values.astype(np.float32)
        self.inverse_integral = on_device(mi.Float, 1.0 / integral)
        self.camera_weight = on_device(mi.Float, magnitude / integral)
        pixel, middle = np.arange(size), size // 2
        alike = np.where(np.minimum(pixel, size - 1 - pixel) > math.ceil(self.reach), middle, pixel)
        #: Pixels with different weights: those near the border, and the middle one for all others; which of them each
        #: pixel is.
        self.by_border, which = np.unique(alike, return_inverse=True)
        self.border = on_device(mi.UInt32, which)
        self.cell_weights = cell_weights(table.values, _BINS_PER_CELL)

    def cells(self, u: float) -> CellAxis:
        """The cells of splats along this axis, shifted by ``u``."""
        assert self.cell_weights is not None
        return CellAxis(self.cell_weights, _BINS_PER_CELL, self.inverse_integral, u)

    def camera(self, pixel: mi.UInt32, u: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Film position sampled from ``|f|`` around ``pixel``, and its signed weight."""
        per_pixel, zero = BINS_PER_PIXEL, self.bins // 2
        to_left = mi.Int32(pixel) * per_pixel + per_pixel // 2
        first = mi.UInt32(dr.maximum(zero - to_left, 0))
        end = mi.UInt32(dr.minimum(zero + self.size * per_pixel - to_left, self.bins))
        below = dr.gather(mi.Float, self.cumulative, first)
        above = dr.gather(mi.Float, self.cumulative, end)
        target = dr.fma(u, above - below, below)
        # Inversion, which preserves the stratification of the numbers.
        found = dr.binary_search(
            0, self.bins - 1, lambda index: dr.gather(mi.Float, self.cumulative, index + 1) <= target
        )
        chosen = dr.clip(found, first, end - 1)
        value = dr.gather(mi.Float, self.values, chosen)
        inside = (target - dr.gather(mi.Float, self.cumulative, chosen)) * per_pixel / dr.abs(value)
        inside = dr.select(value != 0.0, dr.clip(inside, 0.0, 1.0), 0.5)
        offset = (mi.Float(chosen) + inside) / per_pixel - self.reach
        position = dr.clip(mi.Float(pixel) + (0.5 + offset), 0.0, float(self.size))
        weight = dr.gather(mi.Float, self.camera_weight, pixel)
        return position, dr.mulsign(weight, value)

    def taps(self, position: mi.Float) -> list[tuple[mi.Int32, mi.Float, mi.Bool]]:
        """(pixel, value of the filter, whether the pixel is on the film) of every pixel within the radius of
        ``position``."""
        last = mi.Int32(dr.floor(position + (self.reach - 0.5)))
        found = []
        for index in range(self.candidates):
            pixel = last - (self.candidates - 1 - index)
            on_film = (pixel >= 0) & (pixel < self.size)
            found.append((pixel, self._value(position - (mi.Float(pixel) + 0.5), on_film), on_film))
        return found

    def _value(self, offset: mi.Float, active: mi.Bool | bool = True) -> mi.Float:
        """The filter at a distance from a pixel's centre."""
        place = dr.clip(mi.Int32(dr.floor((offset + self.reach) * BINS_PER_PIXEL)), 0, self.bins - 1)
        return dr.gather(mi.Float, self.values, mi.UInt32(place), active)

    def splat(self, position: mi.Float, u: mi.Float) -> tuple[mi.UInt32, mi.Float, mi.Bool]:
        """A pixel sampled from ``|f|`` among those within the radius of ``position``, its signed weight, and a mask of
        the valid lanes."""
        taps = self.taps(position)
        total = mi.Float(0.0)
        for _, value, _ in taps:
            total = total + dr.abs(value)
        target = u * total
        # Downwards: the pixel taken last is the lowest one whose cumulative sum exceeds the target.
        running = mi.Float(total)
        pixel, value = mi.Int32(0), mi.Float(0.0)
        for candidate, f, _ in reversed(taps):
            take = (running > target) & (f != 0.0)
            pixel = dr.select(take, candidate, pixel)
            value = dr.select(take, f, value)
            running = running - dr.abs(f)
        valid = self.holds(position) & (value != 0.0)
        chosen = mi.UInt32(pixel)
        return chosen, dr.mulsign(self.normalised(total, chosen, valid), value), valid

    def normalised(self, value: mi.Float, pixel: mi.Int32 | mi.UInt32, active: mi.Bool) -> mi.Float:
        """A value of the filter over its integral for ``pixel``."""
        return value * dr.gather(mi.Float, self.inverse_integral, mi.UInt32(pixel), active)

    def holds(self, position: mi.Float) -> mi.Bool:
        """Whether a position is on the film."""
        return (position >= 0.0) & (position <= float(self.size))

    def offsets(self, u: mi.Float) -> Spread:
        """Weights of samples at the offsets ``u`` in [0, 1) of their pixels for the surrounding pixels."""
        place = np.array(u, np.float32)  # on the host: they are few
        last = np.floor(place + (self.reach - 0.5)).astype(np.int32)
        shift = last[:, None] - np.arange(self.candidates - 1, -1, -1, dtype=np.int32)
        offset = place[:, None] - (shift.astype(np.float32) + 0.5)
        bins = np.floor((offset + self.reach) * BINS_PER_PIXEL).astype(np.int32)
        return Spread(last, self.host_values[np.clip(bins, 0, self.bins - 1)])

    def convolve(self, values: V, spread: Spread, place: mi.UInt32, stride: mi.UInt32 | int) -> V:
        """Sums of the weighted samples within the radius along this axis. ``values``: one lane a pixel, which has one
        sample; ``place``: the pixel's coordinate; ``stride``: lanes from one pixel to the next."""
        kind: type[mi.Color3f] = type(values)
        lane = mi.Int32(dr.arange(mi.UInt32, dr.width(values)))
        last, size, result = on_device(mi.Int32, spread.last), dr.opaque(mi.Int32, self.size), kind(0.0)
        for index, weight in enumerate(spread.values[0]):
            shift = last - (self.candidates - 1 - index)
            source = mi.Int32(place) - shift
            on_film = (source >= 0) & (source < size)
            sample = dr.gather(kind, values, mi.UInt32(lane - shift * mi.Int32(stride)), on_film)
            result = result + sample * on_device(mi.Float, weight)
        return result

    def near(
        self,
        values: list[V],
        weights: mi.Float,
        sample: mi.UInt32,
        pixel: mi.UInt32,
        place: mi.UInt32,
        count: mi.UInt32,
    ) -> list[V]:
        """As :meth:`convolve`, for several layers with ``count`` samples a pixel, of which only number ``sample`` is
        used; ``weights``: :meth:`Spread.rows`."""
        kinds: list[type[mi.Color3f]] = [type(layer) for layer in values]
        row, size = sample * (1 + self.candidates), dr.opaque(mi.Int32, self.size)
        last = mi.Int32(dr.gather(mi.Float, weights, row))
        results: list[V] = [kind(0.0) for kind in kinds]
        for index in range(self.candidates):
            shift = last - (self.candidates - 1 - index)
            source, weight = mi.Int32(place) - shift, dr.gather(mi.Float, weights, row + (1 + index))
            at, on_film = mi.UInt32(mi.Int32(pixel) - shift) * count + sample, (source >= 0) & (source < size)
            results = [
                result + dr.gather(kind, layer, at, on_film) * weight
                for kind, layer, result in zip(kinds, values, results, strict=True)
            ]
        return results

    def table(self, spread: Spread) -> tuple[mi.Float, range]:
        """(weights, a row for each sample and a column for each offset from the sample's own pixel; the offsets)."""
        last = spread.last
        offsets = range(int(last.min()) - self.candidates + 1, int(last.max()) + 1)
        dense = np.zeros((len(last), len(offsets)), np.float32)
        for row, end, weights in zip(dense, last - offsets.start + 1, spread.values, strict=True):
            row[end - self.candidates : end] = weights
        return on_device(mi.Float, dense.ravel()), offsets

    def reached(self, spread: Spread, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        """Sum of the filter over the samples on the film within the radius, for each sample number and each of
        ``pixels`` of the axis: (samples, pixels); 1 away from the border."""
        sums = np.zeros((len(spread.last), len(pixels)), np.float32)
        for index, values in enumerate(spread.values.T):
            source = pixels - (spread.last - (self.candidates - 1 - index))[:, None]
            sums += values[:, None] * ((source >= 0) & (source < self.size))
        return sums


@dataclass
class Spread:
    """Weights of the samples of a pixel for its neighbours along one axis, a row for each sample."""

    last: NDArray[np.int32]  #: offset of the last pixel within the radius of a sample from the sample's own pixel
    values: NDArray[np.float32]  #: (samples, pixels): the filter at the pixels up to the last one

    def rows(self) -> mi.Float:
        """On the device, for each sample: the last pixel, then the values."""
        return on_device(mi.Float, np.column_stack([self.last, self.values]))


class PixelFilter:
    """Reconstruction filter of a ``width`` x ``height`` film.

    ``rfilter`` is a Mitsuba reconstruction filter (``film.rfilter()``). Film positions are continuous, in pixels,
    with (0, 0) the corner of the first pixel (of the crop window, if the film has one). Built under a JIT variant. All
    methods but ``spread``, ``spread_together`` and ``cells`` use gathers only and may be called inside symbolic loops.
    """

    def __init__(self, rfilter: mi.ReconstructionFilter, width: int, height: int) -> None:
        self.width, self.height = int(width), int(height)
        #: The box filter needs neither a table nor random numbers for a splat.
        self.is_box = bool(rfilter.is_box_filter())
        #: Whether a sample may be outside the radius of all pixels: :meth:`spread` replaces such a filter by a box.
        self.has_gaps = False
        #: Distance in pixels, along an axis, of the last pixel to which a sample contributes; at least 1.
        self.reach = 1
        if not self.is_box:
            table = FilterTable(rfilter)
            self.has_gaps = table.has_gaps
            self.reach = max(1, math.floor(table.reach + 0.5))
            self._x = _Axis(table, self.width)
            self._y = self._x if self.width == self.height else _Axis(table, self.height)

    def camera(self, px: mi.UInt32, py: mi.UInt32, u1: mi.Float, u2: mi.Float) -> tuple[mi.Float, mi.Float, mi.Float]:
        """Film position for a camera path of pixel (``px``, ``py``), UInt32, from two numbers in [0, 1).

        Returns ``x``, ``y`` and the signed weight, a factor on the path's radiance. The pixel is the mean over its
        samples. The weight is 1 for filters without negative lobes.
        """
        if self.is_box:
            return mi.Float(px) + u1, mi.Float(py) + u2, mi.Float(1.0)
        x, weight_x = self._x.camera(px, u1)
        y, weight_y = self._y.camera(py, u2)
        return x, y, weight_x * weight_y

    def spread(self, values: V, u1: mi.Float, u2: mi.Float) -> V:
        """:meth:`spread_together` of one layer."""
        return self.spread_together([values], u1, u2)[0]

    def spread_together(self, values: list[V], u1: mi.Float, u2: mi.Float) -> list[V]:
        """Filtered sums of several layers over the samples, one lane a pixel. ``values``: one lane a sample, the
        samples of a pixel consecutive; sample j of each pixel has the offset (``u1[j]``, ``u2[j]``). Evaluates
        ``values``, but not the results.

        As in Mitsuba, pixels near the border are divided by the filter weights of their samples, so that a constant
        picture stays constant; the expectation there depends on the number of samples."""
        samples = dr.width(u1)
        if self.is_box or self.has_gaps:
            return [dr.block_sum(layer, samples) if samples > 1 else layer for layer in values]
        across, down = self._x.offsets(u1), self._y.offsets(u2)
        pixel, width = dr.arange(mi.UInt32, self.width * self.height), dr.opaque(mi.UInt32, self.width)
        y = pixel // width
        x = pixel - y * width
        dr.eval(values)
        inverse = self._inverse_reached(across, down, x, y)
        if samples == 1:  # a third of the memory
            rows = [self._x.convolve(layer, across, x, 1) for layer in values]
            dr.eval(rows)
            return [self._y.convolve(row, down, y, width) * inverse for row in rows]
        return [layer * inverse for layer in self._by_neighbour(values, across, down, x, y)]

    def _inverse_reached(self, across: Spread, down: Spread, x: mi.UInt32, y: mi.UInt32) -> mi.Float:
        """1 over the mean filter weight of the samples that reach each pixel; 1 away from the border."""
        # Pixels away from the border have equal weights, so that few rows and columns have to be multiplied. Not by
        # BLAS, whose threads would compete with the threads of Dr.Jit and take longer than everything else.
        columns, rows = self._x.by_border, self._y.by_border
        reached = np.einsum("si,sj->ij", self._y.reached(down, rows), self._x.reached(across, columns))
        inverse = on_device(mi.Float, np.float32(len(across.last)) / reached)
        place = dr.gather(mi.UInt32, self._y.border, y) * dr.opaque(mi.UInt32, len(columns))
        place += dr.gather(mi.UInt32, self._x.border, x)
        return dr.gather(mi.Float, inverse, place)

    def _by_neighbour(self, values: list[V], across: Spread, down: Spread, x: mi.UInt32, y: mi.UInt32) -> list[V]:
        """Sums over several samples a pixel, of all layers in one kernel: the samples of a pixel are first added along
        rows, with one sum for each row that they reach."""
        kinds: list[type[mi.Color3f]] = [type(layer) for layer in values]
        count, width, height = (dr.opaque(mi.UInt32, n) for n in (len(across.last), self.width, self.height))
        pixel, (table, offsets) = dr.arange(mi.UInt32, self.width * self.height), self._y.table(down)
        weights_across = across.rows()

        def add(sample: mi.UInt32, sums: list[list[V]]) -> tuple[mi.UInt32, list[list[V]]]:
            rows = self._x.near(values, weights_across, sample, pixel, x, count)
            weights = [dr.gather(mi.Float, table, sample * len(offsets) + place) for place in range(len(offsets))]
            return sample + 1, [
                [total + row * weight for total, weight in zip(each, weights, strict=True)]
                for each, row in zip(sums, rows, strict=True)
            ]

        empty: list[list[V]] = [[kind(0.0) for _ in offsets] for kind in kinds]
        _, sums = dr.while_loop((mi.UInt32(0), empty), lambda sample, _: sample < count, add, label="filter")
        dr.eval(sums)
        results: list[V] = [kind(0.0) for kind in kinds]
        for place, offset in enumerate(offsets):
            source = mi.Int32(y) - offset
            at, on_film = mi.UInt32(mi.Int32(pixel) - offset * mi.Int32(width)), source < mi.Int32(height)
            for number, (kind, each) in enumerate(zip(kinds, sums, strict=True)):
                results[number] = results[number] + dr.gather(kind, each[place], at, (source >= 0) & on_film)
        return results

    def taps(self, x: mi.Float, y: mi.Float) -> list[tuple[mi.UInt32, mi.Float, mi.Bool]]:
        """The pixels of a contribution at film position (``x``, ``y``): a list of (pixel index ``y * width + x``,
        signed weight, mask). The contribution is per unit of film area in pixels; the weight of pixel ``c`` is
        ``f(x - c - 1/2) / Z_c``. All masks are false off the film."""
        if self.is_box:
            return [self.splat(x, y, 0.5, 0.5)]
        on_film = self._x.holds(x) & self._y.holds(y)
        columns = [(pixel, self._x.normalised(value, pixel, valid), valid) for pixel, value, valid in self._x.taps(x)]
        rows = [(pixel, self._y.normalised(value, pixel, valid), valid) for pixel, value, valid in self._y.taps(y)]
        return [
            (mi.UInt32(row * self.width + column), row_weight * weight, on_film & row_valid & valid)
            for row, row_weight, row_valid in rows
            for column, weight, valid in columns
        ]

    def cells(self, u1: float, u2: float) -> CellGrid | None:
        """The cells to which the splats of a pass may be added in place of :meth:`taps`, shifted by two numbers in
        [0, 1); ``None`` if they save nothing or add too much variance."""
        if self.is_box or self.has_gaps or self._x.cell_weights is None:
            return None
        return CellGrid(self._x.cells(u1), self._y.cells(u2), self.width, self.height)

    def splat(
        self, x: mi.Float, y: mi.Float, u1: mi.Float | float, u2: mi.Float | float
    ) -> tuple[mi.UInt32, mi.Float, mi.Bool]:
        """One pixel for a contribution at film position (``x``, ``y``), sampled by two numbers in [0, 1).

        The contribution is per unit of film area in pixels. Returns the pixel index ``y * width + x``, the signed
        weight and a mask, false off the film, where the index is 0. The expected value added to pixel ``c`` is the
        contribution times ``f(x - c - 1/2) / Z_c``.
        """
        if self.is_box:
            valid = (x >= 0.0) & (x < float(self.width)) & (y >= 0.0) & (y < float(self.height))
            column, row = mi.UInt32(dr.maximum(x, 0.0)), mi.UInt32(dr.maximum(y, 0.0))
            return dr.select(valid, row * self.width + column, 0), mi.Float(1.0), valid
        column, weight_x, valid_x = self._x.splat(x, u1)
        row, weight_y, valid_y = self._y.splat(y, u2)
        valid = valid_x & valid_y
        index = dr.select(valid, row * self.width + column, 0)
        return index, dr.select(valid, weight_x * weight_y, 0.0), valid
