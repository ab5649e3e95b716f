"""`etendue point-factors`: what sensors see of the surfaces of a mesh or scene, of the sky and of the ground."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from etendue.core import format_seconds

from . import options as opt
from .console import Steps, error_console, note, say
from .measuring import Cells, Grid, Points, meters_of
from .patches import Ids, LineSeed, MaxArea, More, Obstacles, Orient, Periodic, TwoSided, ZoneName, mesh_arguments


def point_factors(
    mesh: Annotated[
        str,
        typer.Argument(
            help="Mesh (PLY, OBJ, STL, VTU, glTF and others), Mitsuba XML file, or bundled scene.", metavar="SCENE"
        ),
    ],
    points: Points = None,
    grid: Grid = None,
    cells: Cells = None,
    spherical: Annotated[
        bool,
        typer.Option(
            "--spherical",
            help="Sensors have no normal and see all directions, 4 pi, alike; a line of the file may be x,y,z.",
        ),
    ] = False,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "-o",
            "--output",
            help=".csv (a row for each sensor), .npz (arrays); repeatable. By default sensors.csv.",
            metavar="FILE",
        ),
    ] = None,
    groups: Annotated[
        bool,
        typer.Option(
            "--groups",
            help="Columns are groups instead of patches: shapes with a name, or equal numbers of --ids.",
        ),
    ] = False,
    up: Annotated[str, typer.Option("--up", help="Axis of the scene that is up: y or z.", metavar="AXIS")] = "z",
    rays: Annotated[
        int | None, typer.Option("--rays", help="Of each sensor; 8192 if not given.", metavar="N", min=1)
    ] = None,
    error: Annotated[
        float | None,
        typer.Option(
            "--error", help="Cast until no factor has a larger standard error, at most --rays if given.", metavar="X"
        ),
    ] = None,
    solution: Annotated[
        Path | None,
        typer.Option(
            "--solution",
            help="Solution of the same patches, .npz of radiosity or heat: also the irradiance at the sensors.",
            metavar="FILE",
        ),
    ] = None,
    ids: Ids = None,
    max_area: MaxArea = None,
    two_sided: TwoSided = False,
    more: More = None,
    obstacles: Obstacles = None,
    orient: Orient = None,
    zone: ZoneName = None,
    periodic: Periodic = None,
    seed: LineSeed = None,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the view factors from sensors, points with normals or without, to the patches or groups of a mesh, to the
    sky and to the ground, with standard errors.

    A factor of a sensor with a normal is the share of its hemisphere, weighted by the cosine.
    """
    from etendue.products.patches import make_point_factors
    from etendue.radiosity import PatchSource

    from .lines import describe_patches

    began, files = time.perf_counter(), output or [Path("sensors.csv")]
    sensors = meters_of(points, grid, cells, "spherical" if spherical else "irradiance")
    opt.Device(variant, threads).choose()
    source = PatchSource(
        source=mesh,
        max_area=max_area,
        mesh=mesh_arguments(ids, two_sided, orient, more, obstacles, zone, periodic),
        parameters=opt.parse_pairs(param, "-P"),
    )
    asked = {"up": up, "seed": seed or 0} | ({} if rays is None else {"rays": rays})
    with Steps(error_console(), "reading") as steps:
        found = make_point_factors(
            source,
            sensors,
            files,
            steps.update,
            lambda patches: describe_patches(source.name, patches),
            groups=groups,
            solution=solution,
            error=error,
            **asked,
        )
    note(error_console(), f"{found.summary()}; in {format_seconds(time.perf_counter() - began)}")
    say("\n".join(map(str, files)))
    return 0
