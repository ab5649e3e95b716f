"""Division of faces into equal parts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

Index = NDArray[np.int64]


def subdivide(vertices: Array, faces: Index, max_area: float, strips: bool = False) -> tuple[Array, Index, Index]:
    """Vertices and faces (f, 4) of at most ``max_area`` each, and the original face of each.

    Each side of a face is divided into ``n`` parts, ``n`` as small as the area allows: a triangle becomes ``n^2``
    triangles of equal area, a quadrilateral ``n^2`` quadrilaterals, of equal area if its opposite sides are parallel.
    Neighbours with different ``n`` have no gap between them, but different vertices on the common edge. strips: only
    the first and the third side of quadrilaterals are divided.
    """
    power = 1.0 if strips else 0.5
    cuts = np.maximum(np.ceil((_largest_part(vertices[faces]) / max_area) ** power - 1e-9), 1).astype(np.int64)
    is_triangle = faces[:, 2] == faces[:, 3]
    all_vertices, all_faces, sources = [vertices], [faces[cuts == 1]], [np.flatnonzero(cuts == 1)]
    offset = len(vertices)
    for n in np.unique(cuts[cuts > 1]):
        for cut, chosen in ((_triangle, is_triangle), (_quadrilateral, ~is_triangle)):
            rows = np.flatnonzero((cuts == n) & chosen)
            if len(rows) == 0:
                continue
            weights, parts = _quadrilateral(int(n), 1) if strips else cut(int(n))
            all_vertices.append(np.einsum("pk,fkx->fpx", weights, vertices[faces[rows]]).reshape(-1, 3))
            first = offset + len(weights) * np.arange(len(rows))
            all_faces.append((first[:, None, None] + parts).reshape(-1, 4))
            sources.append(np.repeat(rows, len(parts)))
            offset += len(weights) * len(rows)
    source = np.concatenate(sources)
    order = np.argsort(source, kind="stable")
    return np.concatenate(all_vertices), np.concatenate(all_faces)[order], source[order]


def _largest_part(corners: Array) -> Array:
    """Area of the largest part times the number of parts: for a quadrilateral, of the largest parallelogram at a
    corner."""
    areas = []
    for i in range(4):
        sides = corners[:, (i + 1) % 4] - corners[:, i], corners[:, i - 1] - corners[:, i]
        areas.append(np.linalg.norm(np.cross(*sides), axis=1))
    triangle = (corners[:, 2] == corners[:, 3]).all(axis=1)
    return np.where(triangle, areas[1] / 2, np.maximum.reduce(areas))


def _triangle(n: int) -> tuple[Array, Index]:
    """Weights (p, 4) of the corners of a face for each point, and the parts as rows of point indices."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    inside = i + j <= n
    number = np.full((n + 1, n + 1), -1)
    number[i[inside], j[inside]] = np.arange(np.count_nonzero(inside))
    i_in, j_in = i[inside], j[inside]
    # Not 1 - u - v: faces that share an edge must have bit-equal numbers on it, to share vertices.
    weights = np.stack([n - i_in - j_in, i_in, j_in, np.zeros_like(i_in)], axis=1) / n
    i, j = i[i + j < n], j[i + j < n]
    parts = [np.stack([number[i, j], number[i + 1, j], number[i, j + 1]], axis=1)]
    i, j = i[i + j < n - 1], j[i + j < n - 1]
    parts.append(np.stack([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]], axis=1))
    return weights, np.concatenate(parts)[:, [0, 1, 2, 2]]


def _quadrilateral(n: int, m: int | None = None) -> tuple[Array, Index]:
    m = m or n
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n + 1), np.arange(m + 1), indexing="ij"))
    weights = np.stack([(n - i) * (m - j), i * (m - j), i * j, (n - i) * j], axis=1) / (n * m)
    i, j = i[(i < n) & (j < m)], j[(i < n) & (j < m)]
    corner = i * (m + 1) + j
    return weights, np.stack([corner, corner + m + 1, corner + m + 2, corner + 1], axis=1)
