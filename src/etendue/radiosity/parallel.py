"""Work in threads, and the compiled loops that release Python's lock for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from types import ModuleType
from typing import TypeVar

import drjit as dr

from etendue.core import BackendError

T = TypeVar("T")


def compiled(loops: str = "compiled") -> ModuleType:
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


def in_order(tasks: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Results of tasks that run side by side, in the order of the tasks, a few of which are ahead of what was taken."""
    with ThreadPoolExecutor(threads()) as pool:
        waiting: deque[Future[T]] = deque()
        try:
            for task in tasks:
                waiting.append(pool.submit(task))
                if len(waiting) > 2 * threads():
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
