"""A connected page and the messages on their way to it. A slow page loses pictures and never delays the session."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .protocol import packed
from .shown import encoded

#: Most pictures sent to a page that it has not yet drawn.
IN_FLIGHT = 2
#: Messages that are replaced by later ones of the same kind if they have not been sent; all others are sent in order.
REPLACED = ("state", "camera", "progress")
#: Data waiting for a page, in bytes, beyond which it is disconnected.
MOST_WAITING = 256 << 20


class Socket(Protocol):
    """The part of a WebSocket that is used."""

    def write_message(self, message: str | bytes, binary: bool = False) -> Any:
        """Start sending; the result can be awaited."""
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
        self.forward(kind, packed(kind, payload, **fields))

    def forward(self, kind: str, message: str | bytes) -> None:
        """Send a message that is packed."""
        self._later(self._put, kind, message)

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
        if self.closed:
            return
        if kind in REPLACED:
            self._latest.pop(kind, None)  # so that older messages come first
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
                # Awaited until the message has left for the network; later messages replace waiting ones meanwhile.
                await self._socket.write_message(message, binary=isinstance(message, bytes))
            except Exception:  # closed meanwhile: any error ends the connection
                self.close()

    def _next(self) -> str | bytes | None:
        if self._queue:
            message = self._queue.popleft()
            self._waiting -= len(message)
            return message
        if self._latest:
            return self._latest.pop(next(iter(self._latest)))
        if self._frames and len(self._in_flight) < IN_FLIGHT:
            side = min(self._frames, key=lambda side: self._frames[side][0])  # the oldest first
            frame, message = self._frames.pop(side)
            self._in_flight.append(frame)
            return message
        return None


class Audience:
    """The pages of a session, and the latest pictures, which pages that connect later get as well."""

    def __init__(self) -> None:
        self._clients: list[Client] = []
        self._frames: dict[str, tuple[int, bytes]] = {}  # by side
        self._count = 0

    def __iter__(self) -> Iterator[Client]:
        return iter(self._clients)

    def __len__(self) -> int:
        return len(self._clients)

    def add(self, client: Client) -> None:
        """Add a page: it gets the latest pictures, and all messages from now on."""
        self._clients.append(client)
        for side, (frame, message) in self._frames.items():
            client.send_frame(side, frame, message)

    def remove(self, client: Client) -> None:
        """Remove a page that has disconnected."""
        if client in self._clients:
            self._clients.remove(client)

    def send(self, kind: str, payload: bytes | None = None, /, **fields: Any) -> None:
        """Send a message to all pages."""
        message = packed(kind, payload, **fields)
        for client in self._clients:
            client.forward(kind, message)

    def show(self, side: str, picture: NDArray[np.uint8], moving: bool = False) -> None:
        """Send a picture (height, width, 3) of a side to all pages."""
        data, mime = encoded(picture, moving)
        self._count += 1
        height, width = picture.shape[:2]
        fields = {"frame": self._count, "side": side, "width": width, "height": height, "moving": moving}
        message = packed("frame", data, format=mime, **fields)
        assert isinstance(message, bytes)
        self._frames[side] = self._count, message
        for client in self._clients:
            client.send_frame(side, self._count, message)

    def hide(self, side: str) -> None:
        """Forget the latest picture of a side."""
        self._frames.pop(side, None)
