"""Options and beginnings that the commands of the benchmarks share."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated

import typer

from etendue.core import OptionError, suggest, use_variant

from .measuring import console, machine, software

Size = Annotated[str, typer.Option(metavar="WxH")]
Rounds = Annotated[int, typer.Option(min=1, help="Rounds that are timed.")]
WarmUp = Annotated[int, typer.Option(min=1, help="Rounds before them.")]
Variant = Annotated[str | None, typer.Option(help="Mitsuba variant; by default CUDA where usable, else LLVM.")]


def begin(variant: str | None) -> str:
    """Set the variant and say on what is measured; returns the variant."""
    chosen = use_variant(variant)
    console.print(f"{machine()}; {software(chosen)}\n", style="dim")
    return chosen


def words(text: str) -> list[str]:
    """What stands between the commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


def named(text: str, known: Collection[str], what: str) -> list[str]:
    """The names between the commas; raises :class:`OptionError` for one that is not known."""
    names = words(text)
    for name in names:
        if name not in known:
            raise OptionError(f"unknown {what} '{name}'; {suggest(name, known)}")
    return names
