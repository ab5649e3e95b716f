"""Options that the experiments share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..options import named, scene_names
from .drivers import DRIVERS, INDEPENDENT
from .scenes import SCENES

OUT = Path("global-lines-output")
RAYS, BUNDLES = 1 << 23, 4096
EVERY = ",".join(DRIVERS)
GOOD = f"{INDEPENDENT},halton,sobol"


def _sequences(text: str) -> list[str]:
    """Names of sequences, independent numbers first, to which all others are compared."""
    return list(dict.fromkeys([INDEPENDENT, *named(DRIVERS, "sequence")(text)]))


Scenes = scene_names(SCENES)
Sequences = Annotated[
    Any, typer.Option("--sequences", parser=_sequences, help="Names, separated by commas.", metavar="NAMES")
]
Lines = Annotated[int, typer.Option(min=2, help="Global lines, and as many local ones; halved again and again.")]
Least = Annotated[int, typer.Option(min=1, help="The fewest lines of them.")]
Detail = Annotated[float, typer.Option(min=0.01, help="Divides the size of the patches.")]
Rays = Annotated[int, typer.Option(min=1, help="Rays of half a reference.")]
ReferenceBundles = Annotated[int, typer.Option(min=1, help="Bundles of lines of half a reference.")]
