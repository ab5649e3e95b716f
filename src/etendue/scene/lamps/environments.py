"""Environment maps that are lit at a pole only.

Mitsuba samples an environment map by its values times the sine of the polar angle, both interpolated between texels. In
the first and in the last row the sine is zero: beside dark texels, their light has no density, or hardly any. Rows
between them, which change no value because values are interpolated linearly, make its density positive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..graph import plugin_name

if TYPE_CHECKING:
    import mitsuba as mi

#: Largest ratio of a texel of the first or last row to those beside it that samples well, and that is sampled at all.
_GOOD, _POSSIBLE = 4.0, 1e4


def light_poles(emitter: mi.Emitter) -> None:
    """Give an environment map that Mitsuba would not sample well more rows."""
    if plugin_name(emitter) == "envmap" and _steepness(emitter) > _GOOD:
        _double(emitter)


def is_unsampled(emitter: mi.Emitter) -> bool:
    """Whether Mitsuba has no density for some light of an environment map."""
    return plugin_name(emitter) == "envmap" and _steepness(emitter) > _POSSIBLE


def _steepness(emitter: mi.Emitter) -> float:
    """The largest ratio of the texels of a square at a pole to those of its other side."""
    import mitsuba as mi

    rows = np.asarray(mi.traverse(emitter)["data"])
    largest = 0.0
    for ends in (rows[:2], rows[-2:][::-1]):
        pole, beside = ends.mean(axis=2, dtype=np.float64)
        lit, dim = np.maximum(pole[:-1], pole[1:]), np.maximum(beside[:-1], beside[1:])
        with np.errstate(divide="ignore", invalid="ignore"):
            largest = max(largest, float(np.where(lit > 0.0, lit / dim, 0.0).max()))
    return largest


def _double(emitter: mi.Emitter) -> None:
    """Insert a row between every two rows of an environment map."""
    import mitsuba as mi

    parameters = mi.traverse(emitter)
    rows = np.asarray(parameters["data"])
    more = np.empty((2 * len(rows) - 1, *rows.shape[1:]), np.float32)
    more[::2], more[1::2] = rows, 0.5 * (rows[:-1] + rows[1:])
    parameters["data"] = mi.TensorXf(more)
    parameters.update()
