"""Patches of a Mitsuba scene with instances: the patches of each shape group once, and the places of its instances."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from etendue.core import Array, SceneError, UnsupportedError, as_array, use_variant
from etendue.scene import RenderSpace, graph

from ..patches import Patches
from .scenepatches import loaded_scene, patches_of, scene_sky


def has_instances(scene: Any) -> bool:
    """Whether a scene, as :func:`scene_patches` takes it, has shapes of type ``instance``."""
    use_variant()
    return any(map(_is_instance, loaded_scene(scene)[0].shapes()))


def scene_parts(
    scene: Any, *, max_area: float | None = None, segments: int = 32, lamps_apart: bool = False
) -> tuple[Patches | None, list[tuple[Patches, Array]]]:
    """Patches, with the sky, of the shapes that are no instances (``None`` if there are none); and for each shape group
    with instances its patches, in coordinates of the group, and the transforms (k, 4, 4) of the instances.

    Arguments and errors are those of :func:`scene_patches`; ``max_area`` is the area in the scene, for the largest
    instance of each group.
    """
    use_variant()
    scene, space = loaded_scene(scene)
    own = [shape for shape in scene.shapes() if not _is_instance(shape)]
    sky = scene_sky(scene, lamps_apart)
    around = None
    if own:
        around, shape, _ = patches_of(own, segments, space)
        around = around.with_properties(sky=sky)
        around.shapes = shape[around.labels]
        around.shape_names = tuple(graph.name(item) or f"shape {k}" for k, item in enumerate(own))
        around = around if max_area is None else around.subdivided(max_area)
    elif sky.any():
        raise UnsupportedError("a scene of instances alone has no sky in radiosity; add a shape that is no instance")
    placed: dict[str, list[Array]] = {}
    for shape in scene.shapes():
        if _is_instance(shape):
            placed.setdefault(_group_of(shape), []).append(_to_scene(shape, space))
    members = {str(item.id()): item for item in graph.below(scene) if graph.plugin_name(item) == "shapegroup"}
    parts = []
    for name, transforms in placed.items():
        if name not in members:
            raise SceneError(f"the shape group '{name}' of an instance is not in the scene")
        patches = patches_of([item for _, item in graph.contents(members[name]).objects], segments, RenderSpace())[0]
        if max_area is not None:
            largest = max(abs(float(np.linalg.det(matrix[:3, :3]))) for matrix in transforms) ** (2 / 3)
            patches = patches.subdivided(max_area / largest)
        parts.append((patches, np.array(transforms)))
    return around, parts


def _is_instance(shape: Any) -> bool:
    return graph.plugin_name(shape) == "instance"


def _group_of(instance: Any) -> str:
    # In Mitsuba only the description of an instance contains its group.
    found = re.search(r'name = "(.*)"', str(instance))
    if found is None:
        raise SceneError(f"{graph.describe(instance, 'instance')} has no shape group")
    return found[1]


def _to_scene(instance: Any, space: RenderSpace) -> Array:
    (matrix,) = (as_array(value) for name, value in graph.contents(instance).values if name == "to_world")
    result = np.array(matrix, dtype=np.float64).reshape(4, 4)
    result[:3, 3] = space.to_scene(result[:3, 3])
    result[:3, :3] /= space.scale
    return result
