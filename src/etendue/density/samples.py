"""Samples with weights, and surfaces as positions with areas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, copied_to_device, logger
from etendue.integration import Box, Domain

from .errors import DensityError

#: Positions: a host array, or device arrays.
Points: TypeAlias = "ArrayLike | mi.Float | mi.Point2f | mi.Point3f"


class Samples:
    """Points whose density is to be estimated: on a line, in the plane, or on surfaces in space.

    Parameters
    ----------
    positions: NumPy (n,), (n, 2) or (n, 3), or a ``Float``, ``Point2f`` or ``Point3f``. Three coordinates are those of
        points on surfaces, whose density is per area.
    weights: (n,), not negative; by default all equal. ``NaN`` and infinite positions or weights are counted in
        ``rejected``, reported by a warning, and left out.
    mass: integral of the density: 1 for a probability, the sum of the weights for the flux of photons.

    Raises :class:`DensityError` if no sample is left, for negative weights, and if all are zero.

    Attributes
    ----------
    positions: (n, coordinates), double precision.
    weights: (n,), of sum 1.
    rejected: number of samples that were left out.
    dimension: 1 on a line, 2 in the plane and on surfaces.
    """

    def __init__(self, positions: Points, weights: ArrayLike | None = None, mass: float = 1.0) -> None:
        x = rows(positions)
        if not np.isfinite(mass) or mass <= 0:
            raise DensityError(f"a density integrates to a positive number, not {mass!r}")
        w = np.ones(len(x)) if weights is None else np.array(weights, dtype=np.float64)
        if w.shape != (len(x),):
            raise DensityError(f"{len(x)} samples need as many weights, not an array of shape {w.shape}")
        if len(x) == 0:
            raise DensityError("there are no samples: a density needs at least one")
        finite = np.isfinite(x).all(axis=1) & np.isfinite(w)
        self.rejected = int(len(x) - np.count_nonzero(finite))
        if self.rejected == len(x):
            raise DensityError(f"none of {len(x)} samples has a finite position and weight")
        if self.rejected:
            logger.warning("%d of %d samples are not finite; they are left out", self.rejected, len(x))
            x, w = x[finite], w[finite]
        if w.min() < 0 or not 0 < w.sum() < np.inf:
            raise DensityError("weights of samples must not be negative, and not all zero")
        self.positions: Array = x
        self.weights: Array = w / w.sum()
        self.mass = float(mass)

    @classmethod
    def of(cls, samples: Points) -> Samples:
        """Samples from samples, or from positions."""
        return samples if isinstance(samples, Samples) else cls(samples)

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def coordinates(self) -> int:
        """Coordinates of a position."""
        return self.positions.shape[1]

    @property
    def dimension(self) -> int:
        """Dimension of the line, plane or surface."""
        return min(self.coordinates, 2)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Corners of the smallest box around the samples."""
        return self.positions.min(axis=0), self.positions.max(axis=0)

    @property
    def effective(self) -> float:
        """Effective number of samples: ``1 / sum w^2``."""
        return float(1 / np.sum(self.weights**2))

    def chosen(self, index: NDArray[np.integer[Any]], weights: ArrayLike | None = None) -> Samples:
        """The samples of an index array, which may repeat; for the bootstrap."""
        return Samples(self.positions[index], self.weights[index] if weights is None else weights, self.mass)


@dataclass(frozen=True)
class Surface:
    """Surfaces as points spread over them, each with the area (``areas``) that it represents.

    positions: (m, 3). areas: (m,), or a number for all. An estimator divides by the share of its kernel that lies on
    the surface, so that the estimate is not too low at edges, corners and bends. There must be several points per
    bandwidth. Raises :class:`DensityError` if there are no points, or for an area that is not positive.
    """

    positions: Array
    areas: Array

    def __init__(self, positions: ArrayLike, areas: ArrayLike) -> None:
        x = rows(positions)
        a = np.broadcast_to(np.asarray(areas, dtype=np.float64), (len(x),))
        if len(x) == 0 or x.shape[1] != 3:
            raise DensityError(f"a surface is points in space, (m, 3), not an array of shape {x.shape}")
        if not np.isfinite(x).all() or not (np.isfinite(a).all() and (a > 0).all()):
            raise DensityError("points of a surface must be finite, and their areas positive")
        object.__setattr__(self, "positions", x)
        object.__setattr__(self, "areas", a)


@dataclass(frozen=True)
class Frame:
    """Coordinates on the device: data are moved to zero and scaled to about 1 for single precision."""

    origin: Array
    unit: float

    @classmethod
    def around(cls, samples: Samples) -> Frame:
        """The frame of samples: the origin is their median, so that precision is best where most samples are, despite
        outliers."""
        lower, upper = samples.bounds
        extent = float(np.max(upper - lower))
        return cls(np.median(samples.positions, axis=0), extent if extent > 0 else 1.0)

    def host(self, x: Array) -> Array:
        """Local coordinates, (n, coordinates)."""
        return (x - self.origin) / self.unit

    def device(self, x: Array) -> mi.Point3f:
        """Local ``Point3f`` of positions in host coordinates; missing coordinates are zero."""
        local = self.host(x)
        sides = [uploaded(local[:, i]) for i in range(local.shape[1])]
        return mi.Point3f(*sides, *[dr.zeros(mi.Float, len(x))] * (3 - len(sides)))

    def recorded(self, x: mi.Float | mi.Point2f | mi.Point3f, coordinates: int) -> mi.Point3f:
        """Local ``Point3f`` of positions that are on the device."""
        sides = [x] if coordinates == 1 else [x[i] for i in range(coordinates)]
        inverse = dr.opaque(mi.Float, 1 / self.unit)
        local = [(side - dr.opaque(mi.Float, float(o))) * inverse for side, o in zip(sides, self.origin, strict=True)]
        return mi.Point3f(*local, *[mi.Float(0)] * (3 - len(local)))

    def box(self, box: Box) -> Box:
        """A box in local coordinates."""
        low, high = self.host(np.array([box.lower])), self.host(np.array([box.upper]))
        return Box(tuple(low[0]), tuple(high[0]))


def uploaded(values: Array) -> mi.Float:
    """Host numbers as a ``Float`` with memory of its own."""
    return copied_to_device(mi.Float, np.asarray(values, dtype=np.float32))


def by_place(points: Array) -> NDArray[np.int64]:
    """An order of points in which neighbours are near each other: coherent lanes are faster and use caches better.

    Morton order over 1024 cells per axis, three standard deviations to either side.
    """
    d = points.shape[1]
    finite = np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0)
    cell = (finite - finite.mean(axis=0)) / (6 * finite.std(axis=0) + 1e-300) + 0.5
    cell = (np.clip(cell, 0, 1) * 1023).astype(np.uint32)
    number = np.arange(1024, dtype=np.uint32)
    spread = np.bitwise_or.reduce([((number >> bit) & 1) << (bit * d) for bit in range(10)])
    key = np.bitwise_or.reduce([spread[column] << axis for axis, column in enumerate(cell.T)])
    return np.argsort(key)


def rows(positions: Points) -> Array:
    """Positions as (n, coordinates), in double precision; raises :class:`DensityError` for invalid ones."""
    if dr.is_jit_v(positions):
        x = np.array(positions, dtype=np.float64)
        x = x.T if x.ndim == 2 else x
    else:
        x = numbers(positions)
    if x.ndim == 1:
        x = x[:, None]
    if x.ndim != 2 or x.shape[1] not in (1, 2, 3):
        raise DensityError(f"positions are an array (n,), (n, 2) or (n, 3), not {x.shape}")
    return x


def numbers(values: Points) -> Array:
    """A new array of doubles; raises :class:`DensityError` for values that are not numbers."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise DensityError("positions are an array of numbers: (n,), (n, 2) or (n, 3)") from None


def box_of(domain: Domain, samples: Samples) -> Box:
    """The box of a domain that holds all samples, which lie on a line or in the plane; raises :class:`DensityError`."""
    if samples.coordinates == 3:
        raise DensityError("a domain is for samples on a line or in the plane: pass surface=Surface(positions, areas)")
    box = Box.of(domain)
    if box.dimension != samples.coordinates:
        raise DensityError(f"the domain has {box.dimension} dimensions, the samples have {samples.coordinates}")
    outside = ((samples.positions < box.lower) | (samples.positions > box.upper)).any(axis=1)
    if outside.any():
        raise DensityError(
            f"{np.count_nonzero(outside)} of {len(samples)} samples lie outside the domain {box}: enlarge it, or leave "
            "them out"
        )
    return box
