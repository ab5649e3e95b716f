"""`etendue methods`, `scenes` and `cite`: lists and manual pages."""

from __future__ import annotations

import inspect
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from etendue import methods
from etendue.core import OptionError, bibtex, use_variant
from etendue.products import FACTORS, PARTICLES, SOLUTIONS, find

from ..console import output_console, say

#: Software to cite with every picture.
_ALWAYS_CITED = ("Mitsuba3", "Jakob2022")


def show_methods() -> int:
    """Print a line per method, by what they make."""
    for title, names in (
        ("pictures (etendue render)", tuple(methods.names())),
        ("form factors (etendue form-factors)", FACTORS),
        ("radiosity (etendue radiosity)", SOLUTIONS),
        ("particles (etendue particles trace)", PARTICLES),
    ):
        table = Table(box=None, pad_edge=False, show_header=False, title=title, title_justify="left", title_style="dim")
        table.add_column(no_wrap=True, style="bold")
        table.add_column()
        for name in names:
            table.add_row(name, _plain(_first_line(find(name))))
        output_console().print(table, markup=False)
    say("\nMore, with settings: etendue methods NAME")
    return 0


def show_method(name: str) -> int:
    """The manual page: docstrings of class and file, and the settings."""
    method = find(name)
    name = method.name
    say(f"{name}: {_plain(_first_line(method))}\n")
    body = "\n".join(inspect.cleandoc(method.__doc__ or "").splitlines()[1:]).strip()
    module = inspect.cleandoc(sys.modules[method.__module__].__doc__ or "")
    for text in (body, module):
        if text:
            say(f"{_plain(text)}\n")
    table = Table(box=None, pad_edge=False)
    for heading in ("setting (-D)", "type", "default", "meaning"):
        table.add_column(heading, no_wrap=heading == "setting (-D)")
    for setting, kind, default, doc in method.Settings.describe():
        shown = str(default).lower() if isinstance(default, bool) else str(default)
        table.add_row(setting, kind.replace("|", " | "), shown, doc)
    output_console().print(table, markup=False)
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
    output_console().print(table)
    say("\nAll are built by code and have the licence of the library (BSD 3-clause).")
    say("As XML for Mitsuba: etendue scenes NAME -o FILE")
    return 0


def write_scene(name: str, path: Path) -> int:
    """Write a bundled scene as XML, with its meshes and textures in a folder beside it."""
    from etendue.film import write_bytes
    from etendue.scene import bundled_scene, scene_xml

    if path.suffix.lower() != ".xml":
        raise OptionError(f"a scene is written as .xml, not as '{path.name}'")
    use_variant()
    folder = path.absolute().with_name(f"{path.stem}-files")
    text = scene_xml(bundled_scene(name), folder=folder)
    write_bytes(path, text.replace(f'"{folder}{os.sep}', f'"{folder.name}/').encode())  # both can be moved
    say(str(path))
    return 0


def show_citations(names: Sequence[str]) -> int:
    """BibTeX of the methods' papers, each once, and of the software they run on."""
    keys: dict[str, None] = {}
    for name in names:
        keys.update(dict.fromkeys(find(name).citations))
    keys.update(dict.fromkeys(_ALWAYS_CITED))
    say(bibtex(keys))
    return 0


def _plain(text: str) -> str:
    """A docstring as text for a terminal: without citations and the marks of references."""
    text = re.sub(r":[a-z]+:`[~.]*(?:[^`<]*<)?([^`>]*)>?`", r"\1", text)
    text = re.sub(r" \[[A-Z][^\]]*\d{4}[^\]]*\]", "", text)
    text = re.sub(r":math:`([^`]*)`", r"\1", text)
    return text.replace("``", "")


def _first_line(method: type[Any]) -> str:
    return inspect.cleandoc(method.__doc__ or "").partition("\n")[0]
