"""Independent point sequences used in turn, whose variance gives the error of their mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import on_device
from etendue.points import PointSet

if TYPE_CHECKING:
    import mitsuba as mi


class Replicates(PointSet):
    """Runs of points from several independently randomised sequences, in turn.

    Parts of one sequence complement each other: for bundles of lines their variance overestimates the error of the mean
    by a factor of two to nine. With independent sequences the estimate is unbiased, but each sequence is shorter.

    sequences: point sets of equal dimension. run: number of consecutive points from one sequence before the next.
    """

    name = "replicates"
    is_random = True

    def __init__(self, sequences: Sequence[PointSet], run: int) -> None:
        super().__init__(sequences[0].dimension)
        self.sequences, self.run = list(sequences), run

    def _coordinate(self, index: mi.UInt32 | NDArray[np.integer[Any]], dimension: int) -> Any:
        if dr.is_jit_v(index):
            kind = dr.float32_array_t(type(index))
            return on_device(kind, self._coordinate(np.array(index), dimension).astype(np.float32))
        turn, place = np.divmod(index, self.run)
        of, own = turn % len(self.sequences), turn // len(self.sequences) * self.run + place
        result = np.empty(len(index))
        for k in np.unique(of):
            result[of == k] = self.sequences[k]._coordinate(own[of == k], dimension)
        return result
