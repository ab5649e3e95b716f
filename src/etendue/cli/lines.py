"""Execution of `etendue form-factors` and `etendue radiosity`: progress, and messages on patches, lines and results."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from etendue.core import OptionError, format_count, format_seconds, logger
from etendue.engine import Checkpoint, Job, Task
from etendue.products import DaylightResult, FormFactorResult, RadiosityResult, start_job
from etendue.products.patches import (
    ERROR_SCALE,
    AtOnce,
    FormFactorProduct,
    PatchProduct,
    SolutionProduct,
    illuminance_text,
    write_saved,
)

from .console import Steps, error_console, note, say
from .running import follow

if TYPE_CHECKING:
    from etendue.products.patches import SolutionRun
    from etendue.radiosity import FormFactors, Segments

    from .options import Device

#: Share of the sky above which a warning is given; single convex solids see only the sky.
_ALL_SKY = 0.999
#: Exit status if the power of a solution is not balanced.
UNBALANCED = 8
#: Share of the sky below which it is not reported.
_NO_SKY = 1e-6


def run_on_patches(task: Task | AtOnce, device: Device, saved: Checkpoint | None = None) -> int:
    """Run a task, or go on with the checkpoint ``saved``, write the files and print their paths. Returns the exit
    status."""
    device.choose()
    product: Any = task.product
    began, status = time.perf_counter(), 0
    with _ended_by_a_signal(product):
        if isinstance(task, AtOnce):
            if not device.is_alone:
                why = task.why or "there are no passes for workers"
                raise OptionError(f"{why}: leave out --cluster and --workers")
            with Steps(error_console(), "reading") as steps:
                result = task.make(steps.update, lambda patches: describe_patches(task.source.name, patches))
        else:
            outcome = _cast(task, device, saved)
            if outcome.result is None:
                return outcome.exit_code
            (job, run), status = outcome.result, outcome.exit_code
            with Steps(error_console(), "counting") as steps:
                result = product.finish(job, run, steps.update)
            if status and (kept := product.checkpoint or product.if_stopped) is not None:
                _note(f"to go on: etendue resume {kept}")
    if isinstance(result, DaylightResult):
        _note(result.summary())
    elif isinstance(result, FormFactorResult):
        _describe_factors(product, result)
    else:
        _describe_solution(product, task, result)
        status = status or (0 if result.is_balanced else UNBALANCED)
    _note(f"in {format_seconds(time.perf_counter() - began)}")
    say("\n".join(map(str, product.files)))
    return status


def write_again(run: SolutionRun, solution: Path, given: Mapping[str, Any], device: Device) -> int:
    """Write the outputs of a solution from a file. ``given``: options with their default values. Returns the exit
    status."""
    device.choose()
    asked = {**run.asked(run.method), **given}
    run.outputs.check()
    source = run.source_of_files()
    with Steps(error_console(), "writing") as steps:
        result = write_saved(solution, source, run.outputs, asked, steps.update)
    _describe_shown(run.outputs, result)
    say("\n".join(map(str, run.outputs.written)))
    return 0 if result.is_balanced else UNBALANCED


def _cast(task: Task, device: Device, saved: Checkpoint | None) -> Any:
    """Cast lines until the budget is used up or a signal comes; the product is made afterwards."""
    product: PatchProduct[Any] = task.product  # type: ignore[assignment]
    product.on_segments = _describe_segments

    def open_job() -> Job:
        job = Job.open(task, _note) if saved is None else Job.resume(saved, task, _note)
        if job.method.name == "boxes":
            _describe_boxes(job)
        else:
            describe_patches(job.problem.source, job.problem.patches)
        return job

    label = "radiosity" if isinstance(product, SolutionProduct) else product.kind
    with device.opened() as cluster:
        return follow(lambda: start_job(open_job, None, cluster, finish=False), error_console(), label)


@contextmanager
def _ended_by_a_signal(product: PatchProduct[Any]) -> Iterator[None]:
    """Says what was written if Ctrl-C or SIGTERM ends the block. Files are atomic, so nothing has to be cleaned up."""
    began = time.time()
    try:
        yield
    except KeyboardInterrupt:
        left, checkpoint = "nothing was written", product.checkpoint or product.if_stopped
        if written := [str(path) for path in product.files if path.exists() and path.stat().st_mtime >= began]:
            left = f"written: {', '.join(written)}"
        if checkpoint is not None and checkpoint.exists():
            left = f"continue by: etendue resume {checkpoint}"
        _note(f"stopped; {left}")
        raise typer.Abort from None


# -- messages --------------------------------------------------------------------------------------------------------


def _note(text: str) -> None:
    note(error_console(), text)


def describe_patches(name: str, patches: Any) -> None:
    """Say how many patches there are, and whether their mesh is closed."""
    from etendue.radiosity import diagnose

    faces = len(patches.faces)
    _note(f"{name}: {len(patches)} patches of {format_count(faces, 'face')}, {diagnose(patches)}")


def _describe_boxes(job: Job) -> None:
    root = job.problem.root
    boxes = sum(len(part.children) for part in root.distinct)
    what = "without boxes: no object or group is worth one"
    if boxes:
        copies = f"{boxes} box{'' if boxes == 1 else 'es'}, {len(root.distinct) - 1} distinct"
        what = f"{len(root)} of them around {copies}"
    _note(f"{job.problem.source}: {root.total} patches{', ' if boxes else ' '}{what}")


def _describe_segments(bundles: int, segments: Segments) -> None:
    from etendue.radiosity import MixedSegments

    sky = segments.to_sky.sum() / max(segments.counted.sum(), 1e-300)
    # In a closed mesh no line leaves the scene, but a ray in a million may, because of single precision.
    open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > _NO_SKY else ""
    _note(f"{len(segments)} segments of {format_count(bundles, 'bundle')}{open_ends}")
    if isinstance(segments, MixedSegments):
        few = int(np.count_nonzero(segments.extra > 0))
        _note(f"{few} small patches, which few lines meet, have {segments.rays // few} local rays each")
    if sky > _ALL_SKY:
        logger.warning("patches see only the sky: if the mesh is a room, its faces are turned outward; flip them")


def _describe_factors(product: FormFactorProduct, result: FormFactorResult, which: str = "") -> None:
    if result.zones is not None:
        _describe_zones(product, result.zones)
        return
    factors = result.factors
    if result.correction is not None and not which:
        _note(str(result.correction))
    if result.stopped_by == "exact":
        sky = (result.patches.areas * factors.outside).sum() / result.patches.areas.sum()
        open_ends = f", {100 * sky:.3g} % of what patches see is the sky" if sky > 0 else ""
        _note(f"{which}{factors.matrix.nnz} form factors (exact), {_rows(factors)}{open_ends}")
        return
    describe_factors(factors, f"({'rays' if result.stopped_by == 'rays' else product.estimator})", which)


def describe_factors(factors: FormFactors, of: str, which: str = "") -> None:
    """Say how many form factors there are, their row sums and their errors."""
    from etendue.radiosity import known_rows

    errors = factors.row_errors()[known_rows(factors)]
    _note(
        f"{which}{factors.matrix.nnz} form factors {of}, {_rows(factors)}, standard error of a row {errors.mean():.2g} "
        f"(at most {errors.max():.2g})"
    )


def _describe_zones(product: FormFactorProduct, zones: Mapping[str, FormFactorResult]) -> None:
    corrections = {name: zone.correction for name, zone in zones.items() if zone.correction is not None}
    if corrections:
        most = max(corrections, key=lambda name: corrections[name].largest)
        _note(f"of all zones, '{most}' is corrected most: {corrections[most]}")
    for name, zone in zones.items():
        _describe_factors(product, zone, f"zone '{name}', {len(zone.patches)} patches: ")


def _rows(factors: FormFactors) -> str:
    """The range of row sums, including the sky, of the rows that are known."""
    from etendue.radiosity import known_rows

    sums = factors.row_sums()[known_rows(factors)]
    least, most = f"{sums.min():.7g}", f"{sums.max():.7g}"
    whole = "rows and sky sum to" if (factors.outside > _NO_SKY).any() else "rows sum to"
    return f"{whole} {least}" if least == most else f"{whole} {least} to {most}"


def _describe_shown(outputs: Any, result: RadiosityResult) -> None:
    low, high = ERROR_SCALE
    if outputs.photometric and result.solution is not None:
        _note(illuminance_text(result.solution))
    for path in outputs.error_pictures:
        _note(f"{path.name}: relative standard error, black {low:.1%} to yellow {high:.0%}")
    if (made := result.lightmap) is not None:
        height, width = made.covered.shape
        _note(f"lightmap of {width} x {height}, {made.covered.mean():.0%} covered by surfaces")


def _describe_solution(product: SolutionProduct, task: Task | AtOnce, result: RadiosityResult) -> None:
    _describe_shown(product.outputs, result)
    if result.parts is not None:
        _describe_parts(result)
        return
    solution, error = result.solution, result.irradiance_error
    assert solution is not None and result.patches is not None
    if product.ambient is not None and isinstance(task, AtOnce):
        _note(
            f"{product.ambient} ambient term: {1000 * result.elapsed:.0f} ms, without lines, shadows and distances; "
            f"imbalance of power {solution.imbalance:.2g}"
        )
        return
    if (shot := result.shot) is not None:
        emitters = int(shot.emission.any(axis=1).sum())
        which = "one emitter" if emitters == 1 else f"{emitters} emitters"
        _note(f"the light of {which} was sent by {shot.rays} rays")
    count = format_count(len(solution.residuals), "iteration")
    parts = [f"{product.chosen_solver}: {count}, residual {solution.residual:.1g}"]
    if result.points:
        parts = [f"multipath: {result.points} lines, {solution.residual:.1%} of the power unshot"]
    if product.ambient is not None:
        parts.append(f"the rest by the {product.ambient} ambient term")
    parts.append(f"imbalance of power {solution.imbalance:.2g}")
    areas = result.patches.areas[:, None]
    if error is not None and (light := (areas * solution.irradiance).sum()) > 0:
        parts.append(f"standard error of irradiance {(areas * error).sum() / light:.2g} in the mean")
    _note(", ".join(parts))


def _describe_parts(result: RadiosityResult) -> None:
    from etendue.radiosity import relative_error

    parts = result.parts
    assert parts is not None
    left = float((parts.residual / parts.sent.clip(1e-300)).max())
    words = f"{format_count(result.passes, 'pass')}, {left:.1g} of the light is on its way"
    words += f", imbalance of power {parts.imbalance:.2g}"
    if (error := relative_error(parts)) is not None:
        words += f", standard error of irradiance {error:.2g} in the mean (noise; light through boxes is binned)"
    _note(words)
    if (told := result.correspondence) is not None:
        most, count = max(shared.kept for shared in told.workers.values()), len(told.workers)
        again = f"; boxes began a pass anew {told.begun_anew} times" if told.begun_anew else ""
        _note(
            f"{format_count(count, 'worker')} had the boxes, at most {_megabytes(most)} of lines and light each; "
            f"{_megabytes(told.sent)} went to them, {_megabytes(told.received)} came back{again}"
        )


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.3g} MB"
