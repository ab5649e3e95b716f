"""Parallel work in threads, with compiled loops that release Python's lock."""

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
    """A module of loops compiled by Numba; raises :class:`BackendError` if Numba is not installed."""
    try:
        return import_module(f".{loops}", __package__)
    except ImportError as error:
        raise BackendError(
            f"loops of radiosity on the CPU are compiled by numba, which cannot be loaded ({error}): "
            "pip install 'etendue[radiosity]'"
        ) from error


def threads() -> int:
    """Number of threads, the same as that of Dr.Jit (:func:`etendue.core.set_threads`)."""
    return max(int(dr.thread_count()), 1)


@cache
def _pool(count: int) -> ThreadPoolExecutor:
    """A persistent thread pool.

    A separate pool for each stream would be shut down with the stream. The garbage collector may close an abandoned
    stream at any time, even in a thread of that pool, which could deadlock."""
    return ThreadPoolExecutor(count, thread_name_prefix="radiosity")


def in_order(tasks: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Results of parallel tasks, in the order of the tasks; a few tasks run ahead of the consumer.

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
