"""Estimators on a grid of the domain: the histogram, and the fixed kernel on a fine grid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, is_whole
from etendue.integration import Box, Domain

from .boundary import Boundary, check_boundary
from .errors import DensityError
from .estimator import Estimator, positive
from .kernels import Kernel, kernel_of
from .samples import Points, Samples, uploaded

#: Largest number of cells of a grid (about 100 MB), and steps of a fine grid per bandwidth.
_MAX_CELLS = 1 << 22
_STEPS = 10


class Histogram(Estimator):
    """Share of the samples in a cell divided by the size of the cell: count / (n h) on a line.

    Parameters
    ----------
    samples: :class:`Samples`, or positions, on a line or in the plane.
    bins: number of bins, for all dimensions or for each.
    domain: by default the smallest box around the samples.
    areas: the size of each bin, of shape ``bins``, if it differs from that in the domain: for samples in (u, v) of a
        surface, the area of each texel. The density is then per this area.

    Attributes
    ----------
    values: density in each bin, (bins,) or (bins_u, bins_v).
    edges: edges of the bins, an array for each dimension.

    Raises :class:`DensityError`.
    """

    citations = ("Silverman1986", "Leeson2001")
    _searches = False

    def __init__(
        self,
        samples: Samples | Points,
        bins: int | Sequence[int],
        domain: Domain | None = None,
        areas: ArrayLike | None = None,
    ) -> None:
        checked = Samples.of(samples)
        super().__init__(checked, smallest_box(checked) if domain is None else domain)
        assert self.domain is not None
        shape = _shape(bins, checked.dimension)
        low, high = self.domain.lower, self.domain.upper
        self.edges = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, shape, strict=True)]
        sizes: float | Array = self.domain.volume / math.prod(shape)
        if areas is not None:
            sizes = np.asarray(areas, dtype=np.float64)
            if sizes.shape != shape or not (np.isfinite(sizes).all() and (sizes > 0).all()):
                raise DensityError(f"areas of bins are {shape} positive numbers, not an array {sizes.shape}")
        cells = np.array(shape)
        place = ((checked.positions - low) / np.array(self.domain.sides) * cells).astype(np.int64)
        index = np.ravel_multi_index(tuple(np.clip(place, 0, cells - 1).T), shape)
        shares = np.bincount(index, checked.weights, math.prod(shape)).reshape(shape)
        self.values: Array = np.asarray(shares * checked.mass / sizes)
        # The base class multiplies by the mass and the scale of the device, which the values already contain.
        self._table = uploaded(self.values.ravel() * (self._frame.unit**checked.dimension / checked.mass))
        self._shape = [dr.opaque(mi.Float, n) for n in shape]
        self._strides = [dr.opaque(mi.UInt32, math.prod(shape[i + 1 :])) for i in range(len(shape))]

    def _density(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        assert self._local_domain is not None
        index = mi.UInt32(0)
        for axis, (n, stride) in enumerate(zip(self._shape, self._strides, strict=True)):
            place = dr.clip(_steps(point[axis], axis, self._local_domain) * n, 0, n - 1)
            index = index + mi.UInt32(place) * stride
        return dr.gather(mi.Float, self._table, index, active)


class BinnedKernel(Estimator):
    """The estimate of :class:`FixedKernel`, approximated on a grid of a tenth of the bandwidth, on a line or in the
    plane.

    Samples are distributed linearly to the surrounding nodes, the grid is convolved with the kernel by FFT, and
    interpolated linearly [Wand 1994]. A million samples take a fraction of a second for any bandwidth, and queries cost
    almost nothing; the error is about 1e-3 of the largest density.

    Parameters are those of :class:`FixedKernel`, without ``surface``; the domain is by default the box around samples
    and their kernels. ``steps``: nodes in a bandwidth. ``values`` are the densities at the nodes, ``nodes`` their
    coordinates. Raises :class:`DensityError`, also if the grid would have more than 4 million nodes.
    """

    citations = ("Wand1994", "Silverman1986", "Leeson2001")
    _searches = False

    def __init__(
        self,
        samples: Samples | Points,
        bandwidth: float,
        kernel: Kernel | str = "gaussian",
        domain: Domain | None = None,
        boundary: Boundary = "none",
        steps: float = _STEPS,
    ) -> None:
        checked = Samples.of(samples)
        self.bandwidth, self.kernel = positive("the bandwidth", bandwidth), kernel_of(kernel)
        check_boundary(boundary, ("none", "reflect", "renormalise"), domain)
        step = self.bandwidth / positive("steps", steps)
        reach = self.bandwidth * self.kernel.reach
        super().__init__(checked, smallest_box(checked, reach) if domain is None else domain)
        assert self.domain is not None
        counts = [max(math.ceil(side / step), 1) + 1 for side in self.domain.sides]
        if math.prod(float(n) for n in counts) > _MAX_CELLS:
            raise DensityError(
                f"a bandwidth of {self.bandwidth:g} in {self.domain} takes {math.prod(counts)} nodes, the limit is "
                f"{_MAX_CELLS}: widen it, or use FixedKernel"
            )
        ends = zip(self.domain.lower, self.domain.upper, counts, strict=True)
        self.nodes = [np.linspace(a, b, n) for a, b, n in ends]
        spacing = [side / (n - 1) for side, n in zip(self.domain.sides, counts, strict=True)]
        shares = share_out(checked.positions, checked.weights, self.domain, tuple(counts))
        stencil = _stencil(self.kernel, self.bandwidth, spacing)
        values = _convolved(shares, stencil, boundary == "reflect")
        if boundary == "renormalise":
            area = np.full(counts, math.prod(spacing))
            for axis in range(area.ndim):  # nodes at either end stand for half a cell
                np.moveaxis(area, axis, 0)[[0, -1]] *= 0.5
            values /= np.maximum(_convolved(area, stencil, False), 1e-12)
        self.values: Array = np.maximum(values, 0.0) * checked.mass
        self._table = uploaded(self.values.ravel() * (self._frame.unit**checked.dimension / checked.mass))
        self._last = [dr.opaque(mi.UInt32, n - 1) for n in counts]
        self._strides = [dr.opaque(mi.UInt32, math.prod(counts[i + 1 :])) for i in range(len(counts))]

    def _density(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        assert self._local_domain is not None
        corners: list[tuple[mi.UInt32, mi.Float]] = [(mi.UInt32(0), mi.Float(1))]
        for axis, (last, stride) in enumerate(zip(self._last, self._strides, strict=True)):
            place = dr.clip(_steps(point[axis], axis, self._local_domain), 0, 1) * mi.Float(last)
            first = dr.minimum(mi.UInt32(place), last - 1)
            share = place - mi.Float(first)
            corners = [
                (index + node * stride, weight * part)
                for index, weight in corners
                for node, part in ((first, 1 - share), (first + 1, share))
            ]
        total = mi.Float(0)
        for index, weight in corners:
            total = total + weight * dr.gather(mi.Float, self._table, index, active)
        return total


def smallest_box(samples: Samples, margin: float = 0.0) -> Box:
    """The box of the samples, wider by ``margin`` at each end; raises :class:`DensityError` if it has no size."""
    lower, upper = samples.bounds
    if samples.coordinates == 3:
        raise DensityError("a grid needs samples on a line or in the plane: give surfaces by (u, v), with areas")
    if not (upper + margin > lower - margin).all():
        raise DensityError("all samples have the same coordinate, so their box is empty: give a domain")
    return Box(tuple(lower - margin), tuple(upper + margin))


def share_out(positions: Array, weights: Array, box: Box, counts: tuple[int, ...]) -> Array:
    """Weights distributed linearly over the nodes around each position: an array of shape ``counts``."""
    index, share = np.zeros(len(weights), dtype=np.int64), [weights]
    indices = [index]
    for axis, n in enumerate(counts):
        place = (positions[:, axis] - box.lower[axis]) * ((n - 1) / box.sides[axis])
        first = np.clip(place.astype(np.int64), 0, n - 2)
        upper = place - first
        indices = [i * n + first + side for i in indices for side in (0, 1)]
        share = [w * part for w in share for part in (1 - upper, upper)]
    size = math.prod(counts)
    total = sum(np.bincount(i, w, size) for i, w in zip(indices, share, strict=True))
    return np.asarray(total, dtype=np.float64).reshape(counts)


def _shape(bins: int | Sequence[int], dimension: int) -> tuple[int, ...]:
    numbers = [bins] * dimension if isinstance(bins, int | np.integer) else list(bins)
    whole = all(is_whole(n) and n > 0 for n in numbers)
    if len(numbers) != dimension or not whole or math.prod(int(n) for n in numbers) > _MAX_CELLS:
        raise DensityError(
            f"bins are a whole number above zero, or one for each of {dimension} dimensions, and {_MAX_CELLS} at most "
            f"in all, not {bins!r}"
        )
    return tuple(int(n) for n in numbers)


def _steps(x: mi.Float, axis: int, box: Box) -> mi.Float:
    """Position along an axis of the box, from 0 to 1."""
    return (x - dr.opaque(mi.Float, box.lower[axis])) * dr.opaque(mi.Float, 1 / box.sides[axis])


def _stencil(kernel: Kernel, bandwidth: float, spacing: Sequence[float]) -> Array:
    """The kernel at nodes around zero, normalised so that the sum times the spacing is 1."""
    axes = []
    for step in spacing:
        n = math.floor(bandwidth * kernel.reach / step)
        axes.append(np.arange(-n, n + 1) * (step / bandwidth))
    squares = sum(np.square(a) for a in np.meshgrid(*axes, indexing="ij"))
    values = kernel.value(np.sqrt(squares), len(spacing))
    return np.asarray(values / (values.sum() * math.prod(spacing)))


def _convolved(shares: Array, stencil: Array, mirror: bool) -> Array:
    """The grid convolved with the stencil; with ``mirror`` values outside are reflected at the border."""
    pads = [min(n // 2, m - 1) if mirror else 0 for n, m in zip(stencil.shape, shares.shape, strict=True)]
    if mirror:
        shares = shares.copy()
        for axis in range(shares.ndim):  # a node at the border is its own image
            np.moveaxis(shares, axis, 0)[[0, -1]] *= 2
        shares = np.pad(shares, [(p, p) for p in pads], mode="reflect")
    size = [_even(n + m - 1) for n, m in zip(shares.shape, stencil.shape, strict=True)]
    axes = tuple(range(len(size)))
    full = np.fft.irfftn(np.fft.rfftn(shares, size, axes) * np.fft.rfftn(stencil, size, axes), size, axes)
    begin = [n // 2 + p for n, p in zip(stencil.shape, pads, strict=True)]
    ends = [b + n - 2 * p for b, n, p in zip(begin, shares.shape, pads, strict=True)]
    return np.asarray(full[tuple(slice(b, e) for b, e in zip(begin, ends, strict=True))])


def _even(n: int) -> int:
    """The next number of the form 2^a, 3 2^a or 5 2^a, for a fast transform."""
    power = 1 << (n - 1).bit_length()
    return min(m for m in (power, power * 3 // 4, power * 5 // 8) if m >= n)
