r"""Null collisions: free paths and transmittance in heterogeneous media.

Along an edge, tentative collisions are a Poisson process whose intensity is the majorant :math:`\bar\sigma` of the
extinction. In channel c a tentative collision at y is a null collision with probability
:math:`1 - \sigma_c(y) / \bar\sigma`. A walk ends its edge at the first that is none (delta tracking [Woodcock1965]), a
shadow ray goes on, and the product of these probabilities estimates its transmittance (ratio tracking [Novak2014]).

The null collisions are part of the path [Miller2019]. All techniques that can sample a path have the same density of
tentative collisions on each edge, which cancels in weights and contributions. What remains is the product of the
probabilities, in place of the transmittance of a homogeneous medium (:mod:`.flight`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource, hash_mix, keyed_bits, to_unit_float
from etendue.scene import Media, entry

from . import dimensions as dim

#: Two words that select the random numbers of an edge.
Keys: TypeAlias = "tuple[mi.UInt32, mi.UInt32]"


@dataclass
class Tracked:
    """An edge through a heterogeneous medium, one lane each."""

    collision: mi.Float  #: distance to a collision; infinite: none
    passed: mi.Spectrum  #: product of the probabilities of null collisions, by channel


@dataclass
class _Tracking:
    """State of the loop over tentative collisions."""

    active: mi.Bool
    t: mi.Float
    step: mi.UInt32
    collision: mi.Float
    passed: mi.Spectrum


def keys_of_walk(source: SampleSource, number: mi.UInt32) -> Keys:
    """Of the edge that leads to a vertex of a walk."""
    numbers = source.next_1d(number, dim.FREE_PATH), source.decide(number, dim.NULL_COLLISIONS)
    return hash_mix(_bits(numbers[0])), hash_mix(_bits(numbers[1]))


def keys_of_ray(ray: mi.Ray3f) -> Keys:
    """Of a shadow ray: no two rays between points of random paths are the same."""
    keys = []
    for end in (ray.o, ray.d):
        word = hash_mix(_bits(end.x))
        for coordinate in (end.y, end.z):
            word = hash_mix(word ^ _bits(coordinate))
        keys.append(word)
    return keys[0], keys[1] ^ keys[0]


def track(
    media: Media,
    medium: mi.UInt32,
    ray: mi.Ray3f,
    end: mi.Float,
    keys: Keys,
    active: mi.Bool,
    collides: mi.Bool | None = None,
    channel: mi.UInt32 | None = None,
) -> Tracked:
    """Track a ray up to the distance ``end``, or to a collision where it ``collides``, by the extinction of a
    ``channel``; None: extinctions do not depend on the colour. Lanes in homogeneous media, or in none, pass."""
    majorant, first, last = media.span(medium, ray, active)
    last, inverse = dr.minimum(last, end), dr.rcp(majorant)
    key0, key1 = keys
    o, d = mi.Point3f(ray.o), mi.Vector3f(ray.d)

    def step(s: _Tracking) -> tuple[_Tracking]:
        s.t -= dr.log(1.0 - to_unit_float(keyed_bits(key0, key1, s.step))) * inverse
        s.active &= s.t < last
        extinction = media.varying_extinction(medium, dr.fma(d, s.t, o), s.active)
        null = dr.maximum(1.0 - extinction * inverse, 0.0)
        passes = s.active
        if collides is not None:
            u = to_unit_float(keyed_bits(key0, key1, s.step + 1))
            passes = s.active & ~(collides & (u >= in_channel(null, channel)))
            s.collision = dr.select(s.active & ~passes, s.t, s.collision)
        s.passed = dr.select(passes, s.passed * null, s.passed)
        s.active = passes & (dr.max(s.passed) > 0.0)
        s.step += 2
        return (s,)

    start = _Tracking(
        active=active & (majorant > 0.0) & (first < last),
        t=mi.Float(first),
        step=mi.UInt32(0),
        collision=mi.Float(dr.inf),
        passed=mi.Spectrum(1.0),
    )
    (found,) = dr.while_loop((start,), lambda s: s.active, step, label="null collisions")
    return Tracked(found.collision, found.passed)


def in_channel(colour: mi.Spectrum | mi.Float, channel: mi.UInt32 | None) -> mi.Float:
    """A number of a colour by its channel; None: all are equal."""
    if dr.depth_v(colour) == 1:
        return colour
    if channel is None:
        return colour[0]
    return entry(colour, channel)


def _bits(number: mi.Float) -> mi.UInt32:
    return dr.reinterpret_array(mi.UInt32, number)
