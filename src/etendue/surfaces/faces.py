"""Flat faces: triangles and quadrilaterals as rows of four vertex indices; a triangle repeats its last index."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array

from .errors import PatchError

Index = NDArray[np.int64]

#: A face is degenerate if its area is below this part of its longest side squared.
_NO_AREA = 1e-12
#: A quadrilateral is flat if its corners are this close to their plane, in units of its size: the error of single
#: precision.
_FLAT = 1e-6
#: Most faces that a message names.
_NAMED = 20


def flat_faces(
    vertices: Array, faces: ArrayLike | Sequence[Sequence[int]], numbers: Index | None = None
) -> tuple[Index, Index]:
    """Flat and convex faces (f, 4), and for each the row of ``faces`` that contains it. Of a quadrilateral that becomes
    two triangles, one without area is left out.

    numbers: of the faces, for messages.

    Raises :class:`PatchError` if there are none, for another number of corners, for indices out of range, and for a
    face that crosses itself.
    """
    quads = _four_corners(faces)
    if len(quads) == 0:
        raise PatchError("there are no faces: a radiosity problem needs one patch at least")
    low, high = quads.min(), quads.max()
    if low < 0 or high >= len(vertices):
        bad = int(np.argmax(((quads < 0) | (quads >= len(vertices))).any(axis=1)))
        raise PatchError(f"face {bad} names vertex {low if low < 0 else high}, but there are {len(vertices)} vertices")
    # A quadrilateral with two equal consecutive corners is a triangle.
    for corner in range(3):
        same = quads[:, corner] == quads[:, corner + 1]
        quads[same, corner:3] = quads[same, corner + 1 :]
    same = (quads[:, 0] == quads[:, 3]) & (quads[:, 2] != quads[:, 3])
    quads[same, 3] = quads[same, 2]
    bent = np.flatnonzero(_is_bent(vertices, quads))
    if len(bent) == 0:
        return quads, np.arange(len(quads))
    halves, crossed = _halves(vertices, quads[bent])
    if crossed.any():
        bad = bent[crossed][0]
        raise PatchError(f"face {bad if numbers is None else numbers[bad]} crosses itself: cut it into triangles")
    has_area = ~face_vectors(vertices, halves)[1]
    has_area |= np.repeat(~has_area.reshape(-1, 2).any(axis=1), 2)
    rows = np.concatenate([np.delete(np.arange(len(quads)), bent), np.repeat(bent, 2)[has_area]])
    order = np.argsort(rows, kind="stable")
    return np.concatenate([np.delete(quads, bent, axis=0), halves[has_area]])[order], rows[order]


def face_vectors(vertices: Array, faces: Index) -> tuple[Array, NDArray[np.bool_]]:
    """Normals (f, 3) with twice the area as length, and which faces are degenerate."""
    a, b, c, d = (vertices[faces[:, i]] for i in range(4))
    vectors = np.cross(c - a, d - b)
    longest = np.maximum.reduce([((x - y) ** 2).sum(axis=1) for x, y in ((a, b), (b, c), (c, d), (d, a), (a, c))])
    return vectors, ~(np.linalg.norm(vectors, axis=1) > _NO_AREA * longest)


def triangles(faces: Index) -> tuple[Index, Index]:
    """Triangles (t, 3) of the faces, and the face of each triangle."""
    quad = np.flatnonzero(faces[:, 2] != faces[:, 3])
    corners = np.concatenate([faces[:, :3], faces[quad][:, [0, 2, 3]]])
    return corners, np.concatenate([np.arange(len(faces)), quad])


def repeated(vertices: Array, faces: Index) -> Index:
    """Indices of those ``faces`` (f, 4) that have the corners of an earlier face in the same orientation; two faces
    back to back are no duplicates."""
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    corners = place.reshape(-1)[faces]
    count = np.where(faces[:, 2] == faces[:, 3], 3, 4)[:, None]
    turn = (np.argmin(corners, axis=1)[:, None] + np.arange(4)) % count
    _, first = np.unique(np.take_along_axis(corners, turn, axis=1), axis=0, return_index=True)
    return np.setdiff1d(np.arange(len(faces)), first)


def named_faces(numbers: Index) -> str:
    """The first of the numbers of some faces, for messages."""
    return ", ".join(map(str, numbers[:_NAMED])) + (", ..." if len(numbers) > _NAMED else "")


def _four_corners(faces: ArrayLike | Sequence[Sequence[int]]) -> Index:
    try:
        array = np.asarray(faces)
    except ValueError:  # rows of unequal length
        rows = [list(row) for row in cast(Sequence[Sequence[int]], faces)]
        bad = next((i for i, row in enumerate(rows) if len(row) not in (3, 4)), None)
        if bad is not None:
            raise PatchError(f"face {bad} has {len(rows[bad])} corners; cut it into triangles") from None
        array = np.array([row if len(row) == 4 else [*row, row[2]] for row in rows])
    if array.size == 0:
        return np.empty((0, 4), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] not in (3, 4) or array.dtype.kind not in "iu":
        raise PatchError(f"faces are whole numbers (m, 3) or (m, 4), not {array.dtype} of shape {array.shape}")
    array = array.astype(np.int64)
    return array if array.shape[1] == 4 else array[:, [0, 1, 2, 2]]


def _is_bent(vertices: Array, quads: Index) -> NDArray[np.bool_]:
    """Whether a quadrilateral is not flat, or not convex."""
    corners = vertices[quads]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    length = np.linalg.norm(normal, axis=1)
    size = np.sqrt(np.maximum(length, 1e-300))
    away = np.abs(((corners[:, 1] - corners[:, 0]) * normal).sum(axis=1))
    bent = away > _FLAT * size * length
    for i in range(4):
        before, here, after = corners[:, i - 1], corners[:, i], corners[:, (i + 1) % 4]
        turn = (np.cross(here - before, after - here) * normal).sum(axis=1)
        bent |= turn < -_FLAT * length**2
    return bent & (quads[:, 2] != quads[:, 3])


def _halves(vertices: Array, quads: Index) -> tuple[Index, NDArray[np.bool_]]:
    """Two consecutive triangles for each quadrilateral, along the diagonal that keeps the orientation of both; and
    whether none does."""
    one = np.stack([quads[:, [0, 1, 2, 2]], quads[:, [0, 2, 3, 3]]], axis=1)
    other = np.stack([quads[:, [1, 2, 3, 3]], quads[:, [1, 3, 0, 0]]], axis=1)
    upright, turned = [], []
    for halves in one, other:
        (first, no_first), (second, no_second) = (face_vectors(vertices, halves[:, i]) for i in range(2))
        product = (first * second).sum(axis=1)
        upright.append(product > 0)
        turned.append((product < 0) & ~no_first & ~no_second)
    return np.where(upright[0][:, None, None], one, other).reshape(-1, 4), turned[0] & turned[1]
