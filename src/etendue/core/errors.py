"""Errors: one line each, with the cause, the place and the remedy.

All errors that the library raises on purpose are subclasses of :class:`EtendueError`. The command line prints the line
and exits with :attr:`EtendueError.exit_code`. Any other exception is a bug and is shown with its traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class EtendueError(Exception):
    """Base of all errors raised on purpose. ``str(error)`` is one line for the user."""

    exit_code = 1


class OptionError(EtendueError):
    """An option, setting or budget with an unknown name or an invalid value."""

    exit_code = 2


class SceneError(EtendueError):
    """A scene cannot be read or is broken (no sensor, no emitter, a NaN vertex)."""

    exit_code = 3


class UnsupportedError(SceneError):
    """A scene element that no method can render correctly. The message names the element and an alternative."""


class CheckpointError(EtendueError):
    """A checkpoint is missing, damaged, or belongs to another scene or other settings."""

    exit_code = 4


class OutputError(EtendueError):
    """A file cannot be written to the requested place."""

    exit_code = 5


class BackendError(EtendueError):
    """Mitsuba, Dr.Jit, LLVM or CUDA is missing or unusable; the message says what to install."""

    exit_code = 6


class ClusterError(EtendueError):
    """A cluster cannot be reached, has no worker that can be used, or loses its workers."""

    exit_code = 7


def describe(error: BaseException) -> str:
    """An exception as one line: the text of an :class:`EtendueError`; type and text of others."""
    text = " ".join(str(error).split())
    if isinstance(error, EtendueError):
        return text
    kind = type(error).__name__
    return f"{kind}: {text}" if text else kind


def suggest(name: object, known: Iterable[str], otherwise: str = "there are") -> str:
    """A hint for a name that is not ``known``: ``did you mean '...'?``, or ``otherwise`` and all known names."""
    names = list(known)
    # Two swapped letters of three have a similarity of 0.67; less similar names are rarely meant.
    close = difflib.get_close_matches(str(name), names, n=1, cutoff=0.65)
    return f"did you mean '{close[0]}'?" if close else f"{otherwise}: {', '.join(names)}"
