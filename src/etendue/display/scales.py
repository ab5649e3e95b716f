"""Scales of round numbers: ticks of axes and legends."""

from __future__ import annotations

import math

#: Largest number of steps of a linear scale.
_STEPS = 8


def linear_ticks(low: float, high: float) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from ``low`` to ``high``: four to nine of them."""
    step = round_step(low, high)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]


def round_step(low: float, high: float) -> float:
    """The distance of linear ticks."""
    return round_up((high - low) / _STEPS)


def round_up(value: float) -> float:
    """The least 1, 2 or 5 times a power of ten that is not below ``value`` > 0."""
    return _rounded(value, up=True)


def round_down(value: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``value`` > 0."""
    return _rounded(value, up=False)


def _rounded(value: float, up: bool) -> float:
    decade = math.floor(math.log10(value))
    steps = [float(f"{lead}e{decade + more}") for more in (-1, 0, 1) for lead in (1, 2, 5)]
    if up:
        return next(step for step in steps if step >= value * (1 - 1e-9))
    return next(step for step in reversed(steps) if step <= value * (1 + 1e-9))


def logarithmic_ticks(low: float, high: float) -> list[tuple[float, bool]]:
    """(value, labelled) at multiples 1 to 9 of decades. Decades have labels; on short scales multiples as well."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    decades = math.log10(high / low)
    steps = range(1, 10) if decades < 0.8 else (1, 2, 5) if decades < 2.5 else (1,)
    every = 1 if decades <= 6 else 2
    found = []
    for exponent in range(first, last + 1):
        for step in range(1, 10):
            value = step * 10.0**exponent
            if low * (1 - 1e-9) <= value <= high * (1 + 1e-9):
                found.append((value, step in steps and exponent % every == 0))
    return found


def tick_text(value: float) -> str:
    """1000, 0.05, 10^-4."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.6g}"
    exponent = math.floor(math.log10(abs(value)) + 1e-9)
    lead = f"{value / 10.0**exponent:.3g}"
    return f"10^{exponent}" if lead == "1" else f"{lead}·10^{exponent}"
