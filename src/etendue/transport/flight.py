r"""Edges through participating media: transmittance, free paths, and the densities that they add.

An edge of length d has the transmittance :math:`T_c = \exp(-\sigma_c d)` in each colour channel c, over several media
the product. Walks cross media that only absorb. In media that scatter they sample the distance by the extinction of one
channel, of the n, drawn for each edge, so that the next vertex has the density

.. math:: W = \frac{1}{n} \sum_c \varsigma_c P_c

with :math:`P_c` the product of the transmittances of the scattering media, :math:`\varsigma_c` the extinction at the
new vertex if it is in a medium, and 1 if it is on a surface, times the solid-angle density over the squared distance:
per volume in a medium, and with the cosine per area on a surface. The throughput is multiplied by :math:`T_c / W`, in a
medium times its scattering coefficient.

In heterogeneous media the transmittance is estimated by null collisions, and so is their part of P: both are a product
over the null collisions on the edge (:mod:`.tracking`).

W depends on the edge and on its end alone. The walk from the other side has the same, with the extinction at the other
end, so that the weights of a path do not depend on the technique that samples it.

If no medium of a scene scatters with an extinction that depends on the colour, P and :math:`\varsigma` are one number
each, which saves time.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import Media

from . import dimensions as dim
from .tracking import Tracked, in_channel

#: Length in place of an infinite one, for the transmittance of edges that leave the scene.
FAR = 1e30


@dataclass(kw_only=True)
class Passed:
    """What an edge has crossed from its start on, one lane each."""

    probability: mi.Spectrum | mi.Float  #: P so far, by channel
    start: mi.Spectrum | mi.Float  #: extinction at the start if it is in a medium, else 1
    channel: mi.UInt32 | None  #: by which distances are sampled; None if the extinction has one number


@dataclass(kw_only=True)
class Flight:
    """State of a walk in a scene with media, for its next edge."""

    medium: mi.UInt32  #: where the edge starts, or behind the last null surface that it has crossed
    crossed: mi.UInt32  #: null surfaces that bound a medium, so far
    passed: Passed | None  #: None if no medium scatters

    @classmethod
    def begin(cls, media: Media, medium: mi.UInt32) -> Flight:
        """Of an edge that starts at the sensor or on a light."""
        passed = None
        if media.scatters:
            channel = None if media.is_grey else mi.UInt32(0)
            passed = Passed(probability=media.one(), start=media.one(), channel=channel)
        return cls(medium=medium, crossed=mi.UInt32(0), passed=passed)


@dataclass
class Passing:
    """Densities W of an edge's ends, in the sampling of the edge from the other end, over those in a vacuum."""

    to_end: mi.Float
    to_start: mi.Float

    @classmethod
    def of(
        cls,
        probability: mi.Spectrum | mi.Float,
        start: mi.Spectrum | mi.Float | None,
        end: mi.Spectrum | mi.Float | None,
    ) -> Passing:
        """Of the probability P of an edge by channel, and the extinctions of its ends; None on a surface."""
        both = (mean(probability if here is None else probability * here) for here in (end, start))
        return cls(*both)


def mean(value: mi.Spectrum | mi.Float) -> mi.Float:
    """Mean over the channels of a colour, or the number itself."""
    return dr.mean(value) if dr.depth_v(value) > 1 else value


def free_path(media: Media, flight: Flight, source: SampleSource, number: mi.UInt32, active: mi.Bool) -> mi.Float:
    """Distance to the next collision along an edge that leads to vertex ``number``, in homogeneous media; infinite
    where nothing scatters."""
    passed = flight.passed
    assert passed is not None
    one = in_channel(media.sampled(flight.medium), passed.channel)
    u = source.next_1d(number, dim.FREE_PATH)
    return dr.select(active & (one > 0.0), -dr.log(1.0 - u) / dr.select(one > 0.0, one, 1.0), dr.inf)


def draw_channel(source: SampleSource, number: mi.UInt32) -> mi.UInt32:
    """The channel of an edge that leaves vertex ``number``."""
    channels = dr.size_v(mi.Spectrum)
    return dr.minimum(mi.UInt32(source.decide(number, dim.CHANNEL) * float(channels)), channels - 1)


@dataclass
class Arrival:
    """The end of a walk's edge through media, one lane each."""

    factor: mi.Spectrum  #: on the throughput
    passing: Passing | None  #: None if no medium scatters
    extinction: mi.Spectrum | mi.Float | None  #: at a collision, by channel; 1 on surfaces; None if no medium scatters

    @classmethod
    def of(
        cls,
        media: Media,
        flight: Flight,
        si: mi.SurfaceInteraction3f,
        collided: mi.Bool | None,
        tracked: Tracked | None,
    ) -> Arrival:
        """Of an edge that has gone on to ``si``, a collision or a surface. The flight's ``passed`` becomes that of an
        edge that goes on through a null surface there. ``tracked``: null collisions on it."""
        distance = dr.minimum(si.t, FAR)
        transmittance = dr.exp(-media.extinction(flight.medium) * distance)
        if tracked is not None:
            transmittance *= tracked.passed
        if flight.passed is None or collided is None:
            return cls(transmittance, None, None)
        passed, before = flight.passed, mean(flight.passed.probability)
        probability = passed.probability * passed_by_walks(media, flight.medium, distance, tracked)
        extinction, scattering = media.at(flight.medium, si.p, collided)
        end = dr.select(collided, extinction, 1.0)
        passing = Passing.of(probability, passed.start, end)
        # The throughput was divided by ``before`` where the edge has crossed a null surface.
        possible = passing.to_end > 0.0
        weight = before / dr.select(possible, passing.to_end, 1.0)
        factor = transmittance * dr.select(collided, scattering, 1.0) * weight
        passed.probability = probability
        return cls(dr.select(possible, factor, 0.0), passing, end)


def passed_by_walks(
    media: Media, medium: mi.UInt32, distance: mi.Float, tracked: Tracked | None
) -> mi.Spectrum | mi.Float:
    """Factor on the probability P of a distance in a medium."""
    probability = dr.exp(-media.sampled(medium) * distance)
    if tracked is not None:
        probability *= dr.select(media.is_collided_with(medium), media.of_type(tracked.passed), 1.0)
    return probability
