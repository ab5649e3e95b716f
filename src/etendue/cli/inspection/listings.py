"""`etendue methods`, `scenes` and `cite`: lists and manual pages."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from etendue import methods
from etendue.core import bibtex

from ..console import say

#: Software to cite with every picture.
_ALWAYS_CITED = ("Mitsuba3", "Jakob2022")


def show_methods() -> int:
    """Print a line per method."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for name, method in methods.table().items():
        table.add_row(name, _first_line(method))
    Console(highlight=False).print(table)
    say("\nMore, with settings: etendue methods NAME")
    return 0


def show_method(name: str) -> int:
    """The manual page: docstrings of class and file, and the settings."""
    method = methods.get(name)
    say(f"{name}: {_first_line(method)}\n")
    body = "\n".join(inspect.cleandoc(method.__doc__ or "").splitlines()[1:]).strip()
    module = inspect.cleandoc(sys.modules[method.__module__].__doc__ or "")
    for text in (body, module):
        if text:
            say(f"{text}\n")
    table = Table(box=None, pad_edge=False)
    for heading in ("setting (-D)", "type", "default", "meaning"):
        table.add_column(heading, no_wrap=heading == "setting (-D)")
    for setting, kind, default, doc in method.Settings.describe():
        shown = str(default).lower() if isinstance(default, bool) else str(default)
        table.add_row(setting, kind.replace("|", " | "), shown, doc)
    Console(highlight=False).print(table, markup=False)
    if method.citations:
        say(f"\nPapers (etendue cite {name}): {', '.join(method.citations)}")
    return 0


def show_scenes() -> int:
    """Print a line per bundled scene."""
    from etendue.scene import bundled

    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for name, scene in bundled().items():
        table.add_row(name, scene.description)
    Console(highlight=False).print(table)
    say("\nAll are built by code and have the licence of the library (BSD 3-clause).")
    return 0


def show_citations(names: Sequence[str]) -> int:
    """BibTeX of the methods' papers, each once, and of the software they run on."""
    keys: dict[str, None] = {}
    for name in names:
        keys.update(dict.fromkeys(methods.get(name).citations))
    keys.update(dict.fromkeys(_ALWAYS_CITED))
    say(bibtex(keys))
    return 0


def _first_line(method: type[Any]) -> str:
    return inspect.cleandoc(method.__doc__ or "").partition("\n")[0]
