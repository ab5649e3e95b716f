"""The last command that failed, kept for `etendue doctor --report`, and texts without private names."""

from __future__ import annotations

import getpass
import json
import os
import re
import shlex
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import etendue
from etendue.core import VERSION

#: The beginning of a path from the root that is not one of every system.
_ROOT = r"(?:[A-Za-z]:)?[/\\](?!(?:usr|lib\w*|opt|Library|Program Files)[/\\])"
#: The folders of such a path, as it may stand in a sentence, in quotes, or be a word of a command.
_FOLDERS = r"(?<![\w.~:/\\-])" + _ROOT + r"(?:{part}+[/\\])+(?={part})"
_IN_TEXT = re.compile(_FOLDERS.format(part=r"[^\s/\\:,;'\"]"))
_IN_QUOTES = re.compile(r"(?<=['\"])" + _ROOT + r"[^'\"\n]*[/\\](?=[^'\"\n])")
_IN_WORD = re.compile(_FOLDERS.format(part=r"[^/\\:'\"]"))


def cache_folder() -> Path:
    """Where files are kept that may be lost: ``etendue`` in ``$XDG_CACHE_HOME``, by default ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "etendue"


def remember_fault(words: Sequence[str], message: str, status: int, error: BaseException | None = None) -> None:
    """Keep a failed command for :func:`last_fault`, without private names; ``error`` with its traceback, too.

    Nothing is kept, and nothing said, where the folder cannot be written.
    """
    # A path may contain blanks, of which a message does not tell where they belong; the word of the command does.
    hidden = {word: impersonal(word, _IN_WORD) for word in words}
    for word in sorted(hidden, key=len, reverse=True):
        if len(word) > 1 and hidden[word] != word:
            message = message.replace(word, hidden[word])
    fault = {
        "time": time.strftime("%Y-%m-%d %H:%M:%S"),
        "version": VERSION,
        "status": status,
        "command": shlex.join(["etendue", *(hidden[word] for word in words)]),
        "message": impersonal(" ".join(message.split())),
    }
    with suppress(OSError, RuntimeError):
        folder = cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        trace = folder / "last-error.traceback"
        trace.unlink(missing_ok=True)
        if error is not None:
            trace.write_text(impersonal("".join(traceback.format_exception(error))), "utf-8")
        part = folder / f"last-error.{os.getpid()}.part"
        part.write_text(json.dumps(fault), "utf-8")
        part.replace(folder / "last-error.json")


def last_fault() -> str:
    """The last failed command of this user as lines of a report."""
    file = cache_folder() / "last-error.json"
    try:
        fault = json.loads(file.read_text("utf-8"))
        lines = [
            f"last error: {fault['time']}, etendue {fault['version']}, exit status {fault['status']}",
            f"  command: {fault['command']}",
            f"  message: {fault['message']}",
        ]
    except FileNotFoundError:
        return "last error: none"
    except (OSError, ValueError, KeyError, TypeError) as error:
        return f"last error: {file} cannot be read ({type(error).__name__})"
    trace = file.with_suffix(".traceback")
    return "\n".join([*lines, f"  traceback: {trace}"] if trace.exists() else lines)


def impersonal(text: str, paths: re.Pattern[str] = _IN_TEXT) -> str:
    """``text`` without private folders and without the user's name.

    The home folder is ``~``, the folder of the process HERE, those of Python ENVIRONMENT and PYTHON, that of étendue
    ETENDUE; of other paths from the root that match ``paths``, or stand in quotes, the last name stays.
    """
    known = {
        str(Path(etendue.__file__).parent): "ETENDUE",
        sys.prefix: "ENVIRONMENT",
        sys.base_prefix: "PYTHON",
    }
    names = set()
    with suppress(OSError):  # the folder was removed
        known[os.getcwd()] = "HERE"
    with suppress(RuntimeError):  # no home folder
        known[str(Path.home())] = "~"
        names.add(Path.home().name)
    with suppress(OSError, KeyError, ImportError):  # no user of this number
        names.add(getpass.getuser())
    for folder in sorted(known, key=len, reverse=True):
        if len(folder) > 1:
            text = re.sub(rf"(?<![\w.~-]){re.escape(folder)}(?![\w-])", known[folder], text)
    text = paths.sub(".../", _IN_QUOTES.sub(".../", text))
    for name in filter(None, names):
        text = re.sub(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", "USER", text, flags=re.IGNORECASE)
    return text
