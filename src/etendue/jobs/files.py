"""Files that work leaves behind: checked before it begins, written one by one, rescued where that fails."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from etendue.core import EtendueError, OptionError, OutputError, describe
from etendue.film import check_writable

PathLike = str | os.PathLike[str]
#: Writes what it is for to a path.
Write = Callable[[Path], object]


def listed(paths: PathLike | Sequence[PathLike]) -> tuple[Path, ...]:
    """One path, or several, as a tuple."""
    return (Path(paths),) if isinstance(paths, (str, os.PathLike)) else tuple(map(Path, paths))


def check_files(paths: Iterable[Path]) -> None:
    """Raise :class:`OptionError` if one of ``paths`` is named twice, :class:`OutputError` if one cannot be written."""
    seen: set[Path] = set()
    for path in paths:
        if (place := path.resolve()) in seen:
            raise OptionError(f"'{path}' is named for two outputs; give each a name of its own")
        seen.add(place)
        check_writable(path)


def add_to_message(error: EtendueError, text: str) -> None:
    """``error`` says more."""
    error.args = (f"{error}{text}", *error.args[1:])


def rescued(name: str, *ways: tuple[str, Write]) -> Path | None:
    """Where something has been written in the system's folder for temporary files, ``None`` if that has failed, too.

    ``ways`` are tried in turn until one succeeds: a suffix to ``name``, and what writes the file.
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
    """Files that are written one after the other: one that fails does not keep the others from being written."""

    def __init__(self) -> None:
        self._errors: list[EtendueError] = []

    @contextlib.contextmanager
    def attempt(self, what: str, otherwise: Callable[[], str] = str) -> Iterator[None]:
        """Do ``what`` ("write 'a.exr'"). If it fails, whatever the reason, that is raised at the end only; before,
        ``otherwise`` has a last try, and words for the message."""
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
        """Raise what has failed; several failures as one :class:`OutputError`."""
        if len(self._errors) == 1:
            raise self._errors[0]
        if self._errors:
            raise OutputError("; ".join(map(str, self._errors))) from self._errors[0]
