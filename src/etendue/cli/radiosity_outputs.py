"""Options of `etendue radiosity` for its outputs, and the names of options in messages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.jobs import Wording

FactorFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "-o",
        "--output",
        help=".npz or .nc (arrays), .vf (View3D's text); repeatable. By default factors.npz.",
        metavar="FILE",
    ),
]
SolutionFiles = Annotated[
    list[Path] | None,
    typer.Option(
        "-o",
        "--output",
        help=".vtu (ParaView), .ply, .glb, .gltf (vertex colours), .npz, .nc (arrays); .exr, .png (a picture); .html "
        "(a page); repeatable. By default solution.vtu.",
        metavar="FILE",
    ),
]
Gather = Annotated[
    int,
    typer.Option(
        "--gather",
        help="Paths per pixel of a picture with final gathering; 0 shows the patches.",
        min=0,
        metavar="N",
    ),
]
Samples = Annotated[int, typer.Option("--spp", help="Rays per pixel without --gather.", min=1, metavar="N")]
Flat = Annotated[
    bool, typer.Option("--flat", help="In pictures and lightmaps, patches have one colour each: no smoothing.")
]
ErrorPicture = Annotated[
    bool, typer.Option("--error-picture", help="Beside a .png, its relative standard error in false colours.")
]
LightmapSize = Annotated[
    int | None,
    typer.Option(
        "--lightmap",
        help="Write a lightmap of at most this many texels a side, and its mesh.",
        min=16,
        metavar="SIZE",
    ),
]
TextureCoordinates = Annotated[
    str | None,
    typer.Option(
        "--uv",
        help="Coordinates of the lightmap: a .glb or .gltf file with TEXCOORD_1, or 'scene' for the scene's own; "
        "without this an atlas is made.",
        metavar="FILE",
    ),
]


WithPage = Annotated[
    bool, typer.Option("--page", help="Beside the output, a page (.html): pictures of the mesh, errors, tables.")
]
Solved = Annotated[
    Path | None,
    typer.Option(
        "--solution", help="A solution of this scene, .npz or .nc, to write in other formats.", metavar="FILE"
    ),
]


def with_page(files: tuple[Path, ...], output: Path, page: bool) -> tuple[Path, ...]:
    """The files, and the page beside ``output`` if it is wanted."""
    beside = output.with_suffix(".html")
    return (*files, beside) if page and beside not in files else files


class Options(Wording):
    """Names of options for messages of jobs."""

    mesh_light = "give --emission or --temperature (a number, or the name of an array of the file), or --sky"
    lightmap = "give the size of one, as --lightmap 1024"
    _NAMES = {  # noqa: RUF012
        "seconds": "--time",
        "samples": "--spp",
        "parameters": "-P",
        "lightmap_size": "--lightmap",
        "shot": "--no-shot",
        "local_rays": "--no-local-rays",
    }

    def option(self, name: str) -> str:
        """See :class:`Wording`."""
        return self._NAMES.get(name, f"--{name.replace('_', '-')}")

    def limit(self, name: str) -> str:
        """See :class:`Wording`."""
        return f"{name} ({self.option(name)})"

    def resume(self, checkpoint: Path, limit: str = "", count: int = 0) -> str:
        """See :class:`Wording`."""
        return f"etendue resume {checkpoint}" + (f" {self.option(limit)} {count}" if limit else "")
