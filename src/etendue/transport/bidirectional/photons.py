"""Stored light vertices as merging sees them, and which of them belong to the density around a point.

A photon's flux is density on the surface where it was stored. Around a point of a plane that is the irradiance of the
point. At an edge, a moulding or a bend, photons of other surfaces lie within the radius, and three things make them a
sample of what the point receives:

- *Fluence*, flux over the cosine at the photon's own surface, in place of flux: photons then sample the radiance
  there, which the point reflects by its own cosine. Flux over the cosine at the point is the same on a plane, but for
  photons of other surfaces that arrive along this one it has no bound, nor a mean.
- The distance *along the surfaces*, unfolded at the edge: as much surface lies within a radius as on a plane.
- A *weight* for the directions that reach the point but not the photon's surface, which turns away from them.

Under uniform radiance the estimate is exact on both sides of a straight edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from .mis import RadiusFree

#: Least value of 1 + cos of the angle between two surfaces whose photons are mixed: 120 degrees.
_LEAST_OPENING = 0.5


@dataclass
class Photon:
    """Photons read back, one lane each."""

    fluence: Any  #: flux over the cosine at which it reached its surface
    direction: Any  #: world, towards the light side
    normal: Any  #: of its surface, on the side that the light came from
    d_vcm: Any
    d_vc: Any  #: a number, or a :class:`RadiusFree`


@dataclass
class Photons:
    """Photons in the order of a search structure. Positions lie apart: most candidates fail the test."""

    _position: Any
    _flux: Any
    _slopes: Any
    _depth_bits: int  #: of a tag, those that are a depth; the next four are the vertex number where they are fewer

    def position(self, index: Any, active: Any) -> tuple[Any, Any]:
        """(position, depth)."""
        p = dr.gather(mi.Vector4f, self._position, index, active)
        return mi.Point3f(p.x, p.y, p.z), depth_of(p.w, self._depth_bits)

    def number(self, index: Any, active: Any) -> Any:
        """See :class:`LightVertex`."""
        return number_of(dr.gather(mi.Float, self._position, 4 * index + 3, active), self._depth_bits)

    def read(self, index: Any, active: Any) -> Photon:
        """The rest of a photon."""
        f = dr.gather(mi.Vector4f, self._flux, 2 * index, active)
        d = dr.gather(mi.Vector4f, self._flux, 2 * index + 1, active)
        slope = None if self._slopes is None else dr.gather(mi.Float, self._slopes, index, active)
        return Photon(
            fluence=mi.Color3f(f.x, f.y, f.z),
            direction=unpacked_direction(d.x, d.y),
            normal=unpacked_normal(d.z),
            d_vcm=f.w,
            d_vc=d.w if slope is None else RadiusFree(d.w, slope),
        )


def unfolded(si: Any, position: Any, photon: Photon) -> tuple[Any, Any]:
    """(squared distance along the surfaces from ``si.p`` to a photon, weight of the photon); a weight of 0 if the
    surfaces turn away from each other.

    With a and b the distances of the two from the edge at which their planes meet, l along it and c the cosine between
    their normals, the straight distance is a^2 + b^2 + 2 a b c + l^2, and the unfolded one (a + b)^2 + l^2. Of the
    point's cosine-weighted hemisphere (1 + c) / 2 reaches the photon's plane.
    """
    normal = dr.select(dr.dot(si.n, photon.direction) < 0.0, -si.n, si.n)
    offset = position - si.p
    opening = 1.0 + dr.dot(normal, photon.normal)
    # a b (1 - c) = |n_x o| |n_y o| / (1 + c), as |n_x o| = b sin, |n_y o| = a sin
    heights = dr.abs(dr.dot(normal, offset) * dr.dot(photon.normal, offset))
    close = opening >= _LEAST_OPENING
    inverse = dr.rcp(dr.maximum(opening, _LEAST_OPENING))
    return dr.squared_norm(offset) + 2.0 * heights * inverse, dr.select(close, 2.0 * inverse, 0.0)


# ---------------------------------------------------------------------- directions and normals in few numbers


def packed_direction(d: Any) -> tuple[Any, Any]:
    """Two numbers for a unit vector: the octahedron's map [Cigolle 2014]."""
    inverse = dr.rcp(dr.abs(d.x) + dr.abs(d.y) + dr.abs(d.z))
    u, v = d.x * inverse, d.y * inverse
    folded_u, folded_v = dr.copysign(1.0 - dr.abs(v), u), dr.copysign(1.0 - dr.abs(u), v)
    return dr.select(d.z < 0.0, folded_u, u), dr.select(d.z < 0.0, folded_v, v)


def unpacked_direction(u: Any, v: Any) -> Any:
    """Inverse of :func:`packed_direction`."""
    z = 1.0 - dr.abs(u) - dr.abs(v)
    beyond = dr.maximum(-z, 0.0)
    return mi.Vector3f(dr.normalize(mi.Vector3f(u - dr.copysign(beyond, u), v - dr.copysign(beyond, v), z)))


def packed_normal(n: Any) -> Any:
    """One number for a unit vector, right to 3e-5."""
    u, v = packed_direction(n)
    words = [mi.UInt32(dr.round((x + 1.0) * 32767.0)) for x in (u, v)]
    return dr.reinterpret_array(mi.Float, words[0] | (words[1] << 16))


def unpacked_normal(packed: Any) -> Any:
    """Inverse of :func:`packed_normal`."""
    word = dr.reinterpret_array(mi.UInt32, packed)
    u, v = ((mi.Float(x) - 32767.0) * (1.0 / 32767.0) for x in (word & 0xFFFF, word >> 16))
    return unpacked_direction(u, v)


# ---------------------------------------------------------------------- tags


def depth_of(tag: Any, bits: int) -> Any:
    """Edges from the light."""
    return dr.reinterpret_array(mi.UInt32, tag) & ((1 << bits) - 1)


def number_of(tag: Any, bits: int) -> Any:
    """Number of the vertex on its path; the depth where no bits are left for it."""
    word = dr.reinterpret_array(mi.UInt32, tag)
    return (word >> bits) & 15 if bits < 16 else word & 0xFFFF
