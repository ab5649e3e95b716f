"""Options that the experiments share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import OptionError

from ..options import named, scene_names, words
from .entrants import ROULETTE
from .scenes import SCENES

ALL = ",".join(SCENES)
SPECULAR = ",".join(name for name in SCENES if name != "diffuse")
OUT = Path("thesis-output")
SIZE = "320x240"


def _lengths(text: str) -> list[float]:
    """Positive numbers between commas; raises :class:`OptionError` for anything else."""
    try:
        found = [float(word) for word in words(text)]
    except ValueError:
        found = []
    if not found or not all(0.0 < length < float("inf") for length in found):
        raise OptionError(f"option '--radius' takes millimetres, separated by commas, not '{text}'")
    return found


Scenes = scene_names(SCENES)
Radii = Annotated[
    Any,
    typer.Option("--radius", parser=_lengths, help="First radii of vcm in millimetres.", metavar="MM[,MM...]"),
]
Roulette = Annotated[
    Any,
    typer.Option("--roulette", parser=named(ROULETTE, "roulette"), help="Names, by commas.", metavar="NAMES"),
]
Passes = Annotated[int, typer.Option("--passes", min=2, help="Passes of one sample a pixel.", metavar="N")]
ReferenceMethod = Annotated[
    str, typer.Option("--reference-method", help="What makes the references: vcm, bpt, path.", metavar="NAME")
]
ReferenceRadius = Annotated[
    float, typer.Option("--reference-radius", min=0.001, help="First radius of references by vcm.", metavar="MM")
]
