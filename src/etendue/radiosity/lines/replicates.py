"""Point sequences that take turns, so that the scatter of what they bring tells the error of all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from etendue.core import on_device
from etendue.points import PointSet


class Replicates(PointSet):
    """Runs of points of some independently randomised sequences in turn.

    Parts of one sequence fill each other's gaps: they scatter two to nine times as much, in bundles of lines, as their
    mean errs. Independent sequences scatter as it does; the price is that each is a shorter one.

    sequences: of one dimension. run: points of one of them before the next takes its turn.
    """

    name = "replicates"
    is_random = True

    def __init__(self, sequences: Sequence[PointSet], run: int) -> None:
        super().__init__(sequences[0].dimension)
        self.sequences, self.run = list(sequences), run

    def _coordinate(self, index: Any, dimension: int) -> Any:
        if dr.is_jit_v(index):
            kind = dr.float32_array_t(type(index))
            return on_device(kind, self._coordinate(np.array(index), dimension).astype(np.float32))
        turn, place = np.divmod(index, self.run)
        of, own = turn % len(self.sequences), turn // len(self.sequences) * self.run + place
        result = np.empty(len(index))
        for k in np.unique(of):
            result[of == k] = self.sequences[k]._coordinate(own[of == k], dimension)
        return result
