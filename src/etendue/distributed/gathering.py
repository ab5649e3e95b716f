"""Where sums are merged: by the client, or first among the workers, if the client cannot keep up."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

#: Number of sums that a worker merges at a time, and that the client fetches at a time.
_FAN_IN, _FETCHES = 8, 2
#: Seconds of a fetch below which sums are not merged, since merging costs a task.
_LEAST = 0.002


@dataclass(eq=False)
class Bundle:
    """A sum that waits at a worker: of one chunk, or of several that were merged there."""

    tickets: tuple[int, ...]
    worker: str
    where: Any = None  #: the pool's reference to the sum
    #: Workers that hold the parts of the sum, until they are merged.
    sources: frozenset[str] = frozenset()
    level: int = 0  #: how often its parts were merged

    @staticmethod
    def of(parts: Sequence[Bundle], where: Any = None) -> Bundle:
        """The sum of ``parts``, which is made where the first one is."""
        tickets: tuple[int, ...] = sum((part.tickets for part in parts), ())
        sources, level = frozenset(part.worker for part in parts), 1 + max(part.level for part in parts)
        return Bundle(tickets, parts[0].worker, where, sources, level)

    def needs(self, worker: str) -> bool:
        """Whether the sum is lost with this worker."""
        return worker == self.worker or worker in self.sources


def held_by_others(bundles: Iterable[Bundle], worker: str, tickets: Iterable[int]) -> set[int]:
    """The ``tickets`` of a worker that are in sums which are not lost with the worker."""
    found, asked = set(), set(tickets)
    for bundle in bundles:
        if not bundle.needs(worker):
            found |= asked.intersection(bundle.tickets)
    return found


class Gathering:
    """Decides which sums are fetched and which are merged first.

    As long as the client keeps up, every sum is fetched as it is. If ``fan_in`` sums of the same level wait, they are
    merged to one of the next level, and sums of the highest level are fetched first: merging is a tree over workers, as
    deep as the backlog requires [Leeson 2001, sec. 6.3: whole buffers sent to one place limit the speed-up]."""

    def __init__(self, fan_in: int = _FAN_IN, fetches: int = _FETCHES, least: float = _LEAST) -> None:
        self._fan_in, self._fetches, self._least = fan_in, fetches, least
        self._waiting: defaultdict[int, deque[Bundle]] = defaultdict(deque)  # by level
        self._fetching = 0
        self._seconds = 0.0  # of a fetch, moving average
        self.merges = 0

    def put(self, bundle: Bundle) -> None:
        """A sum waits."""
        bundle.sources = frozenset()
        self._waiting[bundle.level].append(bundle)

    def fetched(self, seconds: float) -> None:
        """A fetch has ended."""
        self._fetching -= 1
        self._seconds = seconds if not self._seconds else 0.5 * (self._seconds + seconds)

    def merge_no_more(self) -> None:
        """Fetch every sum as it is."""
        self._fan_in = 1 << 62

    def drop(self, tickets: set[int]) -> list[Bundle]:
        """Remove and return the sums that contain one of these chunks."""
        gone = [b for level in self._waiting.values() for b in level if not tickets.isdisjoint(b.tickets)]
        for bundle in gone:
            self._waiting[bundle.level].remove(bundle)
        return gone

    def next(self) -> list[Bundle] | None:
        """One sum to fetch, several to merge, or ``None`` if there is nothing to do now."""
        levels = [level for level, bundles in self._waiting.items() if bundles]
        if levels and self._fetching < self._fetches:
            self._fetching += 1
            return [self._waiting[max(levels)].popleft()]
        if self._seconds >= self._least:
            for level in levels:
                if len(self._waiting[level]) >= self._fan_in:
                    self.merges += 1
                    return [self._waiting[level].popleft() for _ in range(self._fan_in)]
        return None
