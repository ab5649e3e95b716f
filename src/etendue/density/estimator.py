"""The base class of estimators: a density that can be evaluated at NumPy or device points."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import is_whole, use_variant
from etendue.integration import Box, Domain

from .errors import DensityError
from .samples import Frame, Points, Samples, box_of, by_place, numbers, rows


class Estimator(ABC):
    """An estimate of the density of samples, a function of points.

    ``estimate(x)`` takes positions with as many coordinates as the samples. NumPy arrays, (m,) or (m, coordinates),
    give an array (m,); ``Float``, ``Point2f`` or ``Point3f`` give a ``Float``, also inside kernels and loops. Both are
    computed on the device, in single precision, relative to the median of the samples. Outside a given domain the
    density is zero; at points that are not finite it is NaN.
    """

    #: Papers, as keys of the bibliography.
    citations: ClassVar[tuple[str, ...]] = ()
    #: Whether the estimator searches for samples, so that sorted queries are faster.
    _searches: ClassVar[bool] = True

    def __init__(self, samples: Samples | Points, domain: Domain | None = None) -> None:
        use_variant()
        self.samples = Samples.of(samples)
        self.domain: Box | None = None if domain is None else box_of(domain, self.samples)
        self._frame = Frame.around(self.samples)
        self._local_domain = None if self.domain is None else self._frame.box(self.domain)

    def __call__(self, x: Any) -> Any:
        """The density at ``x``; raises :class:`DensityError` for points with another number of coordinates."""
        n = self.samples.coordinates
        scale = self.samples.mass / self._frame.unit**self.samples.dimension
        if dr.is_jit_v(x):
            if dr.depth_v(x) != (1 if n == 1 else 2) or (n > 1 and len(x) != n):
                raise DensityError(f"the samples have {n} coordinates, the points are {type(x).__name__}")
            return self._inside(self._frame.recorded(x, n)) * dr.opaque(mi.Float, scale)
        points = numbers(x)
        single = points.ndim < (1 if n == 1 else 2)
        columns = rows(points.reshape(-1) if n == 1 else np.atleast_2d(points))
        if columns.shape[1] != n or (n == 1 and points.ndim > 1):
            raise DensityError(f"the samples have {n} coordinates, the points are an array {points.shape}")
        if not len(columns):
            return np.zeros(0)
        order = by_place(columns) if self._searches else slice(None)
        local = self._frame.device(columns[order])
        dr.eval(local)
        values = np.empty(len(columns))
        values[order] = np.array(self._inside(local), dtype=np.float64) * scale
        return values[0] if single else values

    @abstractmethod
    def _density(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        """Density, of mass 1 and in local coordinates, at a local ``Point3f``."""

    def _inside(self, point: mi.Point3f) -> mi.Float:
        finite = dr.all(dr.isfinite(point))
        active = mi.Bool(finite)
        if self._local_domain is not None:
            for axis, (low, high) in enumerate(zip(self._local_domain.lower, self._local_domain.upper, strict=True)):
                # A point on the border in double precision may be outside after rounding.
                slack = 1e-6 * (high - low)
                active &= (point[axis] >= dr.opaque(mi.Float, low - slack)) & (
                    point[axis] <= dr.opaque(mi.Float, high + slack)
                )
        return dr.select(finite, dr.select(active, self._density(point, active), 0.0), dr.nan)


def positive(name: str, value: float) -> float:
    """A bandwidth or another number that must be finite and above zero; raises :class:`DensityError`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not 0 < number < math.inf:
        raise DensityError(f"{name} must be a number above zero, not {value!r}")
    return number


def neighbours(k: int, samples: Samples, most: int) -> int:
    """A number of neighbours, from 1 to ``most``; raises :class:`DensityError`."""
    if not is_whole(k) or not 1 <= k <= most:
        raise DensityError(f"k must be a whole number from 1 to {most} for {len(samples)} samples, not {k!r}")
    return int(k)
