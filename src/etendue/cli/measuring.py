"""The command that measures light at points."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from etendue.core import OptionError

from . import options as opt
from .console import error_console, note, say
from .settings import settings_in, with_settings

if TYPE_CHECKING:
    from etendue.lighting import Meters


def _methods() -> dict[str, Any]:
    from etendue import methods

    return {name: kind.Settings for name, kind in methods.table().items() if kind.measures}


#: The command with the settings of the methods that measure.
MeasureCommand = with_settings(_methods, "path")


def measure(
    scene: opt.Scene,
    points: Annotated[
        Path | None,
        typer.Option(
            "--points",
            "-p",
            help="Meters: a file with a line x,y,z,nx,ny,nz for each; commas, semicolons or blanks between numbers.",
            metavar="FILE",
        ),
    ] = None,
    grid: Annotated[
        str | None,
        typer.Option(
            "--grid",
            help="Meters on a plane: a corner and two edges of a parallelogram, as '0,0,0.85 4,0,0 0,3,0'; they face "
            "the first edge times the second.",
            metavar="'CORNER U V'",
        ),
    ] = None,
    cells: Annotated[
        opt.Size | None,
        typer.Option("--cells", help="Meters of the grid along its edges.", parser=opt.parse_size, metavar="NxM"),
    ] = None,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "-o",
            "--output",
            help=".csv, or of a grid .png (false colours and isolines); repeatable. By default SCENE-meters.csv.",
            metavar="FILE",
        ),
    ] = None,
    colour_range: opt.ColourRange = None,
    photometric: Annotated[
        bool, typer.Option("--photometric", help="In lx or cd/m^2 (683 lm/W), not in watts of red, green and blue.")
    ] = False,
    radiance: Annotated[
        bool, typer.Option("--radiance", help="Radiance from the direction of each meter, not irradiance on it.")
    ] = False,
    method: Annotated[str, typer.Option("--method", "-m", help="path, guided or bpt.", metavar="NAME")] = "path",
    time: opt.Time = None,
    spp: Annotated[
        int | None, typer.Option("--spp", help="Stop at this many paths of each meter.", metavar="N")
    ] = None,
    error: opt.Error = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    define: opt.Define = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    memory: opt.Memory = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Measure irradiance or radiance at points of a scene, with standard errors.

    Stops at the first of --time, --spp and --error that is reached; without any, after 4096 paths of each meter. The
    scene needs no camera. Ctrl-C stops after the current pass and writes the table.
    """
    from etendue.engine import Job, Task
    from etendue.products import MeterTable, budget_of, choose_method, start_job
    from etendue.scene import SceneSource, locate

    from .running import choose_device, default_name, follow

    meters = _meters(points, grid, cells, "radiance" if radiance else "irradiance")
    settings, parameters = settings_in(define), opt.parse_pairs(param, "-P")
    limits = opt.limits(time, error, spp=spp)
    notes: list[str] = []
    found = locate(scene, notes.append)
    tables = output or [Path(f"{default_name(found)}-meters.csv")]
    product = MeterTable.of(meters, tuple(tables), photometric, scale=colour_range or (None, None))
    choose_device(variant, threads, scene=found)
    kind = choose_method(method, found, parameters)
    source = SceneSource(found, parameters=parameters, memory=memory, meters=meters)
    task = Task(source, kind, product, settings, seed, budget_of(kind, limits))
    console = error_console()

    def open_job() -> Job:
        job = Job.open(task)
        for text in notes:
            note(console, text)
        return job

    with opt.Device(variant, threads, cluster, workers).opened() as opened:
        outcome = follow(lambda: start_job(open_job, None, opened), console, kind.name)
    if outcome.result is not None:
        note(console, outcome.result.summary(photometric))
        say("\n".join(map(str, product.files)))
    return outcome.exit_code


def _meters(points: Path | None, grid: str | None, cells: opt.Size | None, quantity: Any) -> Meters:
    """The meters of the options. Raises :class:`OptionError`."""
    from etendue.lighting import Meters

    if (points is None) == (grid is None):
        raise OptionError("meters are in a file or on a grid; give --points FILE, or --grid with --cells")
    if points is not None:
        if cells is not None:
            raise OptionError("--cells are those of a grid; give --grid, or leave it out")
        return Meters.read(points, quantity)
    try:
        corner, u, v = (tuple(map(float, part.split(","))) for part in re.split(r"[;\s]+", str(grid).strip()))
    except ValueError:
        raise OptionError(f"--grid is a corner and two edges, as '0,0,0.85 4,0,0 0,3,0', not '{grid}'") from None
    if cells is None:
        raise OptionError("a grid needs its numbers of meters; give --cells, as 40x30")
    return Meters.grid(corner, u, v, cells, quantity)
