"""Where sums are merged: by the client, or first among the workers, if the client cannot keep up."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

#: Sums that a worker merges at a time, and that the client fetches at a time.
_FAN_IN, _FETCHES = 8, 2
#: Merging costs a task: not worth it for sums that are fetched faster (seconds).
_LEAST = 0.02


@dataclass(eq=False)
class Bundle:
    """A sum that waits at a worker: of one chunk, or of several that were merged there."""

    tickets: tuple[int, ...]
    worker: str
    where: Any = None  #: of the pool


class Gathering:
    """Decides which sums are fetched and which are merged first.

    As long as the client keeps up, every sum is fetched as it is. If ``fan_in`` of them wait, they become one: then
    merging is a tree over the workers, as deep as the backlog needs [Leeson 2001, sec. 6.3 names whole buffers sent to
    one place as what limits speed-up]."""

    def __init__(self, fan_in: int = _FAN_IN, fetches: int = _FETCHES, least: float = _LEAST) -> None:
        self._fan_in, self._fetches, self._least = fan_in, fetches, least
        self._waiting: deque[Bundle] = deque()
        self._fetching = 0
        self._seconds = 0.0  # of a fetch, lately
        self.merges = 0

    def put(self, bundle: Bundle) -> None:
        """A sum waits."""
        self._waiting.append(bundle)

    def fetched(self, seconds: float) -> None:
        """A fetch has ended."""
        self._fetching -= 1
        self._seconds = seconds if not self._seconds else 0.5 * (self._seconds + seconds)

    def merge_no_more(self) -> None:
        """Fetch every sum as it is."""
        self._fan_in = 1 << 62

    def drop(self, tickets: set[int]) -> list[Bundle]:
        """Remove and return the sums that contain one of these chunks."""
        gone = [bundle for bundle in self._waiting if tickets & set(bundle.tickets)]
        for bundle in gone:
            self._waiting.remove(bundle)
        return gone

    def next(self) -> list[Bundle] | None:
        """One sum to fetch, several to merge, or ``None`` if there is nothing to do now."""
        if len(self._waiting) >= self._fan_in and self._seconds >= self._least and self._fetching >= self._fetches:
            self.merges += 1
            return [self._waiting.popleft() for _ in range(self._fan_in)]
        if self._waiting and self._fetching < self._fetches:
            self._fetching += 1
            largest = max(self._waiting, key=lambda bundle: len(bundle.tickets))
            self._waiting.remove(largest)
            return [largest]
        return None
