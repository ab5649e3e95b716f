"""Threads: how many Dr.Jit has, and work that is divided among as many of Python."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

from .errors import OptionError
from .settings import is_whole

T = TypeVar("T")

#: Seconds without work after which threads of Dr.Jit sleep: new ones do so at once, others after 0.02.
_ASLEEP = 0.05


def set_threads(count: int | None) -> None:
    """Set the number of CPU threads of Dr.Jit; ``None`` does not change it. Raises :class:`OptionError` if it is not 1
    to 1024."""
    import drjit as dr

    if count is None:
        return
    if not is_whole(count) or not 1 <= count <= 1024:
        raise OptionError(f"the number of threads must be a whole number from 1 to 1024, not {count!r}")
    if count != dr.thread_count():
        _set_count(int(count))


def _set_count(count: int) -> None:
    """Set the number of threads while all sleep: one that falls asleep just when it is told to end may miss it, and the
    caller waits for ever (Dr.Jit 1.5; one of 10,000 threads that ended as soon as they began)."""
    import drjit as dr

    if count < dr.thread_count():
        time.sleep(_ASLEEP)
    dr.set_thread_count(count)


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
        _set_count(count)


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
