"""Codecs of particles: how the rows of a pass become chunks of bytes, and the bounds of what is lost.

``raw``
    rows as they are, in the order of their paths.
``exact``
    rows sorted by surface and by Morton code on it; each column as differences of neighbours or as it is, in planes of
    bytes. Only the order is lost.
``packed``
    the same order; a position is its Morton code on its primitive, as a gap in Rice code [Rice 1971]; a direction has
    24 bits on the octahedron [Meyer 2010]; the distinct powers of a chunk are numbered, or, if there are many, rounded
    at random to mantissas with a shared exponent, so that sums stay right on average.
``packed-no-paths``
    the same without path numbers, which come back as 0.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from etendue.core import describe, suggest

from ..errors import ParticleError
from ..particles import Rows
from .coders import coder
from .exact import decode_exact, decode_raw, encode_exact, encode_raw
from .grid import Grid
from .packed import decode_packed, encode_packed
from .strips import Chunk, Strips, kernels, ordering

LAYOUTS = ("raw", "exact", "packed", "packed-no-paths")
#: Particles of a chunk.
CHUNK = 1 << 16


@dataclass(frozen=True)
class Codec:
    """A layout and the coder of its strips, such as ``packed`` or ``exact+lzma``."""

    layout: str = "packed"
    coder: str = "fast"

    @classmethod
    def parse(cls, text: str) -> Codec:
        """From ``LAYOUT`` or ``LAYOUT+CODER``. Raises :class:`ParticleError` for names that do not exist."""
        layout, plus, name = str(text).partition("+")
        if layout not in LAYOUTS:
            raise ParticleError(f"there is no codec '{layout}'; {suggest(layout, LAYOUTS)}")
        result = cls(layout, name if plus else ("none" if layout == "raw" else "fast"))
        coder(result.coder)
        if layout != "raw":
            kernels()
        return result

    def __str__(self) -> str:
        return f"{self.layout}+{self.coder}"

    @property
    def is_bounded(self) -> bool:
        """Whether fields are rounded, within bounds."""
        return self.layout.startswith("packed")


def encode(rows: Rows, codec: Codec, grid: Grid) -> list[Callable[[], Chunk]]:
    """The rows of a pass as functions, each of which makes a chunk; they may run in parallel.

    Raises :class:`ParticleError` for shapes or primitives that the scene does not have."""
    if len(rows) == 0:
        return []
    if codec.layout == "raw":
        return [partial(encode_raw, rows[a : a + CHUNK], codec.coder) for a in range(0, len(rows), CHUNK)]
    loops, surfaces = ordering(), grid.surfaces
    keys, order = np.empty(len(rows), np.uint64), np.empty(len(rows), np.uint32)
    if not loops.keys_of(
        rows, rows.view(np.float32), surfaces.first, surfaces.primitives, grid.bits, grid.shape_bits, keys
    ):
        raise ParticleError("particles name a shape or a triangle that the scene does not have")
    loops.sorted_by(keys, order)
    # A chunk has positions either by frames or without; primitives with frames come first.
    border = int(np.searchsorted(keys, np.uint64(len(surfaces.frames)) << np.uint64(32)))
    cuts = [*range(0, border, CHUNK), *range(border, len(rows), CHUNK), len(rows)]
    parts = [slice(a, b) for a, b in pairwise(cuts)]
    if codec.layout == "exact":
        return [partial(encode_exact, rows, order[part], codec.coder) for part in parts]
    with_paths = codec.layout == "packed"
    return [partial(encode_packed, rows, order[part], keys[part], codec.coder, grid, with_paths) for part in parts]


def decode(head: dict[str, Any], payload: bytes, grid: Grid) -> Rows:
    """Inverse of :func:`encode` for one chunk. Raises :class:`ParticleError` if it cannot be read."""
    kinds: dict[str, Callable[..., Rows]] = {"raw": decode_raw, "exact": decode_exact, "packed": decode_packed}
    try:
        rows = kinds[head["kind"]](head, Strips(head, payload), grid)
    except (KeyError, ValueError, IndexError, StopIteration, OSError, zlib.error, lzma.LZMAError, EOFError) as error:
        raise ParticleError(f"a chunk of particles cannot be unpacked ({describe(error)})") from error
    return rows
