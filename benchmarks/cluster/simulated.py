"""A pool of simulated workers under a simulated clock. What decides is the library: the executor, its schedule, the
gathering of sums, the runner and its measurement; their CPU time is measured and counts as the client's."""

from __future__ import annotations

import heapq
import itertools
import random
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from etendue.core import Iterations, Measurement, Method, Pass
from etendue.distributed import Arrival, Lost, Recipe, Spread
from etendue.distributed.content import Offered
from etendue.distributed.gathering import Bundle, Gathering, held_by_others
from etendue.distributed.pool import Delivered
from etendue.distributed.worker import Chunk, Made, Needs, merge_outcomes
from etendue.engine import Budget, Order, Runner

from .schedules import SCHEDULES

#: Seconds that two looks at the CPU clock take.
_CLOCK = min(-time.thread_time() + time.thread_time() for _ in range(200))


@dataclass(frozen=True)
class Site:
    """What is simulated. Rates in bytes a second, times in seconds."""

    workers: int
    pass_seconds: float
    sum_bytes: float
    scene_bytes: float = 0.0
    first_seconds: float = 5.0  #: loading and compiling, before the first pass of a worker
    link: float = 1.25e9  #: of the client and of each worker: 10 Gbit/s
    add: float = 1.5e9  #: sums added in memory
    task_seconds: float = 5e-4  #: of Dask's scheduler, a task
    latency: float = 1e-3
    spread: float = 0.1  #: standard deviation of the logarithm of a worker's speed
    stragglers: float = 0.02  #: share of workers that are ``slow`` times as slow
    slow: float = 4.0
    jitter: float = 0.05  #: of a pass
    losses: float = 0.01  #: of a worker an hour
    restart: float = 20.0  #: until another one takes its place
    shares_files: bool = True  #: workers take files from each other
    merges: bool = True  #: sums are merged among workers if the client does not keep up
    slow_ones: tuple[int, ...] = ()  #: numbers of further slow workers


@dataclass
class _Worker:
    factor: float
    queue: deque[tuple[int, Chunk]] = field(default_factory=deque)
    busy: bool = False
    has_scene: bool = False
    is_first: bool = True


class SimulatedPool:
    """Implements ``etendue.distributed.Pool`` and is its clock."""

    def __init__(self, site: Site, seed: int = 0) -> None:
        self._site, self._random = site, random.Random(seed)
        self.now = 0.0
        self._names, self._numbers = (f"w{k:05d}" for k in itertools.count()), itertools.count()
        self._workers: dict[str, _Worker] = {}
        self._events: list[tuple[float, int, Any]] = []
        self._arrived: deque[tuple[Arrival, float]] = deque()
        self._gathering = Gathering() if site.merges else Gathering(fan_in=1 << 40)
        self._bundles: set[Bundle] = set()
        self._outcomes: dict[Bundle, Any] = {}
        self._scheduler = self._link = 0.0  # busy until
        self._sources: list[float] = [0.0]  # of the scene: when each can send it next
        self._left: float | None = None  # CPU clock when the client began to work
        #: Seconds in which the client decided, added, and received; the scheduler worked; workers did work that was
        #: lost. Bytes, tasks.
        self.deciding = self.adding = self.receiving = self.scheduling = self.wasted = 0.0
        self.bytes, self.tasks, self.scene_done = 0.0, 0, 0.0
        for _ in range(site.workers):
            self._join()

    # ------------------------------------------------------------------ a pool

    def workers(self) -> dict[str, int | None]:
        """See :class:`Pool`."""
        return dict.fromkeys(self._workers)

    def send(self, worker: str, ticket: int, task: Any) -> None:
        """See :class:`Pool`."""
        self.tasks += 1
        self._at(self._scheduled() + self._site.latency, self._received, worker, ticket, task)

    def wait(self, seconds: float) -> Arrival | None:
        """See :class:`Pool`."""
        if self._left is not None:
            spent = max(0.0, time.thread_time() - self._left - _CLOCK)
            self.now += spent
            self.deciding += spent
        limit = self.now + seconds
        while not self._arrived and self._events and self._events[0][0] <= limit:
            at, _, (function, arguments) = heapq.heappop(self._events)
            self.now = max(self.now, at)
            function(*arguments)
        found = None
        if self._arrived:
            found, adding = self._arrived.popleft()
            self.now += adding
            self.adding += adding
        else:
            self.now = limit
        self._left = time.thread_time()
        return found

    def deliver(self, worker: str, ticket: int, offered: Offered, digest: str) -> None:
        """See :class:`Pool`."""
        seconds = self._site.scene_bytes / self._site.link
        start = max(self.now, heapq.heappop(self._sources))
        heapq.heappush(self._sources, start + seconds)
        if self._site.shares_files:
            heapq.heappush(self._sources, start + seconds)
        self._at(start + seconds, self._have, worker, ticket)

    def end_run(self, run: str) -> None:
        """See :class:`Pool`."""

    def held_by_others(self, worker: str, tickets: list[int]) -> set[int]:
        """See :class:`Pool`."""
        return held_by_others(self._bundles, worker, tickets)

    def forget(self, tickets: list[int]) -> None:
        """See :class:`Pool`."""
        gone = set(tickets)
        for bundle in [b for b in self._bundles if gone & set(b.tickets)]:
            self._bundles.discard(bundle)
            for other in set(bundle.tickets) - gone:
                self._arrived.append((Arrival(other, Lost("merged", worker_is_there=True)), 0.0))
        self._gathering.drop(gone)

    def close(self) -> None:
        """See :class:`Pool`."""

    # ------------------------------------------------------------------ events

    def _at(self, when: float, function: Any, *arguments: Any) -> None:
        heapq.heappush(self._events, (when, next(self._numbers), (function, arguments)))

    def _scheduled(self) -> float:
        """When the scheduler has handled one more task."""
        self._scheduler = max(self._scheduler, self.now) + self._site.task_seconds
        self.scheduling += self._site.task_seconds
        return self._scheduler

    def _join(self) -> None:
        site, name = self._site, next(self._names)
        factor = self._random.lognormvariate(0.0, site.spread)
        if self._random.random() < site.stragglers or int(name[1:]) in site.slow_ones:
            factor *= site.slow
        self._workers[name] = _Worker(factor, has_scene=not site.scene_bytes)
        if site.losses:
            self._at(self.now + self._random.expovariate(site.losses / 3600.0), self._die, name)

    def _die(self, name: str) -> None:
        worker = self._workers.pop(name)
        self._at(self.now + self._site.restart, self._join)
        for ticket, _ in worker.queue:
            self._arrived.append((Arrival(ticket, Lost("killed")), 0.0))

    def _received(self, name: str, ticket: int, chunk: Chunk) -> None:
        worker = self._workers.get(name)
        if worker is None:
            self._arrived.append((Arrival(ticket, Lost("gone")), 0.0))
        elif not worker.has_scene:
            self._at(self.now + self._site.latency, self._small, Arrival(ticket, Needs(("scene",))))
        else:
            worker.queue.append((ticket, chunk))
            self._work(name, worker)

    def _small(self, arrival: Arrival) -> None:
        self._arrived.append((arrival, 0.0))

    def _have(self, name: str, ticket: int) -> None:
        if (worker := self._workers.get(name)) is not None:
            worker.has_scene = True
        self.scene_done = self.now
        self._arrived.append((Arrival(ticket, Delivered()), 0.0))

    def _work(self, name: str, worker: _Worker) -> None:
        if worker.busy or not worker.queue:
            return
        worker.busy = True
        ticket, chunk = worker.queue[0]
        site = self._site
        seconds = worker.factor * chunk.count * site.pass_seconds * max(0.1, self._random.gauss(1.0, site.jitter))
        more = site.first_seconds if worker.is_first else 0.0
        self._at(self.now + seconds + more, self._made, name, ticket, chunk, seconds, worker.is_first)
        worker.is_first = False

    def _made(self, name: str, ticket: int, chunk: Chunk, seconds: float, is_first: bool) -> None:
        worker = self._workers.get(name)
        if worker is None:
            self.wasted += seconds
            return
        worker.queue.popleft()
        worker.busy = False
        sums = Measurement(
            {"x": np.zeros(1)}, {"x": 1.0}, Iterations({0: [(chunk.first, chunk.first + chunk.count)]}), counters={}
        )
        bundle = Bundle((ticket,), name)
        self._outcomes[bundle] = Made(sums, None, chunk.count, seconds, is_first)
        self._gathering.put(bundle)
        self._gather()
        self._work(name, worker)

    def _gather(self) -> None:
        site = self._site
        while (chosen := self._gathering.next()) is not None:
            one = chosen[0]
            if len(chosen) == 1:
                start = max(self.now, self._link)
                self._link = start + site.latency + site.sum_bytes / site.link
                self.receiving += self._link - start
                self._at(self._link, self._fetched, one, self._link - self.now)
                continue
            merged = Bundle.of(chosen)
            self._bundles.add(merged)
            self._outcomes[merged] = merge_outcomes(*(self._outcomes.pop(b) for b in chosen))
            share = (len(chosen) - 1) * site.sum_bytes
            self._at(self._scheduled() + share / site.link + share / site.add, self._merged, merged)

    def _merged(self, bundle: Bundle) -> None:
        if bundle in self._bundles:
            self._gathering.put(bundle)
            self._gather()

    def _fetched(self, bundle: Bundle, seconds: float) -> None:
        self._gathering.fetched(seconds)
        outcome = self._outcomes.pop(bundle)
        if len(bundle.tickets) == 1 or bundle in self._bundles:
            self._bundles.discard(bundle)
            self.bytes += self._site.sum_bytes
            arrival = Arrival(bundle.tickets[0], outcome, seconds, bundle.tickets[1:])
            self._arrived.append((arrival, self._site.sum_bytes / self._site.add))
        self._gather()


class _Passes(Method):
    """A method whose passes are made by nobody."""

    name: ClassVar[str] = "simulated"
    samples_per_iteration = 1
    settings: Any = None

    def prepare(self, problem: Any, seed: int) -> None: ...

    def step(self, iteration: int, seed: int, state: Any) -> Pass:
        raise NotImplementedError

    def develop(self, measurement: Measurement, state: Any) -> Any:
        raise NotImplementedError


@dataclass
class Outcome:
    """How a simulated run went."""

    seconds: float
    efficiency: float  #: work of a worker of mean speed, over the time of all workers
    pool: SimulatedPool
    shares: dict[str, int]


def simulate(site: Site, passes: int, schedule: str = "demand", seed: int = 0) -> Outcome:
    """Run so many passes."""
    pool = SimulatedPool(site, seed)
    offered = Offered({"scene": b""})
    spreads: list[Spread] = []

    def make(order: Order) -> Spread:
        spreads.append(
            Spread(pool, Recipe("recipe", offered), order, schedule=SCHEDULES[schedule], clock=lambda: pool.now)
        )
        return spreads[0]

    speeds = [1.0 / worker.factor for worker in pool._workers.values()]
    runner = Runner(
        _Passes(), seed=0, budget=Budget(iterations=passes), executor=make, clock=lambda: pool.now, watched=False
    )
    run = runner.run()
    assert run.measurement.iterations.to_json() == [[0, 0, passes]]  # each pass once, whatever was lost
    ideal = passes * site.pass_seconds / sum(speeds)
    return Outcome(pool.now, ideal / pool.now, pool, spreads[0].shares())
