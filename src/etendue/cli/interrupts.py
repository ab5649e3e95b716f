"""Ctrl-C and SIGTERM while rendering: the first stops after the current pass, a second ends the process at once."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

#: Signals that request the end of a process.
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Signal handlers during a block; the previous ones are restored after it. Main thread only.

    ``stop`` is called at the first signal; ``abort`` at the second, just before the process ends: the rendering thread
    is inside compiled code and cannot be ended otherwise.
    """

    def __init__(self, stop: Callable[[], None], abort: Callable[[], None]) -> None:
        self._stop = stop
        self._abort = abort
        self._former: dict[int, Callable[[int, FrameType | None], object] | int | None] = {}
        #: The received signal, if any.
        self.received: int | None = None

    def __enter__(self) -> Self:
        for number in SIGNALS:
            self._former[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.received is not None:
            try:
                self._abort()
            finally:  # even if printing from within a signal handler fails
                os._exit(128 + number)
        self.received = number
        self._stop()

    @property
    def exit_code(self) -> int:
        """0, or the exit status of a process ended by a signal."""
        return 0 if self.received is None else 128 + self.received
