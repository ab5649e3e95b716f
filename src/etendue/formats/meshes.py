"""Meshes with values at vertices or faces, written by meshio."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import library
from etendue.film import replacing


def write_mesh(
    path: str | os.PathLike[str],
    kind: str,
    vertices: NDArray[Any],
    faces: NDArray[np.int64],
    at_vertices: Mapping[str, NDArray[Any]],
    of_faces: Mapping[str, NDArray[Any]],
) -> None:
    """Write a file of meshio's format ``kind`` (``ply``, ``vtu``) atomically.

    vertices: (v, 3). faces: (f, 4), a triangle repeats its last vertex; in the file triangles come before
    quadrilaterals. at_vertices, of_faces: arrays by name, a row per vertex or face; a single column of ``of_faces``
    becomes a list of numbers. Raises :class:`etendue.core.BackendError` without meshio,
    :class:`etendue.core.OutputError` if the file cannot be written.
    """
    meshio = library("meshio", f"writing {path}")
    is_triangle = faces[:, 2] == faces[:, 3]
    groups = [("triangle", is_triangle, 3), ("quad", ~is_triangle, 4)]
    present = [(name, chosen, corners) for name, chosen, corners in groups if chosen.any()]
    index = np.int32 if kind == "ply" else np.int64  # PLY has no 64-bit integers
    blocks = [(name, faces[chosen, :corners].astype(index)) for name, chosen, corners in present]
    flat = {n: v[:, 0] if v.ndim == 2 and v.shape[1] == 1 else v for n, v in of_faces.items()}
    data = {name: [values[chosen] for _, chosen, _ in present] for name, values in flat.items()}
    mesh = meshio.Mesh(vertices, blocks, point_data=dict(at_vertices), cell_data=data)
    with replacing(path) as part:
        mesh.write(part, file_format=kind)
