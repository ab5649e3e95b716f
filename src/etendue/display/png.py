"""PNG files by Pillow: eight-bit sRGB, without loss."""

from __future__ import annotations

import io
import os

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from etendue.core import OutputError
from etendue.film import write_bytes


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """The bytes of a PNG file of ``image``, (height, width, 3 or 4) uint8 sRGB; the fourth channel is alpha."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4) or not image.size:
        raise OutputError(f"a PNG is made of (height, width, 3 or 4) bytes, not {image.shape} of {image.dtype}")
    chunks = PngInfo()
    chunks.add(b"sRGB", b"\0")  # the colour space, and the perceptual intent
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", pnginfo=chunks, optimize=True)
    return file.getvalue()


def write_png(path: str | os.PathLike[str], image: NDArray[np.uint8]) -> None:
    """Write ``image``, (height, width, 3 or 4) uint8 sRGB as :func:`tonemap` makes it; the file is written atomically.

    Raises :class:`OutputError` if it cannot be written.
    """
    write_bytes(path, encode_png(image))
