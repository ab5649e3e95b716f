"""Particle tracing by local lines, path by path or bounce by bounce: the classical alternative to global lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from etendue.core import Array
from etendue.points import Independent, OwenSobol, PointSet
from etendue.surfaces import STEP, RayScene, Sides, around, cosine_law

from ..errors import RadiosityError
from ..lines.local import Emission
from .absorption import check_absorption

#: Largest number of bounces of a particle.
_MOST_BOUNCES = 10_000


@dataclass(frozen=True)
class ParticleSolution:
    """The result of particle tracing. ``radiosity``: (n, c). Power (c,): ``absorbed``, ``to_sky``, and ``unshot``, the
    power not followed further. ``rays``: number of rays."""

    radiosity: Array
    absorbed: Array
    to_sky: Array
    unshot: Array
    rays: int


def depth_first(
    scene: RayScene,
    particles: int,
    points: PointSet | None = None,
    seed: int = 0,
    leave: Literal["hit", "patch"] = "hit",
) -> ParticleSolution:
    """Follow particles, equal in power, from sources until they are absorbed [Castro 2002, sec. 2.3.3].

    At a hit a particle survives with the probability of being reflected, and continues by the cosine law from the hit
    point, or from a uniform point of the patch (``leave="patch"``), which is consistent with constant radiosity.
    Sources and first directions are from four-dimensional ``points``, by default a scrambled Sobol' sequence; later
    bounces use independent numbers of the ``seed``. Raises :class:`RadiosityError` if no patch emits.
    """
    patches, power = scene.patches, _power(scene)
    if leave not in ("hit", "patch"):
        raise RadiosityError(f"particles leave from the 'hit' or the 'patch', not {leave!r}")
    n, sides = len(patches), Sides.of(patches)
    rays = Emission(scene, power).rays((OwenSobol(4, seed) if points is None else points).block(particles))
    origins, directions, carried = rays.origins, rays.directions, rays.power
    received, cast = np.zeros((n + 2, patches.channels)), 0
    for bounce in range(_MOST_BOUNCES):
        cast += len(origins)
        hits = scene.first_hits(origins, directions)
        found = np.full(len(origins), n)
        found[hits.ray] = scene.sides(hits.face, directions[hits.ray])[0]
        for c in range(patches.channels):
            received[:, c] += np.bincount(found, carried[:, c], n + 2)
        u = Independent(5, seed * _MOST_BOUNCES + bounce + 1).block(len(origins))
        on_patch = found < n
        reflected = np.zeros_like(carried)
        reflected[on_patch] = carried[on_patch] * patches.reflectance[found[on_patch]]
        survival = reflected.sum(axis=1) / carried.sum(axis=1)
        lives = u[:, 0] < survival
        if not lives.any():
            break
        distance = np.zeros(len(origins))
        distance[hits.ray] = hits.distance
        face = np.zeros(len(origins), dtype=np.int64)
        face[hits.ray] = hits.face
        normal = patches.face_normals[face[lives]]
        normal = normal * -np.sign((normal * directions[lives]).sum(axis=1, keepdims=True))
        if leave == "hit":
            place = origins[lives] + distance[lives, None] * directions[lives]
        else:
            side, within = sides.pick_of(found[lives], u[lives, 3])
            place, normal = sides.points(side, np.column_stack([within, u[lives, 4]])), sides.normals[side]
        carried = reflected[lives] / survival[lives, None]
        origins, directions = place + STEP * normal, around(normal, cosine_law(u[lives, 1:3]))
    else:
        raise RadiosityError(f"a particle is not absorbed after {_MOST_BOUNCES} bounces: reflectance is too near to 1")
    return _result(scene, received, np.zeros(patches.channels), cast)


def breadth_first(
    scene: RayScene, rays: int, points: PointSet | None = None, tolerance: float = 1e-3, seed: int = 0
) -> ParticleSolution:
    """Send the unshot power of all patches, bounce by bounce, until it is the share ``tolerance`` of the emitted power
    [Castro 2002, sec. 2.3.3].

    The emission is sent by ``rays`` rays; the number for a bounce is proportional to its power. ``points`` as in
    :func:`depth_first`; each bounce uses the next points. Raises :class:`RadiosityError` if no patch emits, and if
    light is left after 10,000 bounces.
    """
    patches, unshot = scene.patches, _power(scene)
    sequence = OwenSobol(4, seed) if points is None else points
    whole, cast = unshot.sum(), 0
    received = np.zeros((len(patches) + 2, patches.channels))
    bounces = 0
    while unshot.sum() > tolerance * whole:
        if (bounces := bounces + 1) > _MOST_BOUNCES:
            raise RadiosityError(f"light is left after {_MOST_BOUNCES} bounces: reflectance is too near to 1")
        count = max(int(np.ceil(rays * unshot.sum() / whole)), 1)
        new = Emission(scene, unshot).received(sequence.block(count, cast))
        cast += count
        received += new
        unshot = patches.reflectance * new[:-2]
    return _result(scene, received, unshot.sum(axis=0), cast)


def _power(scene: RayScene) -> Array:
    patches = scene.patches
    if not patches.emission.any():
        raise RadiosityError("no patch emits light: particles start from emitting patches (the sky sends none)")
    check_absorption(patches)
    return patches.areas[:, None] * patches.emission


def _result(scene: RayScene, received: Array, unshot: Array, rays: int) -> ParticleSolution:
    patches = scene.patches
    radiosity = patches.emission + patches.reflectance * received[:-2] / patches.divisors[:, None]
    # Arriving power that is not reflected; the reflected power of the last bounce is unshot.
    absorbed = ((1 - patches.reflectance) * received[:-2]).sum(axis=0) + received[-1]
    return ParticleSolution(radiosity, absorbed, received[-2], unshot, rays)
