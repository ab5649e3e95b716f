"""A page that is connected: messages on their way to it. A slow one loses pictures, never delays the session."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from typing import Any, Protocol

from .protocol import packed

#: Pictures on their way to a page that it has not yet drawn.
IN_FLIGHT = 2
#: Messages that are replaced by later ones of the same kind if they have not been sent; all others are sent in order.
REPLACED = ("state", "progress")
#: Data waiting for a page, in bytes, beyond which it is disconnected.
MOST_WAITING = 256 << 20


class Socket(Protocol):
    """The part of a WebSocket that is used."""

    def write_message(self, message: str | bytes, binary: bool = False) -> Any:
        """Begin to send; the result can be awaited."""
        ...

    def close(self, code: int | None = None, reason: str | None = None) -> None:
        """Disconnect."""
        ...


class Client:
    """Messages to one page. :meth:`send` and :meth:`send_frame` may be called from any thread and return at once."""

    def __init__(self, socket: Socket, loop: asyncio.AbstractEventLoop) -> None:
        self._socket = socket
        self._loop = loop
        # The rest belongs to the thread of the loop.
        self._queue: deque[str | bytes] = deque()
        self._waiting = 0  # bytes in the queue
        self._latest: dict[str, str | bytes] = {}
        self._frames: dict[str, tuple[int, bytes]] = {}  # by side
        self._in_flight: deque[int] = deque()
        self._task: asyncio.Task[None] | None = None
        self.closed = False

    def send(self, kind: str, payload: bytes | memoryview | None = None, /, **fields: Any) -> None:
        """Send a message, see :mod:`etendue.viewer.protocol`."""
        self._later(self._put, kind, packed(kind, payload, **fields))

    def send_frame(self, side: str, frame: int, message: bytes) -> None:
        """Send a picture of a side, or replace the one that is waiting."""
        self._later(self._put_frame, side, frame, message)

    def drawn(self, frame: int) -> None:
        """The page has drawn a frame, and those before it."""
        self._later(self._drawn, frame)

    def close(self) -> None:
        """The connection is closed."""
        self.closed = True
        self._queue.clear()
        self._latest.clear()
        self._frames.clear()

    # ------------------------------------------------------------------ in the thread of the loop

    def _later(self, function: Any, *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(function, *arguments)

    def _put(self, kind: str, message: str | bytes) -> None:
        if kind in REPLACED:
            self._latest[kind] = message
        else:
            self._waiting += len(message)
            self._queue.append(message)
            if self._waiting > MOST_WAITING:
                self._socket.close(1008, "the page does not read its messages")
                return
        self._pump()

    def _put_frame(self, side: str, frame: int, message: bytes) -> None:
        self._frames[side] = frame, message
        self._pump()

    def _drawn(self, frame: int) -> None:
        while self._in_flight and self._in_flight[0] <= frame:
            self._in_flight.popleft()
        self._pump()

    def _pump(self) -> None:
        if not self.closed and (self._task is None or self._task.done()):
            self._task = asyncio.ensure_future(self._send_all(), loop=self._loop)

    async def _send_all(self) -> None:
        while not self.closed and (message := self._next()) is not None:
            try:
                # Awaited until it has left for the network: what comes meanwhile replaces what is waiting.
                await self._socket.write_message(message, binary=isinstance(message, bytes))
            except Exception:  # closed meanwhile; whatever the connection raises, it is over
                self.close()

    def _next(self) -> str | bytes | None:
        if self._queue:
            message = self._queue.popleft()
            self._waiting -= len(message)
            return message
        for kind in REPLACED:
            if kind in self._latest:
                return self._latest.pop(kind)
        if self._frames and len(self._in_flight) < IN_FLIGHT:
            side = min(self._frames, key=lambda side: self._frames[side][0])  # the oldest first
            frame, message = self._frames.pop(side)
            self._in_flight.append(frame)
            return message
        return None
