"""Solutions as vertex colours of glTF."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.formats import GltfMesh
from etendue.surfaces import VertexRadiosity, triangles

from ..solvers.system import Solution

Index = NDArray[np.int64]

#: The share of the non-emitting area whose colours are not clipped.
_SHOWN = 0.99


def coloured_mesh(solution: Solution, smooth: VertexRadiosity, exposure: float | None = None) -> GltfMesh:
    """Interpolated radiosities as colours.

    ``COLOR_0`` is the radiosity times ``exposure``, linear and clipped at 1, since glTF has no brighter colours; the
    default exposure keeps 99 % of the non-emitting area below 1. ``_RADIOSITY`` is the unclipped radiosity, and
    ``extras`` contains ``exposure``.
    """
    mesh, corner = unshared(smooth.vertices, smooth.faces)
    radiosity = np.broadcast_to(smooth.values[corner].reshape(len(corner), -1), (len(corner), 3))
    exposure = _exposure(solution) if exposure is None else exposure
    mesh.attributes = {"COLOR_0": np.clip(exposure * radiosity, 0.0, 1.0), "_RADIOSITY": radiosity}
    mesh.extras = {"exposure": exposure}
    return mesh


def unshared(vertices: Array, faces: Index) -> tuple[GltfMesh, Index]:
    """Faces (s, 4) as a mesh in which only faces with the same normal share vertices, and the original vertex of each
    vertex."""
    points = vertices[faces]
    vectors = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    normals = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    corner = np.column_stack([faces.ravel(), np.repeat(np.round(normals * 1e5).astype(np.int64), 4, axis=0)])
    _, first, number = np.unique(corner, axis=0, return_index=True, return_inverse=True)
    cut, _ = triangles(number.reshape(-1, 4))
    source = faces.ravel()[first]
    return GltfMesh(vertices[source], normals[first // 4], cut), source


def _exposure(solution: Solution) -> float:
    """The exposure that keeps nearly all of the non-emitting area below 1 in its brightest channel."""
    patches, brightest = solution.patches, solution.radiosity.max(axis=1)
    reflects = ~patches.emission.any(axis=1) & (brightest > 0)
    chosen = reflects if reflects.any() else brightest > 0
    if not chosen.any():
        return 1.0
    order = np.argsort(brightest[chosen])
    below = np.cumsum(patches.areas[chosen][order])
    white = brightest[chosen][order][np.searchsorted(below, _SHOWN * below[-1])]
    return float(1.0 / white)
