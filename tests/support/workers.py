"""Workers that are simulated: they die, hesitate, lack things and join late; and methods whose sums tell which passes
are in them."""

from __future__ import annotations

import itertools
import logging
import random
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from etendue.core import Iterations, Measurement, Method, Pass
from etendue.distributed import Arrival, DaskPool, Lost, Recipe, Spread
from etendue.distributed.content import Offered, Store
from etendue.distributed.pool import Delivered
from etendue.distributed.schedules import OnDemand
from etendue.distributed.worker import Made, Needs, _Desk, _Run, merge_outcomes
from etendue.engine import Budget, InTurn, Runner


@dataclass
class Settings:
    def to_json(self) -> str:
        return "{}"


class Powers(Method):
    """Pass i adds a whole number of which every pass has another one, so that a sum tells which passes are in it."""

    name: ClassVar[str] = "powers"
    Settings: ClassVar[Any] = Settings
    samples_per_iteration = 1

    def __init__(self, settings: Any = None) -> None:
        self.settings = settings or Settings()

    def prepare(self, problem: Any, seed: int) -> None:
        self.seed = seed

    def value(self, iteration: int, seed: int, state: Any) -> float:
        return float(pow(3, iteration + 1, 1_000_003))

    def step(self, iteration: int, seed: int, state: Any) -> Pass:
        x = np.array([self.value(iteration, seed, state)])
        return Pass(
            Measurement({"x": x}, {"x": 1.0}, Iterations.single(iteration), {"x": x * x}, {"rays": 1.0}),
            self.following(iteration, seed, state),
        )

    def following(self, iteration, seed, state):
        return state

    def develop(self, measurement, state):
        raise NotImplementedError


class Chain(Powers):
    """Each pass depends on the state after the one before, and on the seed of the replica."""

    carries_on: ClassVar[bool] = True

    def start(self):
        return {"x": self.seed % 1000}

    def value(self, iteration, seed, state):
        return float(state["x"])

    def following(self, iteration, seed, state):
        return {"x": (31 * state["x"] + iteration + 1) % 65_537}


class Opened:
    digest = "recipe"

    def __init__(self, kind: type[Powers]) -> None:
        self.kind = kind

    def method(self, seed: int) -> Powers:
        made = self.kind()
        made.prepare(None, seed)
        return made


#: Seconds of a simulated pass.
_PACE = 3e-5


class Simulated:
    """A pool of simulated workers. ``faults``: probability that a chunk ends otherwise than by being made."""

    def __init__(self, kind: type[Powers], count: int, seed: int = 0, faults: float = 0.0) -> None:
        self.kind, self.faults, self.random = kind, faults, random.Random(seed)
        self.names = iter(f"worker {k}" for k in range(10_000))
        self.desks: dict[str, _Desk] = {}
        self.sent: deque[tuple[str, int, Any]] = deque()
        self.deaths = 0
        self.delivered: list[tuple[str, str]] = []
        for _ in range(count):
            self.join()

    def join(self) -> None:
        self.desks[next(self.names)] = _Desk()

    def workers(self):
        return dict.fromkeys(self.desks)

    def send(self, worker, ticket, chunk) -> None:
        self.sent.append((worker, ticket, chunk))

    def outcome(self, worker, chunk):
        desk = self.desks[worker]
        if chunk.run not in desk._runs:
            desk._runs[chunk.run] = _Run(Opened(self.kind))  # type: ignore[arg-type]
        made = desk._passes(chunk, desk._runs[chunk.run])
        # The same seconds on every machine: they decide how long the next chunks are, and so what becomes of them.
        return replace(made, seconds=_PACE * made.passes) if isinstance(made, Made) else made

    def wait(self, seconds: float):
        if not self.sent:
            return None
        at = self.random.randrange(len(self.sent)) if self.kind is Powers else 0
        worker, ticket, chunk = self.sent[at]
        del self.sent[at]
        if isinstance(chunk, (Delivered, Lost)):
            return Arrival(ticket, chunk)
        if worker not in self.desks:
            # It died earlier: what it had never arrives, or arrives as lost.
            return Arrival(ticket, Lost("died")) if self.random.random() < 0.5 else None
        if self.random.random() < self.faults:
            what = self.random.randrange(6 if self.kind is Powers else 4)
            if what == 0:  # killed before the sum arrived, another one takes its place
                del self.desks[worker]
                self.deaths += 1
                self.join()
                return Arrival(ticket, Lost("killed")) if self.random.random() < 0.5 else None
            if what == 1:
                return Arrival(ticket, Needs((f"file {ticket}",)))
            if what == 2:  # the time ended in the middle
                made = self.outcome(worker, _shorter(chunk, self.random))
                return Arrival(ticket, made)
            if what >= 4:
                return self.bundle(worker, ticket, chunk, what)
            self.join()  # one more, late
        return Arrival(ticket, self.outcome(worker, chunk))

    def bundle(self, worker, ticket, chunk, what):
        """Sums that workers merge; with one that is forgotten, or all of them lost."""
        others = [
            entry
            for entry in list(self.sent)[:2]
            if entry[0] in self.desks and not isinstance(entry[2], (Delivered, Lost))
        ]
        for entry in others:
            self.sent.remove(entry)
        if what == 4:
            for lost in others:
                self.sent.append((lost[0], lost[1], Lost("merged", worker_is_there=True)))
            return Arrival(ticket, Lost("merged", worker_is_there=True))
        if len(others) > 1 and self.random.random() < 0.3:  # its worker dies before the sum arrives
            self.desks.pop(others[0][0], None)
            self.join()
        made = merge_outcomes(self._made(worker, chunk), *(self._made(w, c) for w, _, c in others))
        return Arrival(ticket, made, 0.0, tuple(entry[1] for entry in others))

    def _made(self, worker, chunk):
        return self.outcome(worker, chunk) if worker in self.desks else Lost("died")

    def deliver(self, worker, ticket, offered, digest):
        self.delivered.append((worker, digest))
        self.sent.append((worker, ticket, Delivered()))

    def end_run(self, run) -> None: ...

    def held_by_others(self, worker, tickets):
        return set()

    def forget(self, tickets) -> None:
        self.sent = deque(entry for entry in self.sent if entry[1] not in tickets)

    def close(self) -> None: ...


def _shorter(chunk, source):
    return replace(chunk, count=source.randrange(chunk.count + 1))


def run(pool, method, passes, start=None, state=None, seed=5, schedule=OnDemand, longest=None, on_progress=None):
    method.prepare(None, seed)
    runner = Runner(
        method,
        seed=seed,
        budget=Budget(iterations=passes),
        start=start,
        state=state,
        executor=lambda order: Spread(
            pool, Recipe("recipe", Offered(), method.carries_on), order, longest=longest, schedule=schedule
        ),
        on_progress=on_progress,
    )
    return runner.run()


def alone(method, passes, seed=5):
    method.prepare(None, seed)
    return Runner(method, seed=seed, budget=Budget(iterations=passes), executor=InTurn).run()


class InProcess:
    """A pool whose workers are in this process, each with a desk and a folder of its own. ``losses``: numbers of the
    tasks in which a worker dies."""

    def __init__(self, folder: Path, count: int = 2, losses: tuple[int, ...] = ()) -> None:
        self._folder, self._losses, self._names = folder, losses, (f"worker {k}" for k in itertools.count())
        self._desks: dict[str, _Desk] = {}
        self._waiting: deque = deque()
        self.done = 0
        for _ in range(count):
            self._join()

    def _join(self) -> None:
        name = next(self._names)
        self._desks[name] = desk = _Desk()
        store = Store(self._folder / name)
        desk.store = lambda: store

    def workers(self):
        return dict.fromkeys(self._desks)

    def send(self, worker, ticket, task):
        self._waiting.append((worker, ticket, task))

    def wait(self, seconds):
        if not self._waiting:
            return None
        worker, ticket, task = self._waiting.popleft()
        if isinstance(task, Delivered):
            return Arrival(ticket, task)
        if worker not in self._desks:
            return Arrival(ticket, Lost("gone"))
        self.done += 1
        if self.done in self._losses:
            del self._desks[worker]
            self._join()
            return Arrival(ticket, Lost("killed"))
        return Arrival(ticket, self._desks[worker].make(task))

    def deliver(self, worker, ticket, offered, digest):
        for offset, piece, is_last in offered.pieces(digest):
            self._desks[worker].store().receive(digest, offset, piece, is_last)
        self._waiting.append((worker, ticket, Delivered()))

    def end_run(self, run): ...

    def held_by_others(self, worker, tickets):
        return set()

    def forget(self, tickets):
        self._waiting = deque(entry for entry in self._waiting if entry[1] not in tickets)

    def close(self): ...


@contextmanager
def dask_workers(count: int) -> Iterator[DaskPool]:
    """Workers of Dask on this machine, of one thread each, which are replaced if they are killed."""
    import dask
    import distributed

    # A killed worker is not the fault of its chunk; and a worker may take long to start again on a loaded machine.
    patient = {"distributed.scheduler.allowed-failures": 1000, "distributed.deploy.lost-worker-timeout": "1 day"}
    here = {"host": "127.0.0.1", "scheduler_port": 0, "dashboard_address": "127.0.0.1:0"}
    with (
        dask.config.set(patient),
        distributed.LocalCluster(
            n_workers=count, threads_per_worker=1, memory_limit=0, silence_logs=logging.CRITICAL, **here
        ) as cluster,
        distributed.Client(cluster, set_as_default=False, direct_to_workers=True) as client,
    ):
        yield DaskPool(client)
