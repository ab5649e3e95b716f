"""Solutions from files, from which other outputs are made without solving again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from etendue.core import Array, OptionError, numbers_for_json
from etendue.radiosity import (
    PatchSource,
    RadiosityError,
    Solution,
    check_balance,
    read_solution,
    solution_metadata,
)
from etendue.scene import Problem
from etendue.surfaces import differences

from ..files import Writing
from ..results import RadiosityResult
from .solution_files import SolutionFiles

#: Names in the metadata of a solution of what it was made by in the end, whatever was asked for.
_MADE_BY = {
    "bundles": ("bundles",),
    "passes": ("passes",),
    "points": ("points",),
    "seed": ("seed",),
    "solver": ("solver",),
    "method": ("solver",),
}
#: Values of options that were not asked for.
_DEFAULTS = {"method": "lines", "seed": 0}
#: Methods that are named as the solver of a solution, with the names of earlier versions.
_METHODS = {"multipath": "multipath", "boxes": "boxes", "hierarchical-multipath": "boxes"}


def write_saved(
    path: Path,
    source: PatchSource,
    outputs: SolutionFiles,
    asked: Mapping[str, Any],
    tell: Any,
) -> RadiosityResult:
    """Write the ``outputs`` of the solution in a file. ``asked``: options that were given, by name.

    Raises :class:`OptionError` for options that contradict those of the solution, :class:`RadiosityError` for a
    solution of another scene, and the errors of :func:`read_solution`.
    """
    scene = source.scene(tell)
    solution, error, known = saved_solution(path, source, scene, asked)
    outputs.check_source(solution.patches, scene)
    writing, about = Writing(), {"source": source.name, **known, "solution": str(path)}
    shown = outputs.write(writing, scene, solution, error, about, tell)
    writing.finish()
    return RadiosityResult(
        patches=solution.patches,
        solution=solution,
        irradiance_error=error,
        stopped_by="file",
        elapsed=0.0,
        is_balanced=check_balance(solution, error),
        picture=shown.picture,
        lightmap=shown.lightmap,
    )


def saved_solution(
    path: Path, source: PatchSource, scene: Problem | None, asked: Mapping[str, Any]
) -> tuple[Solution, Array | None, dict[str, Any]]:
    """The solution of a file, the standard error of its irradiance and its metadata. Errors as
    :func:`write_saved`."""
    solution, error = read_solution(path)
    known = solution_metadata(path)
    _check_options(path, known, asked)
    _check_scene(path, known, solution.patches, source, scene)
    return solution, error, known


def _flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with those of the mesh and of groups at the same level, as plain values, without those not given, and
    without parameters of the scene, which the scene itself shows."""
    flat = {name: value for name, value in settings.items() if not isinstance(value, Mapping)}
    for name in ("mesh", "groups", "hierarchy"):
        flat |= {key: value for key, value in dict(settings.get(name) or {}).items() if value is not False}
    plain: dict[str, Any] = json.loads(json.dumps(flat, default=numbers_for_json))
    return {name: value for name, value in plain.items() if value is not None}


def _check_options(path: Path, known: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    before, unknown = _flat(known.get("settings", {})), "settings" not in known
    wrong = []
    for name, value in _flat(asked).items():
        made = next((known[key] for key in _MADE_BY.get(name, ()) if key in known), None)
        if name == "method" and made is not None:
            made = "ambient" if str(made).startswith("ambient") else _METHODS.get(made, "lines")
        if made is None and unknown and value is not False:
            raise OptionError(f"'{path}' does not say its {name}: leave it out, since nothing is solved again")
        if made is None:
            made = before.get(name, _DEFAULTS.get(name))
        if str(made) != str(value) and (made or value):
            wrong.append(f"{_with(name, made)}, not {_with(name, value)}")
    if wrong:
        raise OptionError(f"'{path}' was made {'; '.join(wrong)}: leave that out, or solve again without the solution")


def _with(name: str, value: Any) -> str:
    if value is None or value is False:
        return f"without {name}"
    return f"with {name}" if value is True else f"with {name}={','.join(map(str, np.ravel(value).tolist()))}"


def _check_scene(
    path: Path, known: Mapping[str, Any], patches: Any, source: PatchSource, scene: Problem | None
) -> None:
    """Raise :class:`RadiosityError` unless the patches are those of the source."""
    before = known.get("settings", {})
    mesh = {**before.get("mesh", {}), **source.mesh}
    max_area = source.max_area if source.max_area is not None else before.get("max_area")
    here = replace(source, mesh=mesh if source.is_mesh else {}, max_area=max_area).patches(scene)
    # A file of an earlier version, or from Python, does not say how it was made.
    told = "settings" in known
    different = differences(patches, here, divided=not told and max_area is None, light=told or not source.is_mesh)
    if different:
        of = f" ({known['source']})" if "source" in known else ""
        raise RadiosityError(
            f"'{path}' is the solution of another scene{of} than '{source.name}': {', '.join(different)}; solve again"
        )
