"""The executor of a scene that is cut into boxes: paths go from worker to worker as records."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue.core import Measurement, Pass
from etendue.engine import Order

from .content import Offered
from .dispatcher import Dispatcher
from .pool import Pool
from .recipes import Recipe
from .worker import Carried, PathBatch

#: Largest number of paths of a task.
_BATCH = 1 << 16
#: Passes whose paths are under way at the same time, so that workers have something to do while the last paths of a
#: pass end.
_AHEAD = 2
#: Number of tasks of a worker at a time.
_IN_FLIGHT = 2
_TICK = 0.1

#: Records of paths, (n, words) uint32; column 1 is the box in which a path goes on.
Records = NDArray[np.uint32]


@dataclass(frozen=True)
class Visit:
    """One task: the worker, the box, and the number of paths carried through the box."""

    worker: str
    box: int  #: -1 where paths began
    paths: int
    leaving: int  #: paths that went on in other boxes
    loaded: bool  #: whether the scene of the box had to be loaded


@dataclass
class Traffic:
    """The tasks of a run, in the order in which they ended."""

    visits: list[Visit] = field(default_factory=list)
    received: int = 0  #: bytes of records and products that came from workers
    sent: int = 0  #: bytes of records that went to workers

    @property
    def loads(self) -> int:
        """How often the scene of a box was loaded by a worker."""
        return sum(visit.loaded for visit in self.visits)


@dataclass
class _Open:
    """A pass whose paths are under way."""

    tasks: int = 0  #: waiting or in flight
    products: list[NDArray[np.uint32]] = field(default_factory=list)
    counters: dict[str, float] = field(default_factory=dict)


class Divided(Dispatcher[PathBatch]):
    """Makes passes of light paths in a divided scene; implements ``engine.Executor``.

    recipes: of the method in each box, whose functions ``emit`` and ``carry`` return (product, records, counters).
    gather: makes the measurement of a pass of its iteration, products and counters. paths: of a pass. A
    worker holds an equal share of the boxes, those it used last.

    Records pass through this process. The tasks of a lost worker are sent again, and each product counts once.
    """

    keeps_time: ClassVar[bool] = False

    def __init__(
        self,
        pool: Pool,
        recipes: Sequence[Recipe],
        order: Order,
        paths: int,
        gather: Callable[[int, Sequence[NDArray[np.uint32]], dict[str, float]], Measurement],
        *,
        traffic: Traffic | None = None,
    ) -> None:
        contents: dict[str, Any] = {}
        for recipe in recipes:
            contents |= recipe.offered.contents
        super().__init__(pool, Offered(contents))
        self._recipes, self._order, self._paths, self._gather = recipes, order, paths, gather
        self.traffic = traffic if traffic is not None else Traffic()
        self._missing = order.done.missing()
        self._begun = len(order.done)
        self._open: dict[int, _Open] = {}
        self._ready: list[int] = []
        self._beginnings: list[PathBatch] = []  # tasks in which paths begin, for any box
        #: Waiting tasks by box.
        self._waiting: dict[int, list[PathBatch]] = {box: [] for box in range(len(recipes))}
        #: Boxes that each worker holds, the last used box last.
        self._holds: dict[str, OrderedDict[int, None]] = {}
        self._box_of = {recipe.digest: box for box, recipe in enumerate(recipes)}
        self._shares: dict[str, int] = {}
        self._look(now=True)

    # ------------------------------------------------------------------ an executor

    def next(self) -> Pass | None:
        """See :class:`Executor`."""
        self._look()
        most = self._order.most
        while len(self._open) < _AHEAD and (most is None or self._begun < most):
            self._begin(next(self._missing))
        self._feed()
        if (arrival := self._pool.wait(_TICK)) is not None and (taken := self._take(arrival)) is not None:
            self._carried(*taken)
        return self._finished()

    def rest(self) -> Iterator[Pass]:
        """See :class:`Executor`: unfinished passes are given up."""
        return iter(())

    def close(self) -> None:
        """See :class:`Executor`."""
        self._cancel()

    def shares(self) -> dict[str, int]:
        """Tasks of each worker."""
        return dict(self._shares)

    # ------------------------------------------------------------------ workers

    def _joined(self, name: str) -> None:
        self._holds.setdefault(name, OrderedDict())

    def _gone(self, name: str) -> None:
        self._holds.pop(name, None)

    def _not_made(self, task: PathBatch) -> None:
        if isinstance(task.paths, tuple):
            self._beginnings.append(task)
        else:
            self._waiting[self._box_of[task.recipe]].append(task)

    @property
    def _kept(self) -> int:
        """Number of boxes that a worker holds."""
        return -(-len(self._recipes) // max(1, len(self._workers)))

    def _begin(self, iteration: int) -> None:
        """Paths of a pass begin: any worker can sample the lights."""
        self._begun += 1
        self._open[iteration] = _Open()
        for first in range(0, self._paths, _BATCH):
            self._add(iteration, 0, (first, min(_BATCH, self._paths - first)))

    def _add(self, iteration: int, box: int, paths: Records | tuple[int, int]) -> None:
        self._open[iteration].tasks += 1
        self._not_made(PathBatch(self._run, self._recipes[box].digest, self._order.seed, iteration, paths))

    def _feed(self) -> None:
        for level in range(_IN_FLIGHT):
            for name, worker in sorted(self._workers.items()):
                if len(worker.flights) != level or worker.coming:
                    continue
                if (box := self._choose(name)) is not None:
                    # Paths of the oldest pass first; those of one pass that wait for the same box go together.
                    queue = self._waiting[box]
                    queue.sort(key=lambda task: task.iteration)
                    task = self._joined_tasks(queue)
                elif self._beginnings and (box := self._home(name)) is not None:
                    task = replace(self._beginnings.pop(0), recipe=self._recipes[box].digest)
                else:
                    continue
                held = self._holds[name]
                held[box] = None
                held.move_to_end(box)
                while len(held) > self._kept:
                    held.popitem(last=False)
                if not isinstance(task.paths, tuple):
                    self.traffic.sent += task.paths.nbytes
                self._send(name, replace(task, kept=self._kept, threads=worker.threads))

    def _choose(self, name: str) -> int | None:
        """The next box for a worker: of the boxes open to it, the one with the most waiting paths."""
        full = {box: sum(map(_size, queue)) for box, queue in self._waiting.items() if queue}
        if mine := {box: n for box, n in full.items() if box in self._holds[name]}:
            full = mine
        else:
            # A box that another worker holds is left to that worker, unless many paths wait.
            others = self._held_by_others(name)
            full = {box: n for box, n in full.items() if box not in others or n > 2 * _BATCH}
        return max(full, key=lambda box: full[box], default=None)

    def _held_by_others(self, name: str) -> set[int]:
        return set().union(*(held for other, held in self._holds.items() if other != name))

    def _home(self, name: str) -> int | None:
        """The box in which a worker begins paths: the one that it used last, or its first one."""
        if self._holds[name]:
            return next(reversed(self._holds[name]))
        held = self._held_by_others(name)
        return next((box for box in range(len(self._recipes)) if box not in held), None)

    def _joined_tasks(self, queue: list[PathBatch]) -> PathBatch:
        """The first task of a queue, with the paths of others of the same pass, up to :data:`_BATCH` paths."""
        first = queue.pop(0)
        if isinstance(first.paths, tuple):
            return first
        parts, size = [first.paths], len(first.paths)
        for task in list(queue):
            if task.iteration != first.iteration or isinstance(task.paths, tuple) or size + len(task.paths) > _BATCH:
                continue
            queue.remove(task)
            parts.append(task.paths)
            size += len(task.paths)
            self._open[first.iteration].tasks -= 1
        return PathBatch(first.run, first.recipe, first.seed, first.iteration, np.concatenate(parts))

    # ------------------------------------------------------------------ outcomes

    def _carried(self, name: str, task: PathBatch, made: Any) -> None:
        assert isinstance(made, Carried)
        leaving = made.leaving
        box = -1 if isinstance(task.paths, tuple) else self._box_of[task.recipe]
        self.traffic.visits.append(Visit(name, box, _size(task), len(leaving), made.loaded))
        self.traffic.received += made.product.nbytes + leaving.nbytes
        self._shares[name] = self._shares.get(name, 0) + 1
        current = self._open[task.iteration]
        current.tasks -= 1
        if len(made.product):
            current.products.append(made.product)
        _add_counters(current.counters, made.counters)
        for following in np.unique(leaving[:, 1]):
            self._add(task.iteration, int(following), leaving[leaving[:, 1] == following])
        if not current.tasks:
            self._ready.append(task.iteration)

    def _finished(self) -> Pass | None:
        if not self._ready:
            return None
        iteration = self._ready.pop(0)
        done = self._open.pop(iteration)
        return Pass(self._gather(iteration, done.products, done.counters), self._order.state)


def _size(task: PathBatch) -> int:
    return task.paths[1] if isinstance(task.paths, tuple) else len(task.paths)


def _add_counters(total: dict[str, float], more: Mapping[str, float]) -> None:
    for name, value in more.items():
        total[name] = total.get(name, 0.0) + value
