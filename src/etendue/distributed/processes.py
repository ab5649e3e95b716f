"""Workers as processes of this machine, by ``concurrent.futures``: no library is needed, nothing listens on a port."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import queue
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from etendue.core import ClusterError, EtendueError, OptionError, describe, is_whole

from .content import Offered, Store
from .pool import Arrival, Delivered, Lost
from .worker import WorkerTask, ends_by, introduce, make_passes

#: Seconds to wait for the first answer of a process.
_FIRST_ANSWER = 60.0


class ProcessPool:
    """``count`` processes with ``threads`` Dr.Jit threads each, by default shares of those of this process; implements
    :class:`Pool`. A process that ends is replaced. Processes do not run the script that started this one, so it needs
    no ``if __name__ == "__main__"``.

    Raises :class:`OptionError` for another number of processes, :class:`ClusterError` if they cannot be started.
    """

    def __init__(self, count: int, threads: int | None = None) -> None:
        if not is_whole(count) or not 1 <= count <= 1024:
            raise OptionError(f"the number of workers is a whole number from 1 to 1024, not {count!r}")
        if threads is None:
            import drjit as dr

            threads = max(1, dr.thread_count() // count)
        self._context: Any = multiprocessing.get_context("spawn")
        self._ended = self._context.Value("Q", 0)
        self._threads, self._numbers = threads, itertools.count(1)
        self._processes: dict[str, ProcessPoolExecutor] = {}
        self._futures: dict[int, Future[Any]] = {}
        self._done: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()
        #: Process ids by name.
        self.pids: dict[str, int] = {}
        for started in [self._start() for _ in range(count)]:
            self._greet(*started)

    def workers(self) -> dict[str, int | None]:
        """See :class:`Pool`."""
        return dict.fromkeys(self._processes, self._threads)

    def send(self, worker: str, ticket: int, task: WorkerTask) -> None:
        """See :class:`Pool`."""
        future: Future[Any] = Future()
        try:
            future = self._processes[worker].submit(make_passes, task)
        except (BrokenProcessPool, KeyError) as error:  # it has ended, and may have been replaced
            future.set_exception(error)
        self._futures[ticket] = future
        future.add_done_callback(lambda _: self._done.put((ticket, worker)))

    def wait(self, seconds: float) -> Arrival | None:
        """See :class:`Pool`."""
        try:
            ticket, worker = self._done.get(timeout=seconds)
        except queue.Empty:
            return None
        future = self._futures.pop(ticket, None)
        if future is None or future.cancelled():
            return None
        try:
            return Arrival(ticket, future.result())
        except Exception as error:
            if isinstance(error, BrokenProcessPool) and worker in self._processes:
                self._processes.pop(worker).shutdown(wait=False)
                self.pids.pop(worker, None)
                self._greet(*self._start())
            return Arrival(ticket, Lost(describe(error)))

    def deliver(self, worker: str, ticket: int, offered: Offered, digest: str) -> None:
        """See :class:`Pool`. All processes share the folder of this one."""
        problem = None
        try:
            for offset, piece, is_last in offered.pieces(digest):
                Store().receive(digest, offset, piece, is_last)
        except EtendueError as error:
            problem = str(error)
        done: Future[Any] = Future()
        self._futures[ticket] = done
        done.set_result(Delivered(problem))
        self._done.put((ticket, worker))

    def end_run(self, run: str) -> None:
        """See :class:`Pool`."""
        self._ended.value = int(run[:16], 16)

    def held_by_others(self, worker: str, tickets: list[int]) -> set[int]:
        """See :class:`Pool`."""
        return set()

    def forget(self, tickets: list[int]) -> None:
        """See :class:`Pool`."""
        for ticket in tickets:
            if (future := self._futures.pop(ticket, None)) is not None:
                future.cancel()

    def close(self) -> None:
        """End the processes after their current pass."""
        for process in self._processes.values():
            process.shutdown(wait=True, cancel_futures=True)
        self._processes.clear()

    def _start(self) -> tuple[str, Future[Any]]:
        """Start a process; its name and its answer."""
        process, name = (
            ProcessPoolExecutor(1, self._context, initializer=_begin, initargs=(self._ended,)),
            f"process {next(self._numbers)}",
        )
        self._processes[name] = process
        with _without_script():
            return name, process.submit(introduce, True)  # starts it

    def _greet(self, name: str, answer: Future[Any]) -> None:
        try:
            self.pids[name] = answer.result(_FIRST_ANSWER)["pid"]
        except Exception as error:
            self.close()
            raise ClusterError(f"worker processes cannot be started: {describe(error)}") from error


@contextmanager
def _without_script() -> Iterator[None]:
    """Keep ``multiprocessing`` from running the script of this process in those that it starts: what workers need is in
    modules, see :func:`.recipe`."""
    main = sys.modules["__main__"]
    known: dict[str, Any] = {name: vars(main)[name] for name in ("__file__", "__spec__") if name in vars(main)}
    try:
        main.__spec__ = None
        vars(main).pop("__file__", None)
        yield
    finally:
        vars(main).update(known)


def _begin(ended: Any) -> None:
    """In a process of the pool: end it with its parent, even if the parent is killed."""
    ends_by(ended)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
