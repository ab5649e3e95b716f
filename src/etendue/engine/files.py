"""Whether a file could be written, asked before hours of work depend on it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from etendue.core import OutputError


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise :class:`OutputError` if ``path`` could not be written now; leaves nothing behind."""
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"cannot write '{path}': it is a folder; give a file name")
    if path.parent.exists() and not path.parent.is_dir():
        raise OutputError(f"cannot write '{path}': '{path.parent}' is a file, not a folder; choose another place")
    if not path.parent.is_dir():
        raise OutputError(f"cannot write '{path}': there is no folder '{path.parent}'; create it first")
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            file.write(b"\0")
            file.flush()
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror}; choose a place you may write to") from error
