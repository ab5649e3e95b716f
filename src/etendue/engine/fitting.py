"""Samples of a pass that share a budget of samples, where the method may choose them."""

from __future__ import annotations

from typing import Any

from etendue.core import Method, OptionError
from etendue.scene import Problem


def fit_samples(method: Method, samples: int, problem: Problem, seed: int) -> Method:
    """``method``, or one like it whose passes share ``samples`` (camera paths per pixel) with :func:`fitting_samples`.

    Both are prepared for ``problem`` with ``seed``. A method that was told ``samples_per_pass``, or has no such
    setting, stays as it is.
    """
    most = method.samples_per_iteration
    fitting = fitting_samples(samples, most)
    if fitting == most or getattr(method.settings, "samples_per_pass", 1) != 0:
        return method
    kind: Any = type(method)
    fitted: Method = kind(method.settings.replace(samples_per_pass=fitting))
    fitted.prepare(problem, seed)
    return fitted


def settle_samples(method: Method) -> None:
    """Write the samples of a pass that a prepared method has chosen into its settings: they decide the random numbers,
    and a machine that goes on with the run may choose otherwise."""
    if getattr(method.settings, "samples_per_pass", 1) == 0:
        kept: Any = method
        kept.settings = method.settings.replace(samples_per_pass=method.samples_per_iteration)


def fitting_samples(samples: int, most: int) -> int:
    """Camera paths per pixel and pass, at most ``most``, that share ``samples`` without rest where that costs little.

    The largest divisor of ``samples`` if it fills at least half of a pass; otherwise passes of equal size that together
    exceed ``samples`` by less than one path each.
    """
    if samples < 1:
        raise OptionError(f"a rendering needs at least one sample per pixel, not {samples}")
    divisor = max(n for n in range(1, min(samples, most) + 1) if samples % n == 0)
    return divisor if 2 * divisor >= min(samples, most) else -(-samples // -(-samples // most))
