r"""Camera paths that end in a map of irradiance.

A path ends at the first diffuse surface after a given number of scatterings, with the light that a map has there,

.. math:: \alpha \, \rho(z) \, E(z) / \pi

with the throughput alpha and the albedo rho. Mirrors, glass and null surfaces do not count as scatterings: a surface
seen through them is as far from the map as one that the path sees directly. Diffuse materials have a diffuse and no
glossy component; at other materials, and where the mirror or glass of a diffuse one is sampled, the path goes on. If
the map keeps particles with their directions, paths may end at glossy surfaces, too, which reflect each particle. No
light point is sampled at the end, since the map contains the direct light [Leeson 2001, sec. 5.7.3].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import LightTable

from ..direct import DirectWeights
from ..emission import DirectSample
from ..guiding.lights import LocalLights
from ..guiding.walk import GuidedWalk
from ..scattering import Scattered
from ..vertex import WalkVertex
from ..visibility import Visibility
from ..walk import CameraPath, MapEnd, SubPath, Walker, ones

if TYPE_CHECKING:
    from etendue.surfaces import NearestMap, SurfaceMap


def light_of_map(surface_map: SurfaceMap, end: MapEnd, visibility: Visibility) -> tuple[mi.Spectrum, mi.Bool]:
    """(contribution of the map to paths whose loop has been evaluated, lanes that end where the map has no surface)."""
    reflects = end.by_directions if end.by_directions is not None else mi.Bool(False)
    found = surface_map.irradiance(end.position, end.normal, end.reached & ~reflects)
    light, known = found.value * dr.inv_pi, found.known
    if end.ray is not None:
        here = end.reached & reflects
        si = visibility.scene.ray_intersect(end.ray, active=here)
        nearest = cast("NearestMap", surface_map)  # the only kind of map with directions
        reflected, there = nearest.reflected(si, end.normal, visibility.material(si, end.ray), here)
        light, known = dr.select(reflects, reflected, light), dr.select(reflects, there, known)
    return dr.select(end.reached & known, end.throughput * light, 0.0), end.reached & ~known


@dataclass(kw_only=True)
class EndingWalker(Walker):
    """Paths end in a map after ``after`` scatterings; the state of the walk has a :class:`MapEnd`."""

    after: mi.UInt32  #: opaque
    by_directions: bool = False  #: whether paths end at glossy surfaces, too: the map reflects particles by directions

    def arrive(self, s: SubPath, source: SampleSource | None = None) -> WalkVertex:
        """See :class:`Walker`."""
        assert isinstance(s, CameraPath) and s.end is not None
        vertex = super().arrive(s, source)
        vertex.scatterings = mi.UInt32(s.end.scatterings)
        return vertex

    def ends(self, vertex: WalkVertex) -> mi.Bool:
        """See :class:`Walker`."""
        flags = vertex.bsdf.flags()
        ends = mi.has_flag(flags, mi.BSDFFlags.Diffuse) & ~mi.has_flag(flags, mi.BSDFFlags.Glossy)
        if self.by_directions:
            other = mi.has_flag(flags, mi.BSDFFlags.Delta) | mi.has_flag(flags, mi.BSDFFlags.Transmission)
            ends |= mi.has_flag(flags, mi.BSDFFlags.GlossyReflection) & ~other
        return ends & (vertex.scatterings >= self.after)

    def light_point(
        self,
        vertex: WalkVertex,
        source: SampleSource,
        active: mi.Bool,
        index: int = 0,
        lights: LightTable | LocalLights | None = None,
    ) -> DirectSample:
        """See :class:`Walker`."""
        return super().light_point(vertex, source, active & ~self.ends(vertex), index, lights)

    def advance(
        self,
        s: SubPath,
        vertex: WalkVertex,
        scattered: Scattered,
        source: SampleSource,
        roulette_by: tuple[mi.Spectrum, mi.Float] | None = None,
    ) -> mi.Float:
        """See :class:`Walker`."""
        assert isinstance(s, CameraPath) and s.end is not None
        si, flags = vertex.si, vertex.bsdf.flags()
        # Directions may come from a guide; only the choice between mirror and diffuse reflection matters here.
        has_choice = mi.has_flag(flags, mi.BSDFFlags.Delta)
        reflects = (mi.Frame3f.cos_theta(si.wi) > 0.0) | mi.has_flag(flags, mi.BSDFFlags.BackSide)
        chosen = scattered.active & ~scattered.is_delta & ~scattered.is_null
        here = s.active & self.ends(vertex) & dr.select(has_choice, chosen, reflects)
        albedo = vertex.bsdf.call(mi.BSDF.eval_diffuse_reflectance, si, active=here & ~has_choice)
        albedo = dr.select(has_choice, scattered.weight, 1.0 if self.by_directions else albedo)
        towards = dr.select(dr.dot(si.n, vertex.incoming) > 0.0, -si.n, si.n)
        depth = vertex.depth + ones(has_choice)
        count = s.end.scatterings + ones(chosen)
        end = MapEnd(here, vertex.position, towards, s.throughput * albedo, depth, count)
        if self.by_directions:
            end.ray, end.by_directions = mi.Ray3f(s.ray.o, s.ray.d), ~has_choice
        s.end = dr.select(here, end, replace(s.end, scatterings=count))
        factor = super().advance(s, vertex, scattered, source, roulette_by)
        s.active &= ~here
        return factor


@dataclass(kw_only=True)
class EndingInIndirect(EndingWalker):
    """Paths end in a map without direct light: light points are sampled at their ends, too, and count fully there,
    since no path goes on to hit a light."""

    def light_point(
        self,
        vertex: WalkVertex,
        source: SampleSource,
        active: mi.Bool,
        index: int = 0,
        lights: LightTable | LocalLights | None = None,
    ) -> DirectSample:
        """See :class:`Walker`."""
        return Walker.light_point(self, vertex, source, active, index, lights)

    def light_weight(self, vertex: WalkVertex, light: DirectSample, pdf: mi.Float, weights: DirectWeights) -> mi.Float:
        """See :class:`Walker`."""
        return dr.select(self.ends(vertex), 1.0, super().light_weight(vertex, light, pdf, weights))


@dataclass(kw_only=True)
class EndingGuidedWalk(EndingWalker, GuidedWalk):
    """Guided paths that end in a map."""
