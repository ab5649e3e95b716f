"""Domains that are repeated without end along x and y."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, logger

from .errors import PatchError

#: Lines and rays are at least this steep, their height over their length: so each leaves a periodic domain, after as
#: many periods as its height has in ten thousand heights.
LEAST_SLOPE = 1e-4
#: Lengths that differ by less than this share of a period are equal: rounding in files of single precision.
_SAME = 1e-5
#: The same for the two ends of surfaces that go straight on, in sizes of their section.
_STRAIGHT = 1e-6


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


def endless_faces(
    vertices: Array, faces: NDArray[np.int64], period: tuple[float, float] | None
) -> NDArray[np.int64] | None:
    """Faces (f, 4) of surfaces without end along y, each from the first of its two corners at the lower end of the
    period; ``None`` unless the domain repeats along y only and all faces are rectangles from end to end."""
    if period is None or period[0] or (faces[:, 2] == faces[:, 3]).any():
        return None
    corners = vertices[faces]
    y = corners[..., 1]
    if np.ptp(y) < (1 - _SAME) * period[1]:
        return None  # a gap between the repetitions
    is_low, is_high = (np.abs(y - end) <= _SAME * period[1] for end in (y.min(), y.max()))
    first = np.argmax(is_low & np.roll(is_low, -1, axis=1), axis=1)
    order = (first[:, None] + np.arange(4)) % 4
    flat = np.take_along_axis(corners, order[..., None], axis=1)[..., ::2]
    off = np.abs(flat[:, :2] - flat[:, :1:-1]).max(axis=(1, 2))
    straight = (
        (is_low.sum(axis=1) == 2) & (is_high.sum(axis=1) == 2) & (off <= _STRAIGHT * np.ptp(flat, axis=(0, 1)).max())
    )
    return np.take_along_axis(faces, order, axis=1) if straight.all() else None
