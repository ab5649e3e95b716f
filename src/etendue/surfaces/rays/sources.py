"""Rays from sides of patches, generated on the device: from the index of a point to the hit of a ray in one kernel.
Lanes are arrays of the current variant."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device

from .raycasting import STEP, RayScene
from .sides import Sides

#: Rays traced at once.
BATCH = 1 << 20
#: The largest number below 1.
_BELOW_ONE = float(np.nextafter(1, 0))


@dataclass(frozen=True)
class Places:
    """Points of sides: ``side`` (UInt32), ``point`` and ``normal`` (Point3d, Vector3d), in unit coordinates."""

    side: mi.UInt32
    point: mi.Point3d
    normal: mi.Vector3d

    @property
    def origin(self) -> mi.Point3d:
        """Ray origins: slightly above the side."""
        return self.point + STEP * self.normal

    def directions(self, ways: mi.Vector3f) -> mi.Vector3f:
        """Directions in scene coordinates from ``ways`` in frames whose third axis is the normal."""
        return mi.Frame3f(mi.Normal3f(self.normal)).to_world(ways)


class RaySource:
    """Sides on the device: samples one of all sides, or one of a patch, in proportion to its share of ``edges``."""

    def __init__(self, scene: RayScene, sides: Sides) -> None:
        self.scene, self.sides = scene, sides
        self._corners = copied_to_device(mi.Float, sides.corners)
        self._normals = copied_to_device(mi.Float, sides.normals)
        self._edges = copied_to_device(mi.Float64, sides.edges)
        self._patch = copied_to_device(mi.UInt32, sides.patch)
        self._face = copied_to_device(mi.UInt32, sides.face)
        starts = np.searchsorted(sides.patch, np.arange(len(scene.patches) + 1))
        self._starts = copied_to_device(mi.UInt32, starts)
        self._most = int(np.diff(starts).max())
        self._count, self._whole = dr.opaque(mi.UInt32, len(sides.patch)), dr.opaque(mi.Float64, sides.edges[-1])

    def patch_of(self, side: mi.UInt32) -> mi.UInt32:
        """Numbers of patches."""
        return dr.gather(mi.UInt32, self._patch, side)

    def face_of(self, side: mi.UInt32) -> mi.UInt32:
        """Numbers of faces."""
        return dr.gather(mi.UInt32, self._face, side)

    def any(self, u: mi.Float64, v: mi.Float64) -> Places:
        """Places on all sides, sampled by ``edges``, from lanes of numbers in [0, 1)."""
        return self._places(u * self._whole, v, mi.UInt32(0), self._count, len(self.sides.patch))

    def of(self, patch: mi.UInt32, u: mi.Float64, v: mi.Float64) -> Places:
        """Places on given patches. For an empty patch they are anywhere."""
        first, end = dr.gather(mi.UInt32, self._starts, patch), dr.gather(mi.UInt32, self._starts, patch + 1)
        first = dr.minimum(first, self._count - 1)  # of an empty patch behind the last side
        low, high = dr.gather(mi.Float64, self._edges, first), dr.gather(mi.Float64, self._edges, end)
        return self._places(low + u * (high - low), v, first, end, self._most)

    def _places(self, place: mi.Float64, v: mi.Float64, first: mi.UInt32, end: mi.UInt32, most: int) -> Places:
        side = first
        for bit in reversed(range((most - 1).bit_length())):
            further = side + (1 << bit)
            is_in = further < end
            side = dr.select(is_in & (dr.gather(mi.Float64, self._edges, further, is_in) <= place), further, side)
        low, high = dr.gather(mi.Float64, self._edges, side), dr.gather(mi.Float64, self._edges, side + 1)
        # The remainder of the number is uniform again.
        root = dr.sqrt(dr.clip((place - low) / (high - low), 0.0, _BELOW_ONE))
        a, b, c = (mi.Point3d(dr.gather(mi.Point3f, self._corners, 3 * side + i)) for i in range(3))
        normal = mi.Vector3d(dr.gather(mi.Vector3f, self._normals, side))
        return Places(side, (1 - root) * a + root * (1 - v) * b + root * v * c, normal)


def cosine_lanes(u: mi.Float64, v: mi.Float64) -> mi.Vector3f:
    """Directions of cosine density around the third axis, from lanes of numbers in [0, 1)."""
    sine, cosine = dr.sincos(dr.two_pi * mi.Float(v))
    r = mi.Float(dr.sqrt(u))
    return mi.Vector3f(r * cosine, r * sine, mi.Float(dr.sqrt(1 - u)))


def even_lanes(u: mi.Float64, v: mi.Float64) -> mi.Vector3f:
    """Directions evenly spread over both angles: theta = pi/2 u, phi = 2 pi v."""
    sine, cosine = dr.sincos(dr.two_pi * mi.Float(v))
    r, z = dr.sincos(dr.pi / 2 * mi.Float(u))
    return mi.Vector3f(r * cosine, r * sine, z)


def columns(u: Array) -> list[mi.Float64]:
    """Numbers (k, d) as lanes."""
    return [mi.Float64(np.ascontiguousarray(column)) for column in u.T]


def pairs_of(one: mi.UInt32, other: mi.UInt32) -> NDArray[np.uint32]:
    """Two arrays of lanes as a NumPy array (k, 2), evaluated in one kernel."""
    both = mi.UInt64(one) | (mi.UInt64(other) << 32)
    return np.array(both).view(np.uint32).reshape(-1, 2)
