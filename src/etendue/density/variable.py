"""Two-pass kernel estimators: each sample has its own bandwidth, ``f(x) = sum_j w_j K((x - x_j) / h_j) / h_j^d``.

The first pass finds sparse regions, the second uses wider kernels there, so that dark areas become smooth and bright
edges remain sharp [Breiman 1977; Abramson 1982; Silverman 1986, ch. 5; Leeson 2001, sec. 3.5 and 5.7.2].
"""

from __future__ import annotations

from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array
from etendue.integration import Box, Domain

from .boundary import Boundary, check_boundary, reflected
from .errors import DensityError
from .estimator import Estimator, neighbours, positive
from .fixed import FixedKernel
from .kernels import Kernel, kernel_of
from .samples import Frame, Points, Samples, box_of, by_place, uploaded
from .search.kdtree import KdTree

_BOUNDARIES = ("none", "reflect")


class SampleBandwidths(Estimator):
    """Kernel estimator with a bandwidth for each sample.

    Parameters
    ----------
    samples: :class:`Samples`, or positions.
    bandwidths: (n,), one for each sample that was not left out.
    kernel: a :class:`Kernel` or its name.
    domain, boundary: as for :class:`FixedKernel`; the correction is ``"reflect"`` or ``"none"``.

    Raises :class:`DensityError`.
    """

    citations: ClassVar[tuple[str, ...]] = ("Silverman1986", "Leeson2001", "Bentley1975")

    def __init__(
        self,
        samples: Samples | Points,
        bandwidths: ArrayLike,
        kernel: Kernel | str = "gaussian",
        domain: Domain | None = None,
        boundary: Boundary = "none",
    ) -> None:
        super().__init__(samples, domain)
        self.kernel = kernel_of(kernel)
        check_boundary(boundary, _BOUNDARIES, domain)
        h = np.asarray(bandwidths, dtype=np.float64)
        if h.shape != (len(self.samples),) or not (np.isfinite(h).all() and (h > 0).all()):
            raise DensityError(f"{len(self.samples)} samples need as many bandwidths, all above zero, not {h.shape}")
        self.bandwidths: Array = h
        positions: Array = self.samples.positions
        owners: NDArray[np.int64] = np.arange(len(h))
        if boundary == "reflect":
            assert self.domain is not None
            positions, owners = reflected(positions, h * self.kernel.reach, self.domain)
        local = h[owners] / self._frame.unit
        d = self.samples.dimension
        weights = self.samples.weights[owners] * self.kernel.normalisation(d) / local**d
        self._tree = KdTree(self._frame.device(positions), reach=uploaded(local * self.kernel.reach))
        # In tree order: weight with all factors, and ``1 / h_j^2``, the factor on squared distances.
        packed = mi.Vector2f(uploaded(weights), uploaded(local**-2.0))
        order = self._tree.order
        self._packed = dr.ravel(mi.Vector2f(dr.gather(mi.Float, packed.x, order), dr.gather(mi.Float, packed.y, order)))
        dr.eval(self._packed)

    def _density(self, point: mi.Point3f, active: mi.Bool) -> mi.Float:
        limit = self.kernel.reach**2

        def add(place: mi.UInt32, distance: mi.Float, total: mi.Float) -> mi.Float:
            sample = dr.gather(mi.Vector2f, self._packed, place)
            return total + sample.x * self.kernel.profile(dr.minimum(distance * sample.y, limit))

        return self._tree.covering(point, mi.Float(0), add, active)


class VariableKernel(SampleBandwidths):
    """Bandwidths from neighbours: ``h_j = h d_jk``, d_jk the distance from sample j to its k-th neighbour.

    Parameters are those of :class:`SampleBandwidths`, but instead of ``bandwidths`` the number ``k``, below the number
    of samples, and the factor ``h``. Raises :class:`DensityError`, also if k other samples coincide with a sample.
    """

    citations: ClassVar[tuple[str, ...]] = ("Breiman1977", "Silverman1986", "Leeson2001", "Bentley1975")

    def __init__(
        self,
        samples: Samples | Points,
        k: int,
        h: float = 1.0,
        kernel: Kernel | str = "gaussian",
        domain: Domain | None = None,
        boundary: Boundary = "none",
    ) -> None:
        checked = Samples.of(samples)
        self.k, self.h = neighbours(k, checked, len(checked) - 1), positive("the factor h", h)
        check_boundary(boundary, _BOUNDARIES, domain)
        mirror = None if boundary == "none" or domain is None else box_of(domain, checked)
        distance = neighbour_distances(checked, self.k, mirror)
        if not (distance > 0).all():
            raise DensityError(
                f"{np.count_nonzero(distance == 0)} samples have {self.k} others at their place, so no bandwidth: "
                "raise k, or use AdaptiveKernel"
            )
        super().__init__(checked, self.h * distance, kernel, domain, boundary)


class AdaptiveKernel(SampleBandwidths):
    """Bandwidths from a first estimate: ``h_j = h (f(x_j) / g)^-alpha``, g the geometric mean of the ``f(x_j)``.

    Parameters
    ----------
    samples, kernel, domain, boundary: as for :class:`SampleBandwidths`.
    bandwidth: h; also the bandwidth of the default ``pilot``.
    pilot: the first estimate, of the same samples; a histogram or a :class:`BinnedKernel` is enough. By default a
        :class:`FixedKernel`.
    alpha: 0 for a fixed kernel, 1/2 for the smallest bias [Abramson 1982], 1/d for widths like :class:`VariableKernel`.
    widest: bandwidths are at most this times h, so that samples in sparse regions do not affect the whole domain.
    """

    citations: ClassVar[tuple[str, ...]] = ("Abramson1982", "Silverman1986", "Leeson2001", "Bentley1975")

    def __init__(
        self,
        samples: Samples | Points,
        bandwidth: float,
        pilot: Estimator | None = None,
        alpha: float = 0.5,
        kernel: Kernel | str = "gaussian",
        domain: Domain | None = None,
        boundary: Boundary = "none",
        widest: float = 10.0,
    ) -> None:
        checked = Samples.of(samples)
        self.bandwidth = positive("the bandwidth", bandwidth)
        if not 0 <= alpha <= 1:
            raise DensityError(f"alpha must be from 0 to 1, not {alpha!r}")
        if pilot is None:
            pilot = FixedKernel(checked, self.bandwidth, kernel, domain, boundary)
        first = pilot(checked.positions[:, 0] if checked.coordinates == 1 else checked.positions)
        if not (np.isfinite(first) & (first > 0)).all():
            raise DensityError("the first estimate must be finite and above zero at every sample: widen its bandwidth")
        widths = np.minimum(relative_widths(first, checked.weights, alpha), positive("widest", widest))
        super().__init__(checked, self.bandwidth * widths, kernel, domain, boundary)


def relative_widths(first: Array, weights: Array, alpha: float = 0.5) -> Array:
    """``(f / g)^-alpha``, (n,), of a first estimate f above zero; g is its geometric mean, with weights not below zero
    [Abramson 1982]."""
    mean = np.exp(np.sum(weights * np.log(first)) / weights.sum())
    widths: Array = (first / mean) ** -float(alpha)
    return widths


def neighbour_distances(samples: Samples, k: int, mirror: Box | None = None) -> Array:
    """Distance from each sample to its k-th neighbour, excluding itself: (n,).

    With ``mirror`` the mirror images of samples at the border of this box count as neighbours, too; without them
    bandwidths grow there.
    """
    frame = Frame.around(samples)
    order = by_place(samples.positions)
    points = frame.device(samples.positions[order])
    dr.eval(points)

    def distances(tree: KdTree) -> Array:
        squared = tree.kth_distance_squared(points, dr.opaque(mi.UInt32, k + 1), dr.inf)
        result = np.empty(len(samples))
        result[order] = np.sqrt(np.array(squared, dtype=np.float64)) * frame.unit
        return result

    found = distances(KdTree(points))
    if mirror is None:
        return found
    images, _ = reflected(samples.positions, np.full(len(samples), found.max()), mirror)
    return distances(KdTree(frame.device(images)))
