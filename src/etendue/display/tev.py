"""Pictures in the image viewer tev, over its network protocol (library ``tevclient``)."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Self

import numpy as np
from numpy.typing import NDArray

from etendue.core import OptionError, Result, describe, library, logger
from etendue.film import BANDS, channel_names

#: The port on which tev listens by default.
PORT = 14158
#: Most bytes of pixels in a packet, so that a slow display is not sent a whole picture at once.
_PACKET_BYTES = 1 << 22
#: Seconds to wait for a connection, and for a display that does not read its data.
_PATIENCE = 5.0
#: Least seconds between two pictures, and the largest share of the time in which pictures are developed and sent.
_LEAST_PAUSE, _LARGEST_SHARE = 0.5, 0.1


def parse_address(text: str) -> tuple[str, int]:
    """Host and port from ``HOST:PORT``, ``HOST`` or ``:PORT``; an IPv6 address with a port stands in brackets.

    Raises :class:`OptionError`."""
    text = text.strip()
    host, colon, port = text.rpartition(":") if text.count(":") == 1 or "]:" in text else (text, "", "")
    try:
        number = int(port) if colon else PORT
        if not text or not 0 < number < 1 << 16:
            raise ValueError
    except ValueError:
        raise OptionError(f"--tev needs HOST:PORT such as localhost:{PORT}, not '{text}'") from None
    return host.strip("[]") or "localhost", number


def picture_packets(name: str, result: Result, known: Layout | None = None) -> tuple[list[bytes], Layout]:
    """Packets that show the layers (height, width, channels) as one image, with the channel names of OpenEXR, and their
    layout. The image is made anew unless its layout is ``known``."""
    packet = library("tevclient.packet", "--tev", "tev")
    planes = {key: np.atleast_3d(np.asarray(layer, np.float32)) for key, layer in result.layers.items()}
    height, width = next(iter(planes.values())).shape[:2]
    bands = result.metadata.get(BANDS)
    channels = {key: channel_names(key, plane.shape[2], bands=bands) for key, plane in planes.items()}
    layout: Layout = (width, height, tuple(name for names in channels.values() for name in names))
    packets = (
        [] if layout == known else [packet.close_image(name), packet.create_image(name, width, height, list(layout[2]))]
    )
    for key, plane in planes.items():
        for y, rows in _bands(plane):
            packets.append(packet.update_image(name, rows, channels[key], 0, y))
    return packets, layout


#: Width, height and channels of an image.
Layout = tuple[int, int, tuple[str, ...]]


class TevDisplay:
    """Shows the newest layers of a run in tev.

    A thread develops and sends them, so that a slow display does not slow the rendering: pictures for which it has
    no time are left out. If tev cannot be reached, or goes away, ``tell`` receives one line, and nothing more is sent.
    As a context manager, it sends the last layers at the end of the block.

    Parameters
    ----------
    address: ``HOST:PORT``.
    name: of the image in tev.
    """

    def __init__(self, address: str, name: str, tell: Callable[[str], object] = logger.warning) -> None:
        self._host, self._port = parse_address(address)
        library("tevclient", "--tev", "tev")  # whether it is installed
        self._name, self._tell = name, tell
        self._socket: socket.socket | None = None
        self._layout: Layout | None = None
        self._newest: Callable[[], Result] | None = None
        self._changed = threading.Condition()
        self._closing = False
        self._thread: threading.Thread | None = None

    def connect(self) -> bool:
        """Connect; returns whether tev answers."""
        try:
            self._socket = socket.create_connection((self._host, self._port), timeout=_PATIENCE)
        except OSError as error:
            reason = error.strerror or describe(error)
            self._tell(f"no tev at {self._host}:{self._port} ({reason}); the picture is not shown there")
            return False
        self._thread = threading.Thread(target=self._work, name="etendue-tev", daemon=True)
        self._thread.start()
        return True

    def offer(self, result: Callable[[], Result]) -> None:
        """Show the layers of what ``result()`` returns, once there is time. It is called in the thread of the
        display."""
        with self._changed:
            self._newest = result
            self._changed.notify()

    def close(self) -> None:
        """Send the last layers that were offered, and disconnect."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _work(self) -> None:
        try:
            while (result := self._next()) is not None:
                begin = time.monotonic()
                self._show(result())
                self._rest(max(_LEAST_PAUSE, (time.monotonic() - begin) / _LARGEST_SHARE))
        except OSError as error:
            self._tell(f"tev at {self._host}:{self._port} has gone ({error.strerror or describe(error)})")
        except Exception as error:
            self._tell(f"the picture cannot be shown in tev: {describe(error)}")

    def _next(self) -> Callable[[], Result] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._closing)
            result, self._newest = self._newest, None
            return result

    def _rest(self, seconds: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closing, seconds)

    def _show(self, result: Result) -> None:
        assert self._socket is not None
        packets, self._layout = picture_packets(self._name, result, self._layout)
        for packet in packets:
            self._socket.sendall(packet)


def _bands(pixels: NDArray[np.float32]) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """(first row, rows) of the parts of a layer, a packet each."""
    height, width, count = pixels.shape
    rows = max(1, _PACKET_BYTES // (4 * width * count))
    for y in range(0, height, rows):
        yield y, pixels[y : y + rows]
