"""Casting, multipath and hierarchies on a cluster: what a worker needs to make their passes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.distributed import Ingredients, Recipe, recipe
from etendue.radiosity import (
    HierarchicalCasting,
    HierarchicalCastingSettings,
    HierarchicalMultipath,
    LineCasting,
    MultipathPasses,
    Objects,
    Part,
    PartProblem,
    Patches,
    PatchProblem,
)


def patch_recipe(problem: PatchProblem, method: LineCasting | MultipathPasses) -> Recipe:
    """Of a method that works on patches."""
    arrays = problem.patches.arrays()
    make: str | None = None
    given: dict[str, NDArray[Any]] = {}
    if isinstance(method, HierarchicalCasting):
        make = f"{__name__}:casting_in_hierarchy"
        found = method.objects
        given = {name: getattr(found, name) for name in ("of_patch", "areas", "lower", "upper")}
        given["names"] = np.array(found.names, dtype=str)
    ingredients = Ingredients(f"{__name__}:open_patches", {}, arrays)
    return recipe(ingredients, method, problem.fingerprint, given, make)


def part_recipe(problem: PartProblem, method: HierarchicalMultipath) -> Recipe:
    """Of a method that works on parts."""
    parts = problem.root.distinct
    number = {id(part): k for k, part in enumerate(parts)}
    arrays: dict[str, NDArray[Any]] = {}
    rows = []
    for k, part in enumerate(parts):
        if part.patches is not None:
            arrays |= {f"{k}/{name}": array for name, array in part.patches.arrays().items()}
        arrays[f"{k}:numbers"] = part.numbers
        for c, copy in enumerate(part.copies):
            arrays[f"{k}:copies{c}"] = copy.transforms
        copies = [number[id(copy.part)] for copy in part.copies]
        rows.append({"has_patches": part.patches is not None, "objects": part.objects, "copies": copies})
    ingredients = Ingredients(f"{__name__}:open_parts", {"parts": rows}, arrays)
    return recipe(ingredients, method, problem.fingerprint)


def open_patches(ingredients: Ingredients, folder: Path) -> PatchProblem:
    """The problem of :func:`patch_recipe`."""
    return PatchProblem(Patches.of_arrays(ingredients.arrays))


def open_parts(ingredients: Ingredients, folder: Path) -> PartProblem:
    """The problem of :func:`part_recipe`."""
    arrays = ingredients.arrays
    parts: list[Part] = []
    for k, row in enumerate(ingredients.values["parts"]):
        own = {name.removeprefix(f"{k}/"): array for name, array in arrays.items() if name.startswith(f"{k}/")}
        copies = [(parts[inner], arrays[f"{k}:copies{c}"]) for c, inner in enumerate(row["copies"])]
        patches = Patches.of_arrays(own) if row["has_patches"] else None
        parts.append(Part(patches, copies, numbers=arrays[f"{k}:numbers"], objects=row["objects"]))
    return PartProblem(parts[-1])


def casting_in_hierarchy(
    settings: HierarchicalCastingSettings, problem: PatchProblem, names: NDArray[Any], **objects: Any
) -> HierarchicalCasting:
    """The method of :func:`patch_recipe` in a hierarchy."""
    return HierarchicalCasting(Objects(problem.patches, names=tuple(map(str, names)), **objects), settings)
