"""The executor that spreads the passes of a run over worker processes."""

from __future__ import annotations

import heapq
import itertools
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, ClassVar

from etendue import core
from etendue.core import ClusterError, EtendueError, Measurement, Pass, State, logger
from etendue.engine import Order

from .pool import Arrival, Lost, Pool
from .recipe import Recipe
from .worker import Chunk, Failed, Made, Needs

#: Chunks of a worker at a time: while one is made, the next one is there.
_IN_FLIGHT = 2
#: Seconds of a chunk: at least, and at most.
_SHORTEST, _LONGEST = 1.0, 60.0
#: The transfer of a sum takes at most this share of the time of its chunk.
_TRANSFER_SHARE = 0.05
#: A chunk takes at most this share of the passes that are left, divided by the number of workers, so that workers end
#: at about the same time.
_SHARE_OF_REST = 0.5
#: Seconds between looks at the list of workers, and until a cluster without workers is given up.
_LOOK, _PATIENCE = 0.5, 60.0
#: Chunks that are lost one after the other without a pass from any worker before the run fails.
_MOST_LOST = 12
#: How often a file is sent to a worker.
_MOST_SENT = 4
#: What the end of a run waits for passes that have begun: seconds; multiples of the transfer of a sum, and of a pass.
#: At the end of the time, passes have ended by themselves.
_GRACE, _GRACE_TRANSFERS, _GRACE_PASSES, _GRACE_PASSES_IN_TIME = 1.0, 2.0, 3.0, 0.5
_TICK = 0.1


@dataclass
class _Worker:
    """What is known of a worker."""

    threads: int | None
    flights: set[int] = field(default_factory=set)
    pace: float | None = None  #: seconds of a pass
    passes: int = 0  #: made and merged


class Spread:
    """Makes passes in worker processes; implements ``engine.Executor``.

    Independent passes are handed out in chunks of consecutive iterations, of such a length that the transfer of their
    sum costs little. What a lost worker had is made again by others. Replicas of a method whose passes depend on each
    other are given to a worker each; if it is lost, another one continues from the last state that has arrived.
    """

    keeps_time: ClassVar[bool] = True

    def __init__(self, pool: Pool, recipe: Recipe, order: Order, attributes: Mapping[str, Any] | None = None) -> None:
        self._pool, self._recipe, self._order = pool, recipe, order
        self._run, self._tickets = uuid.uuid4().hex, itertools.count()
        self._attributes = dict(attributes or {})
        self._workers: dict[str, _Worker] = {}
        self._refused: dict[str, str] = {}
        self._flights: dict[int, tuple[str, Chunk]] = {}
        self._planned = len(order.done)  # passes that are made or in flight
        self._longest, self._transfer = 0.0, 0.0
        self._lost = 0  # chunks, since the last pass
        self._looked = self._alive = time.monotonic()
        self._ending = False
        self._shares: dict[str, int] = {}
        self._sent: dict[tuple[str, str], int] = {}  # how often, by worker and digest
        self._work: _Independent | _Replicas = (
            _Replicas(order) if self._recipe.carries_on else _Independent(order.done.missing())
        )
        self._look(now=True)

    # ------------------------------------------------------------------ an executor

    def next(self) -> Pass | None:
        """See :class:`Executor`."""
        self._look()
        if not self._ending:
            self._feed()
        arrival = self._pool.wait(_TICK)
        return None if arrival is None else self._take(arrival)

    def rest(self) -> Iterator[Pass]:
        """See :class:`Executor`."""
        self._ending = True
        if not self._flights:
            return
        self._pool.end_run(self._run)
        left = self._order.left()
        passes = _GRACE_PASSES if left is None or left > 0 else _GRACE_PASSES_IN_TIME
        end = time.monotonic() + _GRACE + _GRACE_TRANSFERS * self._transfer + passes * self._longest
        while self._flights and time.monotonic() < end:
            self._look()
            if (arrival := self._pool.wait(_TICK)) is not None and (made := self._take(arrival)) is not None:
                yield made

    def close(self) -> None:
        """See :class:`Executor`."""
        self._ending = True
        if self._flights:
            with suppress(EtendueError):  # the cluster may be gone, and the run has an error of its own
                self._pool.end_run(self._run)
                self._pool.forget(list(self._flights))
            self._flights.clear()

    def shares(self) -> dict[str, int]:
        """Passes of each worker, including lost ones."""
        return dict(self._shares)

    # ------------------------------------------------------------------ workers

    def _look(self, now: bool = False) -> None:
        """Look which workers there are; take back what lost ones had."""
        time_ = time.monotonic()
        if not now and time_ - self._looked < _LOOK:
            return
        self._looked = time_
        there = {name: n for name, n in self._pool.workers().items() if name not in self._refused}
        for name in self._workers.keys() - there.keys():
            logger.info("worker %s is gone; what it had is made again", name)
            self._drop(name)
        for name in there.keys() - self._workers.keys():
            self._workers[name] = _Worker(there[name])
        if there:
            self._alive = time_
        elif self._refused:
            name, why = next(iter(self._refused.items()))
            raise ClusterError(f"no worker can be used; {name}: {why}")
        elif time_ - self._alive > _PATIENCE:
            raise ClusterError(f"the cluster has had no worker for {_PATIENCE:.0f} seconds; start one")

    def _drop(self, name: str) -> None:
        """Send no more to a worker, and take back what it had."""
        worker = self._workers.pop(name, None)
        for ticket in [] if worker is None else list(worker.flights):
            self._pool.forget([ticket])
            self._give_back(ticket)

    def _give_back(self, ticket: int) -> None:
        """The passes of a chunk were not made."""
        _, chunk = self._flights.pop(ticket)
        self._planned -= chunk.count
        self._work.give_back(chunk, chunk.first)

    def _feed(self) -> None:
        """Send chunks to workers that have few."""
        # A run makes one pass at least: where preparation in the workers takes all of the time, too.
        left = self._order.left() if self._shares else None
        if left is not None and left <= 0:
            return
        for name, worker in sorted(self._workers.items(), key=lambda item: len(item[1].flights)):
            while len(worker.flights) < self._work.in_flight:
                count = self._length(worker, left)
                chunk = self._work.take(name, count, self._workers.keys()) if count > 0 else None
                if chunk is None:
                    break
                first, count, replica, state = chunk
                self._send(name, worker, first, count, replica, state, left)

    def _send(
        self,
        name: str,
        worker: _Worker,
        first: int,
        count: int,
        replica: int | None,
        state: State | None,
        left: float | None,
    ) -> None:
        ticket = next(self._tickets)
        chunk = Chunk(
            self._run,
            self._recipe.digest,
            self._order.seed,
            first,
            count,
            left=left,
            replica=replica,
            state=state,
            plan=self._order.plan,
            attributes=self._attributes,
            threads=worker.threads,
        )
        self._flights[ticket] = name, chunk
        worker.flights.add(ticket)
        self._planned += count
        self._pool.send(name, ticket, chunk)

    def _length(self, worker: _Worker, left: float | None) -> int:
        """Passes of the next chunk of a worker."""
        count = 1
        if worker.pace is not None:
            seconds = min(max(_SHORTEST, self._transfer / _TRANSFER_SHARE), _LONGEST)
            seconds = seconds if left is None else min(seconds, left)
            count = max(1, int(seconds / max(worker.pace, 1e-6)))
        if self._order.most is not None:
            rest = self._order.most - self._planned
            count = min(count, max(1, int(_SHARE_OF_REST * rest / len(self._workers))), rest)
        return count

    # ------------------------------------------------------------------ outcomes

    def _take(self, arrival: Arrival) -> Pass | None:
        if arrival.ticket not in self._flights:
            return None
        name, chunk = self._flights[arrival.ticket]
        worker, outcome = self._workers.get(name), arrival.outcome
        if worker is not None:
            worker.flights.discard(arrival.ticket)
        if isinstance(outcome, Made):
            del self._flights[arrival.ticket]
            return self._merge(name, chunk, outcome, arrival.seconds)
        self._give_back(arrival.ticket)
        if isinstance(outcome, Lost):
            self._lost += 1
            self._drop(name)  # the next look tells whether it is still there
            if self._lost > _MOST_LOST:
                raise ClusterError(
                    f"workers have ended {self._lost} times without finishing a pass; the last was {name}"
                    f"{f' ({outcome.reason})' if outcome.reason else ''}: see its log, its memory may be too small"
                )
        elif isinstance(outcome, Needs):
            self._deliver(name, outcome)
        elif outcome.refused:
            self._refuse(name, outcome.message)
        else:
            raise _error(outcome, name)
        return None

    def _merge(self, name: str, chunk: Chunk, made: Made, transfer: float) -> Pass | None:
        self._planned -= chunk.count - made.passes
        self._work.give_back(chunk, chunk.first + made.passes)
        if made.measurement is None:
            return None
        self._lost, self._transfer = 0, max(transfer, 0.5 * self._transfer)
        pace = made.seconds / made.passes
        self._longest = max(self._longest, pace)
        if (worker := self._workers.get(name)) is not None and not (made.is_first and made.passes == 1):
            worker.pace = pace if worker.pace is None else 0.5 * (worker.pace + pace)
        elif worker is not None and worker.pace is None:
            worker.pace = pace
        self._shares[name] = self._shares.get(name, 0) + made.passes
        state = self._work.after(chunk, made)
        return Pass(_writable(made.measurement), self._order.state if state is None else state)

    def _deliver(self, name: str, needs: Needs) -> None:
        for digest in needs.digests:
            times = self._sent[name, digest] = self._sent.get((name, digest), 0) + 1
            if times > _MOST_SENT:
                self._refuse(name, "it does not keep the files that it is sent")
                return
            if (problem := self._pool.deliver(name, self._recipe.offered, digest)) is not None:
                self._refuse(name, problem)
                return

    def _refuse(self, name: str, why: str) -> None:
        """Leave a worker out."""
        self._refused[name] = why
        self._drop(name)
        if self._workers:
            logger.warning("worker %s is left out: %s", name, why)
        else:
            raise ClusterError(f"no worker can be used; {name}: {why}")


# -- what is to be made ----------------------------------------------------------------------------------------------

#: First iteration, number of passes, replica and state of a chunk.
_Next = tuple[int, int, int | None, State | None]


class _Independent:
    """Passes that any worker may make, each once."""

    in_flight: ClassVar[int] = _IN_FLIGHT

    def __init__(self, missing: Iterator[int]) -> None:
        self._missing = missing
        self._again: list[int] = []  # given back, a heap

    def take(self, worker: str, count: int, workers: Any) -> _Next:
        """Up to ``count`` consecutive iterations that are not handed out."""
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
        """The iterations of a chunk from ``first`` on were not made."""
        for iteration in range(first, chunk.first + chunk.count):
            heapq.heappush(self._again, iteration)

    def after(self, chunk: Chunk, made: Made) -> None:
        """There is no state."""


class _Replicas:
    """Passes of replicas, each of which is at one worker at a time."""

    in_flight: ClassVar[int] = 1

    def __init__(self, order: Order) -> None:
        self._states: list[State | None] = list(order.state["replicas"])
        self._passes: list[int] = list(order.state["passes"])
        self._homes: dict[int, str] = {}
        #: Worker and iteration of the state that it holds.
        self._held: dict[int, tuple[str, int]] = {}
        self._busy: set[int] = set()
        self._most = order.most

    def take(self, worker: str, count: int, workers: Any) -> _Next | None:
        """The next passes of the replica that lives at a worker, or of one whose worker is gone."""
        size = len(self._states)
        owners = [home for home in self._homes.values() if home in workers]
        fewest = min((owners.count(name) for name in workers), default=0)
        mine = [
            r
            for r in range(size)
            if r not in self._busy
            and (self._homes.get(r) == worker or (self._homes.get(r) not in workers and owners.count(worker) <= fewest))
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
        """Passes from ``first`` on were not made."""
        assert chunk.replica is not None
        self._busy.discard(chunk.replica)
        if first == chunk.first:
            self._held.pop(chunk.replica, None)  # the next chunk takes the state along

    def after(self, chunk: Chunk, made: Made) -> State:
        """The state of the run after a chunk."""
        replica = chunk.replica
        assert replica is not None
        self._states[replica] = made.state
        self._passes[replica] = chunk.first + made.passes
        self._held[replica] = self._homes[replica], self._passes[replica]
        return {"replicas": list(self._states), "passes": list(self._passes)}


def _writable(measurement: Measurement) -> Measurement:
    """The measurement, or a copy if its arrays lie in a received message and cannot be added to."""
    tables = (measurement.sums, measurement.squares, measurement.products)
    if all(array.flags.writeable for table in tables for array in table.values()):
        return measurement
    return measurement.copy()


def _error(failed: Failed, worker: str) -> EtendueError:
    kind: Any = getattr(core, failed.kind, EtendueError)
    error: EtendueError = kind(f"{failed.message} (on worker {worker})")
    return error
