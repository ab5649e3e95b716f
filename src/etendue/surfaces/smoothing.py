"""Radiosity at vertices: values of patches made continuous over smooth surfaces, for pictures and renderers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, sparse

from .errors import SurfaceError
from .patches import Patches

Index = NDArray[np.int64]


@dataclass(frozen=True)
class VertexRadiosity:
    """A mesh with radiosities at its vertices.

    ``vertices``: (v, 3), one for each value at a position. ``faces``: (s, 4), a triangle repeats its last index; fronts
    in the order of the patches' faces, then the backs of sheets with reversed orientation. ``values``: (v, c) or (v,).
    ``patch``: (s,).
    """

    vertices: Array
    faces: Index
    values: Array
    patch: Index


def face_sides(patches: Patches) -> tuple[Index, Index]:
    """All sides of faces that belong to a patch: corners (s, 4), counterclockwise seen from that side, and the patch
    (s,).

    Fronts come first, in the order of the faces; then the backs of sheets.
    """
    has_front, has_back = patches.front >= 0, patches.back >= 0
    turned = patches.faces[has_back][:, ::-1]
    triangle = turned[:, 0] == turned[:, 1]
    turned[triangle] = turned[triangle][:, [1, 2, 3, 3]]
    return (
        np.concatenate([patches.faces[has_front], turned]),
        np.concatenate([patches.front[has_front], patches.back[has_back]]),
    )


def side_normals(patches: Patches) -> Array:
    """(s, 3) normals of the sides of :func:`face_sides`."""
    return np.concatenate([patches.face_normals[patches.front >= 0], -patches.face_normals[patches.back >= 0]])


def vertex_radiosity(patches: Patches, radiosity: ArrayLike, angle: float = 30.0) -> VertexRadiosity:
    """Radiosities (n, c) or (n,) of patches at the corners of their faces, for interpolation in between.

    Each corner of a face gets the mean over the adjacent faces with a normal within ``angle`` degrees, weighted by
    their angles at the corner, so that the triangulation of a wall does not matter. At sharper edges values stay
    separate: such a position has several vertices. A corner in the middle of another face's edge (a T-junction, after
    :meth:`Patches.subdivided`) ignores that face.

    Raises :class:`SurfaceError` for an angle outside [0, 180] and for values of another number of patches.
    """
    of_patches = np.asarray(radiosity, dtype=np.float64)
    if of_patches.ndim not in (1, 2) or len(of_patches) != len(patches):
        raise SurfaceError(f"radiosity has one row for each of {len(patches)} patches, not shape {of_patches.shape}")
    if not 0 <= angle <= 180:
        raise SurfaceError(f"the smoothing angle is 0 to 180 degrees, not {angle!r}")
    corners, patch = face_sides(patches)
    is_corner = np.ones(corners.shape, dtype=bool)
    is_corner[:, 3] = corners[:, 2] != corners[:, 3]
    weight = _corner_angles(patches.vertices, corners)[is_corner]
    places, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    at = place.reshape(-1)[corners][is_corner]
    side = np.broadcast_to(np.arange(len(corners))[:, None], corners.shape)[is_corner]

    matrices = sparse()
    rows = np.arange(len(at))
    incidence = matrices.csr_array((np.ones(len(at), np.int8), (rows, at)), shape=(len(at), len(places)))
    meeting = (incidence @ incidence.T).tocoo()
    normals = side_normals(patches)[side]
    cosine = (normals[meeting.row] * normals[meeting.col]).sum(axis=1)
    joined = cosine >= np.cos(np.radians(angle)) - 1e-9
    joined |= meeting.row == meeting.col
    row, column = meeting.row[joined], meeting.col[joined]
    means = matrices.csr_array((weight[column], (row, column)), shape=(len(at), len(at)))
    means.sort_indices()  # so that corners with the same neighbours add in the same order and become one vertex
    total = means.sum(axis=1)
    values = (means @ of_patches[patch[side]].reshape(len(at), -1)) / total[:, None]

    kept, first, number = np.unique(np.column_stack([at, values]), axis=0, return_index=True, return_inverse=True)
    faces = np.empty_like(corners)
    faces[is_corner] = number.reshape(-1)
    faces[~is_corner[:, 3], 3] = faces[~is_corner[:, 3], 2]
    return VertexRadiosity(
        places[at[first]], faces, kept[:, 1:].reshape(len(kept), *of_patches.shape[1:]), patch.astype(np.int64)
    )


def _corner_angles(vertices: Array, corners: Index) -> Array:
    """(s, 4) the angle of a face at each corner; the value for a triangle's repeated corner is meaningless."""
    points = vertices[corners]
    triangle = corners[:, 2] == corners[:, 3]
    before, after = np.roll(points, 1, axis=1), np.roll(points, -1, axis=1)
    before[triangle, 0], after[triangle, 2] = points[triangle, 2], points[triangle, 0]
    a, b = before - points, after - points
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2))
