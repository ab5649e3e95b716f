"""The density of the k nearest samples: ``f(x) = 1 / d^D sum_i w_i K((x - x_i) / d)``, d the distance of the k-th.

[Loftsgaarden 1965; Silverman 1986, ch. 5; Leeson 2001, sec. 3.5] The kernel is wide where samples are rare. The
estimate has kinks, and its tails fall as ``d^-D``: it does not integrate to 1.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.core import Array
from etendue.integration import Domain

from .boundary import Boundary, check_boundary, share_inside
from .estimator import Estimator, neighbours
from .fixed import check_surface, over
from .kernels import Kernel, kernel_of
from .samples import Frame, Points, Samples, Surface, uploaded
from .search.kdtree import KdTree


class NearestNeighbours(Estimator):
    """Density from the k nearest samples.

    Parameters
    ----------
    samples: :class:`Samples`, or positions.
    k: 1 to the number of samples.
    kernel: a :class:`Kernel` or its name.
    domain, boundary: as for :class:`FixedKernel`; the correction is ``"renormalise"`` or ``"none"``.
    surface: as for :class:`FixedKernel`.
    count_last: whether the k-th sample, at the rim of the disc, is counted. The formula counts it, which makes the
        estimate of the uniform kernel too large by ``k / (k - 1)`` on average; photon maps leave it out. For kernels
        that are zero at the rim there is no difference.

    Where k samples coincide with a point the density is infinite. Raises :class:`DensityError`.
    """

    citations = ("Loftsgaarden1965", "Silverman1986", "Leeson2001", "Bentley1975")

    def __init__(
        self,
        samples: Samples | Points,
        k: int,
        kernel: Kernel | str = "uniform",
        domain: Domain | None = None,
        boundary: Boundary = "none",
        surface: Surface | None = None,
        count_last: bool = True,
    ) -> None:
        super().__init__(samples, domain)
        self.k, self.kernel = neighbours(k, self.samples, len(self.samples)), kernel_of(kernel)
        check_boundary(boundary, ("none", "renormalise"), domain)
        self.boundary, self.surface = boundary, check_surface(surface, self.samples.coordinates)
        self.count_last = count_last
        self._k = dr.opaque(mi.UInt32, self.k)
        self._near = _Neighbourhood(self.samples.positions, self.samples.weights, self._frame)
        self._area = None
        if self.surface is not None:
            areas = self.surface.areas / self._frame.unit**2
            self._area = _Neighbourhood(self.surface.positions, areas, self._frame)

    def _density(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        kernel, dimension = self.kernel, self.samples.dimension
        squared = self._near.tree.kth_distance_squared(point, self._k, dr.inf, active)
        active = active & (squared > 0) & dr.isfinite(squared)
        total, last = self._near.total(point, squared, kernel, active)
        if not self.count_last:
            total = total - last * float(kernel.profile(1.0))
        size = squared if dimension == 2 else dr.sqrt(squared)
        value = total * kernel.normalisation(dimension) / size
        if self._area is not None:
            area, _ = self._area.total(point, squared, kernel, active)
            value = over(value, area * kernel.normalisation(2) / squared)
        elif self.boundary == "renormalise":
            assert self._local_domain is not None
            value = over(value, share_inside(kernel, point, dr.sqrt(squared), self._local_domain))
        return dr.select(squared > 0, value, dr.inf)


class _Neighbourhood:
    """Weighted points in a kd-tree."""

    def __init__(self, positions: Array, weights: Array, frame: Frame) -> None:
        self.tree = KdTree(frame.device(positions))
        self._weights = dr.gather(mi.Float, uploaded(weights), self.tree.order)
        dr.eval(self._weights)

    def total(self, point: mi.Point3f, squared: mi.Float, kernel: Kernel, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        """``sum w k(d^2 / squared)``, not normalised, and the weight of one point at this squared distance."""
        limit = kernel.reach**2

        def add(place: mi.UInt32, distance: mi.Float, state: tuple[mi.Float, mi.Float]) -> tuple[mi.Float, mi.Float]:
            weight = dr.gather(mi.Float, self._weights, place)
            t = dr.minimum(distance / squared, limit)
            return state[0] + weight * kernel.profile(t), dr.select(distance == squared, weight, state[1])

        start = (mi.Float(0), mi.Float(0))
        total: tuple[mi.Float, mi.Float] = self.tree.within(point, squared * limit, start, add, active)
        return total
