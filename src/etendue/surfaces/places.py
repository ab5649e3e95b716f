"""Values of patches at any point of their surfaces: finds the face and the position on it."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, copied_to_device, use_variant
from etendue.scene import RenderSpace

from .faces import triangles
from .patches import Patches
from .smoothing import face_sides, side_normals, vertex_radiosity

Index = NDArray[np.int64]

#: Origins of the short rays onto a point, in radii of the scene: height above it, and two offsets to the side. First at
#: the point; then slightly to the side, in case it lies between two faces; then from higher up, since the true surface
#: may be curved where faces are flat; then further to the side, for the rim of a disk, which is a polygon here.
_LOOKS = (
    *((1e-5, 0.0, 0.0), (1e-5, 2e-6, 0.0), (1e-5, -2e-6, 0.0)),
    *((height, 0.0, 0.0) for height in (1e-4, 1e-3, 2e-2)),
    *((1e-5, aside * x, aside * y) for aside in (6e-5, 6e-4, 6e-3) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))),
)
#: Each side of a face is lifted by this distance, so that a ray hits the right one of two coincident faces.
_LIFT = 2e-6
#: Smallest cosine between the normals of a surface and of the face that represents it.
_SAME_SIDE = 0.3


@dataclass
class Place:
    """Points on patches, one lane each."""

    side: mi.UInt32  #: the side of a face, as :func:`face_sides` numbers them
    weights: mi.Vector4f  #: of its four corners
    found: mi.Bool  #: whether there is a patch at all


class PatchSurfaces:
    """Finds the patches at points, by short rays against the sides of their faces."""

    def __init__(self, patches: Patches) -> None:
        use_variant()
        self.patches = patches
        self.corners, self.patch = face_sides(patches)
        self._centre, self._radius = patches.sphere
        normals = side_normals(patches)
        points = ((patches.vertices - self._centre) / self._radius)[self.corners] + _LIFT * normals[:, None, :]
        is_triangle = self.corners[:, 2] == self.corners[:, 3]
        numbers = np.arange(4 * len(points)).reshape(-1, 4)
        numbers[is_triangle, 3] -= 1
        halves, side = triangles(numbers)
        mesh = mi.Mesh("sides", 4 * len(points), len(halves))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(halves, np.uint32).ravel()
        parameters.update()
        self._scene = mi.load_dict({"type": "scene", "sides": mesh})
        self._side = copied_to_device(mi.UInt32, side.astype(np.uint32))
        self._normal = copied_to_device(mi.Float, normals.astype(np.float32))
        self._is_triangle = copied_to_device(mi.UInt32, is_triangle.astype(np.uint32))

    def find(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool, space: RenderSpace | None = None) -> Place:
        """Places of the points ``p`` of surfaces with normals ``n`` on the visible side. Both are in ``space``, by
        default that of the patches. Casts rays in separate kernels, so it must not be used in device loops.
        """
        count = max(dr.width(p), dr.width(active))
        place = Place(dr.zeros(mi.UInt32, count), dr.zeros(mi.Vector4f, count), dr.full(mi.Bool, False, count))
        space = space or RenderSpace()
        # A large offset from the origin is subtracted in double precision.
        origin = space.from_scene(self._centre)
        local = (mi.Point3f(p) - mi.Point3f(*map(float, origin))) * float(1 / (space.scale * self._radius))
        looking = mi.Bool(active) & dr.full(mi.Bool, True, count)
        dr.eval(local, n, looking)
        for height, x, y in _LOOKS:
            lane = dr.compress(looking)
            if not dr.width(lane):
                break
            there, up = dr.gather(mi.Point3f, local, lane), dr.gather(mi.Normal3f, n, lane)
            tangent, bitangent = mi.coordinate_system(up)
            ray = mi.Ray3f(there + height * up + x * tangent + y * bitangent, -up)
            ray.maxt = mi.Float(2 * height)
            met = self._scene.ray_intersect_preliminary(ray, coherent=False)
            hit = met.is_valid()
            side = dr.gather(mi.UInt32, self._side, met.prim_index, hit)
            towards = dr.dot(dr.gather(mi.Normal3f, self._normal, side, hit), up)
            dr.scatter(place.side, side, lane, hit)
            dr.scatter(place.weights, self._weights(side, met, hit), lane, hit)
            dr.scatter(place.found, towards > _SAME_SIDE, lane, hit)
            dr.scatter(looking, mi.Bool(False), lane, hit)
            dr.eval(place.side, place.weights, place.found, looking)
        return place

    def _weights(self, side: mi.UInt32, met: mi.PreliminaryIntersection3f, active: mi.Bool) -> mi.Vector4f:
        """Linear on triangles, bilinear on quadrilaterals, whose triangles are 0 1 2 and 0 2 3."""
        u, v = met.prim_uv.x, met.prim_uv.y
        is_second = met.prim_index >= len(self.corners)
        s, t = dr.select(is_second, u, u + v), dr.select(is_second, u + v, v)
        is_triangle = dr.gather(mi.UInt32, self._is_triangle, side, active) != 0
        bilinear = mi.Vector4f((1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t)
        return dr.select(is_triangle, mi.Vector4f(1 - u - v, u, v, 0.0), bilinear)


class SurfaceValues:
    """A function on the surfaces: ``constant`` of the patch, plus ``factor`` of the patch times a value interpolated
    between the corners of its faces.

    constant, factor: (n, c) or (n, 1), of one channel or three. between: (n, c), the values of patches to interpolate
    (:func:`vertex_radiosity`, over edges of at most ``angle`` degrees).
    """

    def __init__(
        self,
        surfaces: PatchSurfaces,
        constant: ArrayLike,
        factor: ArrayLike | None = None,
        between: ArrayLike | None = None,
        angle: float = 30.0,
    ) -> None:
        self._constant = _colours(constant)
        self._patch = copied_to_device(mi.UInt32, surfaces.patch.astype(np.uint32))
        self._factor = None
        if factor is not None and between is not None:
            smooth = vertex_radiosity(surfaces.patches, between, angle)
            self._factor, self._values = _colours(factor), _colours(smooth.values)
            self._corners = copied_to_device(mi.UInt32, smooth.faces.astype(np.uint32))

    def at(self, place: Place) -> mi.Color3f:
        """Colours at places; black where there is no patch."""
        patch = dr.gather(mi.UInt32, self._patch, place.side, place.found)
        value = dr.gather(mi.Color3f, self._constant, patch, place.found)
        if self._factor is not None:
            total = dr.zeros(mi.Color3f)
            for k in range(4):
                corner = dr.gather(mi.UInt32, self._corners, 4 * place.side + k, place.found)
                total += place.weights[k] * dr.gather(mi.Color3f, self._values, corner, place.found)
            value += total * dr.gather(mi.Color3f, self._factor, patch, place.found)
        return value & place.found


def _colours(values: ArrayLike) -> mi.Float:
    """(n, c) numbers as colours on the device."""
    rows: Array = np.asarray(values, dtype=np.float64)
    rows = np.broadcast_to(rows.reshape(len(rows), -1), (len(rows), 3))
    return copied_to_device(mi.Float, rows.astype(np.float32))
