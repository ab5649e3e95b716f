"""The bibliography: from the keys in docstrings and ``Method.citations`` to BibTeX text."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping
from importlib import resources
from types import MappingProxyType

from .errors import EtendueError, OptionError

_HEAD = re.compile(r"@(\w+)\s*\{\s*([^,\s]+)\s*,")


def parse(text: str) -> dict[str, str]:
    """Split BibTeX ``text`` into entries by key, each with its original text.

    Raises :class:`EtendueError` on an entry without its closing brace and on a key that occurs twice.
    """
    entries: dict[str, str] = {}
    position = 0
    while (head := _HEAD.search(text, position)) is not None:
        key = head.group(2)
        position = _closing_brace(text, head.start(), key)
        if key in entries:
            raise EtendueError(f"bibliography: key '{key}' occurs twice")
        entries[key] = text[head.start() : position]
    return entries


@functools.cache
def bibliography() -> Mapping[str, str]:
    """The entries of ``core/bibliography.bib`` by key."""
    return MappingProxyType(parse(resources.files(__package__).joinpath("bibliography.bib").read_text("utf-8")))


def bibtex(keys: Iterable[str]) -> str:
    """BibTeX text of the entries ``keys``, in that order. Raises :class:`OptionError` on an unknown key."""
    entries = bibliography()
    missing = [key for key in keys if key not in entries]
    if missing:
        raise OptionError(f"the bibliography has no entry '{missing[0]}'; it has: {', '.join(sorted(entries))}")
    return "\n\n".join(entries[key] for key in keys)


def _closing_brace(text: str, start: int, key: str) -> int:
    depth = 0
    for index in range(start, len(text)):
        if text[index] == "{":
            depth += 1
        elif text[index] == "}":
            depth -= 1
            if depth == 0:
                return index + 1
    raise EtendueError(f"bibliography: entry '{key}' has no closing brace")
