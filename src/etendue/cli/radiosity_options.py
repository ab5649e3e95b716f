"""Options of `etendue form-factors` and `etendue radiosity`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

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
BundleLines = Annotated[
    float | None,
    typer.Option(
        "--lines",
        help="Lines of a bundle through the sphere around the scene; if not given, some four for each patch. Of "
        "form-factors --hierarchy: in all spheres together.",
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
LineSeed = Annotated[
    int | None, typer.Option("--seed", help="The same seed gives the same lines; 0 if not given.", metavar="N")
]
Hierarchy = Annotated[
    str | None,
    typer.Option(
        "--hierarchy",
        help="Cast lines in spheres around objects (form-factors), or in boxes around groups of objects or around "
        "instances, by hierarchical multipath; --bundles are then passes of lines (radiosity). NAME says what an "
        "object is: shapes (of a scene), components (connected surfaces), labels (those of --ids), or an array of the "
        "mesh file that numbers objects, negative for walls. Without it: shapes, or components of a mesh.",
        metavar="[NAME]",
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
    typer.Option(
        "--point-set",
        help="What draws lines, with --hierarchy or multipath: sobol, halton, weyl or independent; or, with --engine "
        "bundles, spiral.",
        metavar="NAME",
    ),
]
Generator = Annotated[
    str | None,
    typer.Option(
        "--generator",
        help="How a line is made of a point: sphere-pairs (multipath, if not given), box-walls (--hierarchy, if not "
        "given) or great-circle.",
        metavar="NAME",
    ),
]
MainShare = Annotated[
    float | None,
    typer.Option(
        "--main-share",
        help="With --hierarchy: share of the lines in the whole scene, 0.2; 0 chooses all shares by least error.",
        metavar="X",
    ),
]

Ambient = Annotated[
    str | None,
    typer.Option(
        "--ambient",
        help="All light by an ambient term, at once and without lines: classic, crisp or fuzzy, which it is without "
        "NAME. With --bounces, what a solution by lines has left.",
        metavar="[NAME]",
    ),
]
Bounces = Annotated[
    int | None,
    typer.Option(
        "--bounces",
        help="Iterations of the solver, jacobi if none is named; light of more is ambient.",
        min=1,
        metavar="N",
    ),
]
SubScenes = Annotated[
    str | None,
    typer.Option(
        "--sub-scenes",
        help="With --ambient: light spreads in parts of the scene first. Objects, named as by --hierarchy, or boxes, "
        "around groups of objects.",
        metavar="NAME",
    ),
]
GroupedObjects = Annotated[
    str | None,
    typer.Option("--objects", help="What makes an object for boxes; the NAME of --hierarchy.", metavar="NAME"),
]
Threshold = Annotated[
    float | None,
    typer.Option("--threshold", help="With boxes: objects get one if they fill it so well (0.8).", metavar="X"),
]
BoxRegions = Annotated[
    int | None,
    typer.Option("--regions", help="With --hierarchy: places along an edge of a box (4).", min=1, metavar="N"),
]
BoxSettings = Annotated[
    list[str] | None,
    typer.Option(
        "-D",
        "--set",
        help="With --hierarchy or boxes: a setting, repeatable, such as lines (of a pass), iterations, sectors, rings, "
        "levels or least.",
        metavar="NAME=VALUE",
    ),
]
Divide = Annotated[
    bool,
    typer.Option(
        "--divide",
        help="With --hierarchy and workers: each worker has some of the boxes and their lines, and all make a pass "
        "together; otherwise each makes whole passes.",
    ),
]


#: Values of options that are given without a name.
_UNNAMED = {"--hierarchy": "", "--ambient": "fuzzy"}


class OptionalName(TyperCommand):
    """A command some of whose options may have a name behind them or not: what is a source is none."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """See ``click.Command``."""
        given: list[str] = []
        for k, word in enumerate(args):
            given.append(word)
            alone = k + 1 == len(args) or args[k + 1].startswith("-") or _is_source(args[k + 1])
            if word in _UNNAMED and alone:
                given.append(_UNNAMED[word])
        parsed: list[str] = super().parse_args(ctx, given)
        return parsed


def _is_source(word: str) -> bool:
    """Whether a word is a file, a folder or a bundled scene."""
    from etendue.scene import bundled

    path = Path(word)
    return bool(path.suffix) or path.exists() or len(path.parts) > 1 or word in bundled()


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
