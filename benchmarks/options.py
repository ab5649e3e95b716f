"""Options that benchmarks share. Those that are read from text have their defaults as text, too."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any

import typer

from etendue import methods
from etendue.cli.options import parse_size
from etendue.core import OptionError, suggest


def words(text: str) -> list[str]:
    """What stands between the commas."""
    return [word.strip() for word in text.split(",") if word.strip()]


def named(known: Collection[str], what: str) -> Callable[[str], list[str]]:
    """Reads names between commas; raises :class:`OptionError` for one that is not known."""

    def names(text: str) -> list[str]:
        found = words(text)
        for name in found:
            if name not in known:
                raise OptionError(f"unknown {what} '{name}'; {suggest(name, known)}")
        return found

    return names


def whole_numbers(text: str) -> list[int]:
    """Whole numbers between commas; raises :class:`OptionError` for anything else."""
    try:
        return [int(word) for word in words(text)]
    except ValueError:
        raise OptionError(f"whole numbers are wanted, separated by commas, not '{text}'") from None


def _names_of_methods(text: str) -> list[str]:
    return [methods.get(name).name for name in words(text)]


#: To typer a list is an option that may be given several times: what stands between commas is ``Any``.
Methods = Annotated[
    Any, typer.Option("--methods", parser=_names_of_methods, help="Names, separated by commas.", metavar="NAMES")
]
Names = Annotated[Any, typer.Option("--scenes", parser=words, help="Names, separated by commas.", metavar="NAMES")]
Size = Annotated[Any, typer.Option("--size", parser=parse_size, metavar="WxH")]
Pixels = Annotated[int, typer.Option(min=1, help="Pixels of a picture, about.")]
Seconds = Annotated[float, typer.Option("--time", min=0.01, help="Seconds for each picture, method or setting.")]
Seeds = Annotated[int, typer.Option(min=1, help="Runs of each; their median or mean square counts.")]
Cells = Annotated[
    Any,
    typer.Option(
        "--cells", parser=whole_numbers, help="Along an edge of the room, separated by commas.", metavar="N,..."
    ),
]
Bundles = Annotated[int, typer.Option(min=1, help="Bundles of parallel lines.")]
Rounds = Annotated[int, typer.Option(min=1, help="Rounds that are timed.")]
WarmUp = Annotated[int, typer.Option(min=1, help="Rounds before them.")]
Define = Annotated[list[str] | None, typer.Option("-D", help="A setting, or METHOD.NAME=VALUE.", metavar="NAME=VALUE")]
Out = Annotated[Path, typer.Option("--out", help="Folder for references, plots and pictures.")]
ReferenceSeconds = Annotated[
    float, typer.Option("--reference-time", min=0.01, help="Seconds for a reference that is not there yet.")
]


def scene_names(known: Collection[str]) -> Any:
    """The option ``--scene`` of a package with these scenes."""
    return Annotated[
        Any,
        typer.Option("--scene", parser=named(known, "scene"), help="Names, separated by commas.", metavar="NAMES"),
    ]
