"""The workers of a run: which are present, which are excluded and why, and the tasks and files sent to each."""

from __future__ import annotations

import itertools
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from etendue import core
from etendue.core import ClusterError, EtendueError, logger

from .content import Offered
from .pool import Arrival, Delivered, Lost, Pool
from .worker import Failed, Needs, WorkerTask

#: Seconds between looks at the list of workers, and until a cluster without workers is given up.
_LOOK, _PATIENCE = 0.5, 60.0
#: Losses without a finished task between them, in addition to one for each worker, before the run fails.
_MOST_LOST = 12
#: Largest number of times that a file is sent to a worker.
_MOST_SENT = 4
#: Tickets of all runs of this process: a pool outlives a run, whose outcomes may arrive during the next run.
_TICKETS = itertools.count()

T = TypeVar("T", bound=WorkerTask)


@dataclass
class Member:
    """The state of a worker."""

    threads: int | None
    flights: set[int] = field(default_factory=set)
    pace: float | None = None  #: seconds of a pass
    coming: dict[int, str] = field(default_factory=dict)  #: digests of files that are being sent, by ticket


class Dispatcher(ABC, Generic[T]):
    """Sends tasks to workers and receives their outcomes. The tasks of a lost worker are given back to the subclass.

    offered: the files that workers may ask for."""

    def __init__(self, pool: Pool, offered: Offered, clock: Callable[[], float] = time.monotonic) -> None:
        self._pool, self._offered, self._clock = pool, offered, clock
        self._run = uuid.uuid4().hex
        self._workers: dict[str, Member] = {}
        self._refused: dict[str, str] = {}
        self._flights: dict[int, tuple[str, T]] = {}
        self._lost = 0  # workers with tasks, since the last task that was finished
        self._most = 0  # workers at a time
        self._has_made = False  # whether a task was finished
        self._sent: dict[tuple[str, str], int] = {}  # how often, by worker and digest
        self._deliveries: dict[int, str] = {}  # worker, by ticket
        self._looked = self._alive = clock()

    # ------------------------------------------------------------------ for the subclass

    @abstractmethod
    def _joined(self, name: str) -> None:
        """A worker has joined, or has room for a further task."""

    @abstractmethod
    def _gone(self, name: str) -> None:
        """A worker is gone; its tasks were given back."""

    @abstractmethod
    def _not_made(self, task: T) -> None:
        """A task must be sent again."""

    # ------------------------------------------------------------------ workers

    def _look(self, now: bool = False) -> None:
        """Update the list of workers; take back the tasks of lost ones."""
        time_ = self._clock()
        if not now and time_ - self._looked < _LOOK:
            return
        self._looked = time_
        there = {name: n for name, n in self._pool.workers().items() if name not in self._refused}
        for name in self._workers.keys() - there.keys():
            logger.info("worker %s is gone; what it had is made again", name)
            worker = self._workers[name]
            self._lose(name, bool(worker.flights or worker.coming))
        for name in sorted(there.keys() - self._workers.keys()):
            self._workers[name] = Member(there[name])
            self._joined(name)
        self._most = max(self._most, len(self._workers))
        if there:
            self._alive = time_
        elif not self._has_made:
            self._check_refused()
        if time_ - self._alive > _PATIENCE:
            self._check_refused()
            raise ClusterError(f"the cluster has had no worker for {_PATIENCE:.0f} seconds; start one")

    def _lose(self, name: str, had_work: bool, why: str = "") -> None:
        """A worker has ended. Raises :class:`ClusterError` if workers end too often without finishing a task."""
        self._drop(name)
        self._lost += had_work
        if self._lost > _MOST_LOST + self._most:
            raise ClusterError(
                f"workers have ended {self._lost} times without finishing a pass; the last was {name}"
                f"{f' ({why})' if why else ''}: see its log, its memory may be too small"
            )

    def _check_refused(self) -> None:
        """Raise :class:`ClusterError` with the reason of the first excluded worker, if there is one."""
        for name, why in self._refused.items():
            raise ClusterError(f"no worker can be used; {name}: {why}")

    def _drop(self, name: str) -> None:
        """Send nothing more to a worker, and take back its tasks, except those whose sums other workers hold."""
        worker = self._workers.pop(name, None)
        if worker is not None:
            held = self._pool.held_by_others(name, sorted(worker.flights))
            tickets = sorted(worker.flights - held)
            self._pool.forget([*tickets, *worker.coming])
            for ticket in tickets:
                self._not_made(self._flights.pop(ticket)[1])
            for ticket in worker.coming:
                self._deliveries.pop(ticket, None)
        self._gone(name)

    def _refuse(self, name: str, why: str) -> None:
        """Exclude a worker."""
        self._refused[name] = why
        self._drop(name)
        if not self._workers and not self._has_made:  # else others may come back
            self._check_refused()
        logger.warning("worker %s is left out: %s", name, why)

    # ------------------------------------------------------------------ tasks

    def _send(self, name: str, task: T) -> None:
        ticket = next(_TICKETS)
        self._flights[ticket] = name, task
        self._workers[name].flights.add(ticket)
        self._pool.send(name, ticket, task)

    def _take(self, arrival: Arrival) -> tuple[str, T, Any] | None:
        """(worker, task, outcome) of a task that was done. Other tasks are given back. Raises the error of a task."""
        if isinstance(arrival.outcome, Delivered):
            self._delivered(arrival.ticket, arrival.outcome)
        if arrival.ticket not in self._flights:
            return None
        name, task = self._flights.pop(arrival.ticket)
        if (worker := self._workers.get(name)) is not None:
            worker.flights.discard(arrival.ticket)
            if not worker.coming:
                self._joined(name)  # there is room for the next one
        outcome: Any = arrival.outcome
        if not isinstance(outcome, (Lost, Needs, Failed)):
            self._lost, self._has_made = 0, True
            return name, task, outcome
        self._not_made(task)
        if isinstance(outcome, Lost) and outcome.worker_is_there:
            return None
        if isinstance(outcome, Lost):
            self._lose(name, True, outcome.reason)  # the next look tells whether it is still there
        elif isinstance(outcome, Needs):
            self._deliver(name, outcome)
        elif outcome.refused:
            self._refuse(name, outcome.message)
        else:
            raise _error(outcome, name)
        return None

    def _deliver(self, name: str, needs: Needs) -> None:
        """Send files; the worker gets no task until they are there."""
        for digest in needs.digests:
            worker = self._workers.get(name)
            if worker is None or digest in worker.coming.values():
                continue
            times = self._sent[name, digest] = self._sent.get((name, digest), 0) + 1
            if times > _MOST_SENT:
                self._refuse(name, "it does not keep the files that it is sent")
                return
            ticket = next(_TICKETS)
            worker.coming[ticket], self._deliveries[ticket] = digest, name
            self._pool.deliver(name, ticket, self._offered, digest)

    def _delivered(self, ticket: int, outcome: Delivered) -> None:
        name = self._deliveries.pop(ticket, None)
        worker = None if name is None else self._workers.get(name)
        if name is None or worker is None:
            return
        worker.coming.pop(ticket, None)
        if outcome.is_lost:
            self._lose(name, True, outcome.problem or "")
        elif outcome.problem is not None:
            self._refuse(name, outcome.problem)
        elif not worker.coming:
            self._joined(name)

    def _cancel(self) -> None:
        """Forget all tasks."""
        if self._flights:
            with suppress(Exception):  # the cluster may be gone, and the run has an error of its own
                self._pool.end_run(self._run)
                self._pool.forget(list(self._flights))
            self._flights.clear()


def _error(failed: Failed, worker: str) -> EtendueError:
    kind: Any = getattr(core, failed.kind, EtendueError)
    error: EtendueError = kind(f"{failed.message} (on worker {worker})")
    return error
