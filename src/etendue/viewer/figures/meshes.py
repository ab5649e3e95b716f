"""Triangles of a scene with a plain colour for each shape."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import UnsupportedError
from etendue.scene import Problem, graph
from etendue.surfaces import shape_triangles

#: Most triangles that are drawn; if there are more, the largest are drawn.
MOST_TRIANGLES = 500_000
_LIGHT, _CLEAR = (255, 205, 80), (150, 175, 205)


@dataclass(frozen=True)
class SceneMesh:
    """Triangles (n, 3, 3) float32; the shape (n,) of each; names and colours (shapes, 3) uint8 of shapes; the number of
    triangles left out because there are too many; names of shapes that have no triangles."""

    triangles: NDArray[np.float32]
    shape: NDArray[np.uint32]
    names: list[str]
    colours: NDArray[np.uint8]
    left_out: int
    missing: list[str]


def scene_mesh(problem: Problem) -> SceneMesh:
    """The shapes of a scene. Instances are left out, as their shapes have no place of their own."""
    parts, owners, colours = [np.zeros((0, 3, 3), np.float32)], [np.zeros(0, np.uint32)], []
    names: list[str] = []
    missing: list[str] = []
    for shape in problem.scene.shapes():
        label = graph.name(shape) or f"{graph.plugin_name(shape)} {len(names) + 1}"
        try:
            triangles = shape_triangles(shape)
        except UnsupportedError:
            missing.append(label)
            continue
        parts.append(triangles.astype(np.float32))
        owners.append(np.full(len(triangles), len(names), np.uint32))
        names.append(label)
        colours.append(_colour(shape))
    every, owner = np.concatenate(parts), np.concatenate(owners)
    left_out = max(0, len(every) - MOST_TRIANGLES)
    if left_out:
        size = np.linalg.norm(np.cross(every[:, 1] - every[:, 0], every[:, 2] - every[:, 0]), axis=1)
        kept = np.sort(np.argpartition(size, left_out)[left_out:])
        every, owner = every[kept], owner[kept]
    return SceneMesh(every, owner, names, np.array(colours, np.uint8).reshape(-1, 3), left_out, missing)


def _colour(shape: mi.Shape) -> tuple[int, int, int]:
    """Colour of a light, or of the material's diffuse reflectance in the middle of its texture."""
    if shape.is_emitter():
        return _LIGHT
    bsdf = shape.bsdf()
    if bsdf is None:
        return _CLEAR
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv, si.wi = mi.Point2f(0.5), mi.Vector3f(0.0, 0.0, 1.0)
    si.shape = mi.ShapePtr(shape)  # a texture may be an attribute of the mesh
    linear = np.array(bsdf.eval_diffuse_reflectance(si), dtype=np.float64).ravel()[:3]
    if not np.isfinite(linear).all() or linear.max() < 0.02:
        return _CLEAR
    red, green, blue = np.round(255 * np.clip(linear, 0.0, 1.0) ** (1 / 2.2)).astype(int).tolist()
    return red, green, blue
