"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from etendue.core import OutputError


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends without an error.

    A reader, or a process killed in between, sees the old file or the new one, never a part of it. Raises
    :class:`OutputError` if the folder does not exist or cannot be written, or if writing fails.
    """
    target = Path(path)
    if target.is_dir():
        raise OutputError(f"cannot write '{target}': it is a folder; give a file name")
    if not target.parent.is_dir():
        raise OutputError(f"cannot write '{target}': there is no folder '{target.parent}'; create it first")
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=target.suffix or ".part")
        os.close(handle)
    except OSError as error:
        raise OutputError(f"cannot write '{target}': {error.strerror}; choose a place you may write to") from None
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)  # mkstemp makes files private; a picture is as public as any other file
        temporary.replace(target)
    except OSError as error:
        raise OutputError(f"cannot write '{target}': {error.strerror or error}; is the disk full?") from None
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write ``data`` to ``path`` by :func:`replacing`."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)
