"""A PNG writer: eight-bit RGB, losslessly, with nothing but zlib."""

from __future__ import annotations

import os
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from etendue.core import OutputError
from etendue.film import write_bytes


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """The bytes of a PNG file of ``image``, (height, width, 3) uint8 sRGB."""
    image = np.ascontiguousarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise OutputError(f"a PNG is made of (height, width, 3) bytes, not {image.shape} of {image.dtype}")
    height, width, _ = image.shape
    left = np.zeros_like(image)
    left[:, 1:] = image[:, :-1]
    above = np.zeros_like(image)
    above[1:] = image[:-1]
    # PNG filter types 0, 1, 2; per row the one with the smallest sum of signed differences, as the standard advises.
    candidates = np.stack([image, image - left, image - above]).reshape(3, height, width * 3)
    cost = np.abs(candidates.view(np.int8).astype(np.int16)).sum(axis=2)
    choice = cost.argmin(axis=0)
    rows = np.empty((height, 1 + width * 3), dtype=np.uint8)
    rows[:, 0] = choice
    rows[:, 1:] = candidates[choice, np.arange(height)]
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        _chunk(kind, data)
        for kind, data in (
            (b"IHDR", header),
            (b"sRGB", b"\x00"),
            (b"IDAT", zlib.compress(rows.tobytes(), 9)),
            (b"IEND", b""),
        )
    )


def write_png(path: str | os.PathLike[str], image: NDArray[np.uint8]) -> None:
    """Write ``image``, (height, width, 3) uint8 sRGB as :func:`tonemap` makes it; the file appears whole or not at all.

    Raises :class:`OutputError` if it cannot be written.
    """
    write_bytes(path, encode_png(image))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
