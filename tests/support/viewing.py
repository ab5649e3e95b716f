"""A page without a browser: a plain client of the viewer's server."""

from __future__ import annotations

import asyncio
import json
import time
from contextlib import asynccontextmanager
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


@asynccontextmanager
async def proxied(port, prefix):
    """A proxy before the server at ``port``, as jupyter-server-proxy is one: it takes ``prefix`` off the addresses and
    leaves the headers as they are. Yields its own port."""
    writers = []

    async def forward(reader, writer):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
        writer.close()

    async def serve(reader, writer):
        inner, outer = await asyncio.open_connection("127.0.0.1", port)
        writers.extend((writer, outer))
        back = asyncio.ensure_future(forward(inner, writer))
        upgraded = False
        while not upgraded:
            try:
                head = await reader.readuntil(b"\r\n\r\n")
            except asyncio.IncompleteReadError:
                break
            verb, path, rest = head.split(b" ", 2)
            assert path.startswith(prefix.encode()), path
            outer.write(verb + b" " + path[len(prefix) :] + b" " + rest)
            upgraded = b"upgrade: websocket" in rest.lower()
        if upgraded:
            await forward(reader, outer)
        outer.close()
        await back

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for writer in writers:
            writer.close()
