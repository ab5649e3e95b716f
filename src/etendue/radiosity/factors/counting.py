"""Pairs of patches, counted over the segments of lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, sparse

from ..compiling import compiled
from ..lines.segments import Pairs

if TYPE_CHECKING:
    import scipy.sparse

#: Smallest number of segments that are merged at once, and their bytes meanwhile.
_BLOCK, _BYTES = 1 << 22, 4
#: Bundles of one of the two halves of a pilot, and margin for its noise.
_HALF, _MARGIN = 8, 1.05


class PairCounts:
    """Numbers of segments between any two of ``n`` patches, counted chunk by chunk: memory is needed for the distinct
    pairs, and for about as many segments that wait to be merged.

    Attributes
    ----------
    ends: (n + 2, 3) of each patch, the sky and dark: all segments, those to the sky, those to dark.
    """

    def __init__(self, n: int, chunks: Iterable[Pairs] = ()) -> None:
        self.ends = np.zeros((n + 2, 3), np.int64)
        self._begin, self._columns, self._counts = np.zeros(n + 1, np.int64), np.empty(0, np.uint32), np.empty(0)
        self._waiting: list[Pairs] = []
        for chunk in chunks:
            self.add(chunk)

    def __len__(self) -> int:
        """Number of distinct pairs."""
        self._merge()
        return len(self._columns)

    def add(self, pairs: Pairs) -> None:
        """Count the segments (k, 2) of a chunk, in which ``n`` is the sky and ``n + 1`` dark."""
        compiled().count_ends(pairs, self.ends)
        self._waiting.append(pairs)
        if sum(map(len, self._waiting)) >= max(_BLOCK, len(self._columns)):
            self._merge()

    def upper(self) -> scipy.sparse.csr_array:
        """(n, n) the counts at the smaller index of each pair as row and the larger one as column."""
        self._merge()
        n = len(self._begin) - 1
        return sparse().csr_array((self._counts, self._columns.astype(np.int64), self._begin), shape=(n, n))

    def _merge(self) -> None:
        if not self._waiting:
            return
        loops, n = compiled(), len(self._begin) - 1
        rows: NDArray[np.int64] = np.zeros(n, np.int64)
        for chunk in self._waiting:
            loops.count_rows(chunk, n, rows)
        starts = np.concatenate([[0], np.cumsum(rows)])
        more, ends = np.empty(starts[-1], np.uint32), starts[:-1].copy()
        for chunk in self._waiting:
            loops.fill_rows(chunk, n, ends, more)
        self._waiting = []
        counts: Array
        self._begin, self._columns, counts = loops.merge_rows(self._begin, self._columns, self._counts, starts, more)
        self._counts = counts


@dataclass(frozen=True)
class MatrixRoom:
    """How many bundles of lines leave room for their form factors.

    Every segment may be a pair of its own, up to all pairs of patches. A pilot gives a closer bound: as bundles are
    alike and in no order, each new one brings fewer new pairs on the average than those before, so their number grows
    by no more than in the second half of the pilot. Segments to the sky are no pairs.

    free: bytes. patches: their number. each: segments of a bundle. stored: bytes of a stored segment. entry: bytes of
    an entry of the matrix. pilot: pairs after the first and the second half of a pilot.
    """

    free: float
    patches: int
    each: float
    stored: float
    entry: float
    pilot: tuple[int, int] | None = None

    def with_pilot(self, cast: Callable[[int, int], Iterable[Pairs]]) -> MatrixRoom:
        """The same, after a pilot of bundles; ``cast`` makes the segments of bundles from a first one on."""
        counts, found, segments = PairCounts(self.patches), [], 0
        for half in range(2):
            for chunk in cast(half * _HALF, _HALF):
                counts.add(chunk)
                segments += len(chunk)
            found.append(len(counts))
        return replace(self, each=max(segments, 1) / (2 * _HALF), pilot=(found[0], found[1]))

    def most(self, limit: int) -> int:
        """The largest number of bundles that fit, up to ``limit``."""
        low, high = 0, limit
        while low < high:
            middle = (low + high + 1) // 2
            low, high = (middle, high) if self._need(middle) <= self.free else (low, middle - 1)
        return low

    def _need(self, bundles: int) -> float:
        segments = self.each * bundles
        pairs = min(segments, self.patches * (self.patches + 1) / 2)
        if self.pilot is not None:
            first, both = self.pilot
            pairs = min(pairs, _MARGIN * (both + max(bundles - 2 * _HALF, 0) * (both - first) / _HALF))
        return self.stored * segments + _BYTES * min(segments, max(_BLOCK, pairs)) + 2 * self.entry * pairs
