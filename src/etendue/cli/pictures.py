"""The commands that render: one picture, a run file, a comparison of methods, the demonstration.

Modules that import Mitsuba are imported inside the commands.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from etendue.core import OptionError

from . import options as opt
from .console import error_console, note, say
from .settings import settings_in, with_settings


def _methods() -> dict[str, Any]:
    from etendue import methods

    return {name: kind.Settings for name, kind in methods.table().items()}


#: Commands with the settings of the methods of pictures as options.
PictureCommand = with_settings(_methods)


def render(
    scene: opt.Scene,
    method: opt.Method = None,
    output: opt.Output = None,
    time: opt.Time = None,
    spp: opt.Spp = None,
    error: opt.Error = None,
    size: opt.PictureSize = None,
    sensor: opt.Sensor = 0,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    define: opt.Define = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    low_priority: opt.LowPriority = False,
    memory: opt.Memory = None,
    save_every: opt.SaveEvery = 60.0,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="Checkpoint for `etendue resume`; by default beside the first picture.", metavar="FILE"),
    ] = None,
    no_checkpoint: opt.NoCheckpoint = False,
    tone: opt.Tone = "srgb",
    exposure: opt.Exposure = "auto",
    tev: opt.Tev = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Render a scene.

    Stops at the first of --time, --spp and --error that is reached; without any, at the scene's own sample count.
    Ctrl-C stops after the current pass and writes the picture and the checkpoint.
    """
    from etendue.engine import Job
    from etendue.products import Picture, budget_of, choose_method, picture_task
    from etendue.scene import SceneSource, locate

    from .running import choose_device, default_name, render_to_files, shown_in_tev

    settings, parameters = settings_in(define), opt.parse_pairs(param, "-P")
    limits = opt.limits(time, error, spp=spp)
    notes: list[str] = []  # shown after all checks
    found = locate(scene, notes.append)
    choose_device(variant, threads, low_priority, found)
    chosen = choose_method(method, found, parameters, notes.append)
    source = SceneSource(found, size, sensor, parameters, memory)
    pictures = output or [Path(f"{default_name(found)}-{chosen.name}.exr")]
    beside = opt.checkpoint_beside(pictures[0], checkpoint, no_checkpoint)
    product = Picture.of(pictures, checkpoint or beside, save_every, False, tone, exposure)
    task = picture_task(source, chosen, product, settings, seed, budget_of(chosen, limits))

    def open_job() -> Job:
        job = Job.open(task)
        for text in notes:
            note(error_console(), text)
        return job

    device = opt.Device(variant, threads, cluster, workers)
    with shown_in_tev(tev, pictures[0].stem) as callback, device.opened() as opened:
        return render_to_files(open_job, product, chosen.name, opened, callback)


def run(
    file: Annotated[Path | None, typer.Argument(help="Run file in TOML; --example shows one.", metavar="FILE")] = None,
    check: Annotated[bool, typer.Option("--check", help="Only check the file and the files that it names.")] = False,
    example: Annotated[bool, typer.Option("--example", help="Print a run file with all its keys.")] = False,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Render the experiment of a run file: scene, camera, method, budget, saves at given times, error against a
    reference.

    Ctrl-C stops after the current pass and writes the pictures and the checkpoint.
    """
    from etendue.engine import Job

    from .experiments.records import Recorder
    from .experiments.run_file import EXAMPLE, RunFile
    from .running import choose_device, render_to_files

    if example:
        say(EXAMPLE)
        return 0
    if file is None:
        raise OptionError("name a run file; `etendue run --example` prints one")
    wanted, console = RunFile.read(file), error_console()
    choose_device(wanted.variant, wanted.threads, wanted.low_priority, wanted.scene)
    notes: list[str] = []  # shown after all checks
    recorder = Recorder(wanted, lambda text: note(console, text))
    task = wanted.task(recorder, notes.append)

    def open_job() -> Job:
        job = Job.open(task)
        for text in notes:
            note(console, text)
        return job

    if check:
        say(f"{file} is in order: {wanted.describe(open_job())}")
        return 0
    with recorder, opt.Device(wanted.variant, wanted.threads, cluster, workers).opened() as opened:
        return render_to_files(open_job, recorder, task.method.name, opened, recorder.watch)


def compare(
    scene: opt.Scene,
    method: Annotated[
        list[str] | None, typer.Option("--method", "-m", help="A method; give it twice or more.", metavar="NAME")
    ] = None,
    output: opt.Folder = None,
    reference: Annotated[
        Path | None, typer.Option(help="A converged picture to measure the error against.", metavar="FILE")
    ] = None,
    time: opt.Time = None,
    spp: opt.Spp = None,
    error: opt.Error = None,
    size: opt.PictureSize = None,
    sensor: opt.Sensor = 0,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    define: opt.Define = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    memory: opt.Memory = None,
    seeds: Annotated[
        int, typer.Option("--seeds", help="Render so many times, for the error of the error.", min=1, metavar="N")
    ] = 1,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Render a scene by several methods for the same time, and write a page that compares them.

    By default `path` and `vcm`, 60 seconds each, in the folder `comparison`.
    """
    from etendue.scene import SceneSource, locate

    from .experiments.compare import Comparison, tasks
    from .running import choose_device

    folder = opt.only_one(output or [Path("comparison")])
    limits = opt.limits(time, error, spp=spp) or {"seconds": 60}
    notes: list[str] = []
    source = SceneSource(locate(scene, notes.append), size, sensor, opt.parse_pairs(param, "-P"), memory)
    wanted = tasks(source, method or ["path", "vcm"], settings_in(define), seed=seed, limits=limits)
    choose_device(variant, threads, scene=source.scene)
    console = error_console()
    for text in notes:
        note(console, text)
    with opt.Device(variant, threads, cluster, workers).opened() as opened:
        return Comparison(wanted, folder, reference, seeds=seeds, cluster=opened).run(console)


def demo(
    output: opt.Folder = None,
    time: opt.Time = 45.0,
    size: opt.PictureSize = None,
    variant: opt.Variant = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Render the bundled caustic scene by path tracing and by VCM for the same time, and write a page.

    By default in the folder `demo-output`.
    """
    from .experiments.compare import demonstration
    from .running import choose_device

    folder = opt.only_one(output or [Path("demo-output")])
    comparison = demonstration(folder, opt.limits(time), size)
    choose_device(variant, threads)
    return comparison.run(error_console())
