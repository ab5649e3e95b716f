"""Values on surfaces as vertex colours of glTF."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.formats import GltfMesh

from ..faces import triangles
from ..smoothing import VertexRadiosity

Index = NDArray[np.int64]

#: The share of the lit area whose colours are not clipped.
_SHOWN = 0.99


def vertex_colours(smooth: VertexRadiosity, exposure: float, name: str) -> GltfMesh:
    """Interpolated values as colours.

    ``COLOR_0`` is the value times ``exposure``, linear and clipped at 1, since glTF has no brighter colours; the
    attribute ``name`` is the unclipped value, and ``extras`` contains ``exposure``.
    """
    mesh, corner = unshared(smooth.vertices, smooth.faces)
    values = np.broadcast_to(smooth.values[corner].reshape(len(corner), -1), (len(corner), 3))
    mesh.attributes = {"COLOR_0": np.clip(exposure * values, 0.0, 1.0), name: values}
    mesh.extras = {"exposure": exposure}
    return mesh


def shown_exposure(values: Array, areas: Array) -> float:
    """The exposure that keeps values (n, c) at most 1 in their brightest channel on 99 % of the lit areas (n,)."""
    brightest = values.max(axis=1)
    chosen = brightest > 0
    if not chosen.any():
        return 1.0
    order = np.argsort(brightest[chosen])
    below = np.cumsum(areas[chosen][order])
    white = brightest[chosen][order][np.searchsorted(below, _SHOWN * below[-1])]
    return float(1.0 / white)


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
