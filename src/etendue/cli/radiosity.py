"""`etendue form-factors` and `etendue radiosity`: patches, global lines, files for others."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from etendue.core import BackendError, OptionError, SceneError, format_seconds, logger, suggest

from . import options as opt
from . import radiosity_outputs as out
from .console import error_console, note, say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from etendue.radiosity import Patches, Segments
    from etendue.scene import Problem

#: What the extra brings.
_LIBRARIES = ("numba", "scipy", "meshio", "trimesh")
#: Share of what patches see that may be sky without a warning: single convex solids have all of it.
_ALL_SKY = 0.999
#: Solvers that work on segments; the others need the matrix.
_ON_SEGMENTS = ("jacobi", "conjugate-gradient")

Bundles = Annotated[
    int, typer.Option("--bundles", help="Directions of parallel lines; a power of two is best.", min=1, metavar="N")
]
MaxArea = Annotated[
    float | None, typer.Option("--max-area", help="Cut faces that are larger than this.", metavar="AREA")
]


def form_factors(
    mesh: Annotated[Path, typer.Argument(help="PLY, OBJ, STL, VTU, glTF and others.", metavar="MESH")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".npz or .nc (arrays), .vf (View3D's text).", metavar="FILE")
    ] = Path("factors.npz"),
    bundles: Bundles = 1024,
    estimator: Annotated[str, typer.Option("--estimator", help="F1, F2, F3, F4 or reciprocal.", metavar="NAME")] = "F1",
    reflectance: Annotated[
        float, typer.Option("--reflectance", help="Of all faces; only passed on to the file.", metavar="X")
    ] = 0.0,
    max_area: MaxArea = None,
    two_sided: Annotated[
        bool, typer.Option("--two-sided", help="Faces are sheets: their backs are patches, too.")
    ] = False,
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same lines.", metavar="N")] = 0,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the form factors (view factors) of a mesh, each face a patch, by lines through the whole scene.

    A face looks to where its corners run counterclockwise. Ctrl-C ends it; a file that is there stays as it is.
    """
    _require_extra()
    from etendue.core import set_threads
    from etendue.film import check_writable
    from etendue.radiosity import ESTIMATORS, FORM_FACTOR_FILES, check_file, read_patches

    _check_name("estimator", estimator, ESTIMATORS)
    check_file(output, FORM_FACTOR_FILES)
    check_writable(output)
    set_threads(threads)
    with _ended_by_ctrl_c():
        patches = read_patches(mesh, reflectance=reflectance, two_sided=two_sided)
        patches = patches if max_area is None else patches.subdivided(max_area)
        return factors_to_file(patches, output, str(mesh), bundles, estimator, seed)


def radiosity(
    scene: opt.Scene,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help=".vtu (ParaView), .ply, .glb, .gltf (vertex colours), .npz, .nc (arrays); .exr, .png (a picture).",
            metavar="FILE",
        ),
    ] = Path("solution.vtu"),
    bundles: Bundles = 1024,
    max_area: MaxArea = None,
    solver: Annotated[
        str,
        typer.Option("--solver", help="conjugate-gradient, jacobi, gauss-seidel, southwell or direct.", metavar="NAME"),
    ] = "conjugate-gradient",
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same lines.", metavar="N")] = 0,
    sensor: opt.Sensor = 0,
    size: opt.PictureSize = None,
    gather: out.Gather = 0,
    spp: out.Samples = 16,
    flat: out.Flat = False,
    error_picture: out.ErrorPicture = False,
    lightmap: out.LightmapSize = None,
    uv: out.TextureCoordinates = None,
    solution: out.Solved = None,
    variant: opt.Variant = None,
    param: opt.Param = None,
    threads: opt.Threads = None,
    debug: opt.Debug = False,
) -> int:
    """Compute the radiosities of a scene's surfaces, each face a patch; materials count as diffuse.

    Ctrl-C ends it; a file that is there stays as it is.
    """
    _require_extra()
    from etendue.radiosity import SOLVERS, scene_patches
    from etendue.scene import locate

    from .rendering import choose_device

    _check_name("solver", solver, SOLVERS)
    wanted = out.SolutionOutput(output, size, sensor, gather, spp, flat, error_picture, lightmap, uv)
    wanted.check()
    parameters = opt.parse_pairs(param, "-P")
    found = locate(scene, lambda text: note(error_console(), text))
    choose_device(variant, threads)
    with _ended_by_ctrl_c():
        problem = wanted.load(found, parameters)
        if solution is not None:
            return wanted.write_again(problem, solution)
        patches = scene_patches(problem.scene, max_area=max_area)
        if not (patches.emission.any() or patches.sky.any()):
            raise SceneError(f"'{scene}' has no light for radiosity; give it an emitter of type 'area' or 'constant'")
        return solution_to_file(patches, wanted, problem, scene, bundles, solver, seed)


def factors_to_file(patches: Patches, output: Path, source: str, bundles: int, estimator: Any, seed: int) -> int:
    """Cast, count, write, and say what came of it. Returns the exit status."""
    from etendue.radiosity import form_factors, save_form_factors

    began = time.perf_counter()
    segments = _cast(patches, source, bundles, seed)
    factors = form_factors(segments, estimator)
    save_form_factors(
        output,
        factors,
        emissivity=1 - patches.reflectance[:, 0],
        metadata=_metadata(source, bundles, seed, estimator=estimator),
    )
    sums, errors = factors.row_sums(), factors.row_errors()
    _note(
        f"{factors.matrix.nnz} form factors ({estimator}), rows sum to {sums.min():.5g} to {sums.max():.5g}, "
        f"standard error of a row {errors.mean():.2g} (at most {errors.max():.2g})"
    )
    _note(f"in {format_seconds(time.perf_counter() - began)}")
    say(str(output))
    return 0


def solution_to_file(
    patches: Patches,
    wanted: out.SolutionOutput,
    problem: Problem,
    source: str,
    bundles: int,
    solver: Any,
    seed: int,
) -> int:
    """Cast, solve, write, and say what came of it. Returns the exit status."""
    from etendue.radiosity import form_factors, solve

    began = time.perf_counter()
    segments = _cast(patches, source, bundles, seed)
    solution = solve(patches, segments if solver in _ON_SEGMENTS else form_factors(segments), solver)
    error = segments.gather_error(solution.radiosity, patches.sky) if segments.batch_count > 1 else None
    known = _metadata(source, bundles, seed, solver=solver, imbalance=solution.imbalance)
    wanted.write(problem, solution, error, known)
    steps = len(solution.residuals)
    parts = [f"{solver}: {steps} iteration{'' if steps == 1 else 's'}, residual {solution.residual:.1g}"]
    parts.append(f"imbalance of power {solution.imbalance:.2g}")
    if error is not None and (light := (patches.areas[:, None] * solution.irradiance).sum()) > 0:
        parts.append(f"standard error of irradiance {(patches.areas[:, None] * error).sum() / light:.2g} in the mean")
    _note(", ".join(parts))
    _note(f"in {format_seconds(time.perf_counter() - began)}")
    wanted.say()
    return 0


def _cast(patches: Patches, source: str, bundles: int, seed: int) -> Segments:
    """Segments, with a line on the patches before and on the segments after."""
    from etendue.points import OwenSobol
    from etendue.radiosity import ABuffer, diagnose

    faces = len(patches.faces)
    _note(f"{source}: {len(patches)} patches of {faces} face{'' if faces == 1 else 's'}, {diagnose(patches)}")
    with error_console().status(f"casting {bundles} bundles of lines"):
        segments = ABuffer(patches, OwenSobol(4, seed=seed)).cast(bundles)
    lines = max(int(segments.counted.sum()), 1)
    sky = segments.to_sky.sum() / lines
    open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > 0 else ""
    _note(f"{len(segments)} segments of {bundles} bundle{'' if bundles == 1 else 's'}{open_ends}")
    if sky > _ALL_SKY:
        logger.warning(
            "patches see nothing but the sky: if this should be a room, its faces are turned outward; turn them round"
        )
    return segments


def _metadata(source: str, bundles: int, seed: int, **more: Any) -> dict[str, Any]:
    software = f"etendue {metadata.version('etendue')}"
    return {"software": software, "source": source, "bundles": bundles, "seed": seed, **more}


def _note(text: str) -> None:
    note(error_console(), text)


def _check_name(what: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise OptionError(f"there is no {what} '{name}'; {suggest(name, known)}")


def _require_extra() -> None:
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        raise BackendError(f"radiosity needs {', '.join(missing)}, not installed: pip install 'etendue[radiosity]'")


@contextmanager
def _ended_by_ctrl_c() -> Iterator[None]:
    """Files are written whole, at the end: there is nothing to clean up, only something to say."""
    try:
        yield
    except KeyboardInterrupt:
        _note("stopped; nothing was written")
        raise typer.Exit(130) from None
