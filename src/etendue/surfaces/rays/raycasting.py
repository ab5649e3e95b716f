"""Rays against patches by Mitsuba: one mesh, centred and of unit size, since rays have single precision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device, use_variant

from ..faces import triangles
from ..patches import Patches

if TYPE_CHECKING:
    import mitsuba as mi

Index = NDArray[np.int64]

#: Offset of a continued ray, in radii. A smaller one makes it hit the same face again, a larger one skip thin gaps.
STEP = 1e-6


@dataclass(frozen=True)
class Hits:
    """First hits: for each ray with a hit its index, the distance in radii, and the face. Host arrays."""

    ray: Index
    distance: NDArray[np.float32]
    face: Index


class RayScene:
    """Patches as a scene for rays, in unit coordinates: relative to the ``centre`` of the patches, in units of their
    ``radius``. Faces that lie back to back are set apart (:class:`Coincident`); a warning names those that clash."""

    def __init__(self, patches: Patches) -> None:
        use_variant()
        import mitsuba as mi

        self.patches = patches
        self.centre, self.radius = patches.sphere
        patches.coincident.warn(patches)
        vertices, faces = patches.coincident.apart(patches)
        corners, self._face = triangles(faces)
        mesh = mi.Mesh("patches", len(vertices), len(corners))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(self.local(vertices), np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(corners, np.uint32).ravel()
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "patches": mesh})
        # For each triangle, on the device: the face, its normal, and the patches of its front and its back.
        self._faces = copied_to_device(mi.UInt32, self._face)
        self._normals = copied_to_device(mi.Float, patches.face_normals[self._face])
        self._sides = copied_to_device(mi.UInt32, patches.sides[self._face])
        self._sky = dr.opaque(mi.UInt32, len(patches))

    def local(self, points: Array) -> Array:
        """Points (k, 3) in unit coordinates."""
        return (points - self.centre) / self.radius

    def first_hits(self, origins: Array, directions: Array) -> Hits:
        """Closest hits of rays with origins and directions (k, 3), in unit coordinates."""
        import mitsuba as mi

        ray = mi.Ray3f(mi.Point3f(_columns(origins)), mi.Vector3f(_columns(directions)))
        pi = self._scene.ray_intersect_preliminary(ray, coherent=False)
        distance, triangle = np.array(pi.t), np.array(pi.prim_index)
        hit = np.flatnonzero(np.isfinite(distance))
        return Hits(hit, distance[hit], self._face[triangle[hit]])

    def first_patches(self, origins: Array, directions: Array) -> Index:
        """The patch that each ray (k, 3) hits first; of n patches, ``n`` is the sky, ``n + 1`` the back of a face."""
        import mitsuba as mi

        if len(origins) == 0:  # Dr.Jit cannot trace empty arrays
            return np.zeros(0, np.int64)
        return np.array(self.meets(mi.Point3f(_columns(origins)), mi.Vector3f(_columns(directions)))).astype(np.int64)

    def hit(
        self, origins: mi.Point3f, directions: mi.Vector3f, active: mi.Bool | bool = True
    ) -> mi.PreliminaryIntersection3f:
        """:meth:`first_hits` on the device, for lanes of points and directions."""
        import mitsuba as mi

        ray = mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))
        return self._scene.ray_intersect_preliminary(ray, coherent=False, active=active)

    def meets(self, origins: mi.Point3f, directions: mi.Vector3f) -> mi.UInt32:
        """:meth:`first_patches` on the device."""
        return self.patch_of(self.hit(origins, directions), directions)

    def patch_of(self, hit: mi.PreliminaryIntersection3f, directions: mi.Vector3f) -> mi.UInt32:
        """The patch of a :meth:`hit` on the device; see :meth:`first_patches`."""
        import mitsuba as mi

        is_hit = hit.is_valid()
        is_back = dr.dot(self.normal_of(hit), directions) > 0
        patch = dr.gather(mi.UInt32, self._sides, 2 * hit.prim_index + dr.select(is_back, mi.UInt32(1), 0), is_hit)
        return dr.select(is_hit, patch, self._sky)

    def normal_of(self, hit: mi.PreliminaryIntersection3f) -> mi.Vector3f:
        """Normals of the front sides of the faces that were hit; zero without a hit."""
        import mitsuba as mi

        return dr.gather(mi.Vector3f, self._normals, hit.prim_index, hit.is_valid())

    def face_of(self, hit: mi.PreliminaryIntersection3f) -> mi.UInt32:
        """The faces that were hit; 0 without a hit."""
        import mitsuba as mi

        return dr.gather(mi.UInt32, self._faces, hit.prim_index, hit.is_valid())

    def sides(self, face: Index, directions: Array) -> tuple[Index, Index]:
        """Patches of the sides of faces towards the origins of rays, and away from them; ``n + 1`` for a side without a
        patch."""
        front, back = self.patches.sides[face].T
        is_back = (self.patches.face_normals[face] * directions).sum(axis=1) > 0
        return np.where(is_back, back, front), np.where(is_back, front, back)


def _columns(rows: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(rows.T, dtype=np.float32)
