"""What `etendue form-factors` takes for lines in a hierarchy of spheres."""

from __future__ import annotations

from typing import Annotated

import typer

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
