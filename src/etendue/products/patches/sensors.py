"""View factors of sensors to the patches of a source, their light, and files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from etendue.core import logger
from etendue.engine import silent
from etendue.lighting import Meters
from etendue.radiosity import (
    PatchSource,
    PointFactors,
    check_point_file,
    point_factors,
    point_factors_to_error,
    read_light,
    save_point_factors,
)
from etendue.scene import graph
from etendue.surfaces import lamps_apart

from ..files import PathLike, Writing, about, check_files, listed


def make_point_factors(
    source: PatchSource,
    meters: Meters,
    outputs: PathLike | Sequence[PathLike] = (),
    tell: Callable[[str], object] = silent,
    on_patches: Callable[[Any], object] = silent,
    *,
    groups: bool = False,
    solution: PathLike | None = None,
    error: float | None = None,
    **options: Any,
) -> PointFactors:
    """See :func:`etendue.radiosity.point_factors`, whose ``options`` are. groups: of groups instead of patches.
    error: the largest standard error of a factor, see :func:`etendue.radiosity.point_factors_to_error`.
    solution: a file with radiosities of the patches, see :func:`etendue.radiosity.read_light`, for the irradiance at
    the sensors. ``tell`` receives the current step, ``on_patches`` the patches beforehand. Raises the errors of files
    before anything is computed."""
    files: tuple[Path, ...] = tuple(check_point_file(path) for path in listed(outputs))
    check_files(files)
    problem = source.open(tell)
    patches = problem.patches
    for path in files:
        check_point_file(path, patches, meters, groups)
    light = None if solution is None else read_light(solution, patches)
    if light is not None and problem.scene is not None and (lamps := lamps_apart(problem.scene.scene)):
        logger.warning(
            "%s has no surface: its direct light is missing in the irradiance at the sensors; etendue measure has it",
            graph.describe(lamps[0], "emitter"),
        )
    on_patches(patches)
    if error is None:
        found = point_factors(patches, meters, tell=tell, **options)
    else:
        found = point_factors_to_error(patches, meters, error, groups=groups, tell=tell, **options)
    if light is not None:
        found = found.lit(*light)
    if groups:
        found = found.of_groups()
    known = {
        "sensors": len(meters),
        "error": error,
        "groups": groups,
        "solution": None if solution is None else str(solution),
    }
    writing = Writing()
    for path in files:
        with writing.attempt(f"write '{path}'"):
            save_point_factors(path, found, metadata=about(problem.source, **known, **options))
    writing.finish()
    return found
