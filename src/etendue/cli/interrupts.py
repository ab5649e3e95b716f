"""Ctrl-C and SIGTERM during a command: the first signal requests its end, a second one ends the process at once."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Self

#: Signals that request the end of a process.
SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: Seconds within which a further signal is the same request: ``timeout`` sends one to its child and one to the group of
#: the child, and a key is easily pressed twice.
ONE_REQUEST = 1.0
#: Seconds after which a signal that was put off comes again.
_AGAIN = 0.05


class Interrupts:
    """Signal handlers during a block in the main thread; the previous ones are restored after it.

    ``stop`` is called at the first signal, ``abort`` at each that comes more than :data:`ONE_REQUEST` seconds after the
    one before. Both may raise. While ``wait()``, a signal is put off. A block may be inside another, which handles
    signals before and after it; if it has received one and goes on, its ``stop`` is called again.
    """

    def __init__(
        self, stop: Callable[[], object], abort: Callable[[], object], wait: Callable[[], bool] = lambda: False
    ) -> None:
        self._stop, self._abort, self._wait = stop, abort, wait
        self._former: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}
        self._latest = -float("inf")
        self._later: threading.Timer | None = None
        #: The received signal, if any.
        self.received: int | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            around = getattr(signal.getsignal(signal.SIGTERM), "__self__", None)
            if isinstance(around, Interrupts) and around.received is not None:
                around._stop()  # what it raised was lost: in an import, or in compiled code
            self._former = {number: signal.signal(number, self._handle) for number in SIGNALS}
        return self

    def __exit__(self, *error: object) -> None:
        if self._later is not None:
            self._later.cancel()
        for number, handler in self._former.items():
            signal.signal(number, handler)
            if isinstance(around := getattr(handler, "__self__", None), Interrupts):
                around._latest = self._latest  # what repeats a signal may come after this block

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._wait():
            if self._later is not None:
                self._later.cancel()
            self._later = threading.Timer(_AGAIN, signal.raise_signal, (number,))
            self._later.start()
            return
        now = time.monotonic()
        if now - self._latest < ONE_REQUEST:
            return
        self._latest = now
        if self.received is None:
            self.received = number
            self._stop()
        else:
            self._abort()

    @property
    def exit_code(self) -> int:
        """0, or the exit status of a process ended by a signal."""
        return 0 if self.received is None else 128 + self.received


@contextmanager
def saving_on_signal(save: Callable[[], object]) -> Iterator[None]:
    """A block in which SIGUSR1, where there is one, calls ``save``; in the main thread only."""
    number = getattr(signal, "SIGUSR1", None)
    if number is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    former = signal.signal(number, lambda *_: save())
    try:
        yield
    finally:
        signal.signal(number, former)


class _Left(KeyboardInterrupt):
    """Not KeyboardInterrupt itself: Python ends by SIGINT if that has passed an ``exec``, even if it was caught."""


def leaving() -> Interrupts:
    """A block that a signal leaves by :class:`KeyboardInterrupt`, but not in the midst of writing a file."""

    def leave() -> None:
        raise _Left

    return Interrupts(leave, leave, _is_writing)


def _is_writing() -> bool:
    # Looked up, not imported: the signal may have interrupted an import of this very module.
    is_writing = getattr(sys.modules.get("etendue.film.output"), "is_writing", None)
    return is_writing is not None and is_writing()
