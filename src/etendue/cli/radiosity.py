"""`etendue form-factors` and `etendue radiosity`: options of both commands, and their execution."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from etendue.core import OptionError, format_seconds
from etendue.jobs import DEFAULT_POINTS

from . import options as opt, radiosity_outputs as out
from .boxes import box_settings, check_divided
from .console import command_line, error_console, note, say
from .radiosity_options import (
    Ambient,
    Bounces,
    BoxRegions,
    BoxSettings,
    BundleLines,
    Bundles,
    CheckpointFile,
    Divide,
    Engine,
    Error,
    Generator,
    GroupedObjects,
    Hierarchy,
    Ids,
    LineSeed,
    MainShare,
    MaxArea,
    NoLocalRays,
    PointSet,
    Reflectance,
    SubScenes,
    Threshold,
    TwoSided,
    Walls,
    quantity,
    sky_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from etendue.engine import Checkpoint
    from etendue.jobs import FormFactorRequest, LinesRequest, RadiosityRequest

#: Methods of checkpoints: the names of ``LineCasting``, ``HierarchicalCasting`` and ``MultipathPasses`` of
#: ``etendue.radiosity``.
LINES = ("global-lines", "hierarchical-lines", "multipath")


def form_factors(
    mesh: Annotated[
        str,
        typer.Argument(
            help="Mesh (PLY, OBJ, STL, VTU, glTF and others), Mitsuba XML file, or bundled scene.", metavar="SCENE"
        ),
    ],
    output: out.FactorFiles = None,
    bundles: Bundles = None,
    lines: BundleLines = None,
    time: opt.Time = None,
    error: Error = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator", help="F1, F2, F3, F4, reciprocal or pooled; F1, or F4 with --hierarchy.", metavar="NAME"
        ),
    ] = None,
    hierarchy: Hierarchy = None,
    walls: Walls = None,
    engine: Engine = None,
    point_set: PointSet = None,
    main_share: MainShare = None,
    reflectance: Reflectance = None,
    ids: Ids = None,
    max_area: MaxArea = None,
    two_sided: TwoSided = False,
    exact: Annotated[
        bool, typer.Option("--exact", help="By integrals instead of lines, for surfaces without occlusion.")
    ] = False,
    seed: LineSeed = None,
    no_local_rays: NoLocalRays = False,
    checkpoint: CheckpointFile = None,
    save_every: opt.SaveEvery = 60.0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the form factors (view factors) of a mesh or scene, each face a patch, by lines through all of it.

    The front of a face is the side from which its corners are counterclockwise. Stops at the first of --bundles, --time
    and --error that is reached, or by Ctrl-C, and writes the form factors from the lines so far.
    """
    from etendue.jobs import FormFactorRequest, FormFactorWork

    device = opt.Device(variant, threads, cluster, workers)
    if exact and (bundles, lines, time, error, checkpoint, hierarchy) != (None,) * 6:
        raise OptionError(
            "--exact casts no lines: leave out --bundles, --lines, --time, --error, --checkpoint and --hierarchy"
        )
    request = FormFactorRequest(
        source=mesh,
        estimator=estimator,
        hierarchy=True if hierarchy == "" else hierarchy,
        walls=None if walls is None else tuple(name for name in walls.split(",") if name),
        engine=engine,
        point_set=point_set,
        main_share=main_share,
        outputs=tuple(output or [Path("factors.npz")]),
        seconds=time,
        bundles=bundles,
        lines=lines or 0.0,
        error=error,
        seed=seed or 0,
        max_area=max_area,
        local_rays=not no_local_rays,
        mesh={"reflectance": quantity(reflectance), "ids": ids, "two_sided": two_sided},
        parameters=opt.parse_pairs(param, "-P") or None,
        checkpoint=checkpoint,
        save_every=save_every,
        wording=out.Options(),
    )
    if exact:
        device.check_alone("--exact")
        return _run_exact(request, device)
    return _run(request, lambda **options: FormFactorWork(request, **options), device)


def radiosity(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file, bundled scene, or mesh (PLY, OBJ, VTU, glTF and others).")
    ],
    output: out.SolutionFiles = None,
    bundles: Bundles = None,
    lines: BundleLines = None,
    time: opt.Time = None,
    error: Error = None,
    max_area: MaxArea = None,
    solver: Annotated[
        str | None,
        typer.Option(
            "--solver",
            help="conjugate-gradient (default), jacobi, gauss-seidel, southwell or direct; or multipath, which stores "
            "no lines.",
            metavar="NAME",
        ),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            help=f"Lines of multipath, in place of --bundles. {DEFAULT_POINTS}, if no budget is given.",
            min=1,
            metavar="N",
        ),
    ] = None,
    ambient: Ambient = None,
    bounces: Bounces = None,
    sub_scenes: SubScenes = None,
    reflectance: Reflectance = None,
    emission: Annotated[
        str | None,
        typer.Option("--emission", help="Of a mesh: power per area, in the same forms.", metavar="X|NAME"),
    ] = None,
    temperature: Annotated[
        str | None,
        typer.Option("--temperature", help="Of a mesh: in kelvin, for grey bodies that emit.", metavar="X|NAME"),
    ] = None,
    sky: Annotated[
        str | None, typer.Option("--sky", help="Of a mesh: power per area from the surroundings.", metavar="X")
    ] = None,
    ids: Ids = None,
    two_sided: TwoSided = False,
    seed: LineSeed = None,
    no_shot: Annotated[
        bool, typer.Option("--no-shot", help="No local rays for the light of small emitters: lines transport it, too.")
    ] = False,
    no_local_rays: NoLocalRays = False,
    point_set: PointSet = None,
    generator: Generator = None,
    hierarchy: Hierarchy = None,
    objects: GroupedObjects = None,
    threshold: Threshold = None,
    regions: BoxRegions = None,
    define: BoxSettings = None,
    divide: Divide = False,
    sensor: opt.Sensor = 0,
    size: opt.PictureSize = None,
    gather: out.Gather = 0,
    spp: out.Samples = 16,
    flat: out.Flat = False,
    error_picture: out.ErrorPicture = False,
    lightmap: out.LightmapSize = None,
    uv: out.TextureCoordinates = None,
    page: out.WithPage = False,
    solution: out.Solved = None,
    checkpoint: CheckpointFile = None,
    save_every: opt.SaveEvery = 60.0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    cluster: opt.Cluster = None,
    workers: opt.Workers = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the radiosities of a scene's or mesh's surfaces, each face a patch; all materials are treated as diffuse.

    Stops at the first of --bundles (or --points), --time and --error that is reached, or by Ctrl-C, and writes the
    solution from the lines so far.
    """
    from etendue.jobs import RadiosityRequest, SolutionOutputs, files_and_lightmap, radiosity_work

    device = opt.Device(variant, threads, cluster, workers)
    named = output or [Path("solution.vtu")]
    files, map_file = (tuple(named), None) if lightmap is None else files_and_lightmap(named)
    files = out.with_page(files, named[0], page)
    asked: dict[str, Any] = dict(
        source=scene,
        solver=solver,
        outputs=SolutionOutputs(
            files=files,
            command=command_line() if any(path.suffix == ".html" for path in files) else "",
            size=size,
            sensor=sensor,
            gather=gather,
            samples=spp,
            smooth=not flat,
            error_picture=error_picture,
            lightmap=map_file,
            lightmap_size=lightmap or 1024,
            uv=uv,
        ),
        seconds=time,
        bundles=bundles,
        lines=lines or 0.0,
        points=points,
        error=error,
        seed=seed or 0,
        max_area=max_area,
        shot=not no_shot,
        point_set=point_set,
        generator=generator,
        ambient=ambient,
        bounces=bounces,
        sub_scenes=sub_scenes,
        local_rays=not no_local_rays,
        mesh={
            "reflectance": quantity(reflectance),
            "emission": quantity(emission),
            "temperature": quantity(temperature),
            "ids": ids,
            "sky": sky_of(sky),
            "two_sided": two_sided,
        },
        parameters=opt.parse_pairs(param, "-P"),
        checkpoint=checkpoint,
        save_every=save_every,
        wording=out.Options(),
    )
    check_divided(divide, hierarchy, device)
    groups, boxes = box_settings(objects, hierarchy, threshold, regions, define)
    if hierarchy is not None:
        from etendue.jobs import HierarchyRequest

        from .boxes import solve_hierarchy

        if solution is not None:
            raise OptionError("--solution is there already: leave out --hierarchy")
        return solve_hierarchy(HierarchyRequest(**asked, **groups, hierarchy=boxes, divide=divide), None, device)
    if boxes:
        name = "--regions" if regions is not None else f"-D {next(iter(boxes))}"
        raise OptionError(f"{name} is for --hierarchy")
    asked |= groups
    request = RadiosityRequest(**asked)
    if solution is not None:
        device.check_alone("--solution")
        if checkpoint is not None:
            raise OptionError("--solution is there already and casts no lines: leave out --checkpoint")
        return _write_again(request, solution, {} if seed is None else {"seed": seed}, device)
    if request.is_instant:
        device.check_alone("--ambient")
        return _run_ambient(request, device)
    return _run(request, lambda **options: radiosity_work(request, **options), device)


def resume_lines(
    saved: Checkpoint,
    checkpoint: Path,
    output: Sequence[Path],
    scene: str | None,
    limits: Mapping[str, float | None],
    save_every: float | None,
    device: opt.Device,
) -> int:
    """Resume a checkpoint of one of these commands up to new ``limits``, and write its file again."""
    from etendue.jobs import FormFactorRequest, FormFactorWork, asked_before, radiosity_work

    if limits.get("points") is not None and saved.method != "multipath":
        raise OptionError(f"{checkpoint} has bundles of lines: give --bundles in place of --points")
    given: dict[str, Any] = {name: limit for name, limit in limits.items() if limit is not None}
    request: Any = asked_before(
        saved,
        source=scene,
        output=output,
        **given,
        checkpoint=checkpoint,
        save_every=save_every,
        wording=out.Options(),
    )
    work: Any = FormFactorWork if isinstance(request, FormFactorRequest) else radiosity_work
    return _run(request, lambda **options: work(request, saved, **options), device)


def _run(request: LinesRequest, open_work: Callable[..., Any], device: opt.Device) -> int:
    """Execute a request and write its files. Returns the exit status."""
    from .solutions import cast, describe_patches, finish

    device.choose()
    began, console = time.perf_counter(), error_console()
    with _ended_by_a_signal(request, request.checkpoint):
        work = open_work(is_watched=console.is_terminal, tell=lambda text: note(console, text))
        describe_patches(request, work.patches)
        with device.opened() as work.cluster:
            outcome = cast(work)
        if outcome.result is None:
            return outcome.exit_code
        status = finish(work, outcome.result)
    _end(began, request)
    return outcome.exit_code or status


def _run_exact(request: FormFactorRequest, device: opt.Device) -> int:
    """Execute a request for exact form factors. Returns the exit status."""
    from .solutions import describe_patches, exact_to_files

    device.choose()
    began = time.perf_counter()
    with _ended_by_a_signal(request):
        _, patches = request.load()
        describe_patches(request, patches)
        exact_to_files(request, patches)
    _end(began, request)
    return 0


def _run_ambient(request: RadiosityRequest, device: opt.Device) -> int:
    """A solution without lines. Returns the exit status."""
    from .solutions import ambient_to_files

    device.choose()
    began = time.perf_counter()
    with _ended_by_a_signal(request):
        status = ambient_to_files(request)
    _end(began, request)
    return status


def _write_again(request: RadiosityRequest, solution: Path, given: Mapping[str, Any], device: opt.Device) -> int:
    """Write the outputs of a solution from a file. ``given``: options with their default values. Returns the exit
    status."""
    from .solutions import solution_to_files

    device.choose()
    with _ended_by_a_signal(request):
        problem = request.problem(lambda text: note(error_console(), text))
        status = solution_to_files(request, problem, solution, given)
    say("\n".join(map(str, request.files)))
    return status


def _end(began: float, request: LinesRequest) -> None:
    note(error_console(), f"in {format_seconds(time.perf_counter() - began)}")
    say("\n".join(map(str, request.files)))


@contextmanager
def _ended_by_a_signal(request: LinesRequest, checkpoint: Path | None = None) -> Iterator[None]:
    """Says what was written if Ctrl-C or SIGTERM ends the block. Files are atomic, so nothing has to be cleaned up."""
    began = time.time()
    try:
        yield
    except KeyboardInterrupt:
        left = "nothing was written"
        if written := [str(path) for path in request.files if path.exists() and path.stat().st_mtime >= began]:
            left = f"written: {', '.join(written)}"
        if checkpoint is not None and checkpoint.exists():
            left = f"continue by: etendue resume {checkpoint}"
        note(error_console(), f"stopped; {left}")
        raise typer.Abort from None
