"""The executor that spreads the passes of a run over worker processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import numpy as np

from etendue.core import Measurement, Pass, State
from etendue.engine import Order

from .dispatcher import Dispatcher, Member
from .pool import Arrival, Lost, Pool
from .recipes import Recipe
from .schedules import OnDemand, Replicas, Schedule
from .worker import Chunk, Made, Merged

#: Seconds of a chunk: at least, and at most.
_SHORTEST, _LONGEST = 1.0, 60.0
#: The transfer of a sum takes at most this share of the time of its chunk; that of a replica, whose state comes with it
#: and whose worker waits meanwhile, a smaller one.
_TRANSFER_SHARE, _STATE_SHARE = 0.05, 0.02
#: A chunk takes at most this share of the time that all workers need for the passes that are left, so that they end at
#: about the same time.
_SHARE_OF_REST = 0.5
#: Waiting time at the end of a run for passes that have begun: seconds, multiples of the transfer of a sum, and
#: multiples of a pass; the last is for runs that end by time, whose passes have mostly ended by then.
_GRACE, _GRACE_TRANSFERS, _GRACE_PASSES, _GRACE_PASSES_IN_TIME = 1.0, 2.0, 3.0, 0.5
_TICK = 0.1


class Spread(Dispatcher[Chunk]):
    """Makes passes in worker processes; implements ``engine.Executor``.

    Independent passes are handed out in chunks of consecutive iterations, of such a length that the transfer of their
    sum costs little. The passes of a lost worker are made again by others. Replicas of a method whose passes depend on
    each other are given to one worker each; if a worker is lost, another continues from the last state that arrived.

    ``attributes`` are set on the method in the workers. longest: most passes of a chunk; with one, passes come one by
    one. schedule: of independent passes.
    """

    keeps_time: ClassVar[bool] = True

    def __init__(
        self,
        pool: Pool,
        recipe: Recipe,
        order: Order,
        attributes: Mapping[str, Any] | None = None,
        longest: int | None = None,
        schedule: Callable[[Order], Schedule] = OnDemand,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(pool, recipe.offered, clock)
        self._recipe, self._order, self._most_passes = recipe, order, longest
        self._attributes = dict(attributes or {})
        self._planned = len(order.done)  # passes that are made or in flight
        self._longest, self._transfer = 0.0, 0.0
        self._ending = False
        self._shares: dict[str, int] = {}
        self._work = Replicas(order) if recipe.carries_on else schedule(order)
        self._speeds = _Sum()  # passes per second
        #: Workers with room for a chunk, and workers for which there was no chunk.
        self._hungry: set[str] = set()
        self._starved: set[str] = set()
        self._look(now=True)

    # ------------------------------------------------------------------ an executor

    def next(self) -> Pass | None:
        """See :class:`Executor`."""
        self._look()
        if not self._ending:
            self._feed()
        arrival = self._pool.wait(_TICK)
        return None if arrival is None else self._merged(arrival)

    def rest(self) -> Iterator[Pass]:
        """See :class:`Executor`."""
        self._ending = True
        if not self._flights:
            return
        self._pool.end_run(self._run)
        left = self._order.left()
        passes = _GRACE_PASSES if left is None or left > 0 else _GRACE_PASSES_IN_TIME
        end = self._clock() + _GRACE + _GRACE_TRANSFERS * self._transfer + passes * self._longest
        while self._flights and self._clock() < end:
            self._look()
            if (arrival := self._pool.wait(_TICK)) is not None and (made := self._merged(arrival)) is not None:
                yield made

    def close(self) -> None:
        """See :class:`Executor`."""
        self._ending = True
        self._cancel()

    def shares(self) -> dict[str, int]:
        """Passes of each worker, including lost ones."""
        return dict(self._shares)

    # ------------------------------------------------------------------ workers

    def _joined(self, name: str) -> None:
        self._hungry.add(name)

    def _gone(self, name: str) -> None:
        self._speeds.pop(name, None)
        self._work.lost(name)
        self._feed_all()

    def _not_made(self, task: Chunk) -> None:
        self._planned -= task.count
        self._work.give_back(task, task.first)
        self._feed_all()

    def _feed_all(self) -> None:
        """Look again at workers for which there was no chunk."""
        self._hungry |= self._starved
        self._starved.clear()

    def _feed(self) -> None:
        """Send chunks to workers that have few."""
        # A run makes at least one pass, even if preparation in the workers takes all of the time.
        left = self._order.left() if self._shares else None
        if left is not None and left <= 0:
            return
        # First each worker has one chunk, then two. Only those with room are looked at: there may be thousands.
        for level in range(self._work.in_flight):
            for name in sorted(self._hungry):
                worker = self._workers.get(name)
                if worker is None or worker.coming or len(worker.flights) >= self._work.in_flight:
                    self._hungry.discard(name)
                elif len(worker.flights) <= level:
                    self._give(name, worker, left, level)

    def _give(self, name: str, worker: Member, left: float | None, level: int) -> None:
        """Send the next chunk to a worker, if there is one."""
        count = self._length(worker, left, may_wait=level > 0)
        found = self._work.take(name, count, self._workers.keys()) if count > 0 else None
        if found is None:
            self._hungry.discard(name)
            if not worker.flights:  # else it is looked at again when one arrives
                self._starved.add(name)
            return
        first, count, replica, state = found
        if replica is not None and (first == 0 or state is not None):
            self._feed_all()  # a replica has moved, which may leave the next one to others
        self._planned += count
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
            may_merge=replica is None and self._most_passes != 1,
        )
        self._send(name, chunk)

    def _length(self, worker: Member, left: float | None, may_wait: bool) -> int:
        """Passes of the next chunk of a worker; 0 if there is none, or, with ``may_wait``, if it would be too long."""
        rest = None if self._order.most is None else self._order.most - self._planned
        if worker.pace is None:
            return 0 if may_wait else 1 if rest is None else min(1, rest)
        # With many workers each sends less often, or the sums would arrive faster than one process can add them.
        carries_on = self._recipe.carries_on
        share = _STATE_SHARE if carries_on else _TRANSFER_SHARE
        seconds = min(max(_SHORTEST, self._transfer * max(1 / share, len(self._workers))), _LONGEST)
        seconds = seconds if left is None else min(seconds, left)
        if rest is not None and not carries_on:  # a replica leaves nothing to other workers
            speed = self._speeds.total * len(self._workers) / max(1, len(self._speeds))
            # At least the time in which the client can receive a sum from each worker.
            least = min(_SHORTEST, self._transfer * len(self._workers))
            seconds = min(seconds, max(least, _SHARE_OF_REST * rest / speed))
        count = int(seconds / max(worker.pace, 1e-6))
        if not may_wait or rest is None or carries_on:
            count = max(1, count)
        return min([count, *(n for n in (self._most_passes, rest) if n is not None)])

    # ------------------------------------------------------------------ outcomes

    def _merged(self, arrival: Arrival) -> Pass | None:
        if isinstance(arrival.outcome, Merged):
            return self._bundle(arrival, arrival.outcome)
        taken = self._take(arrival)
        if taken is None:
            return None
        state, made = self._count(*taken, arrival.seconds), taken[2]
        if made.measurement is None:
            return None
        return Pass(_writable(made.measurement), self._order.state if state is None else state)

    def _bundle(self, arrival: Arrival, merged: Merged) -> Pass | None:
        """The sum of several chunks. It cannot be used if one of them was given up meanwhile, because other workers
        then make its passes."""
        outcomes = dict(zip((arrival.ticket, *arrival.others), merged.outcomes, strict=True))
        made = {ticket for ticket, outcome in outcomes.items() if isinstance(outcome, Made)}
        for ticket in outcomes.keys() - made:  # first: a worker may be dropped together with its chunks
            self._take(Arrival(ticket, outcomes[ticket]))
        usable = made <= self._flights.keys()
        for ticket in made:
            outcome = outcomes[ticket] if usable else Lost("merged with a lost one", worker_is_there=True)
            if (taken := self._take(Arrival(ticket, outcome))) is not None:
                self._count(*taken, arrival.seconds)
        if merged.total is None or not usable:
            return None
        return Pass(_writable(merged.total), self._order.state)

    def _count(self, name: str, chunk: Chunk, made: Made, transfer: float) -> State | None:
        """Count the passes of a chunk; returns the state of the run after them."""
        self._planned -= chunk.count - made.passes
        self._work.give_back(chunk, chunk.first + made.passes)
        if made.passes < chunk.count:
            self._feed_all()
        if not made.passes:
            return None
        self._transfer = max(transfer, 0.5 * self._transfer)
        pace = made.seconds / made.passes
        self._longest = max(self._longest, pace)
        if (worker := self._workers.get(name)) is not None:
            if worker.pace is None:
                worker.pace = pace
            elif not (made.is_first and made.passes == 1):
                worker.pace = 0.5 * (worker.pace + pace)
            self._speeds[name] = 1.0 / max(worker.pace, 1e-6)
        self._shares[name] = self._shares.get(name, 0) + made.passes
        return self._work.after(name, chunk, made)


class _Sum(dict[str, float]):
    """Numbers by name, and their sum, which is updated at each change instead of computed anew."""

    total = 0.0

    def __setitem__(self, name: str, value: float) -> None:
        self.total += value - self.get(name, 0.0)
        super().__setitem__(name, value)

    def pop(self, name: str, default: Any = None) -> Any:
        """See :class:`dict`."""
        self.total -= self.get(name, 0.0)
        return super().pop(name, default)


def _writable(measurement: Measurement) -> Measurement:
    """The measurement, or a copy if nothing can be added to its arrays, because they lie in a received message or are
    in single precision."""
    tables = (measurement.sums, measurement.squares, measurement.products)
    arrays = [array for table in tables for array in table.values()]
    if all(array.flags.writeable and array.dtype == np.float64 for array in arrays):
        return measurement
    return measurement.copy()
