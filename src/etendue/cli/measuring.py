"""The commands that measure light at points, and what the sky contributes there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from etendue.core import OptionError

from . import options as opt
from .console import error_console, note, say
from .patches import (
    Bundles,
    Ids,
    MaxArea,
    More,
    Obstacles,
    Orient,
    Reflectance,
    TwoSided,
    ZoneName,
    mesh_arguments,
    quantity,
)
from .settings import settings_in, with_settings

if TYPE_CHECKING:
    from etendue.engine import Checkpoint, Job, Task
    from etendue.lighting import Meters


def _methods() -> dict[str, Any]:
    from etendue import methods

    return {name: kind.Settings for name, kind in methods.table().items() if kind.measures}


def _of_the_sky() -> dict[str, Any]:
    from etendue.methods import SkySettings

    return {"daylight": SkySettings}


def _cells(text: str) -> opt.Size:
    """The meters of a grid along its edges. Raises :class:`OptionError`."""
    found = re.fullmatch(r"\s*(\d+)\s*[x,]\s*(\d+)\s*", str(text).lower())
    if found is None or "0" in found.groups():
        raise OptionError(f"--cells needs the meters along both edges, as 40x30, not '{text}'")
    return opt.Size(int(found[1]), int(found[2]))


#: The commands with the settings of the methods that measure, and of daylight.
MeasureCommand = with_settings(_methods, "path")
DaylightCommand = with_settings(_of_the_sky, "daylight")

Points = Annotated[
    Path | None,
    typer.Option(
        "--points",
        "-p",
        help="Meters: a file with a line x,y,z,nx,ny,nz for each; commas, semicolons or blanks between numbers.",
        metavar="FILE",
    ),
]
Grid = Annotated[
    str | None,
    typer.Option(
        "--grid",
        help="Meters on a plane: a corner and two edges of a parallelogram, as '0,0,0.85 4,0,0 0,3,0'; they face "
        "the first edge times the second.",
        metavar="'CORNER U V'",
    ),
]
Cells = Annotated[
    opt.Size | None,
    typer.Option("--cells", help="Meters of the grid along its edges.", parser=_cells, metavar="NxM"),
]
PathsOfMeters = Annotated[int | None, typer.Option("--spp", help="Stop at so many paths of each meter.", metavar="N")]


def measure(
    scene: opt.Scene,
    points: Points = None,
    grid: Grid = None,
    cells: Cells = None,
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
    quantity: Annotated[
        str,
        typer.Option(
            "--quantity",
            help="irradiance on a plane, radiance from the direction of each meter, or mean cylindrical or spherical "
            "irradiance around it.",
            metavar="NAME",
        ),
    ] = "irradiance",
    method: Annotated[str, typer.Option("--method", "-m", help="path, guided or bpt.", metavar="NAME")] = "path",
    time: opt.Time = None,
    spp: PathsOfMeters = None,
    error: opt.Error = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    define: opt.Define = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    memory: opt.Memory = None,
    checkpoint: Annotated[
        Path | None, typer.Option(help="Checkpoint for `etendue resume`; none by default.", metavar="FILE")
    ] = None,
    save_every: opt.SaveEvery = 60.0,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Measure irradiance or radiance at points of a scene, with standard errors.

    Stops at the first of --time, --spp and --error that is reached; without any, after 4096 paths of each meter. The
    scene needs no camera. Ctrl-C stops after the current pass and writes the table.
    """
    from etendue.engine import Job, Task
    from etendue.products import MeterTable, budget_of, choose_method
    from etendue.scene import SceneSource, locate

    from .running import choose_device, default_name

    meters = meters_of(points, grid, cells, quantity)
    settings, parameters = settings_in(define), opt.parse_pairs(param, "-P")
    limits = opt.limits(time, error, spp=spp)
    notes: list[str] = []
    found = locate(scene, notes.append)
    tables = output or [Path(f"{default_name(found)}-meters.csv")]
    product = MeterTable.of(meters, tables, photometric, save_every, colour_range or (None, None), checkpoint)
    choose_device(variant, threads, scene=found)
    kind = choose_method(method, found, parameters)
    source = SceneSource(found, parameters=parameters, memory=memory, meters=meters)
    task = Task(source, kind, product, settings, seed, budget_of(kind, limits))

    def open_job() -> Job:
        job = Job.open(task)
        for text in notes:
            note(error_console(), text)
        return job

    return _measured(task, opt.Device(variant, threads, cluster, workers), open_job)


def resume_measuring(task: Task, device: opt.Device, saved: Checkpoint) -> int:
    """Continue a run of ``measure``. Returns the exit status."""
    from etendue.engine import Job

    from .running import choose_device

    choose_device(device.variant, device.threads, colours=saved.colours)
    return _measured(task, device, lambda: Job.resume(saved, task))


def _measured(task: Task, device: opt.Device, open_job: Callable[[], Job]) -> int:
    """Measure, and print the names of the files. Returns the exit status."""
    from etendue.products import MeterTable, start_job

    from .running import follow

    product, console = task.product, error_console()
    assert isinstance(product, MeterTable)
    with device.opened() as opened:
        outcome = follow(lambda: start_job(open_job, None, opened), console, task.method.name)
    if outcome.result is not None:
        note(console, outcome.result.summary(product.photometric))
        say("\n".join(map(str, product.files)))
    return outcome.exit_code


def daylight(
    scene: opt.Scene,
    points: Points = None,
    grid: Grid = None,
    cells: Cells = None,
    surfaces: Annotated[
        bool,
        typer.Option(
            "--surfaces",
            help="Of all faces of a mesh or scene in place of points, by lines and radiosity; all are diffuse.",
        ),
    ] = False,
    weather: Annotated[
        Path | None, typer.Option("--epw", help="Weather of a year, for the metrics of the year.", metavar="FILE")
    ] = None,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="Coefficients for Radiance (.mtx), all arrays (.npz), or with --epw the metrics of each meter (.csv); "
            "give it again for more.",
            metavar="FILE",
        ),
    ] = None,
    time: opt.Time = None,
    spp: PathsOfMeters = None,
    error: opt.Error = None,
    bundles: Bundles = None,
    max_area: MaxArea = None,
    reflectance: Reflectance = None,
    ids: Ids = None,
    two_sided: TwoSided = False,
    more: More = None,
    obstacles: Obstacles = None,
    orient: Orient = None,
    zone: ZoneName = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    define: opt.Define = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Compute daylight coefficients of points, or of --surfaces: what each patch of the sky contributes, and from
    weather the daylight of a year.

    Stops at the first of --time, --spp (--bundles, of surfaces) and --error that is reached; without any, after 65536
    paths of each meter, or 16 to 32 bundles for each patch of the sky. The scene needs neither camera nor lamp.
    """
    from etendue.engine import Job, Task
    from etendue.lighting import read_epw
    from etendue.methods import SkyTracing
    from etendue.products import Daylight, budget_of, start_job
    from etendue.products.patches import daylight_run
    from etendue.scene import SceneSource, locate

    from .lines import run_on_patches
    from .running import choose_device, default_name, follow

    settings, parameters = settings_in(define), opt.parse_pairs(param, "-P")
    limits = opt.limits(time, error, spp=spp, bundles=bundles)
    mesh = mesh_arguments(ids, two_sided, orient, more, obstacles, zone, reflectance=quantity(reflectance))
    if surfaces:
        if not (points is None and grid is None and cells is None):
            raise OptionError("--surfaces are in place of --points and --grid; give one of them")
        suffix = ".mtx" if weather is None else ".csv"
        asked = {"source": scene, "max_area": max_area, "mesh": mesh, "parameters": parameters, "seed": seed}
        files = tuple(output or [Path(f"{Path(scene).stem}-daylight{suffix}")])
        run = daylight_run(settings, limits=limits, weather=weather, outputs=files, **asked)
        return run_on_patches(run.task(), opt.Device(variant, threads, cluster, workers))
    for name, value in {"max_area": max_area, **mesh}.items():
        if value not in (None, False):
            raise OptionError(f"--{name.replace('_', '-')} is for --surfaces; leave it out")
    meters = meters_of(points, grid, cells, "irradiance")
    console = error_console()
    found = locate(scene, lambda text: note(console, text))
    year = None if weather is None else read_epw(weather)
    suffix = ".mtx" if year is None else ".csv"
    product = Daylight.of(meters, year, output or [Path(f"{default_name(found)}-daylight{suffix}")])
    choose_device(variant, threads)
    source = SceneSource(found, parameters=parameters, meters=meters, lit=False)
    task = Task(source, SkyTracing, product, settings, seed, budget_of(SkyTracing, limits))
    with opt.Device(variant, threads, cluster, workers).opened() as opened:
        outcome = follow(lambda: start_job(lambda: Job.open(task), None, opened), console, "daylight")
    if outcome.result is not None:
        note(console, outcome.result.summary())
        say("\n".join(map(str, product.files)))
    return outcome.exit_code


def meters_of(points: Path | None, grid: str | None, cells: opt.Size | None, quantity: Any) -> Meters:
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
