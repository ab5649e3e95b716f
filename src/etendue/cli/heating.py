"""`etendue heat`: temperatures and heat of the groups of a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.core import format_seconds

from . import options as opt
from .console import Steps, error_console, note, say
from .patches import (
    Bundles,
    Ids,
    LineSeed,
    MaxArea,
    More,
    Obstacles,
    Orient,
    Periodic,
    TwoSided,
    ZoneName,
    mesh_arguments,
)


def heat(
    mesh: Annotated[
        str, typer.Argument(help="Mesh (STL, OBJ, VTU, View3D and others), Mitsuba XML file or bundled scene.")
    ],
    conditions: Annotated[
        Path,
        typer.Option(
            "--conditions",
            "-c",
            help="Table with the columns group, temperature (K), flux (W/m^2, or adiabatic), power (W), conductance "
            "(W/(m^2 K)), ambient (K), emissivity, or by bands in micrometres emissivity:0-4, emissivity:4-inf, "
            "isothermal (yes or no); '*' is every other group.",
            metavar="FILE",
        ),
    ],
    loads: Annotated[
        Path | None,
        typer.Option(
            "--loads",
            help="Table with a row for each case: its name, and columns GROUP:temperature, GROUP:flux, "
            "GROUP:power, GROUP:ambient, GROUP:conductance or surroundings.",
            metavar="FILE",
        ),
    ] = None,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "-o",
            "--output",
            help=".csv (groups, or cases; heads of columns have units, as heat_W), .npz (arrays), and of one case .vtu "
            "(faces) and .png (temperatures in false colours); repeatable. By default heat.csv.",
            metavar="FILE",
        ),
    ] = None,
    surroundings: Annotated[
        float | None,
        typer.Option(
            "--surroundings",
            help="Temperature of the black sky around an open mesh, or 0.",
            metavar="K",
            min=0,
        ),
    ] = None,
    factors: Annotated[
        Path | None,
        typer.Option("--factors", help="Form factors of all patches from a file, .npz, .nc or .vf.", metavar="FILE"),
    ] = None,
    solver: Annotated[
        str | None, typer.Option("--solver", help="conjugate-gradient, gauss-seidel, jacobi or direct.", metavar="NAME")
    ] = None,
    time: opt.Time = None,
    bundles: Bundles = None,
    error: opt.Error = None,
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
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Solve for temperatures and heat of the groups of a mesh that exchange heat by radiation.

    Patches of a group have its temperature, or the heat flux that it sends into the enclosure (0 if it is adiabatic),
    or exchange heat with a body of known temperature; their own temperatures are then found. They are grey, or have an
    emissivity for each band of wavelengths.
    """
    import time as clock

    from etendue.radiosity import PatchSource
    from etendue.verbs import solve_heat

    from .running import choose_device

    console, began = error_console(), clock.perf_counter()
    choose_device(variant, threads)
    files = output or [Path("heat.csv")]
    given = mesh_arguments(ids, two_sided, orient, more, obstacles, zone, periodic)
    patches = PatchSource(source=mesh, max_area=max_area, mesh=given).open().patches
    limits = opt.limits(time, error, bundles=bundles)
    with Steps(console, "form factors" if factors is None else "solving"):
        result = solve_heat(
            patches,
            conditions,
            loads,
            surroundings=surroundings,
            factors=factors,
            solver=solver,
            seed=seed or 0,
            save=files,
            **limits,
        )
    note(console, f"{len(patches)} patches, {result.summary()}, in {format_seconds(clock.perf_counter() - began)}")
    say("\n".join(map(str, files)))
    return 0
