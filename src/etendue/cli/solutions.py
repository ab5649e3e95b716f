"""What `etendue form-factors` and `etendue radiosity` make of lines that were cast: files, and lines on them."""

from __future__ import annotations

from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.core import logger

from .console import error_console, note
from .lines import Request

if TYPE_CHECKING:
    from etendue.radiosity import CastLines, FirstShot, FormFactors, Patches, Segments
    from etendue.scene import Problem

#: Share of what patches see that may be sky without a warning: single convex solids have all of it.
_ALL_SKY = 0.999
#: Share that is not worth a word.
_NO_SKY = 1e-6


def factors_to_file(request: Request, lines: CastLines, segments: Segments) -> None:
    """Count, write, and say what came of it."""
    from etendue.radiosity import form_factors, save_form_factors

    estimator: Any = request.kind
    with error_console().status("counting"):
        factors = form_factors(segments, estimator)
        save_form_factors(
            request.output,
            factors,
            emissivity=1 - lines.patches.reflectance[:, 0],
            metadata=request.metadata(lines, estimator=estimator),
        )
    errors = factors.row_errors()
    _say(
        f"{factors.matrix.nnz} form factors ({estimator}), {_rows(factors)}, "
        f"standard error of a row {errors.mean():.2g} (at most {errors.max():.2g})"
    )


def exact_to_file(request: Request, patches: Patches) -> None:
    """Integrate, write, and say what came of it."""
    from etendue.radiosity import exact_form_factors, save_form_factors

    with error_console().status("integrating over contours"):
        factors = exact_form_factors(patches)
        known = {"software": f"etendue {metadata.version('etendue')}", "source": request.source, "estimator": "exact"}
        save_form_factors(request.output, factors, emissivity=1 - patches.reflectance[:, 0], metadata=known)
    sky = (patches.areas * factors.sky).sum() / patches.areas.sum()
    open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > 0 else ""
    _say(f"{factors.matrix.nnz} form factors (exact), {_rows(factors)}{open_ends}")


def _rows(factors: FormFactors) -> str:
    """What rows sum to, what leads to the sky included."""
    sums = factors.row_sums()
    least, most = f"{sums.min():.7g}", f"{sums.max():.7g}"
    whole = "rows and sky sum to" if (factors.sky > _NO_SKY).any() else "rows sum to"
    return f"{whole} {least}" if least == most else f"{whole} {least} to {most}"


def solution_to_file(request: Request, lines: CastLines, segments: Segments, problem: Problem | None) -> None:
    """Solve, write, and say what came of it."""
    from etendue.radiosity import form_factors, solve

    patches, solver = lines.patches, request.kind
    with error_console().status("solving"):
        shot = lines.shot()
        transport: Any = form_factors(segments) if request.wants_matrix else segments
        solution = solve(patches, transport, solver, shot=shot)  # type: ignore[arg-type]
        error = solution.irradiance_error(segments) if segments.batch_count > 1 else None
    known = request.metadata(lines, solver=solver, imbalance=solution.imbalance)
    request.writer.write(problem, solution, error, known)
    if shot is not None:
        _say(_of_shot(shot))
    steps = len(solution.residuals)
    parts = [f"{solver}: {steps} iteration{'' if steps == 1 else 's'}, residual {solution.residual:.1g}"]
    parts.append(f"imbalance of power {solution.imbalance:.2g}")
    if error is not None and (light := (patches.areas[:, None] * solution.irradiance).sum()) > 0:
        parts.append(f"standard error of irradiance {(patches.areas[:, None] * error).sum() / light:.2g} in the mean")
    _say(", ".join(parts))


def _of_shot(shot: FirstShot) -> str:
    emitters = int(shot.emission.any(axis=1).sum())
    which = "one emitter" if emitters == 1 else f"{emitters} emitters"
    return f"the light of {which} was sent by {shot.rays} rays"


def describe_patches(request: Request, patches: Patches) -> None:
    """A line on the patches."""
    from etendue.radiosity import diagnose

    faces = len(patches.faces)
    _say(f"{request.source}: {len(patches)} patches of {faces} face{'' if faces == 1 else 's'}, {diagnose(patches)}")


def segments_of(lines: CastLines) -> Segments:
    """What was cast, and a line on it."""
    from etendue.radiosity import MixedSegments

    with error_console().status("counting"):
        segments = lines.segments()
    sky = segments.to_sky.sum() / max(segments.counted.sum(), 1e-300)
    # In a closed mesh no line gets out, but of a million rays one may, by their single precision.
    open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > _NO_SKY else ""
    _say(f"{len(segments)} segments of {lines.count} bundle{'' if lines.count == 1 else 's'}{open_ends}")
    if isinstance(segments, MixedSegments):
        few = int(np.count_nonzero(segments.extra > 0))
        _say(f"{few} small patches, which few lines meet, have {segments.rays // few} local rays each")
    if sky > _ALL_SKY:
        logger.warning(
            "patches see nothing but the sky: if this should be a room, its faces are turned outward; turn them round"
        )
    return segments


def _say(text: str) -> None:
    note(error_console(), text)
