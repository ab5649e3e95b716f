"""Sums over stored segments on a GPU by Dr.Jit; :mod:`etendue.radiosity.kernels` is the CPU version."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

#: Segments of one kernel: a billion bytes.
_BLOCK = 1 << 27


class DeviceSegments:
    """Arrays (k, 2) of segments, copied to the device of the current variant."""

    def __init__(self, chunks: Sequence[NDArray[np.uint32]]) -> None:
        self._blocks = [mi.UInt64(block.view(np.uint64).ravel()) for block in _blocks(chunks)]

    def gather(self, values: Array) -> Array:
        """For each patch the sum of the ``values`` (n + 2, c) at the other ends of its segments, (n + 2, c)."""
        columns = [mi.Float64(np.ascontiguousarray(column)) for column in values.T]
        sums = [dr.zeros(mi.Float64, len(values)) for _ in columns]
        for block in self._blocks:
            i, j = mi.UInt32(block & 0xFFFFFFFF), mi.UInt32(block >> 32)
            for column, total in zip(columns, sums, strict=True):
                dr.scatter_add(total, dr.gather(mi.Float64, column, j), i)
                dr.scatter_add(total, dr.gather(mi.Float64, column, i), j)
            dr.eval(sums)
        return np.stack([np.array(total) for total in sums], axis=1)

    def ends(self, patches: int) -> NDArray[np.int64]:
        """Counts for each end (n + 2, 3): segments, those to the sky, and those to dark."""
        what = np.zeros((patches + 2, 3))
        what[:, 0] = what[patches, 1] = what[patches + 1, 2] = 1
        return np.rint(self.gather(what)).astype(np.int64)


def _blocks(chunks: Sequence[NDArray[np.uint32]]) -> Iterator[NDArray[np.uint32]]:
    """The chunks that are not empty, joined to larger blocks."""
    waiting: list[NDArray[np.uint32]] = []
    for chunk in chunks:
        if waiting and sum(map(len, waiting)) + len(chunk) > _BLOCK:
            yield np.concatenate(waiting)
            waiting = []
        if len(chunk):
            waiting.append(chunk)
    if waiting:
        yield np.concatenate(waiting)
