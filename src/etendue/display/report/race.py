"""Equal-time and equal-error tables, from curves of the error over time.

Between two points a curve is a straight line on logarithmic axes, like errors that fall by a power of time; beyond its
points a curve has no values. An error counts as reached when the curve goes below it for the last time: a short dip is
not enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ..plots import Series
from .tables import Column, number_text, time_text

#: Equal times are the end of the shortest curve and this time halved up to so many times.
_HALVES = 3
#: Columns of equal errors.
_LEVELS = 4


@dataclass(frozen=True)
class Reached:
    """When a curve reaches an error. ``seconds``: this time; or the first time of a curve that is below the error from
    the beginning (``sign`` ``<``), or the last time of a curve that does not reach it (``sign`` ``>``)."""

    seconds: float
    sign: str = ""


def error_at(series: Series, seconds: float) -> float:
    """The error of a curve at a time, NaN before its first point and after its last."""
    points = _points(series)
    if not points or not points[0][0] <= seconds <= points[-1][0] * (1 + 1e-9):
        return math.nan
    for (t0, e0), (t1, e1) in pairwise(points):
        if seconds <= t1:
            share = math.log(seconds / t0) / math.log(t1 / t0)
            return math.exp((1 - share) * math.log(e0) + share * math.log(e1))
    return points[-1][1]


def time_to(series: Series, error: float) -> Reached | None:
    """When the error of a curve is below ``error`` for good; ``None`` for a curve without points."""
    points = _points(series)
    if not points:
        return None
    if points[-1][1] > error * (1 + 1e-9):
        return Reached(points[-1][0], ">")
    for (t0, e0), (t1, e1) in reversed(list(pairwise(points))):
        if e0 > error:
            share = math.log(e0 / error) / math.log(e0 / e1)
            return Reached(math.exp((1 - share) * math.log(t0) + share * math.log(t1)))
    return Reached(points[0][0], "<")


def over_seeds(curves: Sequence[Series]) -> list[tuple[float, float, float]]:
    """(seconds, mean error, standard error of the mean) of runs that differ by their seed: at the times of the first
    curve that all curves cover, and at the mean time of their ends. The standard error of one run is 0."""
    known = [_points(series) for series in curves]
    if not known or not all(known):
        return []
    end = min(points[-1][0] for points in known)
    rows = []
    for seconds in (t for t, _ in known[0] if t < end):
        errors = [error_at(series, seconds) for series in curves]
        if all(map(math.isfinite, errors)):
            rows.append((seconds, *_mean(errors)))
    seconds, _ = _mean([points[-1][0] for points in known])
    return [*rows, (seconds, *_mean([points[-1][1] for points in known]))]


def _mean(values: Sequence[float]) -> tuple[float, float]:
    """The mean and its standard error."""
    count = len(values)
    mean = sum(values) / count
    return mean, math.sqrt(sum((v - mean) ** 2 for v in values) / max(1, count - 1) / count)


def equal_times(curves: Sequence[Series]) -> list[Column]:
    """Errors at the same times: at the end of the shortest curve, and at halves of this time when all have begun."""
    known = [_points(series) for series in curves]
    if len(curves) < 2 or not all(known):
        return []
    first, last = max(p[0][0] for p in known), min(p[-1][0] for p in known)
    times = [last / 2**k for k in range(_HALVES, -1, -1)]
    return [
        Column.numbers(f"after {time_text(t)}", [error_at(series, t) for series in curves]) for t in times if t >= first
    ]


def equal_errors(curves: Sequence[Series]) -> list[Column]:
    """Times to the same errors: the errors at the ends of the curves, from the largest to the smallest."""
    known = [_points(series) for series in curves]
    if len(curves) < 2 or not all(known):
        return []
    columns = []
    for level in sorted({points[-1][1] for points in known}, reverse=True)[:_LEVELS]:
        reached = [r for series in curves if (r := time_to(series, level)) is not None]
        slowest = max((r.seconds for r in reached if not r.sign), default=math.nan)
        columns.append(
            Column(
                f"to {number_text(level)}",
                [_text(r, slowest) for r in reached],
                _fastest(reached),
            )
        )
    return columns


def _fastest(reached: Sequence[Reached]) -> int | None:
    """Number of the curve that reaches the error first, if that is certain."""
    done = [(r.seconds, r.sign, i) for i, r in enumerate(reached) if r.sign != ">"]
    if not done or len(reached) < 2:
        return None
    (seconds, _, index), *others = sorted(done)
    return index if all(other > seconds for other, sign, _ in others if sign != "<") else None


def _text(reached: Reached, slowest: float) -> str:
    if reached.sign == ">":
        return f"not in {time_text(reached.seconds)}"
    text = f"{'under ' if reached.sign else ''}{time_text(reached.seconds)}"
    factor = slowest / reached.seconds
    return f"{text} (×{number_text(factor, 2)})" if factor > 1.05 else text


def _points(series: Series) -> list[tuple[float, float]]:
    """Drawable points in order of time, one for each time."""
    return sorted({point[0]: point[1] for point in series.drawable()}.items())
