"""What `auto` of form factors takes: integrals or lines, by their measured time."""

from __future__ import annotations

import time

import numpy as np

from etendue.core import format_seconds
from etendue.points import OwenSobol
from etendue.radiosity import (
    EXACT_TOLERANCE,
    ABuffer,
    RadiosityError,
    exact_seconds,
    form_factors,
    with_local_rays,
)
from etendue.surfaces import Patches

#: Without an error to reach, integrals may take so many seconds.
_PATIENCE = 10.0
#: The least time that is told.
_LEAST = 0.1
#: Bundles by which the time of lines is estimated, and how it grows with the inverse of their error.
_BUNDLES, _POWER = 64, 1.5


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
    """The time of lines to this error of a row, averaged over patches."""
    ABuffer(patches, OwenSobol(4, seed=0)).cast(1, warn=False)  # loads or compiles
    began = time.perf_counter()
    segments = with_local_rays(ABuffer(patches, OwenSobol(4, seed=0)).cast(_BUNDLES, warn=False))
    spent = time.perf_counter() - began
    rows = float(np.mean(form_factors(segments).row_errors()))
    return spent * max((rows / error) ** _POWER, 1 / _BUNDLES)
