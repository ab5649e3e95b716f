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
from ..periods import LEAST_SLOPE

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
    ``radius``. Faces that lie back to back are set apart (:class:`Coincident`); a warning names those that clash.

    Rays through patches with a ``period`` go on in its repetitions; those flatter than ``LEAST_SLOPE`` get this slope.
    """

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

        pi = self.hit(mi.Point3f(_columns(origins)), mi.Vector3f(_columns(directions)))
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

        if self.patches.period is not None:
            return self._hit_again(mi.Point3d(origins), mi.Vector3d(directions), mi.Bool(active))
        ray = mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))
        return self._scene.ray_intersect_preliminary(ray, coherent=False, active=active)

    def _hit_again(self, origins: mi.Point3d, directions: mi.Vector3d, active: mi.Bool) -> mi.PreliminaryIntersection3f:
        """:meth:`hit` in a periodic domain: a ray that leaves the period at a side enters it at the opposite one. Both
        parts overlap by two steps at the side, so that rounding lets no ray pass a face there."""
        import mitsuba as mi

        assert self.patches.period is not None
        lengths = [dr.opaque(mi.Float64, x / self.radius if x else np.inf) for x in self.patches.period]
        top = dr.opaque(mi.Float64, np.ptp(self.patches.bounds, axis=0)[2] / 2 / self.radius)
        d = mi.Vector3d(directions)
        d.z = dr.mulsign(dr.maximum(dr.abs(d.z), LEAST_SLOPE), d.z)
        p = mi.Point3d(origins)
        p.x, p.y = (dr.select(dr.isfinite(x), a - x * dr.round(a / x), a) for a, x in zip(p, lengths, strict=False))

        def way_to_side(p: mi.Point3d, further: float) -> list[mi.Float64]:
            """Way to the planes of the sides, or a little further, along both axes."""
            return [
                dr.maximum((x / 2 + further - dr.mulsign(a, c)) / dr.abs(c), 0.0)
                for a, c, x in zip(p, d, lengths, strict=False)
            ]

        def step(
            p: mi.Point3d, way: mi.Float64, going: mi.Bool, t: mi.Float, triangle: mi.UInt32
        ) -> tuple[mi.Point3d, mi.Float64, mi.Bool, mi.Float, mi.UInt32]:
            ray = mi.Ray3f(mi.Point3f(p), mi.Vector3f(d))
            ray.maxt = mi.Float(dr.minimum(*way_to_side(p, STEP)))
            found = self._scene.ray_intersect_preliminary(ray, coherent=False, active=going)
            is_hit = going & found.is_valid()
            t = dr.select(is_hit, found.t + mi.Float(way), t)
            triangle = dr.select(is_hit, found.prim_index, triangle)
            to_x, to_y = way_to_side(p, -STEP)
            on = dr.minimum(to_x, to_y)
            p = dr.fma(d, on, p)
            p.x -= dr.select(to_x <= on, dr.mulsign(lengths[0], d.x), 0.0)
            p.y -= dr.select(to_y <= on, dr.mulsign(lengths[1], d.y), 0.0)
            is_out = (dr.mulsign(p.z, d.z) > top) | ~dr.isfinite(on)
            return p, way + on, going & ~is_hit & ~is_out, t, triangle

        none = dr.zeros(mi.Float64, dr.width(p, d))
        state = p, none, active & (none == 0), mi.Float(none) + dr.inf, mi.UInt32(none)
        *_, t, triangle = dr.while_loop(state, lambda p, way, going, *_: going, step, label="periodic rays")
        result = dr.zeros(mi.PreliminaryIntersection3f, dr.width(t))
        result.valid, result.t, result.prim_index = dr.isfinite(t), t, triangle
        return result

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
