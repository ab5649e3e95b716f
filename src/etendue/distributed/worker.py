"""Code of a worker: it makes chunks of passes and sends their sum, carries paths through a box, or holds a part of a
scene and answers messages to the part."""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, ClusterError, EtendueError, Measurement, Method, State, describe, on_host, set_threads
from etendue.engine import replica_seed

from .content import Store
from .messages import PartMessages, Reply, Talking
from .recipes import Lacking, OpenRecipe

#: Size in bytes from which on an array is sent in single precision, and the largest number that it may then contain.
_LARGE, _LARGEST = 1 << 20, 1e30
#: Number of the latest runs whose methods a worker keeps.
_KEPT = 2


@dataclass(frozen=True)
class Chunk:
    """Consecutive passes of a run, which a worker makes and adds up."""

    run: str
    recipe: str  #: digest
    seed: int
    first: int
    count: int
    #: Seconds that are left for passes when the chunk is sent.
    left: float | None = None
    #: For methods whose passes depend on each other: the replica, and the state before ``first`` if the worker may not
    #: have it.
    replica: int | None = None
    state: State | None = None
    #: Arguments of the method's ``plan``.
    plan: tuple[float | None, int | None, float | None] = (None, None, None)
    #: Attributes of the method that belong to a run.
    attributes: Mapping[str, Any] = field(default_factory=dict)
    #: Threads of Dr.Jit.
    threads: int | None = None
    #: Whether its sum may be added to those of other chunks before the client has it.
    may_merge: bool = True


@dataclass(frozen=True)
class PathBatch:
    """Paths of a pass that a worker carries through one box of a divided scene; ``recipe`` is that of the box."""

    run: str
    recipe: str  #: digest
    seed: int
    iteration: int
    #: Records of paths; or the number of the first path and the number of paths that begin.
    paths: NDArray[np.uint32] | tuple[int, int]
    #: Number of the latest boxes whose scenes the worker keeps.
    kept: int = 1
    threads: int | None = None


#: A task of a worker.
WorkerTask = Chunk | PathBatch | PartMessages


@dataclass
class Carried:
    """The outcome of a batch: what was measured, and records of the paths that go on in other boxes."""

    product: NDArray[np.uint32]
    leaving: NDArray[np.uint32]
    counters: dict[str, float]
    seconds: float
    loaded: bool  #: whether the scene of the box had to be loaded


@dataclass
class Made:
    """The sum of the passes of a chunk, which may be fewer than requested if time or the run has ended."""

    measurement: Measurement | None
    state: State | None
    passes: int
    seconds: float  #: of the passes
    is_first: bool  #: whether the seconds include compilation


@dataclass(frozen=True)
class Needs:
    """Files, by digest, or the state that must be sent before the task can be done."""

    digests: tuple[str, ...] = ()
    state: bool = False


@dataclass(frozen=True)
class Failed:
    """The error of a task. ``refused``: this worker can do no task of the run; ``kind``: name of its class."""

    message: str
    kind: str
    refused: bool = False


Outcome = Made | Carried | Reply | Needs | Failed


@dataclass
class Merged:
    """Outcomes of several chunks, in the order of their tickets. A :class:`Made` outcome has no measurement here:
    ``total`` is the sum of them all."""

    outcomes: list[Outcome]
    total: Measurement | None = None


def merge_outcomes(*outcomes: Outcome | Merged) -> Merged:
    """Add up sums in a worker, before one of them goes to the client."""
    result = Merged([])
    for outcome in outcomes:
        if isinstance(outcome, Merged):
            result.outcomes += outcome.outcomes
            more = outcome.total
        elif isinstance(outcome, Made):
            result.outcomes.append(replace(outcome, measurement=None))
            more = outcome.measurement
        else:
            result.outcomes.append(outcome)
            continue
        if more is not None:
            result.total = more.copy() if result.total is None else _sum(result.total, more)
    if result.total is not None:
        result.total = narrowed(result.total)
    return result


def narrowed(measurement: Measurement) -> Measurement:
    """The measurement with large arrays in single precision, which halves the bytes to send; relative rounding 6e-8.
    Arrays with values outside the range of single precision do not change."""

    def few(array: Array) -> Array:
        if array.dtype != np.float64 or array.nbytes < _LARGE:
            return array
        size = np.abs(array)
        if not np.isfinite(size).all() or size.max() > _LARGEST:
            return array
        return array.astype(np.float32)

    tables: dict[str, Any] = {
        name: {key: few(array) for key, array in getattr(measurement, name).items()}
        for name in ("sums", "squares", "products")
    }
    return replace(measurement, **tables)


def make_passes(task: WorkerTask) -> Outcome:
    """Do a task in this process."""
    return _desk().make(task)


def receive(digest: str, offset: int, piece: bytes, is_last: bool) -> str | None:
    """Store a piece of a file in this process's folder. Returns the problem, ``None`` if there is none."""
    try:
        _desk().store().receive(digest, offset, piece, is_last)
    except EtendueError as error:
        return str(error)
    return None


def end_run(run: str, seconds: float = 0.0) -> None:
    """Begin no more passes of ``run`` in this process that would end later than ``seconds`` from now."""
    _desk().end(run, seconds)


def ends_by(ended: Any) -> None:
    """Also end a run in this process when ``ended``, a number shared by processes, is the number of the run."""
    _desk().ended = ended


def introduce(is_local: bool = False) -> dict[str, Any]:
    """Process id and Python's version of this process. ``is_local``: ignore Ctrl-C, SIGTERM and SIGUSR1, which a
    terminal, ``timeout`` and ``pkill`` send to all processes of a group or name; the client ends the workers."""
    if is_local and threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGUSR1"):
            if (number := getattr(signal, name, None)) is not None:
                signal.signal(number, signal.SIG_IGN)
    return {"pid": os.getpid(), "python": "{}.{}".format(*sys.version_info[:2])}


def unfit(answer: Any) -> str | None:
    """Why a worker that answers :func:`introduce` so cannot be used; ``None`` if it can, or has ended meanwhile."""
    here = introduce()["python"]
    if isinstance(answer, dict):
        wrong = answer["python"] != here
        return f"it runs Python {answer['python']}, the client {here}; use the same version" if wrong else None
    if isinstance(answer, ModuleNotFoundError):
        return f"it has no module '{answer.name}'; install étendue there"
    if isinstance(answer, (ImportError, AttributeError, TypeError)):
        return f"{describe(answer)}; install the same version of étendue there"
    return None


@cache
def _desk() -> _Desk:
    return _Desk()


class _Run:
    """The methods of a run in this process."""

    def __init__(self, opened: OpenRecipe) -> None:
        self.opened = opened
        #: By replica, -1 if passes are independent: a method, the next iteration of its state, and the state.
        self.methods: dict[int, tuple[Method, int, State]] = {}
        #: For a scene whose parts are in several workers: the part in this one.
        self.part: Talking | None = None
        self._first = 0.0  # seconds of the first pass of a method
        self._recent: deque[float] = deque(maxlen=8)  # seconds of later passes

    def predict(self) -> float:
        """Seconds of the next pass, an upper estimate. The first one of a method includes compilation."""
        return max(self._recent, default=0.5 * self._first)

    def count(self, seconds: float, is_first: bool) -> None:
        """Count a pass."""
        if is_first:
            self._first = seconds
        else:
            self._recent.append(seconds)


class _Desk:
    """Makes chunks, one at a time and in one thread, since Dr.Jit's flags belong to a thread."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="etendue")
        self._runs: OrderedDict[str, _Run] = OrderedDict()
        self._ends: dict[str, float] = {}
        self._lock = threading.Lock()
        self.ended: Any = None

    @staticmethod
    @cache
    def store() -> Store:
        return Store()

    def make(self, task: WorkerTask) -> Outcome:
        if isinstance(task, Chunk) and task.left is not None:
            self.end(task.run, task.left)
        return self._thread.submit(self._make, task).result()

    def end(self, run: str, seconds: float) -> None:
        with self._lock:
            at = time.monotonic() + seconds
            self._ends[run] = min(self._ends.get(run, at), at)
            while len(self._ends) > 64:
                self._ends.pop(next(iter(self._ends)))

    def _make(self, task: WorkerTask) -> Outcome:
        try:
            try:
                run = self._run(task)
            except Lacking as lacking:
                return Needs(tuple(lacking.digests))
            except Exception as error:
                return _failed(error, refused=True)
            if isinstance(task, PartMessages):
                return self._talk(task, run)
            return self._passes(task, run) if isinstance(task, Chunk) else self._carry(task, run)
        except Exception as error:
            return _failed(error)

    def _run(self, task: WorkerTask) -> _Run:
        set_threads(task.threads)
        name = task.run if isinstance(task, Chunk) else f"{task.run} {task.recipe}"
        if isinstance(task, PartMessages):  # parts with the same recipe have a state each
            name += f" {task.part}"
        if name in self._runs:
            self._runs.move_to_end(name)
            return self._runs[name]
        same = [run.opened for run in self._runs.values() if run.opened.digest == task.recipe]
        while len(self._runs) >= (_KEPT if isinstance(task, Chunk) else max(1, task.kept)):
            self._runs.popitem(last=False)
        self._runs[name] = run = _Run(same[0] if same else OpenRecipe(self.store(), task.recipe))
        return run

    def _carry(self, task: PathBatch, run: _Run) -> Carried:
        begin, loaded = time.monotonic(), -1 not in run.methods
        if loaded:
            run.methods[-1] = run.opened.method(task.seed), 0, {}
        method: Any = run.methods[-1][0]
        if isinstance(task.paths, tuple):
            product, leaving, counters = method.emit(task.iteration, task.seed, *task.paths)
        else:
            product, leaving, counters = method.carry(task.iteration, task.seed, task.paths)
        return Carried(product, leaving, counters, time.monotonic() - begin, loaded)

    def _talk(self, task: PartMessages, run: _Run) -> Reply | Needs:
        if loaded := run.part is None:
            method: Any = run.opened.method(task.seed)
            run.part = Talking(method)
        assert run.part is not None
        return run.part.reply(task, loaded) or Needs(state=True)

    def _passes(self, chunk: Chunk, run: _Run) -> Outcome:
        replica = -1 if chunk.replica is None else chunk.replica
        seed = replica_seed(chunk.seed, max(replica, 0))
        is_new = replica not in run.methods
        if not is_new:
            method, at, state = run.methods[replica]
        else:
            method = run.opened.method(seed)
            method.plan(*chunk.plan)
            at, state = 0, method.start()
        if chunk.state is not None:
            at, state = chunk.first, chunk.state
            method.enter(state)
        elif chunk.replica is not None and chunk.first == 0 and at:  # passes made here did not arrive
            at, state = 0, method.start()
            method.enter(state)
        for name, value in chunk.attributes.items():
            setattr(method, name, value)
        if chunk.replica is not None and at != chunk.first:
            return Needs(state=True)
        run.methods.pop(replica, None)  # if a pass raises, the state may be undefined
        total: Measurement | None = None
        passes, began = 0, time.monotonic()
        while passes < chunk.count and self._may_begin(chunk.run, run.predict()):
            begin = time.monotonic()
            made = method.step(chunk.first + passes, seed, state)
            state, total = made.state, _sum(total, made.measurement)
            run.count(time.monotonic() - begin, is_new and passes == 0)
            passes += 1
        run.methods[replica] = method, chunk.first + passes, state
        if chunk.replica is not None and total is not None:
            total.assign(chunk.replica)
        kept = None if chunk.replica is None else on_host(state)
        total = None if total is None else narrowed(total)
        return Made(total, kept, passes, time.monotonic() - began, is_new)

    def _may_begin(self, run: str, seconds: float) -> bool:
        if self.ended is not None and self.ended.value == int(run[:16], 16):
            return False
        return time.monotonic() + seconds <= self._ends.get(run, float("inf"))


def _sum(total: Measurement | None, other: Measurement) -> Measurement:
    if total is None:
        return other
    total += other
    return total


def _failed(error: Exception, refused: bool = False) -> Failed:
    if isinstance(error, MemoryError):
        error = ClusterError("its memory is full; give the worker more, or make the picture smaller")
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        error = ClusterError("its disk is full; free some room")
    known = next((c.__name__ for c in type(error).__mro__ if c.__module__ == EtendueError.__module__), "EtendueError")
    # Another worker may have what is missing here, but a wrong scene or option is wrong on every worker.
    return Failed(describe(error), known, refused and known in ("ClusterError", "BackendError", "EtendueError"))
