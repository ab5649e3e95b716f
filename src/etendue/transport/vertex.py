"""A vertex of a path, where the path scatters: position, frame, evaluation and sampling of directions.

It is a point of a surface or of a medium. A point of a medium has a phase function in place of a BSDF, as a
:class:`Material` too, no normal, and no cosines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import DISPERSES, Material, hero_alone, medium_behind

from .flight import Passing
from .scattering import (
    Evaluated,
    Proposal,
    Scattered,
    cosine_ratio,
    evaluate_camera_end,
    geometric_cos,
    is_smooth,
    scatter_camera,
)


class Joined(Protocol):
    """An end of an edge that a vertex is connected to, one lane each: a light point, a stored vertex, the sensor."""

    @property
    def direction(self) -> mi.Vector3f:
        """World direction from the vertex to the end."""

    @property
    def active(self) -> mi.Bool:
        """Lanes in which the end exists."""


@dataclass(kw_only=True)
class Vertex:
    """A point of a sub-path, one lane each."""

    si: mi.SurfaceInteraction3f  #: ``wi`` points back along the sub-path; the normal ``n`` is 0 in a medium
    bsdf: Material
    medium: mi.UInt32 | None = None  #: the medium on the side of ``wi``; None in scenes without media
    #: Extinction with which walks find the vertex, by channel, 1 on surfaces; None if no medium scatters.
    extinction: mi.Spectrum | mi.Float | None = None

    @property
    def position(self) -> mi.Point3f:
        """World position."""
        return self.si.p

    @property
    def frame(self) -> mi.Frame3f:
        """Shading frame, in which local directions are given."""
        return self.si.sh_frame

    @property
    def smooth(self) -> mi.Bool:
        """Whether the BSDF has a component without delta functions, so that the vertex can be connected or merged."""
        return is_smooth(self.bsdf)

    def hero_goes_on(self, direction: mi.Vector3f) -> mi.Bool:
        """Whether light from a world direction, or to it, has the hero's wavelength only at the vertex."""
        through = mi.Frame3f.cos_theta(self.si.wi) * mi.Frame3f.cos_theta(self.si.to_local(direction)) < 0.0
        return hero_alone(self.si.wavelengths) | ((self.bsdf.flags() & DISPERSES != 0) & through)

    def cos(self, direction: mi.Vector3f) -> mi.Float:
        """``|cos|`` of a world direction and the geometric normal; 1 in a medium."""
        return geometric_cos(self.si, direction, self.bsdf.in_medium)

    def cosine_ratio(self, direction: mi.Vector3f) -> mi.Float:
        """See :func:`.scattering.cosine_ratio`."""
        return cosine_ratio(self.si, direction, self.bsdf.in_medium)

    def medium_towards(self, direction: mi.Vector3f) -> mi.UInt32 | None:
        """The medium into which a world direction leads."""
        if self.medium is None:
            return None
        return medium_behind(self.si, direction, self.medium)

    def evaluate(self, direction: mi.Vector3f, active: mi.Bool) -> Evaluated:
        """BSDF value and densities at a camera vertex, for light that arrives from a world direction."""
        return evaluate_camera_end(self.bsdf, self.si, self.si.to_local(direction), active)

    def ray(self, direction: mi.Vector3f) -> mi.Ray3f:
        """Ray from the vertex in a world direction."""
        return self.si.spawn_ray(direction)

    def ray_to(self, target: mi.Point3f) -> mi.Ray3f:
        """Shadow ray from the vertex to a point."""
        return self.si.spawn_ray_to(target)


@dataclass(kw_only=True)
class WalkVertex(Vertex):
    """End of the edge that a walk has traced last, one lane each; the ray missed the scene where not ``valid``."""

    number: mi.UInt32  #: vertices and null surfaces of the sub-path up to this one; selects its random numbers
    depth: mi.UInt32  #: edges up to the vertex: as ``number``, without null surfaces that bound a medium
    hit: mi.PreliminaryIntersection3f
    incoming: mi.Vector3f  #: world direction of the edge
    distance: mi.Float  #: length of the edge from the last vertex, through null surfaces on the way
    valid: mi.Bool  #: whether the edge ends on a surface or in a medium
    passing: Passing | None = None  #: of the edge; None in scenes without media that scatter
    proposal: Proposal = scatter_camera  #: samples directions
    #: Scatterings before the vertex, see :class:`etendue.transport.MapEnd`; None unless paths end in maps.
    scatterings: mi.UInt32 | None = None
    #: Share of Mitsuba's offset by which rays start off the vertex; None: all of it.
    offset: mi.Float | None = None

    def ray(self, direction: mi.Vector3f) -> mi.Ray3f:
        """See :class:`Vertex`."""
        return self._start.spawn_ray(direction)

    def ray_to(self, target: mi.Point3f) -> mi.Ray3f:
        """See :class:`Vertex`."""
        return self._start.spawn_ray_to(target)

    @property
    def _start(self) -> mi.SurfaceInteraction3f:
        """Where rays start: Mitsuba's offset is in proportion to the normal."""
        if self.offset is None:
            return self.si
        start = mi.SurfaceInteraction3f(self.si)
        start.n = start.n * self.offset
        return start

    def sample(
        self, source: SampleSource, active: mi.Bool, joined: Sequence[Joined] = (), proposal: Proposal | None = None
    ) -> tuple[Scattered, list[Evaluated]]:
        """Sample a direction, and evaluate the BSDF in the directions of ``joined``, all in one call of the BSDF.
        ``proposal`` replaces the proposal of the walk."""
        directions = [(self.si.to_local(other.direction), other.active) for other in joined]
        return (proposal or self.proposal)(self.bsdf, self.si, source, self.number, active, directions)
