"""`etendue particles`: tracing of particles into files, and what one can do with these files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from etendue.core import OptionError, format_seconds

from . import options as opt
from .console import error_console, note, say
from .settings import settings_in, with_settings

if TYPE_CHECKING:
    from etendue.engine import Checkpoint, Task
    from etendue.products.particles import ParticleResult

app = typer.Typer(
    help="Trace particles, the hits of light paths on surfaces, into files; pack these files, and make maps of them.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

CodecName = Annotated[
    str,
    typer.Option(
        "--codec",
        help="raw, exact (no loss), packed (bounded loss) or packed-no-paths; with +fast, +zlib, +bz2, +lzma, +zstd, "
        "+lz4, +blosc2, +rle or +none: the coder.",
        metavar="NAME",
    ),
]

NewFile = Annotated[list[Path], typer.Option("-o", "--output", help="New file of particles.", metavar="FILE")]


def _methods() -> dict[str, Any]:
    from etendue.products import PARTICLES, find

    return {name: find(name).Settings for name in PARTICLES}


@app.command(cls=with_settings(_methods, "particles"))
def trace(
    scene: opt.Scene,
    output: NewFile,
    paths: Annotated[
        int | None, typer.Option("--paths", help="Light paths; 1000000 if no budget is given.", min=1, metavar="N")
    ] = None,
    particles: Annotated[
        int | None, typer.Option("--particles", help="About so many particles.", min=1, metavar="N")
    ] = None,
    time: opt.Time = None,
    codec: CodecName = "packed",
    method: Annotated[
        str,
        typer.Option("--method", "-m", help="particles (independent paths) or metropolis_particles.", metavar="NAME"),
    ] = "particles",
    define: opt.Define = None,
    param: opt.Param = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    memory: opt.Memory = None,
    threads: opt.Threads = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    boxes: Annotated[
        str | None,
        typer.Option(
            "--boxes",
            help="With workers: cut the scene into boxes along x, y and z, of which a worker loads one at a time.",
            metavar="NxNxN",
        ),
    ] = None,
    debug: opt.Debug = False,
) -> int:
    """Trace light paths, and write their hits on surfaces to a file while tracing.

    Stops at the first of --paths, --particles and --time that is reached, or by Ctrl-C; the file then has all whole
    passes, and `etendue resume FILE` goes on.
    """
    from etendue.engine import Task
    from etendue.products import PARTICLES, budget_of, chosen
    from etendue.products.particles import ParticleProduct
    from etendue.scene import SceneSource, locate

    file, kind = opt.only_one(output), chosen(method, PARTICLES, "particles")
    cut = _boxes(boxes, (cluster, workers) != (None, None))
    if paths is not None and particles is not None:
        raise OptionError("--paths and --particles limit the same; give one of them")
    product = ParticleProduct(file, particles, codec, cut)
    found = locate(scene, lambda text: note(error_console(), text))
    # Shapes keep their names.
    source = SceneSource(found, parameters=opt.parse_pairs(param, "-P"), memory=memory, merge=False)
    budget = budget_of(kind, opt.limits(time, paths=paths))
    return trace_to_file(
        Task(source, kind, product, settings_in(define), seed, budget), opt.Device(variant, threads, cluster, workers)
    )


def _boxes(text: str | None, has_workers: bool) -> tuple[int, int, int] | None:
    if text is None:
        return None
    numbers = [int(word) for word in text.lower().replace("×", "x").split("x") if word.strip().isdecimal()]
    if len(numbers) != 3 or text.lower().replace("×", "x").count("x") != 2:
        raise OptionError(f"--boxes needs three numbers such as 2x2x1, not '{text}'")
    if not has_workers:
        raise OptionError("a scene is divided among workers: give --workers or --cluster with --boxes")
    return numbers[0], numbers[1], numbers[2]


@app.command()
def compress(
    file: Annotated[Path, typer.Argument(help="File of particles.", metavar="FILE")],
    output: NewFile,
    codec: CodecName = "packed",
    debug: opt.Debug = False,
) -> int:
    """Write the particles of a file by another codec."""
    from etendue.particles import ParticleFile
    from etendue.products.particles import repack

    console, packed = error_console(), opt.only_one(output)
    with console.status("packing") as status:
        repack(file, packed, codec, lambda done, of: status.update(f"packing: pass {done} of {of}"))
    before, after = ParticleFile(file), ParticleFile(packed)
    count = max(len(after), 1)
    note(
        console,
        f"{len(after)} particles: {before.size / count:.2f} bytes each by {before.codec}, {after.size / count:.2f} by "
        f"{after.codec}",
    )
    say(str(packed))
    return 0


def trace_to_file(task: Task, device: opt.Device, saved: Checkpoint | None = None) -> int:
    """Trace, or go on with the file of the checkpoint ``saved``, report and print the path of the file. Returns the
    exit status."""
    from etendue.engine import Job, RunError
    from etendue.products import start_job

    from .running import follow

    (output,), console = task.product.files, error_console()
    device.choose()

    def open_job() -> Job:
        return Job.open(task) if saved is None else Job.resume(saved, task)

    try:
        with device.opened() as cluster:
            outcome = follow(lambda: start_job(open_job, None, cluster), console, "particles")
    except RunError:
        say(str(output))  # it has the passes before the failure
        raise
    if outcome.result is not None:
        note(console, _summary(outcome.result, output.stat().st_size))
        say(str(output))
    return outcome.exit_code


def _summary(result: ParticleResult, size: int) -> str:
    particles, paths = (int(result.counters[name]) for name in ("particles", "paths"))
    seconds = format_seconds(result.elapsed)
    return f"{particles} particles of {paths} light paths, {seconds}, {size / max(particles, 1):.2f} bytes a particle"
