"""Choice of the samples of a pass, so that the passes divide a budget of samples."""

from __future__ import annotations

from typing import Any

from etendue.core import Method, OptionError, prepared
from etendue.scene import Problem


def fit_samples(method: Method, samples: int, problem: Problem, seed: int) -> Method:
    """``method``, or a copy whose passes divide ``samples`` (camera paths per pixel) by :func:`fitting_samples`.

    The result is prepared for ``problem`` with ``seed``. ``method`` is prepared beforehand only if
    ``samples_for`` does not know the samples of a pass (preparing may take as long as a pass); the caller then
    does it. Of a given ``samples_per_pass`` and of
    a method without this setting the passes remain as they are.
    """
    known = method.samples_for(problem)
    chosen = method.samples_per_iteration if known is None else known
    most = min(chosen, max(1, samples // method.passes_for(problem)))
    fitting = fitting_samples(samples, most)
    if fitting == chosen or getattr(method.settings, "samples_per_pass", 1) != 0:
        return method if known is None else prepared(method, problem, seed)
    kind: Any = type(method)
    fitted: Method = prepared(kind(method.settings.replace(samples_per_pass=fitting)), problem, seed)
    return fitted


def settle_samples(method: Method) -> None:
    """Write the samples per pass that a prepared method has chosen into its settings. They determine the random
    numbers, and another machine that resumes the run might choose differently."""
    if getattr(method.settings, "samples_per_pass", 1) == 0:
        kept: Any = method
        kept.settings = method.settings.replace(samples_per_pass=method.samples_per_iteration)


def fitting_samples(samples: int, most: int) -> int:
    """Camera paths per pixel and pass, at most ``most``, that divide ``samples`` without remainder if possible.

    The largest divisor of ``samples``, if it fills at least half of a pass; otherwise the size of equal passes that
    together exceed ``samples`` by less than one path each.
    """
    if samples < 1:
        raise OptionError(f"a rendering needs at least one sample per pixel, not {samples}")
    divisor = max(n for n in range(1, min(samples, most) + 1) if samples % n == 0)
    return divisor if 2 * divisor >= min(samples, most) else -(-samples // -(-samples // most))
