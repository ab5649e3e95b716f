"""Integrals over some parameters, as functions of the others.

``L = L_e + integral(K * L, ...)`` is the rendering equation; substituted into itself n times, it becomes a distribution
ray tracer of n bounces, with any integrator at each bounce [Leeson 2001, sec. 5.2].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.core import seed_key

from .backend import Numbers, array_namespace
from .errors import IntegrationError
from .estimate import Integrator, Work
from .functions import Integrand
from .plain import MeanSample


def integral(
    f: Integrand, over: Sequence[int], integrator: Integrator | None = None, samples: int = 16, seed: int = 0
) -> Integrand:
    """``y -> integral over x of f(y, x)``: the integral over the parameters ``over``, a function of the others.

    All points y are evaluated together, on the host or the device, each with ``samples`` points x of its own by
    ``integrator``: :class:`MeanSample`, :class:`Stratified`, :class:`QuasiMonteCarlo` or :class:`Importance`, whose
    points do not depend on the function. Any other integrator is run point by point on the host, which is slow.
    Each evaluation uses new random numbers, so that an unbiased integrator of this function stays unbiased. Nested
    integrals need different seeds: with equal seeds they use the same random numbers. The integrator of the outermost
    one may have any seed. The integral has as many values at a point as ``f``.
    """
    free = [a for a in range(f.dimension) if a not in over]
    if not free or len(free) + len(set(over)) != f.dimension:
        raise IntegrationError(f"the integral is over some of the parameters 0 to {f.dimension - 1}, not {list(over)}")
    axes = sorted(over)  # the order of the inner domain
    inner = f.fix({a: f.domain.lower[a] for a in free})
    outer = f.fix({a: f.domain.lower[a] for a in axes})
    calls = iter(range(1 << 62))
    method = integrator if integrator is not None else MeanSample()
    if not method.batched and (f.on == "device" or f.values > 1):
        raise IntegrationError(
            f"{type(method).__name__} takes one integral at a time, of a real function on the host; on the device an "
            "inner integral is by MeanSample, Stratified, QuasiMonteCarlo or Importance"
        )

    def together(y: Any) -> Any:
        number = next(calls)
        on_host = array_namespace(y[0]) is np
        work = Work(replace(inner, on="host" if on_host else "device", values=1), _inner_seed(seed, number))
        y = [work.backend.broadcast(v, y) for v in y]
        work.backend.compute(*y)  # else each of them would be evaluated separately when it is read
        points, weight, size = method.spread(work, len(y[0]), samples)
        place = work.backend.index(len(y[0]) * size) // size
        x: list[Any] = [None] * f.dimension
        for axis, values in zip(free, y, strict=True):
            x[axis] = work.backend.take(values, place)
        for axis, values in zip(axes, points, strict=True):
            x[axis] = values
        found = [work.backend.broadcast(v, x) * weight for v in f.parts(f.evaluate(x))]
        work.backend.compute(*found)
        means = [_mean_of_rows(v, size) for v in found]
        return means if f.values > 1 else means[0]

    def one_by_one(y: Any) -> Any:
        number = next(calls)
        points = np.stack([np.asarray(v, dtype=float) for v in y], axis=1)
        found = []
        for n, point in enumerate(points):
            at = f.fix(dict(zip(free, point, strict=True)))
            found.append(method.integrate(at, samples, _inner_seed(seed, number, n)).value)
        return np.array(found)

    volume = inner.domain.volume
    low, high = f.range
    return Integrand(
        together if method.batched else one_by_one,
        outer.domain,
        (low * volume, high * volume) if volume > 0.0 else (0.0, 0.0),
        f.on if method.batched else "host",
        values=f.values,
    )


def _inner_seed(seed: int, number: int, point: int = 0) -> int:
    """The seed of an evaluation, or of one point of it: a hash of 64 bits, apart from the small seeds that integrators
    are given, and from those of neighbours."""
    high, low = seed_key(seed, "inner integral", (number << 32) + point)
    return (high << 32) + low


def _mean_of_rows(values: Numbers, size: int) -> Any:
    """Means of ``size`` values in a row."""
    if array_namespace(values) is np:
        return values.reshape(-1, size).mean(axis=1)
    import drjit as dr

    return dr.block_sum(values, size) * (1.0 / size)
