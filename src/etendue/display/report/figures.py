"""Pictures as HTML figures that hold their own data, small enough for a page."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image

#: Widths of figures in pixels: the largest and the smallest.
ACROSS = (640, 64)
#: Quality of WebP, which is lossy: figures only illustrate, the script has the radiance in its data.
_QUALITY = 84


@dataclass(frozen=True)
class Figure:
    """``pixels`` (height, width, 3) with ``name`` and ``caption`` below; ``index``: its number for the page's script.
    ``across``: the largest width in pixels at which it is stored."""

    pixels: NDArray[np.uint8]
    alt: str
    name: str
    caption: str = ""
    index: int | None = None
    across: int = ACROSS[0]

    @cached_property
    def _data(self) -> bytes:
        picture = Image.fromarray(self.pixels)
        if picture.width > self.across:
            height = max(1, round(picture.height * self.across / picture.width))
            picture = picture.resize((self.across, height), Image.Resampling.BOX)
        file = io.BytesIO()
        picture.save(file, "WEBP", quality=_QUALITY, method=1)
        return file.getvalue()

    @property
    def source(self) -> str:
        """The pixels as the address of an image."""
        return "data:image/webp;base64," + base64.b64encode(self._data).decode()

    @property
    def size(self) -> int:
        """Number of characters that the figure takes on the page."""
        return len(self._data) * 4 // 3


def fitted(figures: Sequence[Figure], room: int, across: int = ACROSS[0]) -> list[Figure]:
    """The same figures, as wide as ``room`` characters in all allow, and at most ``across`` pixels."""
    made = [replace(figure, across=across) for figure in figures]
    while (total := sum(figure.size for figure in made)) > room and across > ACROSS[1]:
        across = max(ACROSS[1], int(across * min(0.9, (room / total) ** 0.6)))
        made = [replace(figure, across=across) for figure in made]
    return made
