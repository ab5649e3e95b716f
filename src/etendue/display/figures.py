"""A picture as an HTML figure that holds its own data."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .png import encode_png


@dataclass(frozen=True)
class Figure:
    """``pixels`` (height, width, 3) with ``name`` and ``caption`` below; ``index``: its number for the page's
    script."""

    pixels: NDArray[np.uint8]
    alt: str
    name: str
    caption: str = ""
    index: int | None = None

    @property
    def source(self) -> str:
        """The pixels as the address of an image."""
        return "data:image/png;base64," + base64.b64encode(encode_png(self.pixels)).decode()
