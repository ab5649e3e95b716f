"""Rules for the bandwidth of a kernel estimator: by the spread of the samples, and by cross-validation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from etendue.core import Array, logger
from etendue.integration import Box

from .errors import DensityError
from .estimator import positive
from .histogram import share_out, smallest_box
from .kernels import KERNELS, Kernel, kernel_of
from .samples import Points, Samples

#: Nodes along an axis of the grid on which cross-validation adds up pairs, by dimension.
_NODES = {1: 1 << 14, 2: 1 << 10}
#: Candidate bandwidths relative to :func:`normal_reference`: first, last, number.
_TRIED = (0.05, 2.0, 60)


def normal_reference(samples: Samples | Points, kernel: Kernel | str = "gaussian") -> float:
    """The bandwidth with the smallest error for normal samples: for the Gaussian ``s (4 / ((d + 2) n))^(1 / (d + 4))``.

    s is the root mean square of the standard deviations along the axes [Silverman 1986, sec. 4.3.2]; n the effective
    number of samples. Too wide for densities with several peaks. Raises :class:`DensityError` if all samples coincide,
    and for samples on surfaces.
    """
    checked = _plain(samples)
    deviation = _deviations(checked)
    spread = math.sqrt(float(np.mean(deviation**2)))
    return _of_spread(spread, checked, (4 / (checked.dimension + 2)) ** (1 / (checked.dimension + 4)), kernel)


def silverman(samples: Samples | Points, kernel: Kernel | str = "gaussian") -> float:
    """Silverman's rule of thumb: on a line ``0.9 min(s, q / 1.34) n^(-1/5)`` for the Gaussian.

    q is the distance between the quartiles [Silverman 1986, eq. 3.31]. In the plane it is :func:`normal_reference`
    with the lesser of s and q / 1.34 for each axis. Raises the same errors.
    """
    checked = _plain(samples)
    deviation = _deviations(checked)
    quartiles = np.array([_quartile_distance(x, checked.weights) for x in checked.positions.T])
    robust = np.where(quartiles > 0, np.minimum(deviation, quartiles / 1.34), deviation)
    spread = math.sqrt(float(np.mean(robust**2)))
    return _of_spread(spread, checked, 0.9 if checked.dimension == 1 else 1.0, kernel)


def cross_validation(
    samples: Samples | Points, kernel: Kernel | str = "gaussian", bandwidths: ArrayLike | None = None
) -> tuple[float, Array, Array]:
    """The bandwidth that minimises ``int f^2 - 2 sum_i w_i f_without_i(x_i)``: (bandwidth, candidates, scores).

    Least-squares cross-validation [Bowman 1984; Silverman 1986, sec. 3.4.3] assumes nothing about the density, but has
    a large variance: a score estimates the integrated squared error plus a constant. It uses the Gaussian, for which
    the sum over all pairs is computed by a Fourier transform of a grid; the bandwidth is converted to other kernels
    [Marron 1988], the scores remain those of the Gaussian. A warning is given if the minimum is at an end of the
    candidates.

    bandwidths: the candidates; by default 60 from 0.05 to 2 times the :func:`normal_reference`. Raises
    :class:`DensityError` as that function, and for fewer than 2 samples.
    """
    checked = _plain(samples)
    if len(checked) < 2:
        raise DensityError("cross-validation leaves out one sample: it needs at least 2")
    to_gaussian = KERNELS["gaussian"].canonical_bandwidth(checked.dimension) / kernel_of(kernel).canonical_bandwidth(
        checked.dimension
    )
    if bandwidths is None:
        reference = normal_reference(checked)
        tried = reference * np.geomspace(*_TRIED)
    else:
        tried = np.array([positive("a bandwidth", h) for h in np.ravel(bandwidths)]) * to_gaussian
    if not len(tried):
        raise DensityError("there are no bandwidths to try")
    pairs = _Pairs(checked, float(tried.max()))
    if bandwidths is None and tried.max() >= pairs.finest:
        tried = tried[tried >= pairs.finest]
    if tried.min() < pairs.finest:
        raise DensityError(
            f"bandwidths below {pairs.finest / to_gaussian:g} are too small for the extent of the samples"
        )
    scores = np.array([pairs.score(h) for h in tried])
    best = int(np.argmin(scores))
    if len(tried) > 2 and best in (0, len(tried) - 1):
        logger.warning("cross-validation found its minimum at an end of the candidates: samples may be rounded")
    return float(tried[best] / to_gaussian), tried / to_gaussian, scores


class _Pairs:
    """``sum_ij w_i w_j g(x_i - x_j)`` for Gaussians g of any width, from the spectrum of a grid."""

    def __init__(self, samples: Samples, widest: float) -> None:
        d, n = samples.dimension, _NODES[samples.dimension]
        # The transform is periodic: pad by the reach of the widest Gaussian of a pair.
        box = smallest_box(samples, 4 * widest)
        box = Box(box.lower, tuple(low + max(box.sides) for low in box.lower))
        shares = share_out(samples.positions, samples.weights, box, (n,) * d)
        step = max(box.sides) / (n - 1)
        self.finest = 3 * step
        self._dimension, self._cell = d, (step * n) ** d
        spectrum = np.abs(np.fft.fftn(shares)) ** 2
        axis = np.fft.fftfreq(n, step) * (2 * math.pi)
        # Linear binning is a convolution with a hat function; divide by its transform.
        hat = np.sinc(axis * step / (2 * math.pi)) ** 2
        power, squares = (
            spectrum / np.multiply.reduce(np.meshgrid(*[hat**2] * d)),
            sum(np.square(w) for w in np.meshgrid(*[axis] * d)),
        )
        # Higher frequencies contribute less than exp(-40) for any width of ``finest`` or more.
        keep = squares * self.finest**2 < 80
        self._power, self._squares = power[keep], squares[keep]
        self._own = float(np.sum(samples.weights**2))

    def sum(self, width: float) -> float:
        """Sum over all pairs, including each sample with itself."""
        return float(np.sum(self._power * np.exp(-0.5 * width**2 * self._squares)) / self._cell)

    def score(self, h: float) -> float:
        """The criterion; with unequal weights, the correction for left-out samples is correct on average."""
        peak = (2 * math.pi * h * h) ** (-0.5 * self._dimension)
        others = (self.sum(h) - self._own * peak) / (1 - self._own)
        return self.sum(math.sqrt(2) * h) - 2 * others


def _plain(samples: Samples | Points) -> Samples:
    checked = Samples.of(samples)
    if checked.coordinates == 3:
        raise DensityError("rules for bandwidths are for samples on a line or in the plane, not on surfaces")
    return checked


def _deviations(samples: Samples) -> Array:
    """Standard deviation along each axis, unbiased for equal weights."""
    mean = samples.weights @ samples.positions
    effective = samples.effective
    if effective <= 1:
        raise DensityError("the spread of one sample is unknown: give a bandwidth")
    variance = samples.weights @ (samples.positions - mean) ** 2 * (effective / (effective - 1))
    if not variance.max() > 0:
        raise DensityError("all samples coincide: their spread gives no bandwidth")
    return np.asarray(np.sqrt(variance))


def _quartile_distance(x: Array, weights: Array) -> float:
    order = np.argsort(x)
    middle = np.cumsum(weights[order]) - 0.5 * weights[order]
    low, high = np.interp((0.25, 0.75), middle, x[order])
    return float(high - low)


def _of_spread(spread: float, samples: Samples, factor: float, kernel: Kernel | str) -> float:
    d = samples.dimension
    ratio = kernel_of(kernel).canonical_bandwidth(d) / KERNELS["gaussian"].canonical_bandwidth(d)
    return factor * spread * float(samples.effective) ** (-1 / (d + 4)) * ratio
