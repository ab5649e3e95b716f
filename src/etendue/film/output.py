"""Files that appear whole or not at all, and whether they could be written, asked before work depends on it."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from etendue.core import OutputError


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise :class:`OutputError` if ``path`` could not be written now; leaves nothing behind."""
    part = _new_part(Path(path))
    try:
        part.write_bytes(b"\0")
    except OSError as error:
        raise _failure(Path(path), error) from None
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends without an error.

    A reader, or a process killed in between, sees the old file or the new one, never a part of it. Raises
    :class:`OutputError` if the folder does not exist or cannot be written, or if writing fails.
    """
    target = Path(path)
    part = _new_part(target)
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        mask = os.umask(0)
        os.umask(mask)
        part.chmod(0o666 & ~mask)  # mkstemp makes files private; a picture is as public as any other file
        part.replace(target)
    except OSError as error:
        raise _failure(target, error) from None
    finally:
        part.unlink(missing_ok=True)


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write ``data`` to ``path`` by :func:`replacing`."""
    with replacing(path) as part:
        part.write_bytes(data)


def _new_part(target: Path) -> Path:
    """An empty file beside ``target``. Raises :class:`OutputError` if ``target`` cannot be written."""
    folder = target.parent
    if target.is_dir():
        raise OutputError(f"cannot write '{target}': it is a folder; give a file name")
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"cannot write '{target}': '{folder}' is a file, not a folder; choose another place")
    if not folder.is_dir():
        raise OutputError(f"cannot write '{target}': there is no folder '{folder}'; create it first")
    try:
        handle, name = tempfile.mkstemp(dir=folder, prefix=f".{target.name}.", suffix=target.suffix or ".part")
        os.close(handle)
    except OSError as error:
        raise OutputError(f"cannot write '{target}': {error.strerror}; choose a place you may write to") from None
    return Path(name)


def _failure(target: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write '{target}': {error.strerror or error}; is the disk full?")
