"""The light of lamps that are no patches: of points, of the sun and of skies.

It reaches the patches once, by rays from points on them to points of the lamps that Mitsuba's emitters sample, and is
part of the first shot. Lines then carry what the patches reflect.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import copied_to_device, seed_key
from etendue.points import Independent, OwenSobol
from etendue.scene import Problem
from etendue.surfaces import (
    BATCH,
    REACH_OF_PAIRS,
    Patches,
    Places,
    RayScene,
    RaySource,
    Sides,
    lamps_apart,
)

from ..lines.segments import scatter
from .shot import FirstShot

#: Rays from all patches to each lamp, unless another number is asked for; limits of those from a patch to a lamp; and
#: independent sequences of points that share them, whose variance gives the error.
_RAYS, _LEAST, _MOST, _SEQUENCES = 1 << 22, 32, 4096, 8
#: A lamp is seen if nothing is in the way up to this share of its distance.
_REACHED = 1.0 - 1e-4


def lamp_light(scene: Problem, patches: Patches, rays: int = _RAYS, seed: int = 0) -> FirstShot | None:
    """The light that reaches patches directly from the lamps of their scene that have no surface, apart from
    ``constant``, which is the sky of the patches: ``point``, ``spot``, ``projector``, ``luminaire``, ``directional``,
    ``envmap``, ``sunsky`` and so on. ``None`` if there are none.

    scene: that of the patches, which :func:`scene_patches` has read with ``lamps_apart=True``.
    rays: to each lamp, from all patches; at least 32 from each patch.

    The irradiance is the mean of eight estimates with independently randomised points, whose variance gives the error.
    For :func:`solve`, whose ``shot`` it is, alone or added to that of emitting patches.
    """
    lamps = lamps_apart(scene.scene)
    if not lamps:
        return None
    rays_of = _Rays(scene, patches, seed)
    each = int(np.clip(rays / len(patches), _LEAST, _MOST)) // _SEQUENCES
    received = np.zeros((_SEQUENCES, len(patches), patches.channels))
    for lamp in lamps:
        for k in range(_SEQUENCES):
            received[k] += rays_of.irradiance(lamp, k, each)
    mean = received.mean(axis=0)
    error = scatter(((found, np.ones(len(patches))) for found in received), mean)
    nothing = np.zeros(patches.channels)
    count = each * _SEQUENCES * len(patches) * len(lamps)
    return FirstShot(patches, np.zeros_like(mean), mean, error, nothing, nothing, count)


class _Rays:
    """Rays from points on patches to lamps."""

    def __init__(self, scene: Problem, patches: Patches, seed: int) -> None:
        self._scene, self._patches, self._seed = RayScene(patches), patches, seed
        self._sources = RaySource(self._scene, Sides.of(patches))
        space = scene.space
        #: Points in unit coordinates of the patches times the scale, plus the offset, are those of the lamps.
        self._scale = float(space.scale * self._scene.radius)
        self._offset = mi.Point3d(*map(float, space.from_scene(self._scene.centre)))
        self._lit = copied_to_device(mi.Bool, ~patches.empty)
        touches = patches.coincident.back_to_back
        self._touches = copied_to_device(mi.Bool, touches) if touches.any() else None
        # All patches use the same points, each with its own shift.
        self._shifts = Independent(4, seed=seed_key(seed, "lamp shifts", 0)[0]).lanes(mi.UInt32, len(patches))
        dr.eval(self._shifts)

    def irradiance(self, lamp: mi.Emitter, sequence: int, each: int) -> np.ndarray:
        """(n, c), by ``each`` rays from each patch."""
        n, parts = len(self._patches), []
        points = OwenSobol(4, seed=seed_key(self._seed, "lamp points", sequence)[0]).lanes(mi.UInt32, each)
        dr.eval(points)
        at_once = max(BATCH // each, 1)
        for first in range(0, n, at_once):
            count = min(at_once, n - first)
            lane = dr.arange(mi.UInt32, count * each)
            row = lane // dr.opaque(mi.UInt32, each)
            light = self._light(
                lamp, points, row + dr.opaque(mi.UInt32, first), lane - row * dr.opaque(mi.UInt32, each)
            )
            sums = [np.array(dr.block_sum(channel, each), np.float64) for channel in light]
            parts.append(np.stack(sums, axis=1) / each)
        return np.concatenate(parts)

    def _light(self, lamp: mi.Emitter, points: list[mi.Float64], patch: mi.UInt32, point: mi.UInt32) -> mi.Color3f:
        """Irradiance by rays, one lane each."""
        u = []
        for values, shifts in zip(points, self._shifts, strict=True):
            x = dr.gather(mi.Float64, values, point) + dr.gather(mi.Float64, shifts, patch)
            u.append(dr.select(x >= 1, x - 1, x))
        place = self._sources.of(patch, u[0], u[1])
        it = dr.zeros(mi.Interaction3f, dr.width(patch))
        it.p = mi.Point3f(place.point * self._scale + self._offset)
        ds, weight = lamp.sample_direction(it, mi.Point2f(mi.Float(u[2]), mi.Float(u[3])))
        cosine = dr.dot(ds.d, mi.Vector3f(place.normal))
        lit = dr.gather(mi.Bool, self._lit, patch) & (cosine > 0.0) & (ds.pdf > 0.0)
        if self._touches is not None:
            lit &= ~self._is_covered(place)
        distance = ds.dist / self._scale
        if mi.has_flag(lamp.flags(), mi.EmitterFlags.Infinite):
            distance = mi.Float(dr.inf)
        hit = self._scene.hit(mi.Point3f(place.origin), ds.d, lit)
        seen = lit & (hit.t >= distance * _REACHED)
        return dr.select(seen, mi.Color3f(weight) * cosine, 0.0)

    def _is_covered(self, place: Places) -> mi.Bool:
        """Whether a face of another solid lies on the place. Both were moved to their fronts and have changed places,
        so that a ray from behind meets the other one first."""
        face = self._sources.face_of(place.side)
        normal = mi.Vector3f(place.normal)
        hit = self._scene.hit(mi.Point3f(place.point - REACH_OF_PAIRS * place.normal), normal)
        is_near = hit.t <= 2.0 * REACH_OF_PAIRS
        return dr.gather(mi.Bool, self._touches, face) & is_near & (self._scene.face_of(hit) != face)
