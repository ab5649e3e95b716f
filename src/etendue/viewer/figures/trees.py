"""Trees and grids as boxes and spheres, level by level."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, OptionError, copied_to_device
from etendue.density import HashGrid, KdTree
from etendue.radiosity import find_objects, grouped, part_boxes, scene_patches, sphere_tree
from etendue.scene import Problem
from etendue.transport import Guide

#: Structures that can be drawn, with their names on the page.
KINDS = {
    "kd-tree": "kd-tree of photons",
    "hash-grid": "hash grid of photons",
    "spheres": "spheres of form factors",
    "boxes": "boxes of multipath",
    "guide": "cells of the guide",
}
#: Most boxes that are drawn.
MOST_BOXES = 60_000

Boxes = dict[str, NDArray[Any]]


def kd_tree(points: NDArray[np.float32]) -> Boxes:
    """The boxes of a kd-tree over points (n, 3)."""
    level, lower, upper = KdTree(_on_device(points)).boxes()
    return _boxes(level, lower, upper)


def hash_grid(points: NDArray[np.float32], radius: float) -> Boxes:
    """The occupied cells of a hash grid over points (n, 3), for searches of ``radius``; ``value``: number of points."""
    if not radius > 0:
        raise OptionError(f"the radius of a grid is above zero, not {radius:g}")
    there = _on_device(points)
    grid = HashGrid(there, radius, points.min(axis=0).tolist(), points.max(axis=0).tolist())
    lower, upper, counts = grid.occupied(there)
    return _boxes(np.zeros(len(lower), np.int64), lower, upper) | {"value": counts.astype(np.float32)}


def guide_cells(guide: Guide) -> Boxes:
    """The cells of a guide; ``facing``: 0 to 5 for +x, -x, +y, -y, +z, -z."""
    lower, upper, facing = guide.boxes()
    size = np.prod(upper - lower, axis=1)
    level = np.round(np.log2(size.max() / size)).astype(np.int64)
    return _boxes(level, lower, upper) | {"facing": facing.astype(np.uint8)}


def spheres(problem: Problem) -> Boxes:
    """The spheres around the objects of a scene in which lines for form factors are cast."""
    tree = sphere_tree(find_objects(scene_patches(problem), "shapes"))
    scale = problem.space.scale
    return {
        "centres": problem.space.from_scene(tree.centres).astype(np.float32),
        "radii": (scale * tree.radii).astype(np.float32),
        "level": tree.levels.astype(np.uint8),
    }


def multipath_boxes(problem: Problem) -> Boxes:
    """The boxes around groups of objects in which hierarchical multipath casts lines."""
    patches = scene_patches(problem)
    level, corners = part_boxes(grouped(patches, find_objects(patches, "shapes").of_patch))
    return {"corners": problem.space.from_scene(corners).astype(np.float32), "level": level.astype(np.uint8)}


def _boxes(level: NDArray[np.int64], lower: Array, upper: Array) -> Boxes:
    if len(level) > MOST_BOXES:
        raise OptionError(f"there are {len(level)} boxes, more than {MOST_BOXES} that can be drawn: take fewer points")
    ends = np.stack([lower, upper], axis=1)
    corners = np.stack([ends[:, [k & 1, k >> 1 & 1, k >> 2], [0, 1, 2]] for k in range(8)], axis=1)
    return {"corners": corners.astype(np.float32), "level": level.astype(np.uint8)}


def _on_device(points: NDArray[np.float32]) -> mi.Point3f:
    if len(points) == 0:
        raise OptionError("there are no photons: no light path has hit a surface; ask for more paths")
    return mi.Point3f(*(copied_to_device(mi.Float, column) for column in points.T.astype(np.float32)))
