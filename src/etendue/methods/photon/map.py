r"""Photon mapping: density estimation from the nearest photons.

Radiance is estimated from the k nearest photons [Jensen 1996], within the distance r of the farthest, in two maps:
photons that came through mirrors or glass only (caustics), and the others. With ``final_gather`` the second map
has all photons and is evaluated one bounce later, which hides the low-frequency noise of the estimate.

Every pass traces its own photons, and the picture is the mean over passes: noise vanishes with more passes, the blur by
the radius does not. ``sppm`` and ``vcm`` do not have this limit.
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
from .photons import Peaks, PhotonShot, add_by_kind, no_light, photon_room, record_merge, reflected_by

#: Most light paths per photon of the setting ``photons``, for scenes in which light paths store few photons.
_MOST_PATHS_PER_PHOTON = 20
#: Factor on the squared distance of the farthest photon, so that it is not inside.
_INSIDE = 1.0 - 1e-6


@dataclass(frozen=True)
class PmSettings(PhotonSettings):
    """Settings of ``pm``."""

    photons: int = setting(200_000, "approximate number of photons stored in a pass; more: less blur", minimum=1)
    neighbours: int = setting(
        50, "number of nearest photons in an estimate; more: less noise, more blur", minimum=2, maximum=1000
    )
    radius: float = setting(0.1, "largest distance of the nearest photons, in the unit of radius_unit", above=0.0)
    radius_unit: str = setting("scene", radii.UNIT_DOC, choices=radii.UNITS)
    final_gather: bool = setting(
        False, "estimate indirect light from photons one bounce after the first smooth surface, which hides blotches"
    )


@dataclass
class _Map:
    """Photons in a kd-tree."""

    tree: KdTree
    photons: Photons


class Pm(PhotonMapping):
    """Photon mapping with a caustic and a global map."""

    name: ClassVar[str] = "pm"
    Settings: ClassVar[type[ImageSettings]] = PmSettings
    settings: PmSettings
    citations: ClassVar[tuple[str, ...]] = ("Jensen1996",)
    spectral: ClassVar[bool] = True

    def prepare(self, problem: Problem, seed: int) -> None:
        """See :class:`PhotonMapping`."""
        self.final_gather = self.settings.final_gather
        if self.final_gather and self.settings.direct != "next_event":
            raise OptionError("final_gather=true needs direct=next_event; leave out direct=photons")
        room = photon_room(problem)
        if self.settings.photons > room.most:
            needed = room.limit_for(self.settings.photons) / 1e6
            raise OptionError(
                f"photons={self.settings.photons} needs a memory limit of {needed:.0f} MB; raise the limit, or lower "
                f"photons to {room.most}"
            )
        super().prepare(problem, seed)
        self._discs = radii.first_radius(self, self.settings.radius, self.settings.radius_unit)
        self._limit = dr.opaque(mi.Float, self._discs.largest**2)
        self._neighbours = dr.opaque(mi.UInt32, self.settings.neighbours)

    def light_paths(self) -> int:
        """The number of light paths that store ``photons`` photons, measured by the pilot."""
        return max(1, round(self.settings.photons / max(self.tracer.photons_per_path, 1.0 / _MOST_PATHS_PER_PHOTON)))

    def build(self, shot: PhotonShot, iteration: int, seed: int) -> None:
        """Build the two maps."""
        positions, kind, held = shot.vertices.positions()
        is_caustic = (kind == mi.UInt32(Kind.CAUSTIC)) | (kind == mi.UInt32(Kind.BEAM))
        caustic = held & is_caustic
        if self.final_gather:
            rest = held  # at the second surface, photons of all kinds are indirect light of the first
        elif self.settings.direct == "next_event":
            rest = held & (kind == mi.UInt32(Kind.INDIRECT))
        else:
            rest = held & ~is_caustic
        self._caustic, self._global = (self._map(shot, positions, mask) for mask in (caustic, rest))

        self._paths = dr.opaque(mi.Float, shot.paths)

    def _map(self, shot: PhotonShot, positions: mi.Point3f, mask: mi.Bool) -> _Map:
        dr.eval(mask)
        tree = KdTree(positions, mask)
        place = dr.arange(mi.UInt32, tree.count)
        destination = dr.zeros(mi.UInt32, shot.capacity)
        dr.scatter(destination, place, dr.gather(mi.UInt32, tree.order, place))
        return _Map(tree, shot.vertices.sorted_by(destination, mask))

    def gather(self, s: GatherPath, vertex: WalkVertex, active: mi.Bool) -> tuple[list[mi.Spectrum], mi.UInt32]:
        """See :class:`PhotonMapping`."""
        here, beyond = (active & ~s.beyond, active & s.beyond) if self.final_gather else (active, active)
        caustic, _ = self._nearest(self._caustic, s, vertex, self.peaks, here)
        rest, found = self._nearest(self._global, s, vertex, None if self.final_gather else self.peaks, beyond)
        return [a + b for a, b in zip(caustic, rest, strict=True)], found

    def _nearest(
        self, photon_map: _Map, s: GatherPath, vertex: WalkVertex, peaks: Peaks | None, active: mi.Bool
    ) -> tuple[list[mi.Spectrum], mi.UInt32]:
        """(radiance as :meth:`gather` returns it, photons) from the nearest photons of one map."""
        tree, photons, si = photon_map.tree, photon_map.photons, vertex.si
        most = self._limit * self._discs.share(si.p)
        limit = tree.kth_distance_squared(si.p, self._neighbours, most, active)
        # The farthest photon defines the disc; counting it would make the estimate too bright by k / (k - 1).
        rim = dr.select(limit < most, limit * _INSIDE, dr.inf)

        def visit(
            photon: mi.UInt32, _: mi.Float, state: tuple[list[mi.Spectrum], mi.UInt32]
        ) -> tuple[list[mi.Spectrum], mi.UInt32]:
            flux, found = state
            position, depth = photons.position(photon, active)
            allowed = (depth + s.depth <= self.edges) & (dr.squared_norm(position - si.p) < rim)
            value = reflected_by(photons, photon, vertex, limit, self.settings.kernel, active, peaks)
            value = dr.select(allowed, value, 0.0)
            record_merge(self.recording.camera, vertex, photons, photon, value, active)
            return add_by_kind(flux, value, photons, photon, active), found + 1

        start = no_light(self.settings.components), mi.UInt32(0)
        flux, found = tree.within(si.p, limit, start, visit, active)
        return [dr.select(limit > 0.0, part / (dr.pi * limit * self._paths), 0.0) for part in flux], found
