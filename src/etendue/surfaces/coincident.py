"""Faces that lie on each other: thin plates and solids that touch, and faces that hide others of the same side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, logger, sparse

if TYPE_CHECKING:
    from .patches import Patches

Index = NDArray[np.int64]

#: Faces closer to each other than this lie on each other, in radii of the scene: a few times the error of single
#: precision.
_TOGETHER = 1e-6
#: Volumes smaller than this length times the area of all faces count as zero, in radii of the scene.
_NO_DEPTH = 1e-7
#: Distance by which :meth:`Coincident.apart` moves a face to its front, in radii of the scene. Two such faces that
#: rounding has put in the wrong order, at most ``_TOGETHER`` from each other, are then in the right one.
_APART = 1e-6
#: Largest distance of two faces that were set apart, in radii of the scene, with some room for rounding.
REACH_OF_PAIRS = 1.3 * (_TOGETHER + 2 * _APART)


@dataclass
class Coincident:
    """Faces that lie on each other, in part or as a whole.

    pairs: (k, 2) faces that lie on each other, the lower number first.
    back_to_back: (f,) one-sided faces on which another one lies with opposite orientation: the sides of a thin plate,
        or two solids that touch.
    flat: (f,) those of them that are part of no solid: all faces connected with them, at common corners, lie in a
        plane.
    clashing: (k, 2) pairs of faces that bear a patch on the same side, such as a door on a wall: it is arbitrary which
        of them receives the light of lines and rays.
    """

    pairs: Index
    back_to_back: NDArray[np.bool_]
    flat: NDArray[np.bool_]
    clashing: Index
    _is_told: bool = False

    @classmethod
    def of(cls, patches: Patches) -> Coincident:
        """The coincident faces of patches."""
        from . import boxtrees

        centre, radius = patches.sphere
        corners = (patches.vertices[patches.faces] - centre) / radius
        tree = box_tree(corners.min(axis=1), corners.max(axis=1))[:3]
        pairs = boxtrees.overlapping(corners, patches.face_normals, patches.face_areas, tree, _TOGETHER)
        pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
        one, other = pairs.T
        is_sheet = patches.back >= 0
        opposite = (patches.face_normals[one] * patches.face_normals[other]).sum(axis=1) < 0
        is_plate = opposite & ~is_sheet[one] & ~is_sheet[other]
        back_to_back = np.zeros(len(corners), dtype=bool)
        back_to_back[pairs[is_plate]] = True
        flat = back_to_back & _is_flat(patches, corners) if back_to_back.any() else back_to_back
        return cls(pairs, back_to_back, flat, pairs[~is_plate])

    @property
    def kinds(self) -> NDArray[np.uint8]:
        """(f,) for loops: 1 for faces that lie back to back on others, 2 for those that are also ``flat``, else 0."""
        return self.back_to_back.astype(np.uint8) + self.flat.astype(np.uint8)

    def apart(self, patches: Patches) -> tuple[Array, Index]:
        """Vertices and faces for rays, with faces that lie back to back set apart: each is moved a millionth of the
        scene's radius to its front, where the light is that it receives. Otherwise rounding, or the order of the faces,
        would decide which of the two a ray meets."""
        moved = np.flatnonzero(self.back_to_back)
        if len(moved) == 0:
            return patches.vertices, patches.faces
        faces = patches.faces.copy()
        corners = patches.vertices[faces[moved]] + _APART * patches.sphere[1] * patches.face_normals[moved, None]
        is_triangle = faces[moved, 2] == faces[moved, 3]
        faces[moved] = len(patches.vertices) + np.arange(4 * len(moved)).reshape(-1, 4)
        faces[moved[is_triangle], 3] = faces[moved[is_triangle], 2]
        return np.concatenate([patches.vertices, corners.reshape(-1, 3)]), faces

    def warn(self, patches: Patches) -> None:
        """Name faces that clash, once."""
        if len(self.clashing) and not self._is_told:
            self._is_told = True
            logger.warning(
                "%s; it is arbitrary which of them receives the light (of exact form factors, the smaller): cut the "
                "lower one, or remove one",
                self.named(patches),
            )

    def named(self, patches: Patches) -> str:
        """The first of the faces that clash, in words."""
        one, other = self.clashing[0]
        text = f"faces {one} and {other}"
        fronts = patches.front[[one, other]]
        if (fronts < 0).any():
            return text + " lie on each other, and one is an obstacle"
        labels = patches.labels[fronts]
        if not np.array_equal(labels, [one, other]):
            text += f" (of patches labelled {labels[0]} and {labels[1]})"
        if patches.shapes is not None and (shapes := patches.shapes[fronts]).min() >= 0:
            text += " of " + " and ".join(f"'{patches.shape_names[k]}'" for k in shapes)
        text += " lie on each other and face the same way"
        more = len(self.clashing) - 1
        return text + (f", as do {more} more pair{'' if more == 1 else 's'}" if more else "")


def is_interior(patches: Patches) -> bool:
    """Whether the one-sided faces face the inside of a closed space, such as a room, and not the outside of solids;
    determined by the sign of the volume."""
    sided, (centre, radius) = patches.back < 0, patches.sphere
    first = (patches.vertices[patches.faces[sided, 0]] - centre) / radius
    areas = patches.face_areas[sided]
    return bool((first * patches.face_normals[sided]).sum(axis=1) @ areas / 3 < -_NO_DEPTH * areas.sum())


def surfaces_of(patches: Patches) -> Index:
    """(f,) a number for the connected surface that each face belongs to; vertices at the same position count as one."""
    from scipy.sparse.csgraph import connected_components

    _, place = np.unique(patches.vertices, axis=0, return_inverse=True)
    corners = place.reshape(-1)[patches.faces]
    links = np.ones(corners[:, 1:].size), (np.repeat(corners[:, 0], 3), corners[:, 1:].ravel())
    count = len(place)
    _, part = connected_components(sparse().coo_array(links, shape=(count, count)))
    return np.asarray(part[corners[:, 0]], dtype=np.int64)


def _is_flat(patches: Patches, corners: Array) -> NDArray[np.bool_]:
    """(f,) whether all faces of the surface that a face belongs to lie in a plane. ``corners``: in radii."""
    part = surfaces_of(patches)
    _, first, part = np.unique(part, return_index=True, return_inverse=True)
    plane = first[part]
    away = np.abs(((corners - corners[plane, :1]) * patches.face_normals[plane, None]).sum(axis=2)).max(axis=1)
    is_bent = np.zeros(len(first), dtype=bool)
    is_bent[part[away > _TOGETHER]] = True
    return np.asarray(~is_bent[part])


def box_tree(low: Array, high: Array) -> tuple[Array, Index, Index, int]:
    """A tree over boxes (n, 3): corners of its nodes (m, 2, 3), links (m, 3), the order of the boxes, and the depth of
    the deepest leaf; see ``build`` of the loops."""
    from . import boxtrees

    tree: Any = boxtrees.build(low, high)
    return tree[0], tree[1], tree[2], int(tree[3])
