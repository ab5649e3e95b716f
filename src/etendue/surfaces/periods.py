"""Domains that are repeated without end along x and y."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from etendue.core import Array, logger

from .errors import PatchError

#: Lines and rays are at least this steep, their height over their length: so each leaves a periodic domain, after as
#: many periods as its height has in ten thousand heights.
LEAST_SLOPE = 1e-4
#: Lengths that differ by less than this share of a period are equal: rounding in files of single precision.
_SAME = 1e-5


def checked_period(period: Sequence[float], low: Array, high: Array) -> tuple[float, float] | None:
    """The period (Lx, Ly) of faces between two corners, 0 for a direction without; ``None`` if there is none at all.

    Warns of a gap between the faces and their repetition. Raises :class:`PatchError` for what is no period, and for
    faces that exceed it.
    """
    try:
        lengths = np.array(period, dtype=np.float64)
    except (TypeError, ValueError):
        lengths = np.empty(0)
    if lengths.shape != (2,) or not np.isfinite(lengths).all() or (lengths < 0).any():
        raise PatchError(f"a period is two lengths, along x and y, 0 for no repetition, not {period!r}")
    for axis, length, size in zip("xy", lengths, (high - low)[:2], strict=True):
        if length and size > (1 + _SAME) * length:
            raise PatchError(
                f"the mesh is {size:.6g} long in {axis}, more than its period of {length:.6g}: give a period that "
                "contains it, or cut the mesh"
            )
        if length and size < (1 - _SAME) * length:
            logger.warning(
                "the mesh is %.6g long in %s, its period %.6g: lines pass through the gap between its repetitions",
                *(size, axis, length),
            )
    return (float(lengths[0]), float(lengths[1])) if lengths.any() else None
