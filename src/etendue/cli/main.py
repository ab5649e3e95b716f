"""The command `etendue`. Every error of a user is one line on standard error with a non-zero exit status.

What only some commands need is imported inside them, Mitsuba's variants above all.
"""

from __future__ import annotations

import atexit
import gc
import logging
import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import VERSION, EtendueError, OptionError, describe, logger

from . import options as opt
from .console import (
    ConsoleHandler,
    be_quiet,
    error_console,
    note,
    output_console,
    print_error,
    remember_arguments,
    say,
    warning_console,
)
from .developing import develop
from .faults import remember_fault
from .film_picture import film_picture
from .heating import heat
from .inspection.viewing import view
from .interrupts import leaving
from .joining import join_factors
from .measuring import DaylightCommand, MeasureCommand, daylight, measure
from .particle_maps import app as particles
from .patches import FactorCommand, Orient, SolutionCommand, form_factors, radiosity
from .pictures import PictureCommand, compare, demo, render, run
from .sensors import point_factors
from .sunshine import sunlight

app = typer.Typer(
    name="etendue",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# The base class of typer's usage errors; its module depends on the version of typer.
_UsageError: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")

#: The exit status that typer gives to a command that was left by KeyboardInterrupt.
_LEFT = 130


@cache
def _command(name: str = "") -> Any:
    """The command of this name inside `etendue` as click has it, or all if there is none: to make all takes 0.1 s."""
    chosen = copy(app)
    if name:
        chosen.registered_commands = [info for info in app.registered_commands if _name(info) == name]
        chosen.registered_groups = [info for info in app.registered_groups if info.name == name]
        if not (chosen.registered_commands or chosen.registered_groups):
            return _command()
    made = typer.main.get_command(chosen)
    _without_types(made)
    return made


def _name(info: Any) -> str:
    """The name that typer gives to a command."""
    return info.name or typer.main.get_command_name(info.callback.__name__)


def _without_types(command: Any, parent: Any = None) -> None:
    """Show flags without ``<bool>`` in the help of a command and of those in it."""
    context = command.context_class(
        command, parent=parent, **command.context_settings
    )  # without parsing, which is slow
    for parameter in command.get_params(context):
        if getattr(parameter, "is_flag", False):
            parameter.metavar = ""
    for inner in getattr(command, "commands", {}).values():
        _without_types(inner, context)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; ``arguments`` are those of the process by default. Returns the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    remember_arguments(words)
    be_quiet(False)
    debug = "--debug" in words  # read here, since it also applies to errors in other options
    handler = ConsoleHandler(warning_console(), logging.DEBUG if debug else logging.WARNING)
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if debug else logging.WARNING)
    interrupts = leaving()
    try:
        with interrupts:
            name = next((word for word in words if not word.startswith("-")), "")
            status = int(_command(name).main(words, prog_name="etendue", standalone_mode=False) or 0)
        return (interrupts.exit_code or _LEFT) if status == _LEFT else status
    except (Exception, KeyboardInterrupt) as error:
        # After a signal, any error is its consequence: compiled code turns KeyboardInterrupt into others.
        return interrupts.exit_code or _reported(error, debug, words)
    except SystemExit as end:  # of Rich, which prints the help: at a pipe without reader
        if isinstance(end.__context__, BrokenPipeError):
            return 141
        raise
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def command() -> None:
    """The command of the shell: :func:`main`, and the end of the process."""
    gc.set_threshold(10_000, 20, 20)  # imports make many objects and no cycles
    status = main()
    # Freeing a scene and its kernels takes longer than some commands.
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # the reader of a pipe is gone
            stream.flush()
    os._exit(status)


def _reported(error: BaseException, debug: bool, words: Sequence[str]) -> int:
    """Print an error of the command ``words`` in one line and keep it for `doctor`; returns the exit status."""
    if isinstance(error, (typer.Abort, KeyboardInterrupt)):
        return _LEFT
    if isinstance(error, BrokenPipeError):
        return 141
    if debug:
        traceback.print_exc()
    if isinstance(error, (EtendueError, _UsageError)):
        text = error.format_message() if hasattr(error, "format_message") else str(error)
        # Without arguments typer raises with the help text, already printed, or without a message.
        status = int(getattr(error, "exit_code", 1))
        if not text.strip():
            return status
    else:
        text, status = f"{describe(error)} (unexpected; --debug shows where, please report it)", 70
    print_error(text)
    if "doctor" not in words:
        remember_fault(words, text, status, error if debug else None)
    return status


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        others = (f"{name} {metadata.version(name)}" for name in ("mitsuba", "drjit"))
        say(", ".join([f"etendue {VERSION}", *others]))
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Show versions and exit.", callback=_show_version, is_eager=True)
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print only the paths of files, warnings and errors.")
    ] = False,
    debug: opt.Debug = False,
) -> None:
    """Global illumination for Mitsuba 3 scenes: pictures, form factors, radiosity, particles.

    Exit status: 0 done; 1 `check` or `diff --limit` has found faults; an error in 2 options, 3 the scene, 4 a
    checkpoint, 5 an output, 6 what is installed, 7 a cluster; 8 the power of a solution is not balanced; 70 an
    unexpected error; 130 and 143 ended by Ctrl-C or SIGTERM, with what was done written; 141 the reader of a pipe is
    gone.
    """
    be_quiet(quiet)


app.command(cls=PictureCommand)(render)
app.command(cls=MeasureCommand)(measure)
app.command(cls=DaylightCommand)(daylight)


@app.command()
def resume(
    checkpoint: Annotated[
        Path,
        typer.Argument(help="Checkpoint or file of particles that another command wrote.", metavar="CHECKPOINT"),
    ],
    output: opt.Output = None,
    scene: Annotated[str | None, typer.Option(help="New path of the scene, if it has moved.", metavar="SCENE")] = None,
    time: opt.Time = None,
    error: opt.Error = None,
    spp: opt.Spp = None,
    bundles: Annotated[
        int | None, typer.Option(help="For lines and spheres: stop at this many bundles.", min=1, metavar="N")
    ] = None,
    points: Annotated[
        int | None, typer.Option(help="For multipath: stop at this many lines.", min=1, metavar="N")
    ] = None,
    passes: Annotated[int | None, typer.Option(help="For boxes: stop at this many passes.", min=1, metavar="N")] = None,
    paths: Annotated[
        int | None, typer.Option(help="For particles: stop at this many light paths.", min=1, metavar="N")
    ] = None,
    particles: Annotated[
        int | None, typer.Option(help="For particles: stop at about so many.", min=1, metavar="N")
    ] = None,
    variant: opt.Variant = None,
    threads: opt.Threads = None,
    save_every: opt.SaveEvery = 60.0,
    tone: opt.Tone = "srgb",
    exposure: opt.Exposure = "auto",
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Continue an interrupted or finished run of any kind; its file is updated.

    --time is additional time, other limits are those of the whole. Without them the rest of the interrupted budget is
    used. Without -o the files of the run are written again: pictures with the checkpoint's name beside it, .exr and
    .png (if there are none, an .exr is written); for a run file, the remaining saves, log and table continue.
    """
    from contextlib import ExitStack
    from dataclasses import replace

    from etendue.engine import Job
    from etendue.products import MeterTable, Picture, saved_task

    from .experiments.records import Recorder, run_of
    from .running import choose_device, render_to_files

    counts = {"spp": spp, "bundles": bundles, "points": points, "passes": passes, "paths": paths}
    limits = opt.limits(time, error, **counts, particles=particles)
    options: Any = {"save_every": save_every, "tone": tone, "exposure": exposure}
    task, saved = saved_task(checkpoint, scene=scene, limits=limits, save=output or (), **options)
    device = opt.Device(variant, threads, cluster, workers)
    if task.product.kind == "particles":
        from .particles import trace_to_file

        return trace_to_file(task, device, saved)
    if task.product.kind == MeterTable.kind:
        from .measuring import resume_measuring

        return resume_measuring(task, device, saved)
    if task.product.kind != Picture.kind:
        from .lines import run_on_patches

        return run_on_patches(task, device, saved)
    product, callback = task.product, None
    assert isinstance(product, Picture)
    with ExitStack() as stack:
        if output is None and (file := run_of(saved, checkpoint)) is not None:
            console = error_console()
            product = recorder = stack.enter_context(Recorder(file, lambda text: note(console, text)))
            callback = recorder.watch
            variant, threads = variant or file.variant, threads or file.threads
        elif output is None:
            beside = [checkpoint.with_suffix(suffix) for suffix in (".exr", ".png")]
            product = replace(product, pictures=tuple([p for p in beside if p.exists()] or beside[:1]))
        choose_device(variant, threads, colours=saved.colours)
        opened, task = stack.enter_context(device.opened()), replace(task, product=product)
        return render_to_files(lambda: Job.resume(saved, task), product, saved.method, opened, callback)


app.command()(film_picture)
app.command()(run)
app.command(cls=PictureCommand)(compare)
app.command()(demo)
app.command()(develop)
app.command(cls=PictureCommand)(view)


@app.command()
def methods(
    name: Annotated[str | None, typer.Argument(help="Show the manual page of this method.", metavar="[NAME]")] = None,
    debug: opt.Debug = False,
) -> int:
    """List the methods, or show one's manual page with its settings."""
    from .inspection.listings import show_method, show_methods

    return show_method(name) if name else show_methods()


@app.command()
def scenes(
    name: Annotated[str | None, typer.Argument(help="A bundled scene, to be written.", metavar="[NAME]")] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Mitsuba XML; meshes and textures go into a folder.", metavar="FILE.xml"),
    ] = None,
    debug: opt.Debug = False,
) -> int:
    """List the bundled scenes, or write one as XML for Mitsuba."""
    from .inspection.listings import show_scenes, write_scene

    if name is None:
        if output is not None:
            raise OptionError("-o writes a scene: name it")
        return show_scenes()
    return write_scene(name, output or Path(f"{name}.xml"))


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="Picture, checkpoint, particles, solution or factors.", metavar="FILE")],
    json: Annotated[bool, typer.Option("--json", help="Write all of it as JSON to standard output.")] = False,
    debug: opt.Debug = False,
) -> int:
    """Show what is in a file: layers and how a picture was made, a checkpoint, particles on each shape."""
    from .inspection.files import show_info

    return show_info(file, json)


@app.command()
def diff(
    picture: Annotated[Path, typer.Argument(metavar="PICTURE")],
    reference: Annotated[Path, typer.Argument(metavar="REFERENCE")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Relative errors in false colours.", metavar="FILE.png")
    ] = None,
    limit: Annotated[
        float | None, typer.Option("--limit", help="Exit status 1 if relMSE is above this.", metavar="X")
    ] = None,
    debug: opt.Debug = False,
) -> int:
    """Show how far a picture is from a reference: relMSE, FLIP, luminance, bias."""
    from .inspection.files import show_difference

    return show_difference(picture, reference, output, limit)


@app.command()
def glare(
    picture: Annotated[Path, typer.Argument(help="A rendering from the position of the eye.", metavar="PICTURE.exr")],
    view: Annotated[
        str | None,
        typer.Option(
            "--view", help="The sensor of the picture: spherical or perspective; by default its own.", metavar="NAME"
        ),
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option("--fov", help="With --view, its field of view; spherical: of longitude, 360.", metavar="DEGREES"),
    ] = None,
    fov_axis: Annotated[
        str,
        typer.Option("--fov-axis", help="Of a perspective picture: x, width, or y, height.", metavar="NAME"),
    ] = "x",
    illuminance: Annotated[
        float | None,
        typer.Option("--ev", help="Vertical illuminance at the eye; by default that of the picture.", metavar="LUX"),
    ] = None,
    threshold: Annotated[
        str,
        typer.Option(
            "--threshold", help="Luminance above which pixels are sources: in cd/m^2, or 5x the mean.", metavar="L"
        ),
    ] = "2000",
    low_light: Annotated[bool, typer.Option("--low-light", help="Correct DGP below 400 lx.")] = False,
    debug: opt.Debug = False,
) -> int:
    """Compute discomfort glare of a picture: UGR, DGP and the sources.

    The eye looks at the middle of the picture.
    """
    from etendue.lighting import View

    from .inspection.glare import show_glare

    wanted: Any = {"projection": view, "fov": fov, "fov_axis": fov_axis}
    if view is None and fov is not None:
        raise OptionError("--fov is that of a --view; give both, or none if the picture tells its camera")
    return show_glare(picture, None if view is None else View(**wanted), illuminance, threshold, low_light)


@app.command()
def points(
    name: Annotated[
        str | None, typer.Argument(help="A point set, or NAME+shift; without it, all are listed.", metavar="[NAME]")
    ] = None,
    count: Annotated[
        int | None, typer.Option("-n", help="Points; 16, or 1024 for --plot and --measure.", min=1, metavar="N")
    ] = None,
    dimension: Annotated[int | None, typer.Option("-d", help="Dimension; 2.", min=1, metavar="D")] = None,
    first: Annotated[int, typer.Option("--first", help="Index of the first point.", min=0, metavar="I")] = 0,
    seed: Annotated[int, typer.Option("--seed", help="Seed of random sets.", metavar="N")] = 0,
    measure: Annotated[bool, typer.Option("--measure", help="Show star and L2 discrepancies.")] = False,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw projections.", metavar="FILE.svg")] = None,
    pair: Annotated[
        list[str] | None, typer.Option("--pair", help="Dimensions to draw, repeatable; 0,1.", metavar="A,B")
    ] = None,
    debug: opt.Debug = False,
) -> int:
    """List point sets and sequences, or write points as CSV, measure their discrepancy, draw projections."""
    from .inspection.points import show_point_sets, show_points

    if name is None:
        return show_point_sets()
    return show_points(
        name, count=count, dimension=dimension, first=first, seed=seed, measure=measure, plot=plot, pairs=pair or []
    )


app.command(cls=FactorCommand)(form_factors)
app.command()(join_factors)
app.command(cls=SolutionCommand)(radiosity)
app.command()(point_factors)
app.command()(sunlight)
app.command()(heat)
app.add_typer(particles, name="particles")


@app.command()
def cite(
    method: Annotated[list[str], typer.Argument(help="Methods.", metavar="METHOD...")], debug: opt.Debug = False
) -> int:
    """Print the papers that a method implements, as BibTeX."""
    from .inspection.listings import show_citations

    return show_citations(method)


@app.command()
def check(
    scene: opt.Scene,
    json: Annotated[bool, typer.Option("--json", help="Write all findings as JSON to standard output.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer samples; may miss small faults.")] = False,
    orient: Orient = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="Write the mesh as it is tested: .obj, .stl (groups), .ply, .vtu.", metavar="FILE"
        ),
    ] = None,
    sensor: opt.Sensor = 0,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Test the materials, lights, sensors and ray casting of a scene, or the faces of a mesh, and report what is wrong.

    Exit status 1 if something fails.
    """
    from etendue.scene import locate
    from etendue.surfaces import is_mesh_file

    from .inspection.check import show_check
    from .running import choose_device

    parameters = opt.parse_pairs(param, "-P")
    found: Any = Path(scene)
    if is_mesh_file(found):
        choose_device(variant, threads)
    else:
        found = locate(scene, lambda text: note(error_console(), text))
        choose_device(variant, threads, scene=found)
    return show_check(
        found,
        quick=quick,
        as_json=json,
        sensor=sensor,
        seed=seed,
        parameters=parameters,
        orient=orient,
        save=output,
    )


@app.command()
def doctor(
    report: Annotated[
        bool, typer.Option("--report", help="One text for a report of a fault, without names of your folders.")
    ] = False,
    debug: opt.Debug = False,
) -> int:
    """Report what is installed, what is wrong and how to fix it."""
    from .inspection.doctor import run_doctor

    return run_doctor(output_console(), report)


if __name__ == "__main__":
    sys.exit(main())
