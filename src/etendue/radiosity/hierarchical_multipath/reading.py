"""Scenes of parts from patches with objects, and from Mitsuba scenes with instances."""

from __future__ import annotations

from typing import Any

import numpy as np

from etendue.surfaces import Patches, find_objects, has_instances, scene_parts, scene_patches

from .grouping import LEAST, THRESHOLD, grouped
from .parts import Part, Tree


def part_of(
    patches: Patches, objects: Any = "components", threshold: float = THRESHOLD, least: int = LEAST, levels: int = 1
) -> Part:
    """Patches as a scene of parts: :func:`grouped` by the objects that :func:`find_objects` finds."""
    return grouped(patches, find_objects(patches, objects).of_patch, threshold, least, levels)


def scene_part(scene: Any, *, max_area: float | None = None, lamps_apart: bool = False) -> Part | None:
    """A Mitsuba scene with instances as a scene of parts, one part per shape group; ``None`` for a scene without
    instances.

    Raises the errors of :func:`scene_parts` and :class:`Part`.
    """
    if not has_instances(scene):
        return None
    around, groups = scene_parts(scene, max_area=max_area, lamps_apart=lamps_apart)
    return Part(around, [(Part(patches), transforms) for patches, transforms in groups])


def instanced_patches(scene: Any, *, max_area: float | None = None, lamps_apart: bool = False) -> Patches:
    """:func:`scene_patches` of a scene that may have instances: all patches in one mesh, each instance a shape.

    Raises the errors of :func:`scene_patches` and :func:`scene_part`.
    """
    root = scene_part(scene, max_area=max_area, lamps_apart=lamps_apart)
    if root is None:
        return scene_patches(scene, max_area=max_area, lamps_apart=lamps_apart)
    tree = Tree(root)
    patches = tree.joined()
    around = root.patches
    own = () if around is None else around.shape_names
    shapes = np.empty(len(patches), dtype=np.int64)
    for node in range(len(tree)):
        numbers = tree.numbers_in_joined[tree.offsets[node] : tree.offsets[node + 1]]
        shapes[numbers] = len(own) + node - 1
    if around is not None and around.shapes is not None:
        shapes[tree.numbers_in_joined[: len(around)]] = around.shapes
    patches.shapes = shapes
    patches.shape_names = (*own, *(f"instance {k}" for k in range(len(tree) - 1)))
    return patches
