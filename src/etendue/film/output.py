"""Atomic writing of files, and an early check that they can be written."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from etendue.core import OutputError

#: The temporary files of :func:`replacing`.
_being_written: set[Path] = set()


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
    """A temporary path beside ``path``, which replaces ``path`` when the block ends without an error.

    A reader sees the old file or the new one, never a part of it, even if the process is killed or power is lost. The
    file has the permissions of any other new file. Raises :class:`OutputError` if the folder does not exist or cannot
    be written, or if writing fails.
    """
    target = Path(path)
    part = _new_part(target)
    _being_written.add(part)
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.replace(target)
        _sync(target.parent)
    except OSError as error:
        raise _failure(target, error) from None
    finally:
        part.unlink(missing_ok=True)
        _being_written.discard(part)


def is_writing() -> bool:
    """Whether a file is being written by :func:`replacing` in this process."""
    return bool(_being_written)


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
    part = folder / f".{target.name}.{secrets.token_hex(8)}{target.suffix or '.part'}"
    try:
        # open() applies the umask, which cannot be read without changing it for all threads; mkstemp makes files
        # private.
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666))
    except OSError as error:
        raise OutputError(f"cannot write '{target}': {error.strerror}; choose a place you may write to") from None
    return part


def _sync(folder: Path) -> None:
    """Write the entries of a folder to the disk. If that fails, the file is in place nevertheless."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _failure(target: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write '{target}': {error.strerror or error}; is the disk full?")
