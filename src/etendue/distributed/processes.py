"""Workers as processes of this machine, by ``concurrent.futures``: no library is needed, nothing listens on a port."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import queue
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from etendue.core import EtendueError, describe

from .content import Offered, Store
from .pool import Arrival, Delivered, Lost
from .worker import Task, ends_by, introduce, make_passes


class ProcessPool:
    """``count`` processes with ``threads`` Dr.Jit threads each; implements :class:`Pool`. A process that ends is
    replaced."""

    def __init__(self, count: int, threads: int | None = None) -> None:
        self._context: Any = multiprocessing.get_context("spawn")
        self._ended = self._context.Value("Q", 0)
        self._threads, self._numbers = threads, itertools.count(1)
        self._processes: dict[str, ProcessPoolExecutor] = {}
        self._futures: dict[int, Future[Any]] = {}
        self._done: queue.SimpleQueue[tuple[int, str]] = queue.SimpleQueue()
        for _ in range(count):
            self._start()

    def workers(self) -> dict[str, int | None]:
        """See :class:`Pool`."""
        return dict.fromkeys(self._processes, self._threads)

    def send(self, worker: str, ticket: int, task: Task) -> None:
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
                self._start()
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

    def _start(self) -> None:
        process = ProcessPoolExecutor(1, self._context, initializer=_begin, initargs=(self._ended,))
        process.submit(introduce, True)  # starts it
        self._processes[f"process {next(self._numbers)}"] = process


def _begin(ended: Any) -> None:
    """In a process of the pool: end it with its parent, even if the parent is killed."""
    ends_by(ended)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)
