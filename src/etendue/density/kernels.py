"""Kernels of density estimation: functions around zero with integral 1.

A kernel is a function ``k(t)`` of ``t = |u|^2``, the squared distance in bandwidths, with ``k(0) = 1``; the
normalisation depends on the dimension. All but the Gaussian are zero beyond ``|u| = 1`` [Silverman 1986, ch. 3; Leeson
2001, sec. 3.5]. Arrays may be NumPy's or Dr.Jit's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from etendue.core import suggest
from etendue.integration import array_namespace

from .errors import DensityError

#: Cut-off of the Gaussian in bandwidths: 6e-7 of it lies beyond on a line, 4e-6 in the plane.
_GAUSSIAN_REACH = 5.0
#: Bandwidths in the radius of a disc, for the Gaussian truncated by the disc.
_GAUSSIAN_DISC = 3.0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(96)


@dataclass(frozen=True)
class Kernel:
    """A kernel in one and two dimensions.

    Attributes
    ----------
    name: its key in :data:`KERNELS`.
    profile: ``k(t)`` for t from 0 to ``reach^2``; it must not be evaluated beyond.
    reach: the distance, in bandwidths, beyond which the kernel is zero.
    disc_scale: squared bandwidths in the radius of the disc of :meth:`on_disc`.
    """

    name: str
    profile: Callable[[Any], Any]
    _on_line: Callable[[Any], Any] = field(repr=False)  #: integral of k(v^2) over v from 0 to u >= 0
    _in_disc: Callable[[Any], Any] = field(repr=False)  #: integral of k(s) over s from 0 to t
    reach: float = 1.0
    disc_scale: float = 1.0

    def value(self, u: Any, dimension: int = 1) -> Any:
        """The kernel at distance ``u`` in bandwidths (of either sign), in ``dimension`` 1 or 2."""
        t = u * u
        inside = t <= self.reach**2
        clipped = array_namespace(t).minimum(t, self.reach**2)
        return _where(inside, self.normalisation(dimension) * self.profile(clipped) + 0.0 * t, 0.0 * t)

    def on_disc(self, t: Any) -> Any:
        """The kernel as a weight relative to the uniform disc: its mean over the disc is 1.

        t: squared distance over the squared radius of the disc, in [0, 1]. The Gaussian is cut off at three bandwidths.
        An estimate at x from points x_i of weight w_i is ``sum w_i on_disc(|x_i - x|^2 / r^2) / (pi r^2)``.
        """
        return self.profile(t * self.disc_scale) * (self.disc_scale / float(self._in_disc(self.disc_scale)))

    def mass(self, u: Any, dimension: int = 1) -> Any:
        """Share of the kernel between 0 and ``u`` (signed) on a line, within the distance ``u`` >= 0 in the plane."""
        lib = array_namespace(u)
        if dimension == 1:
            half = self.normalisation(1) * self._on_line(lib.minimum(abs(u), self.reach))
            return _where(u < 0, -half, half)
        t = lib.minimum(u * u, self.reach**2)
        return math.pi * self.normalisation(dimension) * self._in_disc(t)

    def normalisation(self, dimension: int) -> float:
        """``1 / integral of k(|u|^2)``."""
        return 1 / _integral(self, dimension, lambda k, t: k)

    def roughness(self, dimension: int) -> float:
        """Integral of the squared kernel: the variance of an estimate is ``f R / (n h^d)``."""
        return self.normalisation(dimension) ** 2 * _integral(self, dimension, lambda k, t: k * k)

    def second_moment(self, dimension: int) -> float:
        """Integral of ``u_1^2`` times the kernel: the bias of an estimate is ``h^2 m / 2`` times the Laplacian of f."""
        return self.normalisation(dimension) * _integral(self, dimension, lambda k, t: k * t) / dimension

    def canonical_bandwidth(self, dimension: int) -> float:
        """The bandwidths of two kernels that smooth alike have the ratio of these numbers [Marron 1988]."""
        ratio = self.roughness(dimension) / self.second_moment(dimension) ** 2
        return ratio ** (1 / (dimension + 4))


def _integral(kernel: Kernel, dimension: int, of: Callable[[Any, Any], Any]) -> float:
    """Integral of ``of(k(t), t)`` over the line or the plane; by quadrature along the radius, where it is smooth."""
    if dimension not in (1, 2):
        raise DensityError(f"kernels have one or two dimensions, not {dimension!r}; a surface has two")
    # The Gaussian is integrated until it falls below the rounding errors of double precision.
    end = 9.0 if kernel.reach > 1 else 1.0
    r = 0.5 * end * (_NODES + 1)
    shell = 2 * np.ones_like(r) if dimension == 1 else 2 * math.pi * r
    return float(0.5 * end * np.sum(_WEIGHTS * shell * of(kernel.profile(r * r) + 0 * r, r * r)))


def _where(mask: Any, yes: Any, no: Any) -> Any:
    lib = array_namespace(yes)
    return np.where(mask, yes, no)[()] if lib is np else lib.select(mask, yes, no)


def _power(name: str, exponent: int) -> Kernel:
    """``(1 - t)^exponent``."""

    def profile(t: Any) -> Any:
        value: Any = 1.0
        for _ in range(exponent):
            value = value * (1.0 - t)
        return value

    terms = [(-1) ** i * math.comb(exponent, i) / (2 * i + 1) for i in range(exponent + 1)]

    def on_line(u: Any) -> Any:
        value: Any = terms[-1]
        for term in reversed(terms[:-1]):
            value = value * (u * u) + term
        return value * u

    def in_disc(t: Any) -> Any:
        return (1.0 - profile(t) * (1.0 - t)) / (exponent + 1)

    return Kernel(name, profile, on_line, in_disc)


def _cosine_in_disc(t: Any) -> Any:
    lib, a = array_namespace(t), 0.5 * math.pi
    r = lib.sqrt(t)
    return 2 * (r * lib.sin(a * r) / a + (lib.cos(a * r) - 1.0) / (a * a))


def _gaussian_on_line(u: Any) -> Any:
    x = u * math.sqrt(0.5)
    erf = np.vectorize(math.erf, otypes=[float])(x)[()] if array_namespace(u) is np else array_namespace(u).erf(x)
    return math.sqrt(0.5 * math.pi) * erf


#: By name: the six kernels of [Leeson 2001, sec. 3.5] and the Gaussian.
KERNELS: dict[str, Kernel] = {
    kernel.name: kernel
    for kernel in (
        _power("uniform", 0),
        Kernel(
            "cone",
            lambda t: 1.0 - array_namespace(t).sqrt(t),
            lambda u: u - 0.5 * u * u,
            lambda t: t - 2 / 3 * t * array_namespace(t).sqrt(t),
        ),
        _power("epanechnikov", 1),
        _power("biweight", 2),
        _power("triweight", 3),
        Kernel(
            "cosine",
            lambda t: array_namespace(t).cos(0.5 * math.pi * array_namespace(t).sqrt(t)),
            lambda u: array_namespace(u).sin(0.5 * math.pi * u) * (2 / math.pi),
            _cosine_in_disc,
        ),
        Kernel(
            "gaussian",
            lambda t: array_namespace(t).exp(-0.5 * t),
            _gaussian_on_line,
            lambda t: 2.0 * (1.0 - array_namespace(t).exp(-0.5 * t)),
            reach=_GAUSSIAN_REACH,
            disc_scale=_GAUSSIAN_DISC**2,
        ),
    )
}


def kernel_of(kernel: Kernel | str) -> Kernel:
    """A kernel, or the one of that name; raises :class:`DensityError` if there is none."""
    if isinstance(kernel, Kernel):
        return kernel
    if kernel not in KERNELS:
        raise DensityError(f"there is no kernel {kernel!r}: {suggest(kernel, KERNELS)}")
    return KERNELS[kernel]
