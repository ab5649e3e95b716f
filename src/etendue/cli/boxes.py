"""`etendue radiosity --hierarchy`: passes of hierarchical multipath, with what they say."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.core import OptionError, format_seconds

from . import options as opt, radiosity_outputs as out
from .console import error_console, note, say
from .options import parse_pairs

if TYPE_CHECKING:
    from etendue.engine import Checkpoint
    from etendue.jobs import HierarchyRequest, HierarchyResult, HierarchyWork

#: The method of checkpoints: the name of :class:`etendue.radiosity.HierarchicalMultipath`.
HIERARCHY = "hierarchical-multipath"


def box_settings(
    objects: str | None,
    hierarchy: str | None,
    threshold: float | None,
    regions: int | None,
    define: list[str] | None,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fields of a request for the grouping, and settings of hierarchical multipath, from the options of both."""
    from etendue.jobs import split_settings

    if objects is not None and hierarchy not in (None, "", objects):
        raise OptionError(f"--hierarchy {hierarchy} says what makes an object: leave out --objects")
    given: dict[str, Any] = dict(parse_pairs(define, "-D"))
    short = {"objects": objects or hierarchy or None, "threshold": threshold, "grid": regions}
    for name, value in short.items():
        if value is None:
            continue
        if name in given:
            raise OptionError(f"-D gives '{name}' a second time; give it once")
        given[name] = value
    return split_settings(given)


def check_divided(divide: bool, hierarchy: str | None, device: opt.Device) -> None:
    """Raise :class:`OptionError` if there is nothing to divide, or nobody among whom."""
    if divide and hierarchy is None:
        raise OptionError("--divide puts the boxes of hierarchical multipath on workers: give --hierarchy, too")
    if divide and (device.cluster, device.workers) == (None, None):
        raise OptionError("boxes are divided among workers: give --workers or --cluster with --divide")


def solve_hierarchy(request: HierarchyRequest, saved: Checkpoint | None, device: opt.Device) -> int:
    """From a request to files. Returns the exit status."""
    from etendue.jobs import HierarchyWork

    from .solutions import cast, exit_status

    device.choose()
    began, console = time.perf_counter(), error_console()
    work = HierarchyWork(request, saved, tell=lambda text: note(console, text))
    _describe(work)
    with device.opened() as work.cluster:
        outcome = cast(work)
    if outcome.result is None:
        return outcome.exit_code
    with console.status("writing") as status:
        result = work.finish(outcome.result, status.update)
    _describe_result(result)
    note(console, f"in {format_seconds(time.perf_counter() - began)}")
    say("\n".join(map(str, request.files)))
    return outcome.exit_code or exit_status(result)


def resume_hierarchy(
    saved: Checkpoint, checkpoint: Path, output: Sequence[Path], device: opt.Device, **asked: Any
) -> int:
    """Go on with a checkpoint, and write its file anew."""
    from etendue.jobs import HierarchyRequest, asked_before

    request: Any = asked_before(
        saved,
        output=output,
        kinds=(HierarchyRequest,),
        checkpoint=checkpoint,
        wording=out.Options(),
        **asked,
    )
    return solve_hierarchy(request, saved, device)


def _describe(work: HierarchyWork) -> None:
    root = work.parts.root
    boxes = sum(len(part.children) for part in root.distinct)
    if boxes == 0:
        note(
            error_console(), f"{work.request.name}: {root.total} patches without boxes: no object or group is worth one"
        )
        return
    copies = f"{boxes} box{'' if boxes == 1 else 'es'}, {len(root.distinct) - 1} distinct"
    note(error_console(), f"{work.request.name}: {root.total} patches, {len(root)} of them around {copies}")


def _describe_result(result: HierarchyResult) -> None:
    from etendue.radiosity import relative_error

    left = float((result.parts.residual / result.parts.sent.clip(1e-300)).max())
    words = f"{result.passes} pass{'' if result.passes == 1 else 'es'}, {left:.1g} of the light is on its way"
    words += f", imbalance of power {result.parts.imbalance:.2g}"
    error = relative_error(result.parts)
    if error is not None:
        words += f", standard error of irradiance {error:.2g} in the mean (noise; light through boxes is binned)"
    note(error_console(), words)
    if (told := result.correspondence) is not None:
        most, count = max(shared.kept for shared in told.workers.values()), len(told.workers)
        again = f"; boxes began a pass anew {told.begun_anew} times" if told.begun_anew else ""
        note(
            error_console(),
            f"{count} worker{'' if count == 1 else 's'} had the boxes, at most {_megabytes(most)} of lines and light "
            f"each; {_megabytes(told.sent)} went to them, {_megabytes(told.received)} came back{again}",
        )


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.3g} MB"
