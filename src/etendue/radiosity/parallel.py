"""Work in threads, and the compiled loops that release Python's lock for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import TypeVar

import drjit as dr

from etendue.core import BackendError

T = TypeVar("T")


def compiled(loops: str = "kernels") -> ModuleType:
    """The loops that Numba compiles, of one module; raises :class:`BackendError` if that is not installed."""
    try:
        return import_module(f".{loops}", __package__)
    except ImportError as error:
        raise BackendError(
            f"loops of radiosity on the CPU are compiled by numba, which cannot be loaded ({error}): "
            "pip install 'etendue[radiosity]'"
        ) from error


def threads() -> int:
    """Threads to use: as many as Dr.Jit does (:func:`etendue.core.set_threads`)."""
    return max(int(dr.thread_count()), 1)


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """Threads that stay.

    A pool of its own for each stream would be shut down with it, and a stream that was given up is
    closed by the garbage collector in the middle of anything, also in a thread of a pool: a deadlock now and then."""
    return ThreadPoolExecutor(count, thread_name_prefix="radiosity")


def in_order(tasks: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Results of tasks that run side by side, in the order of the tasks, a few of which are ahead of what was taken.

    Tasks must not use this themselves: they would wait for their own threads.
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
