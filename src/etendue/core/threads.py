"""Threads: how many Dr.Jit has, and work that is divided among as many of Python."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from .errors import OptionError
from .settings import is_whole

T = TypeVar("T")


def set_threads(count: int | None) -> None:
    """Set the number of CPU threads of Dr.Jit; ``None`` does not change it. Raises :class:`OptionError` if it is not 1
    to 1024."""
    import drjit as dr

    if count is None:
        return
    if not is_whole(count) or not 1 <= count <= 1024:
        raise OptionError(f"the number of threads must be a whole number from 1 to 1024, not {count!r}")
    dr.set_thread_count(int(count))


@contextmanager
def threads_for_files() -> Iterator[None]:
    """At least two threads of Dr.Jit, while Mitsuba reads or writes a file of OpenEXR: with one it waits for ever."""
    import drjit as dr

    count = dr.thread_count()
    if count >= 2:
        yield
        return
    dr.set_thread_count(2)
    try:
        yield
    finally:
        dr.set_thread_count(count)


def threads() -> int:
    """The number of threads of Dr.Jit (:func:`set_threads`), at least 1."""
    import drjit as dr

    return max(int(dr.thread_count()), 1)


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """A persistent thread pool.

    A separate pool for each stream would be shut down with the stream. The garbage collector may close an abandoned
    stream at any time, even in a thread of that pool, which could deadlock."""
    return ThreadPoolExecutor(count, thread_name_prefix="etendue")


def in_order(tasks: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Results of tasks that run in as many threads as Dr.Jit has, in the order of the tasks; a few run ahead of the
    consumer. It pays for what releases Python's lock: compiled loops, compression.

    Tasks must not call this function: they would wait for their own threads.
    """
    count = threads()
    pool, waiting = _pool(count), deque[Future[T]]()
    try:
        for task in tasks:
            waiting.append(pool.submit(task))
            if len(waiting) > 2 * count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
