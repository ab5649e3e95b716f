"""Options and beginnings that the commands of the benchmarks share."""

from __future__ import annotations

from typing import Annotated

import typer

from etendue.core import use_variant

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
