"""Functions whose kernels are launched again without being traced anew in Python, and tracing without interruption."""

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
#: How deep device arrays lie in an object.
_DEPTH = 6
#: Recordings that are kept, for different sizes of arguments.
_RECORDINGS = 8


class Frozen(Generic[R]):
    """A function of device arrays, frozen by ``dr.freeze`` if it can be, and called as it is if not.

    Parameters
    ----------
    function: a function of device arrays and of Mitsuba's objects, evaluated or not, which reads no results back. What
        its Python code does depends on the types and sizes of its arguments only. The object of a bound method is not
        kept alive, because it usually owns this object.
    reads: the objects with the device arrays that it reads beside its arguments, asked for at each call.
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
        assert found is not None  # its object calls it
        return found

    return alive


def _raise_interrupts(error: BaseException) -> None:
    """Raise what Dr.Jit turned into a RuntimeError if it is no failure, such as KeyboardInterrupt."""
    cause: BaseException | None = error
    while cause is not None:
        if not isinstance(cause, Exception):
            raise cause
        cause = cause.__cause__ or cause.__context__


class _Collection:
    """How many threads want no garbage collection, and whether there was one before the first."""

    lock: ClassVar = threading.Lock()
    count: ClassVar[int] = 0
    was_on: ClassVar[bool] = True


@contextmanager
def uncollected() -> Iterator[None]:
    """Without garbage collection, in any thread. While kernels are traced, Dr.Jit calls Python for all lights and
    materials there are; the process dies if a collection deletes a scene then, or another frozen function while one is
    recorded."""
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
    waiting = deque([(root, 0)])  # the shallow ones first: what is seen again is not nearer
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
