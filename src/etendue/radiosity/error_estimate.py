"""The error of a solution on segments, estimated while they are cast."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from etendue.core import Array, PassKey, Record
from etendue.surfaces import Patches

from .lines.segments import Segments, scatter
from .solvers.shot import FirstShot
from .solvers.system import solve

#: Number of segments up to which each estimate solves the system again.
_FEW_SEGMENTS = 1 << 20


class IrradianceError:
    """Standard error of the irradiance of a solution, averaged over the surface, relative to the mean irradiance.

    Estimates of a growing number of passes share their work: beyond a million segments, the last solution and the sums
    over the passes of each replicate are kept.
    """

    def __init__(self, patches: Patches, replicates: int) -> None:
        self.patches, self.replicates = patches, replicates
        self._solution: tuple[Array, Array] | None = None
        # Sums over passes of each replicate, and the passes in them.
        self._sums: list[tuple[Array, Array]] = []
        self._summed: list[PassKey] = []

    def square(self, record: Record, lines: Callable[[], Segments], shot: FirstShot | None) -> float | None:
        """Square of the error of the segments in ``record``, which are ``lines()`` with batches; ``None`` without
        light."""
        patches = self.patches
        if self._solution is None or len(record) <= _FEW_SEGMENTS:
            solution = solve(patches, lines(), "conjugate-gradient", shot=shot, tolerance=1e-3)
            self._solution = solution.radiosity - (0.0 if shot is None else shot.emission), solution.irradiance
            self._sums, self._summed = [], []
        carried, irradiance = self._solution
        if self.replicates == 1:
            error = lines().gather_error(carried, patches.sky)
        else:
            error = self._of_replicates(record, carried)
        error = error if shot is None else np.hypot(error, shot.error)
        areas = patches.areas[:, None]
        light = (areas * irradiance).sum()
        return float(((areas * error).sum() / light) ** 2) if light > 0 else None

    def _of_replicates(self, record: Record, carried: Array) -> Array:
        """Standard error (n, c) of the irradiance by patches of the radiosities ``carried`` and by the sky."""
        patches, passes = self.patches, record.passes
        if passes[: len(self._summed)] != self._summed:
            self._sums, self._summed = [], []
        for k in range(self.replicates):
            chunks = [record[key] for key in passes[len(self._summed) :] if key[1] % self.replicates == k]
            part = Segments(patches, chunks, np.zeros(len(chunks)), patches.areas)  # only counted lines are needed
            found = part.sums(carried, patches.sky)
            if k < len(self._sums):
                self._sums[k] = self._sums[k][0] + found[0], self._sums[k][1] + found[1]
            else:
                self._sums.append(found)
        self._summed = passes
        sums, weights = (sum(parts[1:], start=parts[0]) for parts in zip(*self._sums, strict=True))
        mean = np.divide(sums, weights[:, None], out=np.zeros_like(sums), where=weights[:, None] > 0)
        return scatter(self._sums, mean)
