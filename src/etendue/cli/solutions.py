"""Messages of `etendue form-factors` and `etendue radiosity` on patches, progress and results."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from etendue.core import logger
from etendue.jobs import FormFactorResult, Passes, RadiosityResult, start_work

from .console import error_console, note
from .rendering import Outcome, follow

if TYPE_CHECKING:
    from collections.abc import Mapping

    from etendue.engine import RunResult
    from etendue.jobs import (
        FormFactorRequest,
        HierarchyResult,
        LinesRequest,
        PatchWork,
        RadiosityRequest,
        RequestedWork,
    )
    from etendue.radiosity import FirstShot, FormFactors, Lightmap, Patches, Segments
    from etendue.scene import Problem

#: Share of the sky above which a warning is given; single convex solids see only the sky.
_ALL_SKY = 0.999
#: Exit status if the power of a solution is not balanced.
UNBALANCED = 8
#: Share of the sky below which it is not reported.
_NO_SKY = 1e-6


def cast(work: RequestedWork[Any, Any]) -> Outcome[RunResult]:
    """Cast lines until the budget is used up or a signal comes."""
    return follow(lambda: start_work(lambda: Passes(work)), error_console(), work.request.work)


def exit_status(result: RadiosityResult | HierarchyResult) -> int:
    """0, or :data:`UNBALANCED`."""
    return 0 if result.is_balanced else UNBALANCED


def finish(work: PatchWork[Any, Any], run: RunResult) -> int:
    """Make the result, write it and report it. Returns the exit status."""
    console = error_console()
    with console.status("counting") as status:
        result = work.finish(run, status.update, partial(_describe_segments, console))
    if isinstance(result, FormFactorResult):
        errors = result.factors.row_errors()
        _say(
            f"{result.factors.matrix.nnz} form factors ({work.request.chosen_estimator}), {_rows(result.factors)}, "
            f"standard error of a row {errors.mean():.2g} (at most {errors.max():.2g})"
        )
        return 0
    _describe_shown(work.request, result.lightmap)
    _describe_solution(work.request, result)
    return exit_status(result)


def exact_to_files(request: FormFactorRequest, patches: Patches) -> None:
    """Integrate, write and report the form factors."""
    from etendue.jobs import Writing, about
    from etendue.radiosity import exact_form_factors, save_form_factors

    with error_console().status("integrating over contours"):
        factors = exact_form_factors(patches)
        known, writing = about(request.name, estimator="exact"), Writing()
        for path in request.outputs:
            with writing.attempt(f"write '{path}'"):
                save_form_factors(path, factors, emissivity=1 - patches.reflectance[:, 0], metadata=known)
        writing.finish()
    sky = (patches.areas * factors.sky).sum() / patches.areas.sum()
    open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > 0 else ""
    _say(f"{factors.matrix.nnz} form factors (exact), {_rows(factors)}{open_ends}")


def ambient_to_files(request: RadiosityRequest) -> int:
    """Solve by an ambient term, write, and say what came of it. Returns the exit status."""
    from etendue.jobs import solve_ambient

    with error_console().status("reading") as status:
        result = solve_ambient(request, status.update, partial(describe_patches, request))
    _describe_shown(request, result.lightmap)
    _say(
        f"{request.ambient} ambient term: {1000 * result.elapsed:.0f} ms, without lines, shadows and distances; "
        f"imbalance of power {result.solution.imbalance:.2g}"
    )
    return exit_status(result)


def solution_to_files(
    request: RadiosityRequest, problem: Problem | None, solved: Path, given: Mapping[str, Any]
) -> int:
    """Write the outputs of a solution from a file. ``given``: options with their default values. Returns the exit
    status."""
    from etendue.jobs import Writing, saved_solution
    from etendue.radiosity import check_balance

    solution, error, before = saved_solution(request, problem, solved, given)
    request.outputs.check_source(solution.patches, problem, request.wording)
    writing, known = Writing(), {"source": request.name, **before, "solution": str(solved)}
    with error_console().status("writing") as status:
        shown = request.outputs.write(writing, problem, solution, error, known, request.wording, status.update)
        writing.finish()
    _describe_shown(request, shown.lightmap)
    return 0 if check_balance(solution, error) else UNBALANCED


def _rows(factors: FormFactors) -> str:
    """The range of row sums, including the sky."""
    sums = factors.row_sums()[factors.areas > 0]
    least, most = f"{sums.min():.7g}", f"{sums.max():.7g}"
    whole = "rows and sky sum to" if (factors.sky > _NO_SKY).any() else "rows sum to"
    return f"{whole} {least}" if least == most else f"{whole} {least} to {most}"


def _describe_shown(request: RadiosityRequest, made: Lightmap | None) -> None:
    from etendue.jobs import ERROR_SCALE

    low, high = ERROR_SCALE
    for path in request.outputs.error_pictures:
        _say(f"{path.name}: relative standard error, black {low:.1%} to yellow {high:.0%}")
    if made is not None:
        height, width = made.covered.shape
        _say(f"lightmap of {width} x {height}, {made.covered.mean():.0%} covered by surfaces")


def _describe_solution(request: RadiosityRequest, result: RadiosityResult) -> None:
    solution, error, areas = result.solution, result.irradiance_error, result.patches.areas[:, None]
    if result.shot is not None:
        _say(_of_shot(result.shot))
    steps = len(solution.residuals)
    parts = [f"{request.chosen_solver}: {steps} iteration{'' if steps == 1 else 's'}, residual {solution.residual:.1g}"]
    if result.points:
        parts = [f"{request.chosen_solver}: {result.points} lines, {solution.residual:.1%} of the power unshot"]
    if request.ambient is not None:
        parts.append(f"the rest by the {request.ambient} ambient term")
    parts.append(f"imbalance of power {solution.imbalance:.2g}")
    if error is not None and (light := (areas * solution.irradiance).sum()) > 0:
        parts.append(f"standard error of irradiance {(areas * error).sum() / light:.2g} in the mean")
    _say(", ".join(parts))


def _of_shot(shot: FirstShot) -> str:
    emitters = int(shot.emission.any(axis=1).sum())
    which = "one emitter" if emitters == 1 else f"{emitters} emitters"
    return f"the light of {which} was sent by {shot.rays} rays"


def describe_patches(request: LinesRequest, patches: Patches) -> None:
    """Report the patches."""
    from etendue.radiosity import diagnose

    faces = len(patches.faces)
    _say(f"{request.name}: {len(patches)} patches of {faces} face{'' if faces == 1 else 's'}, {diagnose(patches)}")


def _describe_segments(console: Console, bundles: int, segments: Segments) -> None:
    """Report the segments."""
    from etendue.radiosity import MixedSegments

    sky = segments.to_sky.sum() / max(segments.counted.sum(), 1e-300)
    # In a closed mesh no line leaves the scene, but a ray in a million may, because of single precision.
    open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > _NO_SKY else ""
    note(console, f"{len(segments)} segments of {bundles} bundle{'' if bundles == 1 else 's'}{open_ends}")
    if isinstance(segments, MixedSegments):
        few = int(np.count_nonzero(segments.extra > 0))
        note(console, f"{few} small patches, which few lines meet, have {segments.rays // few} local rays each")
    if sky > _ALL_SKY:
        logger.warning("patches see only the sky: if the mesh is a room, its faces are turned outward; flip them")


def _say(text: str) -> None:
    note(error_console(), text)
