"""Base of the camera walk and the light walk: recursion of the MIS weights, and connections along untraced edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from ..camera import CameraSampler
from ..flight import Passing
from ..guiding.connections import START, ConnectionGuide
from ..guiding.emission import EmissionTraining
from ..places import Places
from ..rays import Edge
from ..scattering import Scattered, shadow_roulette
from ..vertex import Vertex, WalkVertex
from ..walk import SubPath, Walker, ones
from .linear import Carried, Linear
from .mis import Mis, Weights
from .pyramid import Pyramid
from .sinks import Contribution, Sink


@dataclass(kw_only=True)
class BidirectionalPath(SubPath):
    """State of a sub-path whose vertices are connected to others; ``d_vcm`` and ``d_vc``: see :class:`Mis`."""

    d_vcm: mi.Float | Linear
    d_vc: mi.Float | Linear
    vertex: mi.UInt32 | None  #: as ``depth``, without null surfaces; None if it is not used
    place: mi.UInt32 | None = None  #: class of the vertex that the edge leaves, for :attr:`BidirectionalWalk.choice`


@dataclass
class Connected:
    """An untraced edge, one lane each."""

    contribution: Contribution
    weights: Weights
    unshadowed: list[mi.Spectrum]  #: contributions, one per radius, without visibility
    rays: mi.UInt32  #: shadow rays cast


@dataclass(kw_only=True)
class BidirectionalWalk(Walker):
    """A walk whose vertices are connected by several techniques, weighted against each other [Georgiev 2012b]."""

    camera: CameraSampler
    mis: Mis
    dark: mi.Float  #: opaque; contributions below this radiance play roulette before their shadow ray
    sink: Sink | None
    training: EmissionTraining | None = None  #: learns what light paths contribute
    choice: ConnectionGuide | None = None  #: which light vertices connections prefer
    places: Places | None = None  #: how the merging radius varies; None: the same everywhere
    #: Volume in which vertices in media are merged over the area of the largest disc on surfaces; opaque.
    balls: mi.Float | float = 0.0

    @property
    def pyramid(self) -> Pyramid | None:
        """The technique pyramid, if one is recorded."""
        return None if self.sink is None else self.sink.pyramid

    @property
    def start(self) -> mi.UInt32 | None:
        """Class of the sensor and of the lights."""
        return None if self.choice is None else mi.UInt32(START)

    def share(self, vertex: Vertex) -> mi.Float | None:
        """Expected merges at a vertex per density, relative to those on the largest disc; None: the same
        everywhere."""
        if not self.mis.techniques.merge:
            return None
        share = None if self.places is None else self.places.share(vertex.position)
        if vertex.bsdf.in_medium is None:
            return share
        return dr.select(vertex.bsdf.in_medium, self.balls, 1.0 if share is None else share)

    def passed(self, vertex: WalkVertex, d_vcm: Carried, d_vc: Carried) -> tuple[Carried, Carried]:
        """``d_vcm`` and ``d_vc`` after the edge to a vertex; see :meth:`Mis.passed`."""
        return (d_vcm, d_vc) if vertex.passing is None else self.mis.passed(d_vcm, d_vc, vertex.passing)

    def number(self, s: BidirectionalPath) -> mi.UInt32:
        """Number of the vertex at the end of the edge; 0 is the sensor or the light, null surfaces do not count."""
        return s.vertex if self.visibility.transparent and s.vertex is not None else s.depth

    def connect(
        self,
        vertex: WalkVertex,
        target: mi.Point3f,
        edges: mi.UInt32,
        weigh: Callable[[Passing | None], tuple[Weights, list[mi.Spectrum]]],
        alone: mi.Spectrum,
        threshold: mi.Float,
        u: mi.Float,
        active: mi.Bool,
        end: mi.Spectrum | mi.Float | None = None,
        by_camera: bool = False,
    ) -> Connected:
        """Connect a vertex to ``target`` by an untraced edge.

        edges: length of the path. weigh: (weights; contributions, one per radius, without visibility) for the
        densities of the edge in media, which depend on its shadow ray. alone: the contribution without a weight.
        Roulette by ``u`` skips shadow rays of contributions below ``threshold``. With a pyramid, a ray is cast wherever
        ``alone`` is not zero. end: extinction at ``target`` (see :attr:`Vertex.extinction`). by_camera: whether the
        target is on the camera.
        """
        if not self.visibility.volumes:
            weights, values = weigh(None)
            survives, factor = shadow_roulette(values, threshold, u, active)
        else:
            survives, factor = shadow_roulette([alone], threshold, u, active)
        tested = survives if self.pyramid is None else active & ~dr.all(alone == 0.0)
        sight = self.sight(vertex, target, edges, tested, by_camera)
        if sight.passing is not None:
            weights, values = weigh(Passing.of(sight.passing, vertex.extinction, end))
        weighted = [value * (factor * sight.transmittance) for value in values]
        active = sight.visible if self.pyramid is None else sight.visible & survives
        contribution = Contribution(weighted, alone * sight.transmittance, active, sight.visible)
        return Connected(contribution, weights, values, ones(tested))

    def record(
        self,
        kind: Edge,
        vertex: WalkVertex,
        target: mi.Point3f,
        contribution: Contribution,
        light: mi.UInt32 | int = 0,
        wanted: mi.Bool | bool = True,
    ) -> None:
        """Record a join that contributes, if rays are recorded; see :class:`WalkRecorder`."""
        if self.rays is not None:
            active = contribution.active & wanted
            self.rays.joined(kind, vertex, target, contribution.weighted[0], active, light)

    def leave(
        self,
        s: BidirectionalPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        on_edge: tuple[Carried, Carried],
        roulette_by: tuple[mi.Spectrum, mi.Float] | None = None,
        place: mi.UInt32 | None = None,
    ) -> None:
        """:meth:`Walker.advance`, with ``d_vcm`` and ``d_vc`` after scattering; ``on_edge``: the two before the vertex,
        restored at null surfaces; ``place``: class of the vertex."""
        s.d_vcm = self.keep_if_null(scattered, on_edge[0], s.d_vcm)
        s.d_vc = self.keep_if_null(scattered, on_edge[1], s.d_vc)
        if s.place is not None and place is not None:
            s.place = self.keep_if_null(scattered, s.place, place)
        if self.visibility.transparent and s.vertex is not None:
            s.vertex = s.vertex + ones(~scattered.is_null)
        self.advance(s, vertex, scattered, source, roulette_by)
