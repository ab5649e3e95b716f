"""Schedules: which worker makes which passes of a run."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from typing import ClassVar, Protocol

from etendue.core import State
from etendue.engine import Order

from .worker import Chunk, Made

#: Chunks of a worker at a time: the next chunk is present while the first is made.
_IN_FLIGHT = 2

#: First iteration, number of passes, replica and state of a chunk.
Next = tuple[int, int, int | None, State | None]


class Schedule(Protocol):
    """Hands out passes, each once. A task is a range of iterations: two integers."""

    in_flight: ClassVar[int]  #: chunks that a worker may have at a time

    def take(self, worker: str, count: int, workers: Collection[str]) -> Next | None:
        """Up to ``count`` consecutive passes for ``worker``, one of ``workers``; ``None`` if there are none until
        passes are given back or other workers leave."""
        ...

    def give_back(self, chunk: Chunk, first: int) -> None:
        """The passes of a chunk from ``first`` on were not made."""
        ...

    def after(self, worker: str, chunk: Chunk, made: Made) -> State | None:
        """The state of the run after a chunk, ``None`` for methods without state."""
        ...

    def lost(self, worker: str) -> None:
        """A worker is gone."""
        ...


class OnDemand:
    """Passes in their order, to the next worker that asks."""

    in_flight: ClassVar[int] = _IN_FLIGHT

    def __init__(self, order: Order) -> None:
        self._missing: Iterator[int] = order.done.missing()
        self._again: list[int] = []  # given back, a heap

    def take(self, worker: str, count: int, workers: Collection[str]) -> Next | None:
        """See :class:`Schedule`."""
        first = self._pop()
        end = first + 1
        while end - first < count:
            following = self._pop()
            if following != end:
                heapq.heappush(self._again, following)
                break
            end += 1
        return first, end - first, None, None

    def _pop(self) -> int:
        return heapq.heappop(self._again) if self._again else next(self._missing)

    def give_back(self, chunk: Chunk, first: int) -> None:
        """See :class:`Schedule`."""
        for iteration in range(first, chunk.first + chunk.count):
            heapq.heappush(self._again, iteration)

    def after(self, worker: str, chunk: Chunk, made: Made) -> None:
        """See :class:`Schedule`: there is no state."""

    def lost(self, worker: str) -> None:
        """See :class:`Schedule`: the chunks of the worker are given back one by one."""


class Replicas:
    """Passes of replicas; each replica is at one worker at a time."""

    in_flight: ClassVar[int] = 1

    def __init__(self, order: Order) -> None:
        self._states: list[State | None] = list(order.state["replicas"])
        self._passes: list[int] = list(order.state["passes"])
        self._homes: dict[int, str] = {}
        #: By replica: worker and iteration of the state that the worker holds.
        self._held: dict[int, tuple[str, int]] = {}
        self._busy: set[int] = set()
        self._most = order.most

    def take(self, worker: str, count: int, workers: Collection[str]) -> Next | None:
        """The next passes of a replica of this worker, or of one whose worker is gone."""
        owners = Counter(home for home in self._homes.values() if home in workers)
        own, fewest = owners[worker], 0 if len(owners) < len(workers) else min(owners.values())
        mine = [
            r
            for r in range(len(self._states))
            if r not in self._busy
            and (self._homes.get(r) == worker or (self._homes.get(r) not in workers and own <= fewest))
        ]
        for replica in sorted(mine, key=lambda r: self._passes[r]):
            at = self._passes[replica]
            if self._most is not None:
                count = min(count, self._quota(replica) - at)
            if count > 0:
                self._homes[replica] = worker
                self._busy.add(replica)
                has_it = self._held.get(replica) == (worker, at) or at == 0
                return at, count, replica, None if has_it else self._states[replica]
        return None

    def _quota(self, replica: int) -> int:
        """Passes of a replica, if all replicas share the limit evenly."""
        assert self._most is not None
        size = len(self._states)
        return self._most // size + (replica < self._most % size)

    def give_back(self, chunk: Chunk, first: int) -> None:
        """See :class:`Schedule`."""
        assert chunk.replica is not None
        self._busy.discard(chunk.replica)
        if first == chunk.first:
            self._held.pop(chunk.replica, None)  # the next chunk includes the state

    def after(self, worker: str, chunk: Chunk, made: Made) -> State:
        """See :class:`Schedule`."""
        replica = chunk.replica
        assert replica is not None
        self._states[replica] = made.state
        self._passes[replica] = chunk.first + made.passes
        self._held[replica] = self._homes[replica], self._passes[replica]
        return {"replicas": list(self._states), "passes": list(self._passes)}

    def lost(self, worker: str) -> None:
        """See :class:`Schedule`: another worker takes its replica."""
