"""Limits of a run: seconds, samples, passes and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from etendue.core import OptionError, is_number


@dataclass(frozen=True)
class Budget:
    """Any combination of limits; the first one that is reached ends the run. ``None`` is no limit.

    ``seconds`` count from when the scene is loaded: preparation, compilation and passes, not the writing of files at
    the end. ``samples`` (camera paths per pixel), ``iterations`` (passes) and ``error``
    (:meth:`Measurement.relative_error`: noise, not bias) are limits of the picture, including the passes of earlier
    runs that are resumed. ``error`` is compared from ``stopping.LEAST_PASSES_FOR_ERROR`` passes on. Raises
    :class:`OptionError` for a limit that is not positive.
    """

    seconds: float | None = None
    samples: int | None = None
    iterations: int | None = None
    error: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "seconds", _positive("seconds", self.seconds))
        object.__setattr__(self, "error", _positive("error", self.error))
        object.__setattr__(self, "samples", check_count("samples per pixel", self.samples))
        object.__setattr__(self, "iterations", check_count("passes", self.iterations))

    def __bool__(self) -> bool:
        """Whether there is a limit."""
        return any(limit is not None for limit in (self.seconds, self.samples, self.iterations, self.error))

    def passes(self, samples_per_iteration: int) -> int | None:
        """Number of passes that ``samples`` and ``iterations`` allow; ``None`` if neither is limited."""
        limits = []
        if self.samples is not None:
            limits.append(-(-self.samples // max(1, samples_per_iteration)))
        if self.iterations is not None:
            limits.append(self.iterations)
        return min(limits, default=None)

    def to_dict(self) -> dict[str, Any]:
        """The limits that are set, for JSON."""
        return {name: value for name, value in vars(self).items() if value is not None}


def _positive(what: str, value: Any) -> float | None:
    if value is None:
        return None
    if not is_number(value) or value <= 0:
        raise OptionError(f"a budget in {what} must be a number above 0, not {value!r}")
    return float(value)


def check_count(what: str, value: Any) -> int | None:
    """A limit in ``what`` as a whole number. Raises :class:`OptionError`."""
    if value is None:
        return None
    if not is_number(value) or value < 1 or not float(value).is_integer():
        raise OptionError(f"a budget in {what} must be a whole number of at least 1, not {value!r}")
    return int(value)
