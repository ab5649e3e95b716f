"""A random walk, edge by edge: what every path method is written in.

A method keeps the loop. Each turn of it traces one edge to a :class:`WalkVertex`, counts what is found there, and goes
on::

    vertex = walker.arrive(path)
    light = walker.light_point(vertex, source, path.active & vertex.smooth)
    scattered, (f,) = vertex.sample(source, path.active, [light])
    brought, seen = walker.next_event(path, vertex, light, f, weight)
    walker.advance(path, vertex, scattered, source)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import LightTable

from . import dimensions as dim
from .emission import DirectSample, emission_of_hit, is_emissive, sample_direct
from .guiding.lights import LocalLights
from .scattering import Evaluated, Proposal, Scattered, roulette, scatter_camera
from .vertex import WalkVertex
from .visibility import Visibility


@dataclass(kw_only=True)
class SubPath:
    """A sub-path under way, one lane each: what the loop over its edges carries on. Methods add fields of their own."""

    active: mi.Bool
    ray: mi.Ray3f  #: of the edge that is traced next
    throughput: mi.Color3f
    eta: mi.Float | None  #: product of the relative indices of refraction; None where the throughput does not hold it
    depth: mi.UInt32  #: edges so far, the one that is traced next included
    travelled: mi.Float  #: length of that edge before the surfaces that it has crossed
    rays: mi.UInt32  #: that were cast, shadow rays included


@dataclass(kw_only=True)
class CameraPath(SubPath):
    """A path from the camera that finds lights by hits and light points."""

    radiance: mi.Color3f  #: found so far
    pdf: mi.Float  #: solid-angle density of the edge's direction; 0 where no light point competes with it

    @classmethod
    def at(cls, ray: mi.Ray3f, max_edges: mi.UInt32, **own: Any) -> Self:
        """One that begins with ``ray``; ``own``: the fields that a subclass has added, or begins with otherwise."""
        fields = {
            "active": max_edges > 0,
            "ray": mi.Ray3f(ray),
            "throughput": mi.Color3f(1.0),
            "eta": mi.Float(1.0),
            "depth": mi.UInt32(1),
            "travelled": mi.Float(0.0),
            "rays": mi.UInt32(0),
            "radiance": mi.Color3f(0.0),
            "pdf": mi.Float(0.0),
        }
        return cls(**fields | own)


S = TypeVar("S", bound=SubPath)


@dataclass
class Emission:
    """Light that an edge has ended on, one lane each; the densities include the picking of the light."""

    radiance: mi.Color3f
    area_density: mi.Float  #: of the point under next event from where the edge begins; infinite: of the direction
    emission_density: mi.Float  #: of point and direction of emission
    direct_pdf: mi.Float  #: solid-angle density of the edge's direction under next event
    active: mi.Bool


@dataclass(kw_only=True)
class Walker:
    """What sub-paths of one scene are traced by."""

    visibility: Visibility
    lights: LightTable
    max_edges: mi.UInt32  #: opaque
    rr_depth: int
    proposal: Proposal = scatter_camera  #: how directions are drawn

    def walk(self, path: S, edge: Callable[[S], S], label: str) -> S:
        """Follow sub-paths to their ends, in one kernel; ``edge`` traces an edge and what follows from it."""
        (path,) = dr.while_loop((path,), lambda s: s.active, lambda s: (edge(s),), label=label)
        return path

    def arrive(self, s: SubPath) -> WalkVertex:
        """Trace an edge."""
        hit = self.visibility.scene.ray_intersect_preliminary(s.ray, active=s.active)
        si = hit.compute_surface_interaction(s.ray, active=s.active)
        s.rays += 1
        valid = si.is_valid()
        return WalkVertex(
            si=si,
            bsdf=si.bsdf(s.ray),
            number=mi.UInt32(s.depth),
            hit=hit,
            incoming=s.ray.d,
            distance=s.travelled + si.t,
            valid=valid,
            proposal=self.proposal,
        )

    def emission(self, s: SubPath, vertex: WalkVertex, lights: LightTable | LocalLights | None = None) -> Emission:
        """Light at the end of an edge, that of the environment included. ``lights``: as light points were drawn on them
        where the edge begins, if not by the table."""
        si, scene = vertex.si, self.visibility.scene
        active = s.active & is_emissive(scene, si)
        found = emission_of_hit(lights or self.lights, scene, si, active, vertex.distance)
        per_area = dr.square(vertex.distance) / dr.abs(dr.dot(si.n, vertex.incoming))
        direct_pdf = found[1] * dr.select(vertex.valid, per_area, 1.0)
        return Emission(*found, direct_pdf, active)

    def light_point(
        self,
        vertex: WalkVertex,
        source: SampleSource,
        active: mi.Bool,
        index: int = 0,
        lights: LightTable | LocalLights | None = None,
    ) -> DirectSample:
        """Draw the ``index``-th light point for a vertex. ``lights``: as they are picked there, if not by the table."""
        return sample_direct(lights or self.lights, vertex.si, source, vertex.number, index, active)

    def next_event(
        self, s: SubPath, vertex: WalkVertex, light: DirectSample, f: Evaluated, weight: mi.Float, wanted: Any = True
    ) -> tuple[mi.Color3f, mi.Bool]:
        """(what a light point brings by way of a vertex, where it is seen from there): throughput times BSDF times
        radiance over density, weighted. No ray is cast where nothing would come, or where it is not ``wanted``."""
        contribution = s.throughput * f.value * light.radiance * weight
        asked = light.active & ~dr.all(contribution == 0.0) & wanted
        s.rays += ones(asked)
        seen, share = self.seen(vertex, light.target, vertex.number + 1, asked)
        return contribution * share, seen

    def seen(
        self, vertex: WalkVertex, target: mi.Point3f, edges: mi.UInt32, active: mi.Bool
    ) -> tuple[mi.Bool, mi.Color3f | float]:
        """Whether ``target`` is seen from a vertex, and the share of light that gets through; ``edges``: of the path
        that is made so, without surfaces that the edge between the two crosses."""
        return self.visibility.along(vertex.ray_to(target), self.max_edges - edges, active)

    def kept(self, scattered: Scattered, on_edge: Any, after: Any) -> Any:
        """What holds for the next edge: ``after`` scattering, but ``on_edge``, as before, where a surface was crossed:
        that is no vertex, and the edge goes on."""
        return dr.select(scattered.is_null, on_edge, after) if self.visibility.transparent else after

    def advance(
        self,
        s: SubPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        worth: tuple[mi.Color3f, mi.Float] | None = None,
    ) -> mi.Float:
        """Leave a vertex in the direction that was drawn, and play Russian roulette; returns the factor on the
        throughput by which paths pay for those that end. ``worth``: what roulette judges by, in place of throughput
        and eta after the vertex."""
        s.throughput = s.throughput * scattered.weight
        if s.eta is not None:
            s.eta = s.eta * scattered.eta
        s.travelled = self.kept(scattered, vertex.distance, mi.Float(0.0))
        s.ray = vertex.ray(scattered.direction)
        by, eta = worth or (s.throughput, s.eta)
        u = source.decide(vertex.number, dim.ROULETTE)
        alive, factor = roulette(by, eta, vertex.number, self.rr_depth, u)
        s.throughput = s.throughput * factor
        s.depth = vertex.number + 1
        s.active &= scattered.active & alive
        return factor


def ones(mask: mi.Bool) -> mi.UInt32:
    """1 where a mask holds, else 0."""
    return dr.select(mask, mi.UInt32(1), mi.UInt32(0))
