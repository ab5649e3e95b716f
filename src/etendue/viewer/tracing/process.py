"""The session's side of the process that answers orders."""

from __future__ import annotations

import contextlib
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from etendue.core import SceneError, describe

from .orders import Order

#: Starts the process with the modules that this one can import.
_MAIN = "import sys; sys.path[:] = {}; from etendue.viewer.tracing.child import main; main()"


@dataclass(frozen=True)
class Reply:
    """A reply: what is being done (a text); a message for pages (verb, arrays, fields); the end of an order; its error
    (a text); that the scene cannot be used there (a text); or that the process has ended (a text).

    ``number``: that of the order; 0 for messages to all pages and their errors."""

    kind: Literal["doing", "message", "done", "failed", "unusable", "ended"]
    number: int
    content: Any


class TracingProcess:
    """A process that answers orders in turn. ``reply`` is called for each reply, in a thread of its own."""

    def __init__(self, reply: Callable[[Reply], object]) -> None:
        self._tell = reply
        self._orders: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        pipe = subprocess.PIPE
        self._process = subprocess.Popen([sys.executable, "-c", _MAIN.format(sys.path)], stdin=pipe, stdout=pipe)
        for work in (self._write, self._read):
            threading.Thread(target=work, name="etendue-tracing", daemon=True).start()

    def send(self, order: Order) -> None:
        """Send an order, without waiting: the process reads it when it has started. Raises :class:`SceneError` for
        objects that cannot be sent."""
        try:
            self._orders.put(pickle.dumps(order))
        except Exception as error:  # whatever an object raises that cannot be pickled
            raise SceneError(describe(error)) from error

    def close(self) -> None:
        """End the process at once."""
        self._orders.put(None)
        self._process.kill()

    def _write(self) -> None:
        stream = self._process.stdin
        assert stream is not None
        with contextlib.suppress(OSError), stream:  # the reader tells that the process has ended
            while (order := self._orders.get()) is not None:
                stream.write(order)
                stream.flush()

    def _read(self) -> None:
        stream = self._process.stdout
        assert stream is not None
        with stream, contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                self._tell(Reply(*pickle.load(stream)))
        code = self._process.wait()
        self._orders.put(None)
        self._tell(Reply("ended", 0, f"the process that traces rays has ended (exit status {code})"))
