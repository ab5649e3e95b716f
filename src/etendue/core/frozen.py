"""Functions whose kernels are launched again without being traced anew in Python, and tracing without collection."""

from __future__ import annotations

import gc
import inspect
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, Generic, TypeVar

import drjit as dr

from .log import logger

R = TypeVar("R")
#: Largest depth at which an object is searched for device arrays.
_DEPTH = 6
#: Number of recordings kept, for different sizes of arguments.
_RECORDINGS = 8


class Frozen(Generic[R]):
    """A function of device arrays, frozen by ``dr.freeze`` if possible, otherwise called directly.

    Parameters
    ----------
    function: a function of device arrays and of Mitsuba's objects, evaluated or not, which reads no results back. Its
        Python control flow depends only on the types and sizes of its arguments. The object of a bound method is
        referenced weakly, because it usually owns this :class:`Frozen`.
    reads: called at each call; returns the objects whose device arrays the function reads beside its arguments.
    """

    def __init__(self, function: Callable[..., R], reads: Callable[[], object]) -> None:
        self._function = call = _weakly(function)
        ask = _weakly(reads)

        def traced(*arguments: Any) -> R:
            result: R = call()(*arguments)
            return result

        self._frozen = dr.freeze(
            traced, state_fn=lambda *_, **__: device_parts(ask()()), limit=_RECORDINGS, warn_after=1 << 30
        )
        self._fails = False

    @property
    def recordings(self) -> int:
        """How often the function was traced; 0 if it is not frozen."""
        return 0 if self._fails else int(self._frozen.n_recordings)

    def __call__(self, *arguments: Any) -> R:
        """What the function returns."""
        result: R
        if not self._fails:
            try:
                with uncollected():
                    result = self._frozen(*arguments)
                return result
            except RuntimeError as error:
                _raise_interrupts(error)
                name = getattr(self._function(), "__qualname__", "a function")
                log = logger.warning if self.recordings else logger.debug
                log("kernels of %s are traced for every call: %s", name, error)
                self._fails = True
        result = self._function()(*arguments)
        return result


def _weakly(function: Callable[..., Any]) -> Callable[[], Callable[..., Any]]:
    """A function that returns ``function``, without a reference to the object of a bound method."""
    if not inspect.ismethod(function):
        return lambda: function
    method = weakref.WeakMethod(function)

    def alive() -> Callable[..., Any]:
        found = method()
        assert found is not None  # the object itself makes this call
        return found

    return alive


def _raise_interrupts(error: BaseException) -> None:
    """Raise an interrupt, such as KeyboardInterrupt, that Dr.Jit has converted to a RuntimeError."""
    cause: BaseException | None = error
    while cause is not None:
        if not isinstance(cause, Exception):
            raise cause
        cause = cause.__cause__ or cause.__context__


class _Collection:
    """Number of threads that need garbage collection disabled, and whether it was enabled before the first of them."""

    lock: ClassVar = threading.Lock()
    count: ClassVar[int] = 0
    was_on: ClassVar[bool] = True


@contextmanager
def uncollected() -> Iterator[None]:
    """Disable garbage collection in all threads. While kernels are traced, Dr.Jit calls Python for every light and
    material; the process crashes if a collection then deletes a scene, or, while a function is recorded, another frozen
    function."""
    with _Collection.lock:
        if not _Collection.count:
            _Collection.was_on = gc.isenabled()
            gc.disable()
        _Collection.count += 1
    try:
        yield
    finally:
        with _Collection.lock:
            _Collection.count -= 1
            if not _Collection.count and _Collection.was_on:
                gc.enable()


def device_parts(root: object) -> list[Any]:
    """Device arrays and Mitsuba objects in étendue's objects below ``root``: the state of a frozen function."""
    import mitsuba as mi

    found: list[Any] = []
    seen: set[int] = set()
    waiting = deque([(root, 0)])  # breadth first: an object is first reached at its least depth
    while waiting:
        value, depth = waiting.popleft()
        parts: Iterable[Any] = ()
        if isinstance(value, (mi.Object, mi.DiscreteDistribution)) or dr.is_jit_v(value):
            found.append(value)
        elif isinstance(value, (list, tuple)):
            parts = value
        elif isinstance(value, dict):
            parts = value.values()
        elif type(value).__module__.startswith("etendue") and hasattr(value, "__dict__") and id(value) not in seen:
            seen.add(id(value))
            parts = vars(value).values()
        if depth < _DEPTH:
            waiting.extend((part, depth + 1) for part in parts if part is not None)
    return found
