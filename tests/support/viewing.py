"""A page without a browser: a plain client of the viewer's server."""

from __future__ import annotations

import asyncio
import json
import time
from urllib.parse import urlsplit

from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from etendue.viewer.protocol import unpacked

WAIT = 120.0


class Page:
    """A connected page. ``draws``: whether it reports the pictures as drawn, as a browser does."""

    def __init__(self, socket, draws=True):
        self.socket = socket
        self.draws = draws
        self.frames = []

    @classmethod
    async def open(cls, url, origin=None, draws=True):
        place = urlsplit(url)
        address = url.replace("http://", "ws://", 1) + "socket"
        headers = {"Origin": f"http://{place.netloc}" if origin is None else origin}
        request = HTTPRequest(address, headers=headers if origin != "" else {})
        return cls(await websocket_connect(request, max_message_size=1 << 26), draws)

    def send(self, kind, /, **fields):
        self.socket.write_message(json.dumps({"type": kind, **fields}))

    async def next(self, timeout=WAIT):
        """The next message: (fields, data); ``None`` once the connection is closed."""
        message = await asyncio.wait_for(self.socket.read_message(), timeout)
        if message is None:
            return None
        fields, data = unpacked(message)
        if fields["type"] == "frame":
            self.frames.append((time.monotonic(), fields))
            if self.draws:
                self.send("drawn", frame=fields["frame"])
        return fields, data

    async def until(self, kind, test=lambda fields: True, timeout=WAIT):
        """The next message of a kind that passes the test; others are dropped."""
        end = time.monotonic() + timeout
        while (found := await self.next(max(0.1, end - time.monotonic()))) is not None:
            if found[0]["type"] == kind and test(found[0]):
                return found
        raise AssertionError(f"closed before a message '{kind}'")

    def close(self):
        self.socket.close()
