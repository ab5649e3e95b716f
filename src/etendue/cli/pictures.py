"""The commands that render: one picture, a run file, a comparison of methods, the demonstration.

Modules that import Mitsuba are imported inside the commands.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from etendue.core import OptionError

from . import options as opt
from .console import error_console, note, say


def render(
    scene: opt.Scene,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            "-m",
            help="See `etendue methods`; by default the scene's integrator if it is one of them but path, else vcm.",
            metavar="NAME",
        ),
    ] = None,
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
    max_depth: opt.MaxDepth = None,
    threads: opt.Threads = None,
    low_priority: opt.LowPriority = False,
    memory: opt.Memory = None,
    aovs: opt.Aovs = False,
    components: opt.Components = False,
    for_denoising: opt.ForDenoising = False,
    pyramid: opt.Pyramid = False,
    pyramid_depth: opt.PyramidDepth = None,
    no_bsdf_sampling: opt.NoBsdfSampling = False,
    save_every: opt.SaveEvery = 60.0,
    checkpoint: Annotated[
        Path | None,
        typer.Option(help="Checkpoint for `etendue resume`; by default beside the first picture.", metavar="FILE"),
    ] = None,
    no_checkpoint: Annotated[bool, typer.Option("--no-checkpoint", help="Write no checkpoint.")] = False,
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
    from etendue.api import choose_method
    from etendue.engine import Job, Task
    from etendue.jobs import Outputs
    from etendue.scene import locate

    from .rendering import choose_device, default_name, render_to_files, shown_in_tev

    if no_checkpoint and checkpoint is not None:
        raise OptionError("--checkpoint and --no-checkpoint exclude each other; give one of them")
    budget = opt.budget(time, spp, error)
    settings = opt.settings(
        define, max_depth, aovs, pyramid, pyramid_depth, no_bsdf_sampling, components, for_denoising
    )
    parameters = opt.parse_pairs(param, "-P")
    choose_device(variant, threads, low_priority)
    notes: list[str] = []  # shown after all checks
    found = locate(scene, notes.append)
    chosen = choose_method(method, found, parameters, notes.append)
    task = Task(found, chosen, settings, seed, budget, size, sensor, parameters, memory)
    pictures = output or [Path(f"{default_name(found)}-{chosen.name}.exr")]
    beside = pictures[0].parent / f"{pictures[0].stem}.checkpoint"
    outputs = Outputs.of(pictures, None if no_checkpoint else checkpoint or beside, save_every, False, tone, exposure)

    def open_job() -> Job:
        job = Job.open(task)
        for text in notes:
            note(error_console(), text)
        return job

    device = opt.Device(variant, threads, cluster, workers)
    with shown_in_tev(tev, pictures[0].stem) as callback, device.opened() as opened:
        return render_to_files(open_job, outputs, chosen.name, opened, callback)


def run(
    file: Annotated[Path, typer.Argument(help="Run file in TOML, see docs/run-files.md.", metavar="FILE")],
    check: Annotated[bool, typer.Option("--check", help="Only check the file and the files that it names.")] = False,
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
    from .experiments.run_file import RunFile
    from .rendering import choose_device, render_to_files

    wanted = RunFile.read(file)
    choose_device(wanted.variant, wanted.threads, wanted.low_priority)
    notes: list[str] = []  # shown after all checks
    task = wanted.task(notes.append)
    console = error_console()
    recorder = Recorder(wanted, lambda text: note(console, text))

    def open_job() -> Job:
        job = Job.open(task)
        recorder.check(job)
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
    max_depth: opt.MaxDepth = None,
    threads: opt.Threads = None,
    memory: opt.Memory = None,
    aovs: opt.Aovs = False,
    components: opt.Components = False,
    for_denoising: opt.ForDenoising = False,
    pyramid: opt.Pyramid = False,
    pyramid_depth: opt.PyramidDepth = None,
    no_bsdf_sampling: opt.NoBsdfSampling = False,
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
    from etendue.engine import Budget
    from etendue.scene import locate

    from .experiments.compare import Comparison, tasks
    from .rendering import choose_device

    folder = opt.only_one(output or [Path("comparison")])
    budget = opt.budget(time, spp, error) or Budget(seconds=60)
    notes: list[str] = []
    wanted = tasks(
        locate(scene, notes.append),
        method or ["path", "vcm"],
        opt.settings(define, max_depth, aovs, pyramid, pyramid_depth, no_bsdf_sampling, components, for_denoising),
        seed=seed,
        budget=budget,
        size=size,
        sensor=sensor,
        parameters=opt.parse_pairs(param, "-P"),
        memory=memory,
    )
    choose_device(variant, threads)
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
    from .rendering import choose_device

    folder = opt.only_one(output or [Path("demo-output")])
    comparison = demonstration(folder, opt.budget(time, None, None), size)
    choose_device(variant, threads)
    return comparison.run(error_console())
