"""Photons, which are the data of stored light vertices that merging reads, and their weights around a point.

The density of the photons' flux around a point of a plane estimates the irradiance at the point. At edges and on curved
surfaces, photons of other surfaces lie within the radius. Three changes make them an estimate of the point's reflected
radiance:

- *Fluence*, flux over the cosine at the photon's own surface, replaces flux. The photons then sample incident radiance
  there, and the point's own BSDF value contains its cosine. Flux over the cosine at the point would be the same on a
  plane, but is unbounded, with an infinite mean, for photons of other surfaces whose direction is tangential here.
- The distance is measured *along the surfaces*, unfolded at the edge, so that the area within a radius is that of a
  disc.
- A *weight* accounts for directions that arrive at the point but are below the horizon of the photon's surface.

Under uniform radiance the estimate is exact on both sides of a straight edge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import drjit as dr
import mitsuba as mi

from etendue.density import HashGrid

from ..flight import mean
from ..packing import unpacked_direction, unpacked_light, unpacked_normal
from ..vertex import WalkVertex
from .kinds import component_of
from .linear import Carried, Linear

T = TypeVar("T")

#: Least 1 + cos of the angle between the normals of two surfaces whose photons are merged: 120 degrees.
_LEAST_OPENING = 0.5


@dataclass
class Photon:
    """Photons read back, one lane each."""

    fluence: mi.Spectrum  #: flux over the geometric cosine at which it arrived, or over the scattering coefficient
    direction: mi.Vector3f  #: world, towards the light side
    normal: mi.Vector3f  #: of its surface, on the side of ``direction``
    medium: mi.UInt32  #: of a photon in a medium
    extinction: mi.Float | None  #: mean over the channels, in media; None unless one is heterogeneous
    d_vcm: mi.Float | Linear
    d_vc: mi.Float | Linear
    hero_alone: mi.Bool | None  #: see :func:`etendue.scene.hero_alone`; None if no material disperses light


@dataclass
class Photons:
    """Photons in the order of a search structure. Positions are a separate array, because most candidates of a search
    are outside the radius, and only their position is read."""

    _position: mi.Float
    _flux: mi.Float
    _more: mi.Float | None  #: further coefficients of d_vcm and d_vc
    _depth_bits: int  #: bits of a tag that hold the depth; if fewer than 16, the next four hold the vertex number
    _owners: mi.UInt32 | None = None  #: number of the light path of each
    _extinction: mi.Float | None = None
    _fourth: mi.Float | None = None  #: number of the flux, of spectral light
    _disperses: bool = False

    def position(self, index: mi.UInt32, active: mi.Bool) -> tuple[mi.Point3f, mi.UInt32]:
        """(position, depth)."""
        p = dr.gather(mi.Vector4f, self._position, index, active)
        return mi.Point3f(p.x, p.y, p.z), depth_of(p.w, self._depth_bits)

    def number(self, index: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Number of the vertex on its path (see :class:`LightVertex`)."""
        return number_of(dr.gather(mi.Float, self._position, 4 * index + 3, active), self._depth_bits)

    def path(self, index: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Number of the light path, if vertices are ``owned``."""
        assert self._owners is not None
        return dr.gather(mi.UInt32, self._owners, index, active)

    def kind(self, index: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """The :class:`Kind` of the photon's light."""
        # As in `position`, so that both are one gather.
        return kind_of(dr.gather(mi.Vector4f, self._position, index, active).w)

    def component(self, index: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """The ``film.Component`` of the photon's light to an eye that sees the surface."""
        return component_of(self.kind(index, active))

    def read(self, index: mi.UInt32, active: mi.Bool) -> Photon:
        """All but position and depth."""
        f = dr.gather(mi.Vector4f, self._flux, 2 * index, active)
        d = dr.gather(mi.Vector4f, self._flux, 2 * index + 1, active)
        d_vcm, d_vc = weighting(f.w, d.w, self._more, index, active)
        fourth = None if self._fourth is None else dr.gather(mi.Float, self._fourth, index, active)
        return Photon(
            fluence=unpacked_light(f, fourth),
            direction=unpacked_direction(d.x, d.y),
            normal=unpacked_normal(d.z),
            medium=dr.reinterpret_array(mi.UInt32, d.z),
            extinction=None if self._extinction is None else dr.gather(mi.Float, self._extinction, index, active),
            d_vcm=d_vcm,
            d_vc=d_vc,
            hero_alone=self._hero_alone(index, active),
        )

    def _hero_alone(self, index: mi.UInt32, active: mi.Bool) -> mi.Bool | None:
        if not self._disperses:
            return None
        return is_hero_alone(dr.gather(mi.Vector4f, self._position, index, active).w)


def weighting(
    d_vcm: mi.Float, d_vc: mi.Float, more: mi.Float | None, index: mi.UInt32, active: mi.Bool
) -> tuple[Carried, Carried]:
    """(d_vcm, d_vc) of a stored vertex from its packets; ``more``: further coefficients, if it has any."""
    if more is None:
        return d_vcm, d_vc
    zero, m = mi.Float(0.0), dr.gather(mi.Vector4f, more, index, active)
    return Linear(m.x, d_vcm, zero), Linear(d_vc, m.y, m.z)


def weigh(vertex: WalkVertex, position: mi.Point3f, photon: Photon, in_media: bool) -> tuple[mi.Float, mi.Float]:
    """(squared distance of a photon, its weight), on surfaces by :func:`unfolded`; ``in_media``, photons of another
    medium have a weight of 0. If photon and vertex both have light of the hero alone, both count it four times.

    Where the extinction varies, the photons' fluence samples the radiance around the vertex with an unbounded variance
    if divided by the extinction at the photon, and so does the flux if divided by that at the vertex. The mean of both
    is bounded, and of second order in the radius, too."""
    if in_media:
        distance_squared = dr.squared_norm(position - vertex.position)
        weight = dr.select(photon.medium == vertex.medium, mi.Float(1.0), 0.0)
        if photon.extinction is not None and vertex.extinction is not None:
            weight *= 2.0 * photon.extinction / (photon.extinction + mean(vertex.extinction))
    else:
        distance_squared, weight = unfolded(vertex.si, position, photon)
    if photon.hero_alone is not None:
        weight *= dr.select(photon.hero_alone & vertex.hero_goes_on(photon.direction), 0.25, 1.0)
    return distance_squared, weight


def unfolded(si: mi.SurfaceInteraction3f, position: mi.Point3f, photon: Photon) -> tuple[mi.Float, mi.Float]:
    """(squared distance along the surfaces from ``si.p`` to a photon, weight of the photon). The weight is 0 if the
    angle between the surfaces' normals is too large.

    Let a and b be the distances of point and photon from the line in which their planes intersect, l their distance
    along this line and c the cosine between the normals. The squared straight distance is a^2 + b^2 + 2 a b c + l^2,
    the unfolded one (a + b)^2 + l^2. The share (1 + c) / 2 of the point's cosine-weighted hemisphere is above the
    photon's plane.
    """
    normal = dr.select(dr.dot(si.n, photon.direction) < 0.0, -si.n, si.n)
    offset = position - si.p
    opening = 1.0 + dr.dot(normal, photon.normal)
    # a b (1 - c) = |n_x o| |n_y o| / (1 + c), as |n_x o| = b sin, |n_y o| = a sin
    heights = dr.abs(dr.dot(normal, offset) * dr.dot(photon.normal, offset))
    close = opening >= _LEAST_OPENING
    inverse = dr.rcp(dr.maximum(opening, _LEAST_OPENING))
    return dr.squared_norm(offset) + 2.0 * heights * inverse, dr.select(close, 2.0 * inverse, 0.0)


# ---------------------------------------------------------------------- tags


def depth_of(tag: mi.Float, bits: int) -> mi.UInt32:
    """Edges from the light."""
    return dr.reinterpret_array(mi.UInt32, tag) & ((1 << bits) - 1)


#: Bits of a tag that hold the index of a vertex on its path, after 16 others; the kind has the rest.
INDEX_BITS = 13


def kind_of(tag: mi.Float) -> mi.UInt32:
    """The :class:`Kind` of a vertex."""
    return dr.reinterpret_array(mi.UInt32, tag) >> 16 + INDEX_BITS


#: Bit of the index on a path in a tag that marks vertices whose light is of the hero alone, if there may be any.
HERO_ALONE = 1 << INDEX_BITS - 2


def is_hero_alone(tag: mi.Float) -> mi.Bool:
    """Whether light arrives with the wavelength of the hero only."""
    return ((dr.reinterpret_array(mi.UInt32, tag) >> 16) & HERO_ALONE) != 0


def number_of(tag: mi.Float, bits: int) -> mi.UInt32:
    """Number of the vertex on its path; the depth if the tag has no bits for the number."""
    word = dr.reinterpret_array(mi.UInt32, tag)
    return (word >> bits) & 15 if bits < 16 else word & 0xFFFF


@dataclass
class Gather:
    """The stored light vertices for merging, on surfaces or in media, sorted by a grid for the largest radius.

    ``factors``: 1 / (n_VM pi r^2) of each radius on surfaces, 1 / (n_VM 4/3 pi r^3) in media; ``squares``: r^2. Both
    where the radius is largest.
    """

    grid: HashGrid
    photons: Photons
    factors: Sequence[mi.Float]
    squares: Sequence[mi.Float]
    in_media: bool = False  #: whether the vertices are in media

    def at(self, share: mi.Float | None) -> tuple[Sequence[mi.Float], Sequence[mi.Float]]:
        """(``squares``, ``factors``) where the discs have a ``share`` of their largest area; None: all of it."""
        if share is None:
            return self.squares, self.factors
        return [square * share for square in self.squares], [factor / share for factor in self.factors]

    def around(
        self,
        point: mi.Point3f,
        edges: mi.UInt32,
        visit: Callable[[mi.UInt32, T], T],
        state: T,
        active: mi.Bool,
        radius_squared: mi.Float | None = None,
    ) -> T:
        """Visit the photons around ``point`` with a depth of at most ``edges``; see ``HashGrid.within``."""

        def read(photon: mi.UInt32) -> tuple[mi.Point3f, mi.Bool]:
            position, depth = self.photons.position(photon, active)
            return position, depth <= edges

        return self.grid.within(point, read, visit, state, active, radius_squared)
