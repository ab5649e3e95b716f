"""Photons of the photon mapping methods as particles, for maps over surfaces."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.particles import Particles
from etendue.scene import Problem

from .photons import PhotonShot


def photon_hits(shot: PhotonShot, problem: Problem) -> Particles:
    """The photons of a pass of a photon mapping method (:meth:`PhotonMapping.shoot`) as particles, whose power is
    divided by the number of light paths.

    Shapes, primitives and parameters are not known (all 0): maps find them by the positions. The numbers of paths are
    not known either: each photon counts as a path.
    """
    _, _, held = shot.vertices.positions()
    dr.eval(held)
    slot = dr.compress(held)
    place = dr.zeros(mi.UInt32, shot.capacity)
    dr.scatter(place, dr.arange(mi.UInt32, len(slot)), slot)
    photons = shot.vertices.sorted_by(place, held)
    index = dr.arange(mi.UInt32, len(slot))
    position, depth = photons.position(index, True)
    photon = photons.read(index, True)
    # Power is radiance times area, here of the render space.
    to_scene = 1.0 / (shot.paths * problem.space.scale**2)
    power = photon.fluence * (dr.abs(dr.dot(photon.normal, photon.direction)) * to_scene)
    dr.eval(position, depth, photon.direction, power)
    count = len(slot)
    unknown = np.zeros(count, np.uint32)
    return Particles(
        position=problem.space.to_scene(np.array(position).T).astype(np.float32),
        direction=-np.array(photon.direction).T,
        power=np.array(power).T,
        shape=unknown,
        primitive=unknown,
        uv=np.zeros((count, 2), np.float32),
        path=np.arange(count, dtype=np.uint32),
        bounce=np.array(depth),
    )
