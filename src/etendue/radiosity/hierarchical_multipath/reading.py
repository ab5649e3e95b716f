"""Scenes of parts, from what users have: patches and their objects, Mitsuba scenes with instances."""

from __future__ import annotations

from typing import Any

from etendue.surfaces import Patches, find_objects, has_instances, scene_parts

from .grouping import LEAST, THRESHOLD, grouped
from .parts import Part


def part_of(
    patches: Patches, objects: Any = "components", threshold: float = THRESHOLD, least: int = LEAST, levels: int = 1
) -> Part:
    """Patches as a scene of parts: :func:`grouped` by the objects that :func:`find_objects` finds."""
    return grouped(patches, find_objects(patches, objects).of_patch, threshold, least, levels)


def scene_part(scene: Any, *, max_area: float | None = None) -> Part | None:
    """A Mitsuba scene with instances as a scene of parts, each shape group one of them; ``None`` for a scene without.

    Raises as :func:`scene_parts` and :class:`Part` do.
    """
    if not has_instances(scene):
        return None
    around, groups = scene_parts(scene, max_area=max_area)
    return Part(around, [(Part(patches), transforms) for patches, transforms in groups])
