"""Boxes and rooms as vertices and faces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array

Mesh = tuple[Array, NDArray[np.int64]]


def box(low: ArrayLike, high: ArrayLike, cells: ArrayLike = 1, inward: bool = False) -> Mesh:
    """Vertices (v, 3) and quadrilaterals (m, 4) of a box, cut into ``cells`` along each axis, a number or three.

    Its faces look outward, or ``inward`` for a room. Walls are in the order low x, high x, low y ..., each with its own
    vertices, at the same positions as those of its neighbours.
    """
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    cuts = np.broadcast_to(np.asarray(cells, dtype=np.int64), 3)
    lines = [np.linspace(low[axis], high[axis], cuts[axis] + 1) for axis in range(3)]
    walls = []
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        j, k = (x.ravel() for x in np.meshgrid(np.arange(cuts[b] + 1), np.arange(cuts[c] + 1), indexing="ij"))
        first = (j * (cuts[c] + 1) + k)[(j < cuts[b]) & (k < cuts[c])]
        quads = np.stack([first, first + cuts[c] + 1, first + cuts[c] + 2, first + 1], axis=1)
        for end in range(2):
            points = np.empty((len(j), 3))
            points[:, axis], points[:, b], points[:, c] = lines[axis][-end], lines[b][j], lines[c][k]
            walls.append((points, quads if (end == 1) != inward else quads[:, ::-1]))
    return joined(*walls)


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)
