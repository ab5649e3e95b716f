"""What the camera walk and the light walk share: densities for the weights, and edges that join a vertex to another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from ..camera import Camera
from ..scattering import Scattered, shadow_roulette
from ..vertex import WalkVertex
from ..walk import SubPath, Walker, ones
from .mis import Mis, RadiusFree
from .pyramid import Pyramid
from .sinks import Brought, Sink


@dataclass(kw_only=True)
class JoiningPath(SubPath):
    """A sub-path whose vertices are joined to others."""

    d_vcm: mi.Float
    d_vc: mi.Float | RadiusFree
    vertex: mi.UInt32 | None  #: as ``depth``, without the surfaces that were crossed; None where nobody asks


@dataclass(kw_only=True)
class JoiningWalk(Walker):
    """A walk at whose vertices techniques make paths, each weighted against all others [Georgiev 2012b]."""

    camera: Camera
    mis: Mis
    dark: mi.Float  #: opaque: radiance below which a contribution plays roulette before its shadow ray
    sink: Sink | None

    @property
    def pyramid(self) -> Pyramid | None:
        """What shows every technique by itself, if that is asked for."""
        return None if self.sink is None else self.sink.pyramid

    def number(self, s: JoiningPath) -> mi.UInt32:
        """Number of the vertex at the end of the edge, the sub-path's own end being 0; crossings are no vertices."""
        return s.vertex if self.visibility.transparent and s.vertex is not None else s.depth

    def join(
        self,
        vertex: WalkVertex,
        target: mi.Point3f,
        edges: mi.UInt32,
        contributions: Sequence[mi.Color3f],
        alone: mi.Color3f,
        threshold: mi.Float,
        u: mi.Float,
        active: mi.Bool,
    ) -> tuple[Brought, mi.UInt32]:
        """What a technique brings along the edge from a vertex to ``target``, and the shadow rays that it takes.

        ``edges``: of the path; ``contributions``: one a radius, as if nothing lay between, and ``alone`` without a
        weight. Below ``threshold`` roulette by ``u`` decides whether the ray is cast; for a pyramid all are that may
        carry light without a weight.
        """
        lit, factor = shadow_roulette(contributions, threshold, u, active)
        asked = lit if self.pyramid is None else active & ~dr.all(alone == 0.0)
        seen, share = self.seen(vertex, target, edges, asked)
        weighted = [contribution * (factor * share) for contribution in contributions]
        return Brought(weighted, alone * share, seen if self.pyramid is None else seen & lit, seen), ones(asked)

    def leave(
        self,
        s: JoiningPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        on_edge: tuple[mi.Float, mi.Float | RadiusFree],
        worth: tuple[mi.Color3f, mi.Float] | None = None,
    ) -> None:
        """As :meth:`Walker.advance`; ``s.d_vcm`` and ``s.d_vc`` are those after scattering, ``on_edge`` those before
        the vertex, which hold where it is none."""
        s.d_vcm = self.kept(scattered, on_edge[0], s.d_vcm)
        s.d_vc = self.kept(scattered, on_edge[1], s.d_vc)
        if self.visibility.transparent and s.vertex is not None:
            s.vertex = s.vertex + ones(~scattered.is_null)
        self.advance(s, vertex, scattered, source, worth)
