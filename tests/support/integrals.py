"""Functions with known integrals, on the host and on the device, and tests of an integrator over many seeds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import special, stats

from etendue.integration import Estimate, Integrand, Integrator, array_namespace


def _bell(x: Any) -> Any:
    return array_namespace(x[0]).exp(-10.0 * sum((v - 0.4) * (v - 0.4) for v in x))


def _one_bell() -> float:
    root = math.sqrt(10.0)
    return math.sqrt(math.pi) / (2 * root) * (special.erf(root * 0.6) + special.erf(root * 0.4))


#: name: (function, domain, range, integral).
KNOWN: dict[str, tuple[Any, Any, tuple[float, float], float]] = {
    "plane": (lambda x: x[0] + 2.0 * x[1], [(0, 1), (1, 3)], (2.0, 7.0), 9.0),
    "decay": (lambda x: array_namespace(x[0]).exp(-3.0 * x[0]) * x[1], 2, (0.0, 1.0), (1 - math.exp(-3)) / 6),
    "bell": (_bell, 3, (0.0, 1.0), _one_bell() ** 3),
    "sign": (
        lambda x: array_namespace(x[0]).sin(x[0]) * x[1],
        [(-1, 2), (0, 1)],
        (-1.0, 1.0),
        (math.cos(1) - math.cos(2)) / 2,
    ),
    # |s - 0.7| over the square, s = x + y: the mean of s is 1, and below 0.7 twice the missing wedge is added.
    "fold": (lambda x: array_namespace(x[0]).abs(x[0] + x[1] - 0.7), 2, (0.0, 1.3), 0.3 + 0.7**3 / 3),
}


def known(name: str, on: Any = "host") -> tuple[Integrand, float]:
    """A function and its integral."""
    function, domain, bounds, integral = KNOWN[name]
    return Integrand(function, domain, bounds, on), integral


def two_peaks(on: Any = "host", narrow: float = 2000.0) -> tuple[Integrand, float]:
    """Two narrow peaks in the square."""

    def peaks(x: Any) -> Any:
        first = (x[0] - 0.3) * (x[0] - 0.3) + (x[1] - 0.3) * (x[1] - 0.3)
        second = (x[0] - 0.7) * (x[0] - 0.7) + (x[1] - 0.8) * (x[1] - 0.8)
        return array_namespace(x[0]).exp(-narrow * first) + array_namespace(x[0]).exp(-narrow * second)

    return Integrand(peaks, 2, (0.0, 1.0), on), 2 * math.pi / narrow


def runs(integrator: Integrator, f: Integrand, samples: int, count: int, first: int = 0) -> list[Estimate]:
    """Estimates with ``count`` seeds."""
    return [integrator.integrate(f, samples, seed=first + s) for s in range(count)]


def spread(estimates: list[Estimate]) -> float:
    """Measured variance of estimates."""
    return float(np.var([e.value for e in estimates], ddof=1))


def assert_unbiased(estimates: list[Estimate], integral: float, what: Any = "") -> None:
    """The mean over seeds is the integral, by a t-test with the variance that was measured."""
    values = np.array([e.value for e in estimates])
    error = values.std(ddof=1) / math.sqrt(len(values))
    t = (values.mean() - integral) / max(error, 1e-13 * abs(integral))
    assert 2 * stats.t.sf(abs(t), len(values) - 1) > 1e-5, (
        f"{what}: {values.mean():.8g} +- {error:.2g}, not {integral:.8g}"
    )


def assert_honest(estimates: list[Estimate], integral: float, what: Any = "", freedom: float = math.inf) -> None:
    """95 % intervals hold the integral in as many runs as they should, and no standard error is far too large.

    ``freedom``: degrees of freedom of the standard error, where it comes from a few replicates.
    """
    values, errors = np.array([e.value for e in estimates]), np.array([e.standard_error for e in estimates])
    half = stats.norm.ppf(0.975) if math.isinf(freedom) else stats.t.ppf(0.975, freedom)
    covered = int((np.abs(values - integral) <= half * errors).sum())
    least = stats.binom.ppf(1e-5, len(values), 0.94)  # a standard error is an estimate too
    ratio = math.sqrt(float(np.mean(errors**2))) / values.std(ddof=1)
    report = f"{what}: {covered} of {len(values)} intervals hold {integral:.6g}; errors are {ratio:.2f} of the scatter"
    assert covered >= least, report
    assert 0.75 < ratio < 1.35, report
