r"""Photon mapping: the nearest photons around what the camera sees.

Radiance is estimated from the k nearest photons [Jensen 1996], r being the distance of the farthest, from two maps:
light that came through mirrors or glass alone (caustics), and the rest. With ``final_gather`` the rest is not looked up
where the camera sees it but one bounce later, in a map of all photons, which hides the blotches of the estimate.

Every pass traces its own photons, and the picture is the mean over passes: noise vanishes with time, the blur of the
k nearest does not. Where that matters, use ``sppm`` or ``vcm``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, setting
from etendue.density import KdTree
from etendue.scene import Problem
from etendue.transport import Kind, Photons, WalkVertex

from .. import radius as radii
from ..base import ImageSettings
from .mapping import GatherPath, PhotonMapping, PhotonSettings
from .photons import PhotonShot, photon_room, reflected_by

#: Light paths for each photon asked for, at most: where next to nothing is stored, more paths do not help.
_MOST_PATHS_PER_PHOTON = 20
#: Share of the squared distance of the last photon within which the others lie.
_INSIDE = 1.0 - 1e-6


@dataclass(frozen=True)
class PmSettings(PhotonSettings):
    """Settings of ``pm``."""

    photons: int = setting(200_000, "photons that a pass stores, about", minimum=1)
    neighbours: int = setting(50, "nearest photons that an estimate is made from", minimum=2, maximum=1000)
    radius: float = setting(0.1, "largest radius to look for them in, in the unit of radius_unit", above=0.0)
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    final_gather: bool = setting(False, "look up indirect light one bounce after what the camera sees")


@dataclass
class _Map:
    """Photons in a kd-tree."""

    tree: KdTree
    photons: Photons


class Pm(PhotonMapping):
    """Photon mapping with a caustic and a global map."""

    name: ClassVar[str] = "pm"
    Settings: ClassVar[type[ImageSettings]] = PmSettings
    citations: ClassVar[tuple[str, ...]] = ("Jensen1996",)

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`PhotonMapping`."""
        self.final_gather = self.settings.final_gather
        if self.final_gather and self.settings.direct != "next_event":
            raise OptionError("final_gather=true finds direct light by next event; leave out direct=photons")
        room = photon_room(problem)
        if self.settings.photons > room.most:
            needed = room.limit_for(self.settings.photons) / 1e6
            raise OptionError(
                f"photons={self.settings.photons} need a memory limit of {needed:.0f} MB; {room.most} fit now"
            )
        super().prepare(problem, seed)
        largest = radii.absolute_radius(self, self.settings.radius, self.settings.radius_unit, seed)
        self._limit = dr.opaque(mi.Float, largest * largest)
        self._neighbours = dr.opaque(mi.UInt32, self.settings.neighbours)

    def light_paths(self) -> int:
        """As many as store the photons that were asked for."""
        return max(1, round(self.settings.photons / max(self.tracer.photons_per_path, 1.0 / _MOST_PATHS_PER_PHOTON)))

    def build(self, shot: PhotonShot, iteration: int, seed: int) -> None:
        """The two maps."""
        positions, kind, held = shot.vertices.positions()
        caustic = held & (kind == mi.UInt32(Kind.CAUSTIC))
        if self.final_gather:
            rest = held  # a photon of any kind sends light on to where the camera looks
        elif self.settings.direct == "next_event":
            rest = held & (kind == mi.UInt32(Kind.INDIRECT))
        else:
            rest = held & (kind != mi.UInt32(Kind.CAUSTIC))
        self._caustic, self._global = (self._map(shot, positions, mask) for mask in (caustic, rest))
        # Without next event, what the camera sees directly lit is seen in the photons.
        self._paths = dr.opaque(mi.Float, shot.paths)

    def _map(self, shot: PhotonShot, positions: mi.Point3f, mask: mi.Bool) -> _Map:
        dr.eval(mask)
        tree = KdTree(positions, mask)
        place = dr.arange(mi.UInt32, tree.count)
        destination = dr.zeros(mi.UInt32, shot.capacity)
        dr.scatter(destination, place, dr.gather(mi.UInt32, tree.order, place))
        return _Map(tree, shot.vertices.sorted_by(destination, mask))

    def gather(self, s: GatherPath, vertex: WalkVertex, active: mi.Bool) -> tuple[mi.Color3f, mi.UInt32]:
        """See :class:`PhotonMapping`."""
        if not self.final_gather:
            caustic, _ = self._nearest(self._caustic, s, vertex, active)
            rest, found = self._nearest(self._global, s, vertex, active)
            return caustic + rest, found
        caustic, _ = self._nearest(self._caustic, s, vertex, active & ~s.beyond)
        rest, found = self._nearest(self._global, s, vertex, active & s.beyond)
        return caustic + rest, found

    def _nearest(
        self, photon_map: _Map, s: GatherPath, vertex: WalkVertex, active: mi.Bool
    ) -> tuple[mi.Color3f, mi.UInt32]:
        """(radiance, photons) from the nearest photons of one map."""
        tree, photons, si = photon_map.tree, photon_map.photons, vertex.si
        limit = tree.kth_distance_squared(si.p, self._neighbours, self._limit, active)
        # The disc ends at the last photon: counted too, it would make the estimate k / (k - 1) too bright.
        rim = dr.select(limit < self._limit, limit * _INSIDE, dr.inf)

        def visit(photon: mi.UInt32, _: mi.Float, state: tuple[mi.Color3f, mi.UInt32]) -> tuple[mi.Color3f, mi.UInt32]:
            flux, found = state
            position, depth = photons.position(photon, active)
            allowed = (depth + s.depth <= self.edges) & (dr.squared_norm(position - si.p) < rim)
            value = reflected_by(photons, photon, vertex, limit, self.settings.kernel, active)
            return flux + dr.select(allowed, value, 0.0), found + 1

        flux, found = tree.within(si.p, limit, (mi.Color3f(0.0), mi.UInt32(0)), visit, active)
        return dr.select(limit > 0.0, flux / (dr.pi * limit * self._paths), 0.0), found
