"""Files of particles: writing them pass by pass, and resuming a file that was cut off."""

from __future__ import annotations

import contextlib
import fcntl
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.core import OutputError, in_order, logger

from . import blocks
from .blocks import Block
from .files import ParticleFile, PathLike
from .packing.codecs import Codec, encode
from .packing.grid import Grid
from .particles import Rows
from .surfaces import Surfaces


class ParticleWriter:
    """Appends passes to a file. A pass is in the file when :meth:`add` returns, completely or not at all.

    ``file`` is open; ``end`` is the position behind the ``known`` blocks of complete passes."""

    def __init__(self, path: Path, file: Any, codec: Codec, surfaces: Surfaces, known: list[Block], end: int) -> None:
        self.path, self.codec = path, codec
        self._file, self._grid = file, Grid(surfaces)
        self._blocks, self._end = known, end

    @classmethod
    def create(cls, path: PathLike, header: Mapping[str, Any], surfaces: Surfaces, codec: Codec) -> ParticleWriter:
        """Create a file. Raises :class:`OutputError` if it exists, or cannot be written."""
        path = Path(path)
        try:
            file = open(path, "x+b", buffering=0)  # noqa: SIM115 (closed by close)
        except OSError as error:
            raise _failure(path, error) from None
        _lock(path, file)
        head = dict(header) | {"format": blocks.FORMAT, "codec": str(codec), "surfaces": surfaces.describe()}
        try:
            first = blocks.write_block(file, blocks.HEADER, head, [zlib.compress(surfaces.frames.tobytes(), 6)])
        except BaseException as error:
            file.close()
            path.unlink(missing_ok=True)
            if isinstance(error, OSError):
                raise _failure(path, error) from None
            raise
        return cls(path, file, codec, surfaces, [], first.end)

    @classmethod
    def resume(cls, known: ParticleFile) -> ParticleWriter:
        """Continue behind the last complete pass of a file; the remains of an interrupted pass are removed.

        Raises :class:`OutputError` if the file cannot be written, is damaged, or another process writes to it."""
        if known.lost:
            raise OutputError(
                f"'{known.path}' is damaged, and to go on would remove {known.lost} whole passes behind the damage; "
                f"copy it again, or save what can be read by etendue particles compress {known.path}"
            )
        try:
            file = open(known.path, "r+b", buffering=0)  # noqa: SIM115 (closed by close)
        except OSError as error:
            raise _failure(known.path, error) from None
        _lock(known.path, file)
        try:
            if os.fstat(file.fileno()).st_size != known.size:
                raise OutputError(f"'{known.path}' has changed since it was read; resume it again")
            file.truncate(known.end)
        except OSError as error:
            file.close()
            raise _failure(known.path, error) from None
        except OutputError:
            file.close()
            raise
        every = sorted([*known.chunks, *known.passes], key=lambda block: block.start)
        return cls(known.path, file, known.codec, known.surfaces, every, known.end)

    def add(self, iteration: int, rows: Rows, counters: Mapping[str, float], **more: Any) -> None:
        """Write a pass; ``more``: further plain values for its last block. After an error the file ends with the
        previous pass.

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
            raise OutputError(
                f"cannot write '{self.path}': {error.strerror or error}; it has the particles of {self.passes} passes: "
                f"free some space, and go on by etendue resume {self.path}"
            ) from None
        except BaseException:
            self._cut()
            raise
        self._blocks += written
        self._end = self._file.tell()

    @property
    def passes(self) -> int:
        """Passes in the file."""
        return sum(block.kind == blocks.PASS for block in self._blocks)

    def close(self, **ending: Any) -> None:
        """Write the index, with plain values about the end of the run, and close the file.

        Raises :class:`OutputError` if the index cannot be written; the particles remain in the file."""
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
        """Remove everything behind the last complete pass."""
        with contextlib.suppress(OSError):
            self._file.seek(self._end)
        with contextlib.suppress(OSError):
            self._file.truncate(self._end)


def _lock(path: Path, file: Any) -> None:
    """Keep other processes from writing to a file until it is closed. Raises :class:`OutputError` if another process
    writes to it already."""
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise OutputError(f"another run writes to '{path}'; wait for its end, or stop it") from None
    except OSError as error:  # file systems without locks
        logger.debug("'%s' cannot be locked: %s", path, error)


def _failure(path: Path, error: OSError) -> OutputError:
    if isinstance(error, FileExistsError):
        return OutputError(
            f"'{path}' exists: choose another name, remove it, or go on with its particles by etendue resume {path}"
        )
    if isinstance(error, FileNotFoundError):
        return OutputError(f"cannot write '{path}': there is no folder '{path.parent}'; create it first")
    return OutputError(f"cannot write '{path}': {error.strerror or error}; choose a place you may write to")
