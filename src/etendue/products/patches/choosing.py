"""What `auto` of form factors takes: integrals or lines, by their measured time."""

from __future__ import annotations

import time

from etendue.core import format_seconds
from etendue.radiosity import (
    EXACT_TOLERANCE,
    ABuffer,
    RadiosityError,
    SpiralPoints,
    exact_seconds,
    form_factors,
    split_for,
    with_local_rays,
)
from etendue.surfaces import Patches

#: Without an error to reach, integrals may take so many seconds.
_PATIENCE = 10.0
#: The least time that is told.
_LEAST = 0.1
#: Bundles by which the time of lines is estimated, and most lines of one.
_BUNDLES, _MOST_LINES = 32, 1 << 18


def choose(patches: Patches, error: float | None) -> tuple[bool, str]:
    """Whether form factors are integrated, and the reason: to an ``error`` of rows what takes less time, by some pairs
    and some lines; without one, integrals if they take a few seconds."""
    try:
        exact = exact_seconds(patches, error or EXACT_TOLERANCE)
    except RadiosityError as reason:
        return False, str(reason).partition(": cast lines")[0]
    takes = f"integrals take about {format_seconds(max(exact, _LEAST))}"
    if error is None:
        return exact <= _PATIENCE, takes
    lines = _seconds_of_lines(patches, error)
    return exact <= lines, f"to an error of {error:g} {takes}, lines {format_seconds(max(lines, _LEAST))}"


def _seconds_of_lines(patches: Patches, error: float) -> float:
    """The time of the lines that an error needs, by that of some of their bundles."""
    split = split_for(patches, error)
    points = SpiralPoints(0, _BUNDLES)  # a spiral of all bundles takes seconds to make, and its lines cost the same
    cast_lines = None if split is None else min(split.lines, _MOST_LINES)
    engine = ABuffer(patches, points, cast_lines)
    engine.cast(1, warn=False)  # loads or compiles
    began = time.perf_counter()
    lines = engine.cast(_BUNDLES, warn=False)
    cast = time.perf_counter()
    rows = form_factors(with_local_rays(lines)).row_errors().mean()
    counted = time.perf_counter() - cast
    # Too few surfaces in a large space: rays are cast instead, and their number grows as that of lines.
    bundles = _BUNDLES * float(rows / error) ** 2
    if split is not None and cast_lines is not None:
        bundles = split.bundles * split.lines / cast_lines
    return (cast - began) * max(bundles, 1) / _BUNDLES + counted
