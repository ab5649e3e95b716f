"""The estimate that integrators return, and the evaluation of integrands."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from etendue.core import is_number, logger

from .backend import Backend, DeviceBackend, HostBackend, Numbers, Points
from .errors import IntegrationError
from .functions import Domain, Integrand


@dataclass(frozen=True)
class Estimate:
    """An integral's estimate.

    Attributes
    ----------
    value, standard_error: the estimate and the square root of its estimated variance.
    samples: evaluations of the integrand that were used.
    rejected: of these, how many were not finite; they count as zero.
    details: further results of an integrator (``details["iterations"]`` of :class:`Vegas`, for example).
    """

    value: float
    standard_error: float
    samples: int
    rejected: int = 0
    details: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    def __str__(self) -> str:
        return f"{self.value:.8g} +- {self.standard_error:.2g} ({self.samples} samples)"

    @property
    def variance(self) -> float:
        """Estimated variance."""
        return self.standard_error**2


def combine(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of independent estimates of one integral, weighted by their inverse variances [Lepage 1978].

    The weights are estimates themselves, so a few samples in each give a slight bias. A variance of zero is replaced by
    the smallest positive variance of the others. ``details`` has ``chi2`` over ``degrees`` of freedom, which tests
    whether the estimates agree.
    """
    if not estimates:
        raise IntegrationError("there are no estimates to combine")
    positive = [e.variance for e in estimates if e.variance > 0]
    if not positive:
        weights = [float(e.samples) for e in estimates]
    else:
        weights = [1 / max(e.variance, min(positive)) for e in estimates]
    total = sum(weights)
    value = sum(w * e.value for w, e in zip(weights, estimates, strict=True)) / total
    chi2 = sum(w * (e.value - value) ** 2 for w, e in zip(weights, estimates, strict=True)) if positive else 0.0
    return Estimate(
        value,
        1 / math.sqrt(total) if positive else 0.0,
        sum(e.samples for e in estimates),
        sum(e.rejected for e in estimates),
        {"chi2": chi2, "degrees": len(estimates) - 1},
    )


def average(estimates: Sequence[Estimate]) -> Estimate:
    """Mean of independent estimates weighted by their samples: unbiased, for estimates with unreliable variances.

    Its variance is the larger of two: the variance stated by the estimates, and the variance between them.
    """
    if not estimates:
        raise IntegrationError("there are no estimates to combine")
    total = sum(e.samples for e in estimates)
    weights = [e.samples / total for e in estimates]
    value = sum(w * e.value for w, e in zip(weights, estimates, strict=True))
    stated = sum(w * w * e.variance for w, e in zip(weights, estimates, strict=True))
    scatter = sum((w * (e.value - value)) ** 2 for w, e in zip(weights, estimates, strict=True))
    count = len(estimates)
    variance = max(stated, scatter * count / (count - 1) if count > 1 else 0.0)
    return Estimate(value, math.sqrt(variance), total, sum(e.rejected for e in estimates))


class Work:
    """An integrand with its array backend; evaluates it and replaces values that are not finite."""

    def __init__(self, f: Integrand, seed: int) -> None:
        if f.values != 1:
            raise IntegrationError(
                f"the function has {f.values} values at a point, a real one is needed: f.dot(weights) adds them up"
            )
        self.f, self.box, self.seed = f, f.domain, seed
        self.backend: Backend = DeviceBackend(seed) if f.on == "device" else HostBackend(seed)

    @property
    def dimension(self) -> int:
        """Parameters of the integrand."""
        return self.box.dimension

    def values(self, u: Points, weight: Numbers | None = None) -> Numbers:
        """Values at points ``u`` of the unit cube, times ``weight``; those that are not finite are counted and set to
        zero."""
        return self.values_at(self.box.from_unit(u), weight)

    def values_at(self, x: Points, weight: Numbers | None = None) -> Numbers:
        """As :meth:`values`, at points of the domain."""
        values = self.backend.broadcast(self.f.evaluate(x), x)
        return self.backend.clean(values if weight is None else values * weight)

    def batches(self, samples: int, multiple: int = 1) -> Iterator[int]:
        """Batch sizes that add up to ``samples``, all but the last multiples of ``multiple``."""
        size = max(self.backend.batch // multiple, 1) * multiple
        while samples > 0:
            yield min(size, samples)
            samples -= size


class Moments:
    """Mean and variance of numbers in batches."""

    def __init__(self) -> None:
        self.count, self.mean, self._squares = 0, 0.0, 0.0

    def add(self, count: int, mean: float, squares: float) -> None:
        """Add a batch: its size, its mean, the sum of squared deviations from it [Chan 1983]."""
        total = self.count + count
        step = mean - self.mean
        self._squares += squares + step * step * self.count * count / total
        self.mean += step * count / total
        self.count = total

    @property
    def variance(self) -> float:
        """Unbiased variance of the numbers."""
        return self._squares / max(self.count - 1, 1)

    @property
    def standard_error(self) -> float:
        """Standard error of the mean."""
        return math.sqrt(self.variance / self.count)


class Integrator(ABC):
    """A numerical method for integrals over boxes. All have the same signature."""

    #: Whether its points are independent of the integrand, so that :meth:`spread` can serve many integrals at once.
    batched: ClassVar[bool] = False

    def integrate(self, f: Integrand, samples: int, seed: int = 0, domain: Domain | None = None) -> Estimate:
        """Integral of ``f`` over its domain, or a part ``domain`` of it, from at most ``samples`` evaluations.

        The same ``seed`` gives the same estimate on one kind of device. Values that are not finite are counted,
        reported by a warning, and replaced by zero, so that the estimate is the integral over the region where ``f`` is
        finite.
        Raises :class:`IntegrationError` if the samples are too few for the method, or if all values are not finite.
        """
        if not isinstance(f, Integrand):
            raise IntegrationError(
                f"an integrator takes an Integrand, not {type(f).__name__}: Integrand(function, domain)"
            )
        if not is_number(samples) or int(samples) != samples or samples < 2:
            raise IntegrationError(
                f"an estimate with an error needs a whole number of samples, at least 2, not {samples}"
            )
        if domain is not None:
            f = f.restrict(domain)
        work = Work(f, seed)
        result = self._integrate(work, int(samples))
        rejected = work.backend.rejected()
        if rejected >= result.samples:
            raise IntegrationError(
                f"none of {result.samples} values of the integrand was finite: check it on {f.domain}"
            )
        if rejected:
            logger.warning(
                "%d of %d values of the integrand were not finite; they count as zero", rejected, result.samples
            )
        return replace(result, rejected=rejected)

    @abstractmethod
    def _integrate(self, work: Work, samples: int) -> Estimate:
        """The estimate of ``work``, implemented by the method."""

    def spread(self, work: Work, integrals: int, samples: int) -> tuple[Any, Any, int]:
        """Points for many integrals over one domain: ``(x, weight, size)``, ``size <= samples`` consecutive points for
        each integral.

        The mean of ``f(x) * weight`` over the points of an integral estimates it, independently of the others.
        Raises :class:`IntegrationError` for a method that is not ``batched``.
        """
        raise IntegrationError(f"{type(self).__name__} adapts to the function, so it computes one integral at a time")
