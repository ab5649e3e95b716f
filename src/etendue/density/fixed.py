"""Kernel estimators of one bandwidth: ``f(x) = sum_i w_i K((x - x_i) / h) / h^d`` over weights of sum 1.

[Silverman 1986, ch. 2 and 4; Leeson 2001, sec. 3.5] Bias ``h^2 m / 2`` times the Laplacian of the density, variance
``f R / (n h^d)``.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array
from etendue.integration import Domain

from .boundary import Boundary, check_boundary, reflected, share_inside
from .errors import DensityError
from .estimator import Estimator, positive
from .kernels import Kernel, kernel_of
from .samples import Frame, Points, Samples, Surface, uploaded
from .search.hashgrid import HashGrid

#: Smallest reach of a kernel relative to the extent of the samples.
_FINEST = 3e-6


class FixedKernel(Estimator):
    """Kernel estimator of bandwidth ``h``.

    Parameters
    ----------
    samples: :class:`Samples`, or positions.
    bandwidth: in the unit of the positions; see :func:`silverman` and :func:`cross_validation`.
    kernel: a :class:`Kernel` or its name.
    domain, boundary: the domain, as for :class:`etendue.integration.Box`, and the correction at its border:
        ``"reflect"``, ``"renormalise"`` or ``"none"``.
    surface: a :class:`Surface`; the estimate is divided by its area within the kernel.

    A query visits the samples within the kernel's reach. If these are thousands, :class:`BinnedKernel` is much faster.
    Raises :class:`DensityError`.
    """

    citations = ("Silverman1986", "Leeson2001", "Jones1993", "Green2008")

    def __init__(
        self,
        samples: Samples | Points,
        bandwidth: float,
        kernel: Kernel | str = "gaussian",
        domain: Domain | None = None,
        boundary: Boundary = "none",
        surface: Surface | None = None,
    ) -> None:
        super().__init__(samples, domain)
        self.bandwidth, self.kernel = positive("the bandwidth", bandwidth), kernel_of(kernel)
        check_boundary(boundary, ("none", "reflect", "renormalise"), domain)
        self.boundary, self.surface = boundary, check_surface(surface, self.samples.coordinates)
        positions, weights = self.samples.positions, self.samples.weights
        if boundary == "reflect":
            assert self.domain is not None
            reach = np.full(len(positions), self.bandwidth * self.kernel.reach)
            positions, owners = reflected(positions, reach, self.domain)
            weights = weights[owners]
        local = self.bandwidth / self._frame.unit
        if local * self.kernel.reach < _FINEST:
            raise DensityError(
                f"a bandwidth of {self.bandwidth:g} is too small for single precision with samples that are "
                f"{self._frame.unit:g} apart: enlarge it, or leave out distant samples"
            )
        self._h = dr.opaque(mi.Float, local)
        self._sum = _Sum(positions, weights, local, self.kernel, self.samples.dimension, self._frame)
        self._area = None
        if self.surface is not None:
            areas = self.surface.areas / self._frame.unit**2
            self._area = _Sum(self.surface.positions, areas, local, self.kernel, 2, self._frame)

    def _density(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        value = self._sum(point, active)
        if self._area is not None:
            return over(value, self._area(point, active))
        if self.boundary == "renormalise":
            assert self._local_domain is not None
            return over(value, share_inside(self.kernel, point, self._h, self._local_domain))
        return value


class Naive(FixedKernel):
    """The uniform kernel: number of samples within ``h``, over ``2 h n`` on a line, over ``pi h^2 n`` in the plane.

    Parameters are those of :class:`FixedKernel`, without ``kernel``.
    """

    def __init__(
        self,
        samples: Samples | Points,
        bandwidth: float,
        domain: Domain | None = None,
        boundary: Boundary = "none",
        surface: Surface | None = None,
    ) -> None:
        super().__init__(samples, bandwidth, "uniform", domain, boundary, surface)


class _Sum:
    """``sum_i w_i K(|x - x_i| / h) / h^d``, over the candidates of the grid."""

    def __init__(
        self, positions: Array, weights: Array, h: float, kernel: Kernel, dimension: int, frame: Frame
    ) -> None:
        local = frame.host(positions)
        points = frame.device(positions)
        lower, upper = np.zeros(3), np.zeros(3)
        lower[: local.shape[1]], upper[: local.shape[1]] = local.min(axis=0), local.max(axis=0)
        self._grid = HashGrid(points, h * kernel.reach, lower, upper)
        # Weights include the kernel's normalisation, computed in double precision.
        scaled = uploaded(weights * (kernel.normalisation(dimension) / h**dimension))
        self._packed = dr.zeros(mi.Float, 4 * len(positions))
        dr.scatter(self._packed, mi.Vector4f(*points, scaled), self._grid.destination)
        self._inverse = dr.opaque(mi.Float, h**-2)
        self._kernel = kernel
        dr.eval(self._packed)

    def __call__(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        query = self._grid.query(point, active)
        limit = self._kernel.reach**2

        def add(i: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            """All candidates are evaluated: selecting those within reach first would take longer."""
            sample = dr.gather(mi.Vector4f, self._packed, self._grid.candidate(query, i))
            x, y, z = sample.x - point.x, sample.y - point.y, sample.z - point.z
            t = dr.fma(x, x, dr.fma(y, y, z * z)) * self._inverse
            return i + 1, total + dr.select(t <= limit, sample.w * self._kernel.profile(dr.minimum(t, limit)), 0.0)

        start = (mi.UInt32(0), mi.Float(0))
        return dr.while_loop(start, lambda i, _: active & (i < query.total), add, label="density: sum")[1]


def over(value: mi.Float, share: mi.Float) -> mi.Float:
    """``value / share``, zero where no part of a kernel is inside."""
    return dr.select(share > 0, value / share, 0.0)


def check_surface(surface: Surface | None, coordinates: int) -> Surface | None:
    """The surface; raises :class:`DensityError` if it is none, or if the samples do not lie on surfaces."""
    if surface is not None and not (isinstance(surface, Surface) and coordinates == 3):
        raise DensityError("surface takes a Surface(positions, areas), and samples with three coordinates")
    return surface
