"""A picture as an HTML figure that holds its own data."""

from __future__ import annotations

import base64
from html import escape

import numpy as np
from numpy.typing import NDArray

from .png import encode_png


def figure(pixels: NDArray[np.uint8], alt: str, name: str, caption: str, index: int | None = None) -> str:
    """``pixels`` (height, width, 3) with ``name`` and ``caption`` below; ``index``: its number for the page's
    script."""
    source = "data:image/png;base64," + base64.b64encode(encode_png(pixels)).decode()
    height, width = pixels.shape[:2]
    mark = "" if index is None else f' data-picture="{index}"'
    return (
        f'<figure><img src="{source}" width="{width}" height="{height}" alt="{escape(alt)}"{mark}>'
        f"<figcaption><strong>{escape(name)}</strong>{escape(f' · {caption}') if caption else ''}</figcaption></figure>"
    )
