"""`etendue form-factors` and `etendue radiosity`: patches, global lines, files for others."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from etendue.core import BackendError, EtendueError, OptionError, format_seconds, suggest
from etendue.solving import DEFAULT_BUNDLES

from . import options as opt
from . import radiosity_outputs as out
from .console import error_console, note, say
from .lines import Cast, Request, cast, request_of
from .solutions import describe_patches, exact_to_file, factors_to_file, segments_of, solution_to_file

if TYPE_CHECKING:
    from collections.abc import Sequence

    from etendue.engine import Budget, Checkpoint
    from etendue.radiosity import Patches
    from etendue.scene import Problem

#: What the extra brings.
_LIBRARIES = ("numba", "scipy", "meshio", "trimesh")
Bundles = Annotated[
    int | None,
    typer.Option(
        "--bundles",
        help=f"Directions of parallel lines; a power of two is best. {DEFAULT_BUNDLES}, if no budget is given.",
        min=1,
        metavar="N",
    ),
]
Error = Annotated[
    float | None,
    typer.Option(
        "--error", help="Stop at this standard error: of the irradiance, relative; of a row of factors.", metavar="X"
    ),
]
CheckpointFile = Annotated[
    Path | None, typer.Option("--checkpoint", help="Keep what was cast, for `etendue resume`.", metavar="FILE")
]
MaxArea = Annotated[
    float | None, typer.Option("--max-area", help="Cut faces that are larger than this.", metavar="AREA")
]
Reflectance = Annotated[
    str | None,
    typer.Option(
        "--reflectance",
        help="Of a mesh: a number, one for each channel as 0.7,0.5,0.2, or an array of the file for its faces "
        "('emissivity' counts as one minus it). 0 if not given.",
        metavar="X|NAME",
    ),
]
Ids = Annotated[
    str | None, typer.Option("--ids", help="Of a mesh: array of the file; faces of equal number are one patch.")
]
TwoSided = Annotated[
    bool, typer.Option("--two-sided", help="Faces of a mesh are sheets: their backs are patches, too.")
]
NoLocalRays = Annotated[bool, typer.Option("--no-local-rays", help="No rays from small patches, which few lines meet.")]
LineSeed = Annotated[int, typer.Option("--seed", help="The same seed gives the same lines.", metavar="N")]


def form_factors(
    mesh: Annotated[Path, typer.Argument(help="PLY, OBJ, STL, VTU, glTF and others.", metavar="MESH")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".npz or .nc (arrays), .vf (View3D's text).", metavar="FILE")
    ] = Path("factors.npz"),
    bundles: Bundles = None,
    time: opt.Time = None,
    error: Error = None,
    estimator: Annotated[str, typer.Option("--estimator", help="F1, F2, F3, F4 or reciprocal.", metavar="NAME")] = "F1",
    reflectance: Reflectance = None,
    ids: Ids = None,
    max_area: MaxArea = None,
    two_sided: TwoSided = False,
    exact: Annotated[
        bool, typer.Option("--exact", help="By integrals in place of lines, if faces hide nothing from each other.")
    ] = False,
    seed: LineSeed = 0,
    no_local_rays: NoLocalRays = False,
    checkpoint: CheckpointFile = None,
    save_every: opt.SaveEvery = 60.0,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the form factors (view factors) of a mesh, each face a patch, by lines through the whole scene.

    A face looks to where its corners run counterclockwise. Stops at the first of --bundles, --time and --error that is
    reached, or by Ctrl-C, and writes what the lines so far say.
    """
    request = Request(
        "form-factors",
        str(mesh),
        str(output),
        estimator,
        seed,
        max_area,
        two_sided,
        reflectance,
        ids=ids,
        local_rays=not no_local_rays,
    )
    if exact:
        if (bundles, time, error, checkpoint) != (None, None, None, None):
            raise OptionError("--exact casts no lines: leave out --bundles, --time, --error and --checkpoint")
        return _run_exact(request, threads)
    return _run(request, _budget(bundles, time, error), checkpoint, save_every, None, threads)


def radiosity(
    scene: Annotated[
        str, typer.Argument(help="Mitsuba XML file, bundled scene, or mesh (PLY, OBJ, VTU, glTF and others).")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help=".vtu (ParaView), .ply, .glb, .gltf (vertex colours), .npz, .nc (arrays); .exr, .png (a picture).",
            metavar="FILE",
        ),
    ] = Path("solution.vtu"),
    bundles: Bundles = None,
    time: opt.Time = None,
    error: Error = None,
    max_area: MaxArea = None,
    solver: Annotated[
        str,
        typer.Option("--solver", help="conjugate-gradient, jacobi, gauss-seidel, southwell or direct.", metavar="NAME"),
    ] = "conjugate-gradient",
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
        str | None, typer.Option("--sky", help="Of a mesh: power per area that comes from outside.", metavar="X")
    ] = None,
    ids: Ids = None,
    two_sided: TwoSided = False,
    seed: LineSeed = 0,
    no_shot: Annotated[
        bool, typer.Option("--no-shot", help="Leave the light of small emitters to the lines, too.")
    ] = False,
    no_local_rays: NoLocalRays = False,
    sensor: opt.Sensor = 0,
    size: opt.PictureSize = None,
    gather: out.Gather = 0,
    spp: out.Samples = 16,
    flat: out.Flat = False,
    error_picture: out.ErrorPicture = False,
    lightmap: out.LightmapSize = None,
    uv: out.TextureCoordinates = None,
    solution: out.Solved = None,
    checkpoint: CheckpointFile = None,
    save_every: opt.SaveEvery = 60.0,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the radiosities of a scene's or mesh's surfaces, each face a patch; materials count as diffuse.

    Stops at the first of --bundles, --time and --error that is reached, or by Ctrl-C, and writes the solution on the
    lines so far.
    """
    request = Request(
        "radiosity",
        scene,
        str(output),
        solver,
        seed,
        max_area,
        two_sided,
        reflectance,
        emission,
        temperature,
        ids,
        sky,
        opt.parse_pairs(param, "-P"),
        not no_shot,
        not no_local_rays,
        {
            "size": size,
            "sensor": sensor,
            "gather": gather,
            "samples": spp,
            "flat": flat,
            "error_picture": error_picture,
            "lightmap": lightmap,
            "uv": uv,
        },
        to_error=error is not None,
    )
    if solution is not None:
        return _write_again(request, solution, variant, threads)
    return _run(request, _budget(bundles, time, error), checkpoint, save_every, variant, threads)


def resume_lines(
    saved: Checkpoint,
    checkpoint: Path,
    output: Sequence[Path],
    scene: str | None,
    bundles: int | None,
    time: float | None,
    error: float | None,
    save_every: float | None,
    variant: str | None,
    threads: int | None,
) -> int:
    """Go on with a checkpoint of one of these commands, and write its file anew."""
    from etendue.engine import remaining

    request = request_of(saved)
    if len(output) > 1:
        raise OptionError(f"etendue {request.command} writes one file, not {len(output)}")
    request = replace(
        request,
        source=scene if scene is not None else request.source,
        output=str(output[0]) if output else request.output,
    )
    budget = _budget(bundles, time, error) if (bundles, time, error) != (None, None, None) else None
    return _run(
        request,
        budget or remaining(saved, "--bundles, --time or --error"),
        checkpoint,
        save_every,
        variant,
        threads,
        saved,
    )


def _budget(bundles: int | None, seconds: float | None, error: float | None) -> Budget:
    """A sample is a bundle, and noise the square of a standard error."""
    from etendue.engine import Budget

    Budget(seconds, bundles, None, error)  # checks what was typed, before it is squared
    if (bundles, seconds, error) == (None, None, None):
        bundles = DEFAULT_BUNDLES
    return Budget(seconds, bundles, None, None if error is None else error**2)


def _run(
    request: Request,
    budget: Budget,
    checkpoint: Path | None,
    save_every: float | None,
    variant: str | None,
    threads: int | None,
    saved: Checkpoint | None = None,
) -> int:
    """From a request to files. Returns the exit status."""
    from .rendering import choose_device

    _check(request, checkpoint)
    choose_device(variant, threads)
    began = time.perf_counter()
    with _ended_by_ctrl_c(checkpoint):
        problem = request.problem()
        patches = request.patches(problem)
        _check_patches(request, patches, problem)
        describe_patches(request, patches)
        done = cast(request, patches, budget, checkpoint, save_every, saved)
        if done.lines is None:
            return done.status
        segments = segments_of(done.lines)
        try:
            if request.is_factors:
                factors_to_file(request, done.lines, segments)
            else:
                solution_to_file(request, done.lines, segments, problem)
        except EtendueError as error:
            raise type(error)(f"{error}{_rescued(done, checkpoint)}") from error
    note(error_console(), f"in {format_seconds(time.perf_counter() - began)}")
    say("\n".join(map(str, request.files)))
    return done.status


def _run_exact(request: Request, threads: int | None) -> int:
    """Form factors without lines. Returns the exit status."""
    from .rendering import choose_device

    _check(request, None)
    choose_device(None, threads)
    began = time.perf_counter()
    with _ended_by_ctrl_c(None):
        patches = request.patches(None)
        _check_patches(request, patches, None)
        describe_patches(request, patches)
        exact_to_file(request, patches)
    note(error_console(), f"in {format_seconds(time.perf_counter() - began)}")
    say(request.output)
    return 0


def _write_again(request: Request, solution: Path, variant: str | None, threads: int | None) -> int:
    """Write a solution that is in a file. Returns the exit status."""
    from .rendering import choose_device

    _check(request, None)
    choose_device(variant, threads)
    with _ended_by_ctrl_c(None):
        problem = request.problem()
        request.writer.check_source(problem)
        return request.writer.write_again(problem, solution)


def _check(request: Request, checkpoint: Path | None) -> None:
    """What can be said before anything is read."""
    _require_extra()
    from etendue.film import check_writable
    from etendue.radiosity import ESTIMATORS, FORM_FACTOR_FILES, SOLVERS, check_file

    if request.is_factors:
        _check_name("estimator", request.kind, ESTIMATORS)
        check_file(request.output, FORM_FACTOR_FILES)
        check_writable(request.output)
    else:
        _check_name("solver", request.kind, SOLVERS)
        request.writer.check()
    if checkpoint is not None:
        check_writable(checkpoint)
        if checkpoint.resolve() in [path.resolve() for path in request.files]:
            raise OptionError(f"'{checkpoint}' is named for two outputs; give each a name of its own")


def _check_patches(request: Request, patches: Patches, problem: Problem | None) -> None:
    """What can be said before lines are cast."""
    from etendue.radiosity import RadiosityError, check_direct, check_text_size

    suffix = Path(request.output).suffix.lower()
    if suffix == ".vf":
        check_text_size(request.output, len(patches), 0)
    if request.is_factors:
        return
    if request.kind == "direct":
        check_direct(len(patches))
    if suffix in (".ply", ".glb", ".gltf") and patches.channels not in (1, 3):
        raise RadiosityError(f"{suffix} shows one channel or three, not {patches.channels}; write .vtu or .npz")
    request.writer.check_source(problem)


def _rescued(done: Cast, checkpoint: Path | None) -> str:
    """Where the lines are if nothing can be made of them: in the checkpoint, or one among the temporary files."""
    kept = checkpoint if checkpoint is not None else done.rescued()
    if kept is None:
        return ""
    return f"; the lines are kept: etendue resume {kept} --bundles {done.lines.count if done.lines else 1}"


def _check_name(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise OptionError(f"there is no {what} '{name}'; {suggest(name, known)}")


def _require_extra() -> None:
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        raise BackendError(f"radiosity needs {', '.join(missing)}, not installed: pip install 'etendue[radiosity]'")


@contextmanager
def _ended_by_ctrl_c(checkpoint: Path | None) -> Iterator[None]:
    """While lines are not being cast. Files are written whole: there is nothing to clean up, only something to say."""
    try:
        yield
    except KeyboardInterrupt:
        kept = checkpoint is not None and checkpoint.exists()
        note(error_console(), f"stopped; {f'go on by: etendue resume {checkpoint}' if kept else 'nothing was written'}")
        raise typer.Exit(130) from None
