"""The command `etendue`. Every error of a user is one line on standard error with a non-zero exit status.

Mitsuba, NumPy and the rest of étendue are imported inside the commands: `etendue --help` is immediate.
"""

from __future__ import annotations

import logging
import sys
import traceback
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import EtendueError, OptionError, describe, logger

from . import options as opt
from .boxes import HIERARCHY, resume_hierarchy
from .console import ConsoleHandler, error_console, note, print_error, remember_arguments, say
from .developing import develop
from .film_picture import film_picture
from .inspection.viewing import view
from .interrupts import leaving
from .particle_maps import app as particles
from .particles import resume_particles
from .pictures import compare, demo, render, run
from .radiosity import LINES, form_factors, radiosity, resume_lines
from .radiosity_options import OptionalName

app = typer.Typer(
    name="etendue",
    help="Global illumination for Mitsuba 3 scenes: path, light and bidirectional path tracing, VCM.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# The base class of typer's usage errors; its module depends on the version of typer.
_UsageError: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")

#: The exit status that typer gives to a command that was left by KeyboardInterrupt.
_LEFT = 130


@cache
def _command() -> Any:
    """The commands as click has them, made once: typer makes them anew at each call of ``app``."""
    return typer.main.get_command(app)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; ``arguments`` are those of the process by default. Returns the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    remember_arguments(words)
    debug = "--debug" in words  # read here, since it also applies to errors in other options
    handler = ConsoleHandler(error_console(), logging.DEBUG if debug else logging.WARNING)
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if debug else logging.WARNING)
    interrupts = leaving()
    try:
        with interrupts:
            status = int(_command().main(words, prog_name="etendue", standalone_mode=False) or 0)
        return (interrupts.exit_code or _LEFT) if status == _LEFT else status
    except (Exception, KeyboardInterrupt) as error:
        # After a signal, any error is its consequence: compiled code turns KeyboardInterrupt into others.
        return interrupts.exit_code or _reported(error, debug)
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def _reported(error: BaseException, debug: bool) -> int:
    """Print an error in one line; returns the exit status."""
    if isinstance(error, (typer.Abort, KeyboardInterrupt)):
        return _LEFT
    if isinstance(error, BrokenPipeError):
        return 141
    if debug:
        traceback.print_exc()
    if isinstance(error, (EtendueError, _UsageError)):
        text = error.format_message() if hasattr(error, "format_message") else str(error)
        # Without arguments typer raises with the help text, already printed, or without a message.
        if text.strip():
            print_error(text)
        return int(getattr(error, "exit_code", 1))
    print_error(f"{describe(error)} (unexpected; --debug shows where, please report it)")
    return 70


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        names = ("etendue", "mitsuba", "drjit")
        say(", ".join(f"{name} {metadata.version(name)}" for name in names))
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Show versions and exit.", callback=_show_version, is_eager=True)
    ] = False,
    debug: opt.Debug = False,
) -> None:
    """Options of the command itself."""


app.command()(render)


@app.command()
def resume(
    checkpoint: Annotated[
        Path,
        typer.Argument(help="File that a rendering, radiosity or particle command wrote.", metavar="CHECKPOINT"),
    ],
    output: opt.Output = None,
    method: Annotated[
        str | None, typer.Option("--method", "-m", help="Not needed; must be that of the checkpoint.", metavar="NAME")
    ] = None,
    define: Annotated[
        list[str] | None,
        typer.Option("-D", "--define", help="Not needed; must be as in the checkpoint.", metavar="NAME=VALUE"),
    ] = None,
    scene: Annotated[str | None, typer.Option(help="New path of the scene, if it has moved.", metavar="SCENE")] = None,
    time: opt.Time = None,
    spp: opt.Spp = None,
    error: opt.Error = None,
    bundles: Annotated[
        int | None, typer.Option(help="For radiosity: stop at this many bundles of lines.", min=1, metavar="N")
    ] = None,
    points: Annotated[
        int | None, typer.Option(help="For multipath: stop at this many lines.", min=1, metavar="N")
    ] = None,
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
    """Continue an interrupted or finished render; the checkpoint is updated.

    --time is additional time, --spp and --error are limits of the whole picture. Without them the rest of the
    interrupted budget is used. Without -o the pictures with that name beside the checkpoint are updated, .exr and .png
    (if there are none, an .exr is written); for a run file, the remaining saves, log and table continue.
    """
    from etendue import methods
    from etendue.engine import Checkpoint, Job, remaining
    from etendue.jobs import Outputs
    from etendue.particles import is_particle_file

    from .experiments.records import Recorder, run_of
    from .rendering import choose_device, render_to_files

    budget = opt.budget(time, spp, error)
    if is_particle_file(checkpoint):
        if (spp, error, bundles, points, output, method, define) != (None,) * 7:
            raise OptionError(f"{checkpoint} has particles: only --paths, --particles, --time and --scene apply")
        device = opt.Device(variant, threads, cluster, workers)
        return resume_particles(checkpoint, scene, paths, particles, time, device)
    if (paths, particles) != (None, None):
        raise OptionError(f"{checkpoint} is no file of particles: --paths and --particles do not apply")
    device = opt.Device(variant, threads, cluster, workers)
    saved = Checkpoint.read(checkpoint)
    if saved.method in LINES:
        if (spp, method, define) != (None, None, None):
            raise OptionError(f"{checkpoint} is a checkpoint of radiosity: --spp, -m and -D do not apply")
        limits = {"bundles": bundles, "points": points, "seconds": time, "error": error}
        return resume_lines(saved, checkpoint, output or [], scene, limits, save_every, device)
    if saved.method == HIERARCHY:
        if (spp, points, method, define) != (None, None, None, None):
            raise OptionError(f"{checkpoint} has passes of lines: --spp, --points, -m and -D do not apply")
        asked = {"source": scene, "bundles": bundles, "seconds": time, "error": error, "save_every": save_every}
        return resume_hierarchy(saved, checkpoint, output or [], device, **asked)
    if (bundles, points) != (None, None):
        raise OptionError(f"{checkpoint} is a checkpoint of a picture: --bundles and --points do not apply")
    kind = methods.get(saved.method if method is None else method)
    saved.settings_of(kind, opt.parse_pairs(define, "-D"))
    rest = partial(remaining, saved, "--time, --spp or --error")
    file = run_of(saved, checkpoint) if output is None else None
    if file is not None:
        console = error_console()
        recorder = Recorder(file, lambda text: note(console, text))
        choose_device(variant or file.variant, threads or file.threads)

        def open_job() -> Job:
            job = Job.resume(saved, kind, budget=budget or rest(), scene=scene)
            recorder.check(job)
            return job

        with recorder, device.opened() as opened:
            return render_to_files(open_job, recorder, saved.method, opened, recorder.watch)
    beside = [checkpoint.with_suffix(suffix) for suffix in (".exr", ".png")]
    outputs = Outputs.of(
        output or [p for p in beside if p.exists()] or beside[:1], checkpoint, save_every, False, tone, exposure
    )
    choose_device(variant, threads)
    with device.opened() as opened:
        return render_to_files(
            lambda: Job.resume(saved, kind, budget=budget or rest(), scene=scene), outputs, saved.method, opened
        )


app.command()(film_picture)
app.command()(run)
app.command()(compare)
app.command()(demo)
app.command()(develop)
app.command()(view)


@app.command()
def methods(
    name: Annotated[str | None, typer.Argument(help="Show the manual page of this method.", metavar="[NAME]")] = None,
    debug: opt.Debug = False,
) -> int:
    """List the methods, or show one's manual page with its settings."""
    from .inspection.listings import show_method, show_methods

    return show_method(name) if name else show_methods()


@app.command()
def scenes(debug: opt.Debug = False) -> int:
    """List the bundled scenes."""
    from .inspection.listings import show_scenes

    return show_scenes()


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


app.command(cls=OptionalName)(form_factors)
app.command(cls=OptionalName)(radiosity)
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
    sensor: opt.Sensor = 0,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Test the materials, lights, sensors and ray casting of a scene, and report what is implausible.

    Exit status 1 if something fails.
    """
    from etendue.scene import locate

    from .inspection.check import show_check
    from .rendering import choose_device

    parameters = opt.parse_pairs(param, "-P")
    found = locate(scene, lambda text: note(error_console(), text))
    choose_device(variant, threads)
    return show_check(found, quick=quick, sensor=sensor, seed=seed, parameters=parameters, as_json=json)


@app.command()
def doctor(debug: opt.Debug = False) -> int:
    """Report what is installed, what is wrong and how to fix it."""
    from rich.console import Console

    from .inspection.doctor import run_doctor

    return run_doctor(Console())


if __name__ == "__main__":
    sys.exit(main())
