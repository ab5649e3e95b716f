"""How the merging radius varies from place to place, and the surfaces by which it is measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from .scattering import is_smooth
from .visibility import Visibility
from .walk import SubPath, Walker

#: Longest path, in edges, to the first surface that is not specular.
_MOST_EDGES = 12


@dataclass
class Places:
    """A radius that is proportional to the distance from the sensor, as the footprint of a pixel is, within limits.

    It depends on the position alone, so that every technique of a path, from either side, knows the radius at each of
    its vertices. Behind a flat mirror the footprint is larger, because the path to the sensor is longer than the
    distance; through curved glass it may be anything.
    """

    origin: mi.Point3f  #: of the sensor
    least: mi.Float  #: squared distance below which the radius is constant; opaque
    most: mi.Float  #: squared distance beyond which the radius is constant, and largest; opaque

    def share(self, position: mi.Point3f) -> mi.Float:
        """Area of the disc at a position, relative to the largest."""
        squared = dr.squared_norm(position - self.origin)
        return dr.clip(squared, self.least, self.most) * dr.rcp(self.most)


@dataclass(kw_only=True)
class _Collision(SubPath):
    """State of a camera path up to its first collision in a medium."""

    position: mi.Point3f
    reached: mi.Bool

    @classmethod
    def start(cls, ray: mi.Ray3f, eta: mi.Float | None = None) -> Self:
        """The state before the first edge."""
        return cls(
            active=mi.Bool(True),
            ray=mi.Ray3f(ray),
            throughput=mi.Spectrum(1.0),
            eta=eta,
            depth=mi.UInt32(1),
            travelled=mi.Float(0.0),
            rays=mi.UInt32(0),
            position=mi.Point3f(0.0),
            reached=mi.Bool(False),
        )


def first_collisions(walker: Walker, ray: mi.Ray3f, source: SampleSource) -> tuple[mi.Point3f, mi.Bool]:
    """(points at which camera paths first collide with a medium, mask of the paths that do so before they are scattered
    by anything but mirrors and glass)."""
    path = _Collision.start(ray, mi.Float(1.0))

    def edge(s: _Collision) -> _Collision:
        vertex = walker.arrive(s, source)
        here = s.active & vertex.bsdf.in_medium if vertex.bsdf.in_medium is not None else mi.Bool(False)
        s.position = dr.select(here, vertex.position, s.position)
        s.reached |= here
        s.active &= vertex.valid & ~here & ~vertex.smooth & (vertex.number < _MOST_EDGES)
        scattered, _ = vertex.sample(source, s.active)
        walker.advance(s, vertex, scattered, source)
        return s

    path = walker.walk(path, edge, "first collisions")
    return path.position, path.reached


def first_smooth(visibility: Visibility, ray: mi.Ray3f, through: bool) -> tuple[mi.Point3f, mi.Bool]:
    """(positions of the first surfaces with a smooth component that camera rays reach, directly, in mirrors or straight
    through glass; mask of the rays that reach one). Less is computed than by a walk, which keeps the kernel small.
    ``through``: whether the scene has mirrors or glass."""
    if not through:
        hit = visibility.scene.ray_intersect_preliminary(ray)
        return dr.select(hit.is_valid(), ray(hit.t), 0.0), hit.is_valid()

    def edge(
        active: mi.Bool, ray: mi.Ray3f, depth: mi.UInt32, position: mi.Point3f, reached: mi.Bool
    ) -> tuple[mi.Bool, mi.Ray3f, mi.UInt32, mi.Point3f, mi.Bool]:
        hit = visibility.scene.ray_intersect_preliminary(ray, active=active)
        si = hit.compute_surface_interaction(ray, mi.RayFlags.Minimal | mi.RayFlags.ShadingFrame, active)
        material = visibility.material(si, ray)
        here = active & si.is_valid() & is_smooth(material)
        active &= si.is_valid() & ~here & (depth < _MOST_EDGES)
        passes = mi.has_flag(material.flags(), mi.BSDFFlags.Transmission)
        onwards = si.spawn_ray(dr.select(passes, ray.d, si.to_world(mi.reflect(si.wi))))
        return active, onwards, depth + 1, dr.select(here, si.p, position), reached | here

    state = mi.Bool(True), mi.Ray3f(ray), mi.UInt32(1), mi.Point3f(0.0), mi.Bool(False)
    _, _, _, position, reached = dr.while_loop(state, lambda active, *_: active, edge, label="sight")
    return position, reached
