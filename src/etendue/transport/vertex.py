"""A vertex of a path: where it may change its direction, and all that walks, next event and connections ask there.

It has a position and a frame, samples a direction to go on in, and evaluates given ones. Here it is a point of a
surface with a BSDF; a point of a medium with a phase function would answer the same questions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mitsuba as mi

from etendue.core import SampleSource

from .scattering import Evaluated, Proposal, Scattered, evaluate_camera_end, is_smooth, scatter_camera


class Joined(Protocol):
    """What a vertex may be joined to by an edge, one lane each: a light point, a stored vertex, the sensor."""

    @property
    def direction(self) -> mi.Vector3f:
        """World, from the vertex."""

    @property
    def active(self) -> mi.Bool:
        """Where there is such a thing."""


@dataclass(kw_only=True)
class Vertex:
    """A point of a surface, one lane each."""

    si: mi.SurfaceInteraction3f  #: ``wi`` towards the side that the sub-path comes from
    bsdf: mi.BSDFPtr

    @property
    def position(self) -> mi.Point3f:
        """World."""
        return self.si.p

    @property
    def frame(self) -> mi.Frame3f:
        """Of shading; local directions are in it."""
        return self.si.sh_frame

    @property
    def smooth(self) -> mi.Bool:
        """Whether it can be joined to something, or merged at."""
        return is_smooth(self.bsdf)

    def evaluate(self, direction: mi.Vector3f, active: mi.Bool) -> Evaluated:
        """What it scatters from a world direction towards the camera's side, and with what densities."""
        return evaluate_camera_end(self.bsdf, self.si, self.si.to_local(direction), active)

    def ray(self, direction: mi.Vector3f) -> mi.Ray3f:
        """From here in a world direction."""
        return self.si.spawn_ray(direction)

    def ray_to(self, target: mi.Point3f) -> mi.Ray3f:
        """From here to a point, and no further."""
        return self.si.spawn_ray_to(target)


@dataclass(kw_only=True)
class WalkVertex(Vertex):
    """The end of the edge that a walk has just traced, one lane each; a miss where not ``valid``."""

    number: mi.UInt32  #: edges of the sub-path to here; names the random numbers of the vertex
    hit: mi.PreliminaryIntersection3f
    incoming: mi.Vector3f  #: world direction of the edge
    distance: mi.Float  #: length of the edge, with what lies before surfaces that it has crossed
    valid: mi.Bool  #: whether the edge has met a surface
    proposal: Proposal = scatter_camera  #: how directions are drawn

    def sample(
        self, source: SampleSource, active: mi.Bool, joined: Sequence[Joined] = (), proposal: Proposal | None = None
    ) -> tuple[Scattered, list[Evaluated]]:
        """Draw a direction, and evaluate towards all that the vertex is ``joined`` to; one call of the BSDF answers for
        all. ``proposal`` stands in for the walk's."""
        directions: list[tuple[Any, Any]] = [(self.si.to_local(other.direction), other.active) for other in joined]
        return (proposal or self.proposal)(self.bsdf, self.si, source, self.number, active, directions)
