"""Integrals as functions: over some parameters by an integrator, of the others a function again.

``L = L_e + integral(K * L, ...)`` is the rendering equation; put into itself n times it is a distribution ray tracer
of n bounces, with whichever integrator at each [Leeson 2001, sec. 5.2].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .backend import library
from .errors import IntegrationError
from .estimate import Integrator, Work
from .functions import Integrand
from .plain import MeanSample


def integral(
    f: Integrand, over: Sequence[int], integrator: Integrator | None = None, samples: int = 16, seed: int = 0
) -> Integrand:
    """``y -> integral over x of f(y, x)``: the integral over the parameters ``over``, a function of the others.

    With :class:`MeanSample` all points are evaluated together, each with ``samples`` points x of its own, on the
    host or the device. Any other integrator is run point by point, on the host, and is as slow as that sounds. Each
    evaluation goes on with other random numbers, so that an unbiased integrator of this function stays unbiased.
    """
    free = [a for a in range(f.dimension) if a not in over]
    if not free or len(free) + len(set(over)) != f.dimension:
        raise IntegrationError(f"the integral is over some of the parameters 0 to {f.dimension - 1}, not {list(over)}")
    inner = f.fix({a: f.domain.lower[a] for a in free})
    outer = f.fix({a: f.domain.lower[a] for a in over})
    volume = inner.domain.volume
    calls = iter(range(1 << 62))
    method = integrator if integrator is not None else MeanSample()
    if f.on == "device" and not isinstance(method, MeanSample):
        raise IntegrationError("on the device an inner integral is by MeanSample only")

    def together(y: Any) -> Any:
        number = next(calls)
        on_host = library(y[0]) is np
        work = Work(Integrand(f.function, f.domain, on="host" if on_host else "device"), seed + (number << 20))
        count = len(y[0])
        u = work.backend.uniform(count * samples, len(over))
        place = work.backend.index(count * samples) // samples
        x: list[Any] = [None] * f.dimension
        for axis, values in zip(free, y, strict=True):
            x[axis] = work.backend.take(values, place)
        for axis, values in zip(over, inner.domain.from_unit(u), strict=True):
            x[axis] = values
        values = work.backend.broadcast(f.evaluate(x), x)
        if on_host:
            return values.reshape(count, samples).mean(axis=1) * volume
        import drjit as dr

        return dr.block_sum(values, samples) * (volume / samples)

    def one_by_one(y: Any) -> Any:
        number = next(calls)
        points = np.stack([np.asarray(v, dtype=float) for v in y], axis=1)
        return np.array(
            [
                method.integrate(f.fix(dict(zip(free, point, strict=True))), samples, seed + (number << 32) + n).value
                for n, point in enumerate(points)
            ]
        )

    low, high = f.range
    return Integrand(
        together if isinstance(method, MeanSample) else one_by_one,
        outer.domain,
        (low * volume, high * volume) if np.isfinite([low, high]).all() else f.range,
        f.on if isinstance(method, MeanSample) else "host",
    )
