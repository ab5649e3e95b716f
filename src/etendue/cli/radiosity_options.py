"""Options of `etendue form-factors` and `etendue radiosity`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.core import OptionError
from etendue.jobs import DEFAULT_BUNDLES

Bundles = Annotated[
    int | None,
    typer.Option(
        "--bundles",
        help=f"Directions of parallel lines; a power of two is best. {DEFAULT_BUNDLES}, if no budget is given.",
        min=1,
        metavar="N",
    ),
]
Error = Annotated[
    float | None,
    typer.Option(
        "--error", help="Stop at this standard error: of the irradiance, relative; of a row of factors.", metavar="X"
    ),
]
CheckpointFile = Annotated[
    Path | None, typer.Option("--checkpoint", help="Save the lines, for `etendue resume`.", metavar="FILE")
]
MaxArea = Annotated[float | None, typer.Option("--max-area", help="Subdivide faces larger than this.", metavar="AREA")]
Reflectance = Annotated[
    str | None,
    typer.Option(
        "--reflectance",
        help="Of a mesh: a number, one for each channel as 0.7,0.5,0.2, or an array of the file for its faces "
        "('emissivity' counts as one minus it). 0 if not given.",
        metavar="X|NAME",
    ),
]
Ids = Annotated[
    str | None, typer.Option("--ids", help="Of a mesh: array of the file; faces of equal number are one patch.")
]
TwoSided = Annotated[
    bool, typer.Option("--two-sided", help="Faces of a mesh are sheets: their backs are patches, too.")
]
NoLocalRays = Annotated[bool, typer.Option("--no-local-rays", help="No rays from small patches, which few lines meet.")]
LineSeed = Annotated[int, typer.Option("--seed", help="The same seed gives the same lines.", metavar="N")]
Hierarchy = Annotated[
    str | None,
    typer.Option(
        "--hierarchy",
        help="Cast lines in spheres around objects: components (connected surfaces), labels (those of --ids), or an "
        "array of the file that numbers objects, negative for walls.",
        metavar="NAME",
    ),
]
Walls = Annotated[
    str | None,
    typer.Option("--walls", help="Names of objects that are walls, separated by commas; '' for none.", metavar="NAMES"),
]
Engine = Annotated[
    str | None,
    typer.Option("--engine", help="With --hierarchy: rays, line by line, or bundles, rasterised.", metavar="NAME"),
]
PointSet = Annotated[
    str | None,
    typer.Option("--point-set", help="With --hierarchy: independent, halton, sobol or spiral.", metavar="NAME"),
]
MainShare = Annotated[
    float | None,
    typer.Option(
        "--main-share",
        help="With --hierarchy: share of the lines in the whole scene, 0.2; 0 chooses all shares by least error.",
        metavar="X",
    ),
]


def quantity(text: str | None) -> float | str | list[list[float]] | None:
    """A number, a row of numbers for channels, or a name."""
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        return text
    return numbers[0] if len(numbers) == 1 else [numbers]


def sky_of(text: str | None) -> float | list[float] | None:
    """A number, or one for each channel."""
    light = quantity(text)
    if isinstance(light, str):
        raise OptionError(f"--sky is a number, or one for each channel as 1,0.8,0.5, not '{text}'")
    return light[0] if isinstance(light, list) else light
