"""`etendue particles map`: maps of irradiance from files of particles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.core import OptionError

from . import options as opt
from .console import Steps, error_console, note, say
from .particles import app as app


@app.command("map")
def make(
    file: Annotated[Path, typer.Argument(help="File of particles.", metavar="FILE")],
    output: Annotated[
        list[Path],
        typer.Option(
            "-o",
            "--output",
            help="Map for `--method path -D map=...` (.npz), ParaView (.vtu), vertex colours (.glb, .gltf) or lightmap "
            "(.exr, .png); repeatable.",
            metavar="FILE",
        ),
    ],
    scene: Annotated[
        str | None,
        typer.Option("--scene", help="Scene of the particles, if it has moved.", metavar="SCENE"),
    ] = None,
    kind: Annotated[
        str,
        typer.Option(
            "--map",
            help="histogram in cells, kernel of one width a surface, variable kernels, or knn, the nearest particles.",
            metavar="KIND",
        ),
    ] = "histogram",
    cells: Annotated[
        int, typer.Option("--cells", help="About so many cells on all surfaces.", min=1, metavar="N")
    ] = 20_000,
    bandwidth: Annotated[
        str,
        typer.Option(
            "--bandwidth",
            help="Of kernels, in units of the scene, or a rule: silverman, normal, cross-validation.",
            metavar="H",
        ),
    ] = "silverman",
    kernel: Annotated[str, typer.Option("--kernel", help="Of kernel, variable and knn.", metavar="NAME")] = (
        "epanechnikov"
    ),
    boundary: Annotated[
        str,
        typer.Option(
            "--boundary", help="At edges: renormalise, linear, reflect (flat rectangles) or none.", metavar="NAME"
        ),
    ] = "renormalise",
    k: Annotated[int, typer.Option("-k", help="Neighbours of knn.", min=2, metavar="K")] = 50,
    size: Annotated[
        int, typer.Option("--size", help="Largest side of a lightmap in texels.", min=16, metavar="N")
    ] = 1024,
    param: opt.Param = None,
    variant: opt.Variant = None,
    memory: opt.Memory = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Estimate irradiance on the surfaces of the scene from the particles of a file.

    Histograms and kernels read the file in passes and take the memory of their cells; knn holds all particles.
    """
    from etendue.products.particles import FileSource, MapOptions, check_map_file, make_map, write_map

    from .running import choose_device

    for path in output:
        check_map_file(path)
    width, rule = _bandwidth(bandwidth)
    chosen = MapOptions(kind, cells, width, rule, kernel, boundary, k)  # type: ignore[arg-type]
    source = FileSource(file)
    choose_device(variant, threads)
    console = error_console()
    with Steps(console, "loading the scene") as status:
        problem = source.scene(scene, opt.parse_pairs(param, "-P"), memory)
        made = make_map(problem, source, chosen, status.update)
        written: list[Path] = []
        for path in output:
            status.update(f"writing {path}")
            about = {"particles": made.particles, "file": file.name, "scene": problem.source}
            written += write_map(path, made.map, made.surfaces, size=size, metadata=about)
    note(console, f"{made.map.kind} of {made.particles} particles on {len(made.surfaces.patches)} cells")
    for path in written:
        say(str(path))
    return 0


def _bandwidth(text: str) -> tuple[float | None, str]:
    """(bandwidth, rule): a number, or the name of a rule."""
    try:
        return float(text), "silverman"
    except ValueError:
        pass
    if text not in ("silverman", "normal", "cross-validation"):
        raise OptionError(f"--bandwidth is a number, silverman, normal or cross-validation, not '{text}'")
    return None, text
