"""Rays that start where another face lies on their side, such as on the floor under a box."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import BackendError, copied_to_device, logger
from etendue.surfaces import Places, RayScene, Sides

from ..errors import RadiosityError
from .contacts import Contacts
from .occluders import Index

#: Points count as covered up to this distance from the face that covers them, in radii of the scene.
_NEAR = 1e-6


class CoveredSides:
    """What rays from ``sides`` meet. Faces in contact are set apart for rays, so that no ray between them would meet
    the other one: where a side is covered, all that a ray sees is the nearest face on it.

    patches: those that send rays, by default all. clashing: also what faces cover that clash, such as a door on a wall;
    lines know nothing of it, and rays among them must not.

    Raises :class:`RadiosityError` as :meth:`Contacts.of` does, if any of these patches bears such a face.
    """

    def __init__(self, scene: RayScene, sides: Sides, patches: Index | None = None, clashing: bool = False) -> None:
        of, count = scene.patches, len(sides.face)
        touching = of.coincident.back_to_back[sides.face]
        if clashing:
            touching |= np.isin(sides.face, of.coincident.clashing)
        if patches is not None:
            touching &= np.isin(sides.patch, patches)
        self._starts: mi.UInt32 | None = None
        if not touching.any():
            return
        contacts, patch_of = Contacts.of(of), of.sides
        left_out = set() if clashing else set(map(tuple, of.coincident.clashing.tolist()))
        entries: list[tuple[int, int]] = []
        numbers = np.zeros(count, np.int64)
        fronts = (sides.normals * of.face_normals[sides.face]).sum(axis=1) > 0
        known: dict[tuple[int, bool], list[tuple[int, int]]] = {}
        for k in np.flatnonzero(touching).tolist():
            face, front = int(sides.face[k]), bool(fronts[k])
            if (face, front) not in known:
                known[face, front] = [
                    (other, int(patch_of[other, 0 if contacts.facing_front(face, front, other) else 1]))
                    for other in contacts.covers(face, front)
                    if (min(face, other), max(face, other)) not in left_out
                ]
            entries += known[face, front]
            numbers[k] = len(known[face, front])
        if not entries:
            return
        others, seen = np.array(entries).T
        used, place = np.unique(others, return_inverse=True)
        self._starts = copied_to_device(mi.UInt32, np.concatenate([[0], np.cumsum(numbers)]))
        self._seen, self._place = copied_to_device(mi.UInt32, seen), copied_to_device(mi.UInt32, place.reshape(-1))
        self._edges = copied_to_device(mi.Float64, np.array([contacts.edges(face) for face in used.tolist()]))

    def meets(self, places: Places, found: mi.UInt32) -> mi.UInt32:
        """The patches that rays from ``places`` meet, as :meth:`RayScene.meets`, which has ``found`` others."""
        if self._starts is None:
            return found
        end = dr.gather(mi.UInt32, self._starts, places.side + 1)

        def is_inside(entry: mi.UInt32, going: mi.Bool) -> mi.Bool:
            first, inside = 16 * dr.gather(mi.UInt32, self._place, entry, going), mi.Bool(going)
            for edge in range(4):
                x, y, z, w = (dr.gather(mi.Float64, self._edges, first + 4 * edge + k, going) for k in range(4))
                inside &= places.point.x * x + places.point.y * y + places.point.z * z - w > -_NEAR
            return inside

        def step(entry: mi.UInt32, patch: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
            inside = is_inside(entry, entry < end)
            patch = dr.select(inside, dr.gather(mi.UInt32, self._seen, entry, inside), patch)
            return dr.select(inside, end, entry + 1), patch

        state = dr.gather(mi.UInt32, self._starts, places.side), mi.UInt32(found)
        return dr.while_loop(state, lambda entry, _: entry < end, step, label="covers of sides")[1]


def covered_lamps(scene: RayScene, sides: Sides) -> CoveredSides:
    """:class:`CoveredSides` of the ``sides`` that emit; warns if it is not known which face is in front: their light
    then passes the solids that touch them."""
    try:
        return CoveredSides(scene, sides)
    except (RadiosityError, BackendError) as error:
        logger.warning("light of emitters that touch other faces may get lost: %s", error)
        return CoveredSides(scene, sides, np.empty(0, np.int64))
