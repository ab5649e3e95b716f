"""Mirror images of particles at the borders of flat rectangles."""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.scene import RenderSpace

from ..patches import Patches
from .places import Located

#: Tolerance of the area and the normals of faces that form a rectangle.
_SAME = 1e-4
#: Number of edges that are tried as a side of the rectangle.
_TRIED = 16


class Mirror:
    """Mirrors particles on those shapes of ``patches`` that are flat rectangles."""

    def __init__(self, patches: Patches, space: RenderSpace) -> None:
        assert patches.shapes is not None
        self._scale = space.scale
        faces_of = patches.shapes[patches.front]
        self._rectangles = {}
        for shape in np.unique(faces_of):
            found = _rectangle(patches, np.flatnonzero(faces_of == shape), space)
            if found is not None:
                self._rectangles[int(shape)] = found

    def images(self, at: Located, bandwidths: Array, reach: float) -> tuple[Located, Array]:
        """Particles and their images within ``reach`` bandwidths of a border, and the bandwidths of both."""
        parts, widths = [at], [bandwidths]
        for shape, (origin, axes, sides) in self._rectangles.items():
            own = np.flatnonzero(at.shape == shape)
            x = (at.position[own] - origin) @ axes.T
            near = bandwidths[own] * (reach * self._scale)
            for way in product((-1, 0, 1), repeat=2):
                moved, kept = np.zeros_like(x), np.ones(len(x), dtype=bool)
                for axis, side in enumerate(way):
                    if side:
                        away = (sides[axis] if side > 0 else 0.0) - x[:, axis]
                        kept &= np.abs(away) <= near
                        moved[:, axis] = 2 * away
                if any(way) and kept.any():
                    image = at.only(own[kept])
                    parts.append(dataclasses.replace(image, position=image.position + moved[kept] @ axes))
                    widths.append(bandwidths[own[kept]])
        names = [field.name for field in dataclasses.fields(Located)]
        joined = Located(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
        return joined, np.concatenate(widths)


def _rectangle(patches: Patches, faces: NDArray[np.int64], space: RenderSpace) -> tuple[Array, Array, Array] | None:
    """(corner, two axes (2, 3), two sides) in render space of faces that form a flat rectangle, else
    ``None``."""
    normals = patches.face_normals[faces]
    if (normals @ normals[0] < 1 - _SAME).any():
        return None
    corners = space.from_scene(patches.vertices[patches.faces[faces]])
    edges = np.concatenate([np.roll(corners, -1, axis=1) - corners, corners[:, 2:3] - corners[:, :1]], axis=1)
    directions = edges.reshape(-1, 3)
    lengths = np.linalg.norm(directions, axis=1)
    points, area = corners.reshape(-1, 3), patches.face_areas[faces].sum() * space.scale**2
    for first in (directions[lengths > 0] / lengths[lengths > 0, None])[:_TRIED]:
        axes = np.stack([first, np.cross(normals[0], first)])
        x = points @ axes.T
        low, sides = x.min(axis=0), np.ptp(x, axis=0)
        if np.prod(sides) <= area * (1 + _SAME) and np.ptp(points @ normals[0]) <= _SAME * sides.max():
            origin = low @ axes + (points[0] @ normals[0]) * normals[0]
            return origin, axes, sides
    return None
