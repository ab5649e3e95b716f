"""A small server in the place of tev."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class FakeTev:
    """Accepts one connection and applies its packets to images, as tev does."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self.listener.getsockname()[1]}"
        self.images: dict[str, dict[str, np.ndarray]] = {}
        self.kinds: list[int] = []
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self) -> None:
        connection, _ = self.listener.accept()
        with connection, connection.makefile("rb") as stream:
            while len(head := stream.read(4)) == 4:
                (length,) = struct.unpack("<I", head)
                self._apply(stream.read(length - 4))

    def _apply(self, body: bytes) -> None:
        self.kinds.append(body[0])
        if body[0] == 2:
            name, rest = body[1:].split(b"\0", 1)
            assert rest == b""
            self.images.pop(name.decode(), None)
            return
        name, rest = body[2:].split(b"\0", 1)
        if body[0] == 4:
            width, height, count = struct.unpack("<iii", rest[:12])
            names = rest[12:].decode().split("\0")
            assert names.pop() == "" and len(names) == count
            self.images[name.decode()] = {n: np.zeros((height, width), np.float32) for n in names}
            return
        assert body[0] == 6
        (count,), rest = struct.unpack("<i", rest[:4]), rest[4:]
        names = []
        for _ in range(count):
            channel, rest = rest.split(b"\0", 1)
            names.append(channel.decode())
        x, y, width, height = struct.unpack("<iiii", rest[:16])
        offsets = struct.unpack(f"<{count}q", rest[16 : 16 + 8 * count])
        strides = struct.unpack(f"<{count}q", rest[16 + 8 * count : 16 + 16 * count])
        data = np.frombuffer(rest[16 + 16 * count :], "<f4")
        for channel, offset, stride in zip(names, offsets, strides, strict=True):
            picked = data[offset + stride * np.arange(width * height)]
            self.images[name.decode()][channel][y : y + height, x : x + width] = picked.reshape(height, width)


@contextmanager
def fake_tev() -> Iterator[FakeTev]:
    server = FakeTev()
    try:
        yield server
        server.thread.join(10)
    finally:
        server.listener.close()
