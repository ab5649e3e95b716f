"""Photons of the photon mapping methods as particles, for maps over surfaces."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.particles import Particles
from etendue.scene import Problem

from .map import Pm, PmSettings
from .photons import PhotonShot


def trace_photons(problem: Problem, photons: int, seed: int = 0) -> Particles:
    """About so many photons of ``pm``, at each surface with a smooth component that a light path meets.

    Their power is that of all light paths together. Shapes, primitives and parameters of these particles are not known
    (all 0): maps find them by their positions. The number of a path is unknown too, so that each is a path of its own.
    """
    method = Pm(PmSettings(photons=photons))
    method.prepare(problem, seed)
    return photon_hits(method.shoot(0, seed), problem)


def photon_hits(shot: PhotonShot, problem: Problem) -> Particles:
    """The photons of a pass as particles, as of :func:`trace_photons`."""
    _, _, held = shot.vertices.positions()
    dr.eval(held)
    slot = dr.compress(held)
    place = dr.zeros(mi.UInt32, shot.capacity)
    dr.scatter(place, dr.arange(mi.UInt32, len(slot)), slot)
    photons = shot.vertices.sorted_by(place, held)
    index = dr.arange(mi.UInt32, len(slot))
    position, depth = photons.position(index, True)
    photon = photons.read(index, True)
    power = photon.fluence * (dr.abs(dr.dot(photon.normal, photon.direction)) / shot.paths)
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
