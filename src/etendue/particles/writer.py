"""Files of particles: writing them pass by pass, and going on with a file that was cut off."""

from __future__ import annotations

import contextlib
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.core import OutputError

from . import blocks
from .blocks import Block
from .files import ParticleFile, PathLike, in_order
from .packing.codecs import Codec, encode
from .packing.grid import Grid
from .particles import Rows
from .surfaces import Surfaces


class ParticleWriter:
    """Appends passes to a file. A pass is in the file when :meth:`add` returns, wholly or not at all.

    ``file`` is open at the place ``end`` behind the ``known`` blocks of whole passes."""

    def __init__(self, path: Path, file: Any, codec: Codec, surfaces: Surfaces, known: list[Block], end: int) -> None:
        self.path, self.codec = path, codec
        self._file, self._grid = file, Grid(surfaces)
        self._blocks, self._end = known, end

    @classmethod
    def create(cls, path: PathLike, header: Mapping[str, Any], surfaces: Surfaces, codec: Codec) -> ParticleWriter:
        """A new file. Raises :class:`OutputError` if it exists, or cannot be written."""
        path = Path(path)
        try:
            file = open(path, "x+b", buffering=0)  # noqa: SIM115 (closed by close)
        except OSError as error:
            raise _failure(path, error) from None
        head = dict(header) | {"format": blocks.FORMAT, "codec": str(codec), "surfaces": surfaces.describe()}
        try:
            first = blocks.write_block(file, blocks.HEADER, head, [zlib.compress(surfaces.frames.tobytes(), 6)])
        except OSError as error:
            file.close()
            path.unlink(missing_ok=True)
            raise _failure(path, error) from None
        return cls(path, file, codec, surfaces, [], first.end)

    @classmethod
    def resume(cls, known: ParticleFile) -> ParticleWriter:
        """Go on behind the last whole pass of a file. Raises :class:`OutputError` if it cannot be written."""
        try:
            file = open(known.path, "r+b", buffering=0)  # noqa: SIM115 (closed by close)
            file.truncate(known.end)
        except OSError as error:
            raise _failure(known.path, error) from None
        every = sorted([*known.chunks, *known.passes], key=lambda block: block.start)
        return cls(known.path, file, known.codec, known.surfaces, every, known.end)

    def add(self, iteration: int, rows: Rows, counters: Mapping[str, float], **more: Any) -> None:
        """Write a pass; ``more``: further plain values for its end. If it raises, the file ends with the pass before.

        Raises :class:`OutputError` if the disk is full, :class:`ParticleError` for rows of another scene."""
        written: list[Block] = []
        try:
            self._file.seek(self._end)
            for chunk in in_order(encode(rows, self.codec, self._grid)):
                head = {"pass": iteration} | chunk.head
                written.append(blocks.write_block(self._file, blocks.CHUNK, head, chunk.strips))
            end = {"pass": iteration, "counters": dict(counters)} | more
            written.append(blocks.write_block(self._file, blocks.PASS, end))
        except OSError as error:
            self._cut()
            passes = sum(block.kind == blocks.PASS for block in self._blocks)
            raise OutputError(
                f"cannot write '{self.path}': {error.strerror or error}; it has the particles of {passes} passes: "
                f"free some space, and go on by etendue resume {self.path}"
            ) from None
        except BaseException:
            self._cut()
            raise
        self._blocks += written
        self._end = self._file.tell()

    def close(self, **ending: Any) -> None:
        """Write the index, with plain values on how the run ended, and close the file.

        Raises :class:`OutputError` if the index cannot be written; the particles are in the file nevertheless."""
        try:
            self._file.seek(self._end)
            blocks.write_index(self._file, self._blocks, {"stopped_by": "", **ending})
            self._file.truncate()
            os.fsync(self._file.fileno())
        except OSError as error:
            self._cut()
            raise OutputError(
                f"cannot write the index of '{self.path}': {error.strerror or error}; its particles can be read"
            ) from None
        finally:
            with contextlib.suppress(OSError):
                self._file.close()

    def discard(self) -> None:
        """Close and remove the file."""
        with contextlib.suppress(OSError):
            self._file.close()
        self.path.unlink(missing_ok=True)

    def _cut(self) -> None:
        """Remove what is behind the last whole pass."""
        with contextlib.suppress(OSError):
            self._file.seek(self._end)
        with contextlib.suppress(OSError):
            self._file.truncate(self._end)


def _failure(path: Path, error: OSError) -> OutputError:
    if isinstance(error, FileExistsError):
        return OutputError(
            f"'{path}' exists: choose another name, remove it, or go on with its particles by etendue resume {path}"
        )
    if isinstance(error, FileNotFoundError):
        return OutputError(f"cannot write '{path}': there is no folder '{path.parent}'; create it first")
    return OutputError(f"cannot write '{path}': {error.strerror or error}; choose a place you may write to")
