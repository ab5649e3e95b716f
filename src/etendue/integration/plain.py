"""Integrators that draw independent points: hit-or-miss, mean sample, importance, control variate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from .backend import Numbers, Points
from .densities import Density
from .errors import IntegrationError
from .estimate import Estimate, Integrator, Moments, Work
from .functions import Integrand

#: Largest number of samples for fitting a factor or testing a density.
_PILOT = 1 << 12


def mean_of(work: Work, samples: int, values: Callable[[int], Numbers], scale: float) -> Estimate:
    """``scale`` times the mean of ``values(count)`` over batches, which are independent."""
    moments = Moments()
    for count in work.batches(samples):
        moments.add(count, *work.backend.moments(values(count)))
    return Estimate(moments.mean * scale, moments.standard_error * abs(scale), samples)


class MeanSample(Integrator):
    """``V/N sum f(x_i)`` with x_i uniform in the domain of volume V: plain Monte Carlo."""

    batched = True

    def _integrate(self, work: Work, samples: int) -> Estimate:
        backend, d = work.backend, work.dimension
        return mean_of(work, samples, lambda n: work.values(backend.uniform(n, d)), work.box.volume)

    def spread(self, work: Work, integrals: int, samples: int) -> tuple[Any, Any, int]:
        """See :class:`Integrator`."""
        u = work.backend.uniform(integrals * samples, work.dimension)
        return work.box.from_unit(u), work.box.volume, samples


class HitOrMiss(Integrator):
    """``V (a + (b - a) N_H / N)``, from the share of points (x, y), uniform in the domain and [a, b], with y <= f(x).

    The integrand must declare its range; [a, b] is that range, extended to zero. A value beyond it would be clipped
    silently, so it raises :class:`IntegrationError`.
    """

    def _integrate(self, work: Work, samples: int) -> Estimate:
        low, high = min(work.f.range[0], 0.0), max(work.f.range[1], 0.0)
        if not (math.isfinite(low) and math.isfinite(high)):
            raise IntegrationError(
                "hit-or-miss needs the bounds of the function: Integrand(..., range=(least, greatest))"
            )
        backend, d, scale = work.backend, work.dimension, high - low
        if scale == 0:
            return Estimate(low * work.box.volume, 0.0, samples)
        outside = Moments()
        slack = 1e-6 * scale

        def hits(count: int) -> Numbers:
            u = backend.uniform(count, d + 1)
            values = work.values(u[:d])
            beyond = backend.where((values < low - slack) | (values > high + slack), 1.0, backend.broadcast(0.0, u))
            outside.add(count, *backend.moments(beyond))
            return backend.where(u[d] * scale + low <= values, 1.0, backend.broadcast(0.0, u))

        found = mean_of(work, samples, hits, 1.0)
        if outside.mean > 0:
            raise IntegrationError(
                f"{round(outside.mean * samples)} of {samples} values leave the declared range "
                f"[{low:g}, {high:g}]: widen it"
            )
        volume = work.box.volume
        return Estimate(volume * (low + scale * found.value), volume * scale * found.standard_error, samples)


class Importance(Integrator):
    """``1/N sum f(x_i) / p(x_i)`` with x_i drawn from ``density``.

    ``density`` is a :class:`ProductDensity`, a :class:`Warp`, or another :class:`Density`. Its normalisation is checked
    by samples: if the mean of 1/p over its samples, relative to the volume, or the mean of p over uniform points is too
    large, it raises :class:`IntegrationError`.
    """

    batched = True

    def __init__(self, density: Density) -> None:
        self.density = density

    def spread(self, work: Work, integrals: int, samples: int) -> tuple[Any, Any, int]:
        """See :class:`Integrator`. That the density is normalised is not checked here."""
        self._check(work)
        backend = work.backend
        x, p = self.density.sample(backend, backend.uniform(integrals * samples, work.dimension))
        return x, backend.where(p > 0, 1.0 / backend.where(p > 0, p, 1.0), 0.0), samples

    def _check(self, work: Work) -> None:
        if self.density.domain != work.box:
            raise IntegrationError(f"the density is on {self.density.domain}, the function on {work.box}")

    def _integrate(self, work: Work, samples: int) -> Estimate:
        self._check(work)
        backend, d, volume = work.backend, work.dimension, work.box.volume
        inverse = Moments()

        def values(count: int) -> Numbers:
            x, p = self.density.sample(backend, backend.uniform(count, d))
            found = work.values_at(x, backend.where(p > 0, 1.0 / backend.where(p > 0, p, 1.0), 0.0))
            inverse.add(count, *backend.moments(backend.where(p > 0, 1.0 / (p * volume), 0.0)))
            return found

        estimate = mean_of(work, samples, values, 1.0)
        seen = Moments()
        for count in work.batches(min(samples, _PILOT)):
            p = self.density.pdf(backend, work.box.from_unit(backend.uniform(count, d)))
            seen.add(count, *backend.moments(backend.broadcast(p, [p]) * volume))
        # If samples miss a rare region, both means are too small: only a mean that is too large proves a fault.
        for found, integral in ((inverse, 1 / inverse.mean if inverse.mean else math.inf), (seen, seen.mean)):
            if not math.isfinite(found.mean) or found.mean - 1 > 8 * found.standard_error + 1e-3:
                raise IntegrationError(
                    f"the density is not normalised, or does not match its samples: it integrates to about "
                    f"{integral:.4g}, not to 1"
                )
        return estimate


class ControlVariate(Integrator):
    """``c I_g + V/N sum (f - c g)(x_i)`` for a function g like f whose integral I_g is known.

    Parameters
    ----------
    g: the known function, on the domain of f.
    integral: its integral over that domain.
    factor: c. ``None`` fits it, ``cov(f, g) / var(g)``, to a pilot of a tenth of the samples, which the estimate does
        not use, so that it stays unbiased.
    """

    def __init__(self, g: Integrand, integral: float, factor: float | None = 1.0) -> None:
        self.g, self.integral, self.factor = g, float(integral), factor

    def _integrate(self, work: Work, samples: int) -> Estimate:
        if self.g.domain != work.box:
            raise IntegrationError(f"the control variate is on {self.g.domain}, the function on {work.box}")
        backend, box, d = work.backend, work.box, work.dimension
        pilot, factor = 0, self.factor
        if factor is None:
            pilot = min(samples // 10, _PILOT)
            if pilot < 10:
                raise IntegrationError(f"{samples} samples are too few to fit a control variate's factor: at least 100")
            u = backend.uniform(pilot, d)
            f_values, g_values = backend.host(work.values(u)), backend.host(self._known(work, box.from_unit(u)))
            deviation = g_values - g_values.mean()
            spread = float(deviation @ deviation)
            factor = float(deviation @ f_values) / spread if spread > 0 else 1.0
        c = factor

        def values(count: int) -> Numbers:
            x = box.from_unit(backend.uniform(count, d))
            return work.values_at(x) - self._known(work, x) * c

        rest = mean_of(work, samples - pilot, values, box.volume)
        return Estimate(c * self.integral + rest.value, rest.standard_error, samples, details={"factor": c})

    def _known(self, work: Work, x: Points) -> Numbers:
        return work.backend.broadcast(self.g.evaluate(x), x)
