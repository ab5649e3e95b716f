"""Output files: checked before the work begins, written independently, rescued if writing fails."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from etendue.core import VERSION, EtendueError, OptionError, OutputError, checked_path, describe
from etendue.film import check_writable

PathLike = str | os.PathLike[str]
#: Writes a file to a path.
Write = Callable[[Path], object]


def listed(paths: PathLike | Sequence[PathLike]) -> tuple[Path, ...]:
    """One path, or several, as a tuple. Raises :class:`OptionError`."""
    several = isinstance(paths, Iterable) and not isinstance(paths, (str, bytes, os.PathLike))
    return tuple(map(checked_path, paths)) if several else (checked_path(paths),)  # type: ignore[arg-type]


def check_files(paths: Iterable[Path]) -> None:
    """Raise :class:`OptionError` if a path occurs twice, :class:`OutputError` if a file cannot be written."""
    seen: set[Path] = set()
    for path in paths:
        if (place := path.resolve()) in seen:
            raise OptionError(f"'{path}' is named for two outputs; give each a name of its own")
        seen.add(place)
        check_writable(path)


def about(source: str, **more: Any) -> dict[str, Any]:
    """Metadata of files: the software, the source, and ``more`` as plain values."""
    known = {"software": f"etendue {VERSION}", "source": source, **more}
    plain: dict[str, Any] = json.loads(json.dumps(known, default=_plain))
    return plain


def _plain(value: Any) -> Any:
    """A value for JSON: numbers and arrays of NumPy as those of Python, other objects as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def add_to_message(error: EtendueError, text: str) -> None:
    """Append ``text`` to the message of an error."""
    error.args = (f"{error}{text}", *error.args[1:])


def rescued(name: str, *ways: tuple[str, Write]) -> Path | None:
    """Write a file to the system's temporary folder, and return its path; ``None`` if that fails as well.

    ``ways`` are tried in turn until one succeeds: each is a suffix of ``name`` and a function that writes the file.
    """
    with contextlib.suppress(OSError):
        folder = Path(tempfile.mkdtemp(prefix="etendue-"))
        for suffix, write in ways:
            with contextlib.suppress(Exception):
                write(place := folder / (name + suffix))
                return place
        shutil.rmtree(folder)
    return None


class Writing:
    """Writes several files: if one fails, the others are still written."""

    def __init__(self) -> None:
        self._errors: list[EtendueError] = []

    @contextlib.contextmanager
    def attempt(self, what: str, otherwise: Callable[[], str] = str) -> Iterator[None]:
        """Context of an action ``what`` ("write 'a.exr'"). Its error is raised by :meth:`finish`. After an error
        ``otherwise`` may rescue the data; it returns a text that is appended to the message."""
        try:
            yield
        except Exception as error:
            known = error if isinstance(error, EtendueError) else None
            failure = known or OutputError(f"cannot {what}: {describe(error)}")
            if known is None:
                failure.__cause__ = error
            add_to_message(failure, otherwise())
            self._errors.append(failure)

    def finish(self) -> None:
        """Raise the error of a failed action; several errors as one :class:`OutputError`."""
        if len(self._errors) == 1:
            raise self._errors[0]
        if self._errors:
            raise OutputError("; ".join(map(str, self._errors))) from self._errors[0]
