"""A run in the background, with the current picture, progress and cancelling."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from contextvars import copy_context
from types import TracebackType
from typing import TYPE_CHECKING, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from etendue.core import InNotebooks, Progress, describe, logger, own_kernels

from .runner import Cancelled, RunError, Runner, RunResult

if TYPE_CHECKING:
    import drjit as dr

T = TypeVar("T")


class Session(InNotebooks, Generic[T]):
    """A run in its own thread. All members may be used from any thread.

    ``build(cancel)`` is called in the new thread and returns a :class:`Runner` that checks ``cancel``; ``finish``
    computes :attr:`result` from the measurement; ``at_end`` is called last in any case. Dr.Jit's flags belong to a
    thread: those of the creating thread are copied. The variant of Mitsuba is global and must not be changed while a
    session runs.

    As a context manager, a session is cancelled at the end of the block; the error of the run is raised there.
    """

    def __init__(
        self,
        build: Callable[[threading.Event], Runner],
        finish: Callable[[RunResult], T],
        at_end: Callable[[], object] = lambda: None,
    ) -> None:
        self._build = build
        self._finish = finish
        self._at_end = at_end
        self._stop = threading.Event()
        self._done = threading.Event()
        self._runner: Runner | None = None
        self._made = False
        self._result: list[T] = []
        self._error: BaseException | None = None
        self._flags = jit_flags()
        self._thread = threading.Thread(
            target=copy_context().run, args=(self._work,), name="etendue-session", daemon=True
        )
        self._thread.start()

    @own_kernels()
    def _work(self) -> None:
        try:
            set_jit_flags(self._flags)
            self._runner = self._build(self._stop)
            run = self._runner.run()
            self._made = True
            self._result.append(self._finish(run))
        except RunError as error:
            self._made = True
            self._error = error
            self._keep(error.run)
        except BaseException as error:  # raised by `wait`
            self._error = error
        finally:
            try:
                self._at_end()
            except Exception as error:
                logger.warning("after the run: %s", describe(error))
            self._done.set()

    def _keep(self, run: RunResult) -> None:
        """Save the passes before the failed one. The failure is raised, so an error of saving is only logged."""
        try:
            self._finish(run)
        except Exception as error:
            logger.warning("the passes before the failure could not be saved: %s", describe(error))

    @property
    def running(self) -> bool:
        """Whether the run has not ended."""
        return not self._done.is_set()

    @property
    def prepared(self) -> bool:
        """Whether the scene is loaded and the method prepared."""
        return self._runner is not None

    @property
    def finishing(self) -> bool:
        """Whether the passes are made, and the result is being computed and written."""
        return self._made and self.running

    @property
    def progress(self) -> Progress:
        """State after the latest pass."""
        return self._runner.progress if self._runner is not None else Progress()

    @property
    def image(self) -> NDArray[np.float32] | None:
        """A copy of the current picture, (height, width, 3), linear RGB; ``None`` before the first pass, and for
        methods that make no picture."""
        snapshot = self._runner.snapshot() if self._runner is not None else None
        return snapshot.layers.get("image") if snapshot is not None else None

    @property
    def _is_own_thread(self) -> bool:
        return threading.current_thread() is self._thread

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for the end of the run, at most ``timeout`` seconds; returns whether it has ended. Raises the error of
        the run, and :class:`RuntimeError` in a callback, which the run waits for."""
        if self._is_own_thread and self.running:
            raise RuntimeError("a callback cannot wait for the end of its run; use what it is given, or request_stop()")
        # Short waits, since on some systems Ctrl-C does not interrupt a lock.
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._done.is_set():
            left = 0.5 if deadline is None else min(0.5, deadline - time.monotonic())
            if left <= 0:
                return False
            self._done.wait(left)
        self._join()
        if self._error is not None:
            raise self._error
        return True

    def _join(self) -> None:
        self._thread.join()
        take_over()

    @property
    def result(self) -> T:
        """The result of the run. Waits for its end, and raises its error."""
        self.wait()
        return self._result[0]

    def request_stop(self) -> None:
        """Stop the run after the current pass, without waiting for it."""
        self._stop.set()

    def request_save(self) -> None:
        """Save after the current pass; nothing before the first pass has begun."""
        if self._runner is not None:
            self._runner.request_save()

    def cancel(self) -> None:
        """Stop the run after the current pass and wait for it. :attr:`result` then has the passes so far. From a
        callback, which the run waits for, as :meth:`request_stop`."""
        self._stop.set()
        if self._is_own_thread:
            return
        self._done.wait()
        self._join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cancel()
        if error is None and self._error is not None and not isinstance(self._error, Cancelled):
            raise self._error

    def __repr__(self) -> str:
        return f"<etendue.Session {'running' if self.running else 'done'}: {self.progress}>"


def take_over() -> None:
    """Let this thread use device variables that another one has made, which has ended."""
    if "mitsuba" in sys.modules:
        import drjit as dr
        import mitsuba as mi

        if mi.variant() is not None:
            dr.detail.new_scope(dr.backend_v(mi.Float))


def jit_flags() -> dict[dr.JitFlag, bool]:
    """Dr.Jit's flags of this thread, for another one (see :func:`set_jit_flags`)."""
    if "drjit" not in sys.modules:
        return {}
    import drjit as dr

    # Without the flags that describe the tracing state of a thread.
    own = {"Default", "SymbolicScope", "FreezingScope", "ForbidSynchronization"}
    return {flag: dr.flag(flag) for flag in dr.JitFlag if flag.name not in own}


def set_jit_flags(flags: dict[dr.JitFlag, bool]) -> None:
    """Set Dr.Jit's flags in this thread."""
    if flags:
        import drjit as dr

        for flag, value in flags.items():
            dr.set_flag(flag, value)
