"""Base of the camera walk and the light walk: recursion of the MIS weights, and connections along untraced edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from ..camera import CameraSampler
from ..guiding.connections import START, ConnectionGuide
from ..guiding.emission import EmissionTraining
from ..places import Places
from ..rays import Edge
from ..scattering import Scattered, shadow_roulette
from ..vertex import WalkVertex
from ..walk import SubPath, Walker, ones
from .linear import Carried, Linear
from .mis import Mis
from .pyramid import Pyramid
from .sinks import Contribution, Sink


@dataclass(kw_only=True)
class BidirectionalPath(SubPath):
    """State of a sub-path whose vertices are connected to others; ``d_vcm`` and ``d_vc``: see :class:`Mis`."""

    d_vcm: mi.Float | Linear
    d_vc: mi.Float | Linear
    vertex: mi.UInt32 | None  #: as ``depth``, without null surfaces; None if it is not used
    place: mi.UInt32 | None = None  #: class of the vertex that the edge leaves, for :attr:`BidirectionalWalk.choice`


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

    @property
    def pyramid(self) -> Pyramid | None:
        """The technique pyramid, if one is recorded."""
        return None if self.sink is None else self.sink.pyramid

    @property
    def start(self) -> mi.UInt32 | None:
        """Class of the sensor and of the lights."""
        return None if self.choice is None else mi.UInt32(START)

    def share(self, position: mi.Point3f) -> mi.Float | None:
        """Area of the merging disc at a position, relative to the largest; None: the same everywhere."""
        return self.places.share(position) if self.places is not None and self.mis.techniques.merge else None

    def number(self, s: BidirectionalPath) -> mi.UInt32:
        """Number of the vertex at the end of the edge; 0 is the sensor or the light, null surfaces do not count."""
        return s.vertex if self.visibility.transparent and s.vertex is not None else s.depth

    def connect(
        self,
        vertex: WalkVertex,
        target: mi.Point3f,
        edges: mi.UInt32,
        contributions: Sequence[mi.Color3f],
        alone: mi.Color3f,
        threshold: mi.Float,
        u: mi.Float,
        active: mi.Bool,
    ) -> tuple[Contribution, mi.UInt32]:
        """(contribution of the path along the untraced edge from a vertex to ``target``, shadow rays cast).

        edges: length of the path. contributions: one per radius, without visibility; alone: without a weight. Roulette
        by ``u`` skips shadow rays of contributions below ``threshold``. With a pyramid, a ray is cast wherever
        ``alone`` is not zero.
        """
        survives, factor = shadow_roulette(contributions, threshold, u, active)
        tested = survives if self.pyramid is None else active & ~dr.all(alone == 0.0)
        visible, transmittance = self.visible(vertex, target, edges, tested)
        weighted = [contribution * (factor * transmittance) for contribution in contributions]
        active = visible if self.pyramid is None else visible & survives
        return Contribution(weighted, alone * transmittance, active, visible), ones(tested)

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
        roulette_by: tuple[mi.Color3f, mi.Float] | None = None,
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
