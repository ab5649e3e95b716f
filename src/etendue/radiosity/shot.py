"""First shot: the light of emitters sent once by local rays, so that lines need not find a lamp that few of them
meet.

:func:`first_shot` is the classical one, rays that leave emitters by the cosine law. :func:`shot_at_patches` aims most
of them: from even points of the emitters (by power) to even points of each patch, as many for each. Such a ray brings
Phi A K / m, if m are aimed at a patch of area A, with K = cos cos' / (pi r^2): where A K is small, that is all but the
same for all. Near a lamp K has no bound. What has A K above a limit is therefore left to rays by the cosine law, each
of which brings Phi / N. Each pair of points has one way, so that nothing counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.points import Independent, OwenSobol, PointSet

from .errors import RadiosityError
from .local import Sides, around, cosine_law, shoot
from .patches import Patches
from .raycasting import STEP, RayScene

Index = NDArray[np.int64]

#: Parts of the points of a shot, whose scatter tells its error.
_PARTS = 16
#: Least rays of a block of :class:`Shot`, and how many of them are aimed for one by the cosine law.
_BLOCK, _AIMED = 1 << 14, 8
#: Share A K of the light that a patch would take at most, if all of it were as near to a lamp as the point is: above
#: that, rays by the cosine law are better.
_NEAR = 0.3
#: Emitters are shot if that takes most of the variance of direct light away.
_MOST = 0.5


@dataclass(frozen=True)
class FirstShot:
    """Light of emitters, sent once by local lines.

    ``emission``: (n, c) that was sent, zero for patches whose light was not. ``irradiance``, ``error``: (n, c) what
    comes of it to each patch, and its standard error (infinite for a single ray). Power (c,): what went ``to_sky`` and
    to backs of faces, which is ``lost``; with what patches receive, it is what was sent. ``rays``: how many.
    """

    patches: Patches
    emission: Array
    irradiance: Array
    error: Array
    to_sky: Array
    lost: Array
    rays: int

    @property
    def reflected(self) -> Array:
        """(n, c) power that each patch reflects of it."""
        return self.patches.areas[:, None] * self.patches.reflectance * self.irradiance

    @property
    def absorbed(self) -> Array:
        """(c,) power that patches and backs of faces absorb of it."""
        areas = self.patches.areas[:, None]
        return (areas * (1 - self.patches.reflectance) * self.irradiance).sum(axis=0) + self.lost


def first_shot(scene: RayScene, u: Array, emitters: NDArray[np.bool_] | None = None) -> FirstShot:
    """Send the emission of all patches, or of the ``emitters`` (n,), by rays of cosine density, one for each point
    ``u`` (N, 4), equal in power.

    The error is from the scatter of 16 parts of the points. Raises :class:`RadiosityError` if no patch emits.
    """
    emission = _emission(scene.patches, emitters)
    power = scene.patches.areas[:, None] * emission
    parts = np.array_split(np.asarray(u, dtype=np.float64), min(_PARTS, len(u)))
    shares = np.array([len(part) for part in parts]) / len(u)
    received = np.zeros((len(scene.patches) + 2, scene.patches.channels))
    squares = np.zeros_like(received)
    for share, part in zip(shares, parts, strict=True):
        found = shoot(scene, power, part)
        received += share * found
        squares += share * found**2
    return _shot(scene.patches, emission, received, squares, len(parts), len(u))


def shot_at_patches(
    scene: RayScene, rays: float, points: PointSet | None = None, emitters: NDArray[np.bool_] | None = None
) -> FirstShot:
    """Send the emission of all patches, or of the ``emitters`` (n,), by so many rays or some more, most of them aimed:
    as many at each patch. The error of what a patch receives is a small part of that of :func:`first_shot`.

    What all patches receive is made what was sent, less what leaves the scene. points: of four dimensions, by default a
    scrambled Sobol' sequence. The error is from the scatter of blocks of rays. Raises :class:`RadiosityError` if no
    patch emits.
    """
    return Shot(scene, points or OwenSobol(4), emitters).cast(rays)


class Shot:
    """:func:`shot_at_patches`, growing block by block: so many rays give the same, whenever they are cast."""

    def __init__(self, scene: RayScene, points: PointSet, emitters: NDArray[np.bool_] | None) -> None:
        self._lamps = _Lamps(scene, _emission(scene.patches, emitters), points)
        self._blocks = 0
        self._received = np.zeros((len(scene.patches) + 2, scene.patches.channels))
        self._squares = np.zeros_like(self._received)

    def cast(self, rays: float) -> FirstShot:
        """What at least so many rays bring, in two blocks or more; those that were cast before are among them."""
        lamps = self._lamps
        while self._blocks < max(2, rays / lamps.rays):
            found = lamps.light(self._blocks)
            self._received += found
            self._squares += found**2
            self._blocks += 1
        m, patches = self._blocks, lamps.scene.patches
        return _shot(patches, lamps.emission, self._received / m, self._squares / m, m, m * lamps.rays)

    def state(self) -> dict[str, Any]:
        """What :meth:`restore` takes, for a checkpoint."""
        return {"blocks": self._blocks, "received": self._received, "squares": self._squares}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a :meth:`state`."""
        self._blocks, self._received, self._squares = state["blocks"], state["received"], state["squares"]


class _Lamps:
    """Emitters of a scene, ready to send blocks of rays."""

    def __init__(self, scene: RayScene, emission: Array, points: PointSet) -> None:
        self.scene, self.emission, self.points, self.sides = scene, emission, points, Sides.of(scene.patches)
        n = len(emission)
        power = scene.patches.areas[:, None] * emission
        strength = power.sum(axis=1)
        whole = np.bincount(self.sides.patch, self.sides.areas, n)
        by_side = (strength / whole)[self.sides.patch] * self.sides.areas
        self.lit = np.flatnonzero(by_side)
        self.edges = np.concatenate([[0.0], np.cumsum(by_side[self.lit])])
        self.colour = (power / np.where(strength > 0, strength, 1)[:, None])[self.sides.patch[self.lit]]
        #: Rays of a block, at each patch and by the cosine law.
        self.each = 1 << int(np.ceil(np.log2(max(_BLOCK / n, 1))))
        self.shot = -(-n * self.each // _AIMED)
        self.areas = whole
        # Each patch takes the same points, shifted by numbers of its own.
        self.shifts = Independent(4, seed=1).block(n)

    @property
    def rays(self) -> int:
        """Of a block."""
        return self.each * len(self.shifts) + self.shot

    def light(self, block: int) -> Array:
        """Power (n + 2, c) that patches, the sky and backs of faces receive by a block of rays."""
        n = len(self.emission)
        at_patches = self.points.block(self.each, block * self.each)
        u = np.mod(self.shifts[:, None, :] + at_patches, 1.0).reshape(-1, 4)
        parts = self._shot(self.points.block(self.shot, block * self.shot)), self._aimed(u)
        target, power = (np.concatenate(x) for x in zip(*parts, strict=True))
        return np.stack([np.bincount(target, column, n + 2) for column in power.T], axis=1)

    def _shot(self, u: Array) -> tuple[Index, Array]:
        """Rays by the cosine law: what each meets, and what it brings."""
        scene, patches = self.scene, self.scene.patches
        row, origins, normals = self._points(u[:, 0], u[:, 1])
        ways = cosine_law(u[:, 2:])
        directions = around(normals, ways)
        hits = scene.first_hits(origins, directions)
        found = np.full(len(u), len(patches))
        found[hits.ray] = scene.sides(hits.face, directions[hits.ray])[0]
        counts = np.ones(len(u), dtype=bool)
        on_patch = np.flatnonzero(found[hits.ray] < len(patches))
        ray, face = hits.ray[on_patch], hits.face[on_patch]
        cosine = np.abs((patches.face_normals[face] * directions[ray]).sum(axis=1))
        square = hits.distance[on_patch].astype(np.float64) ** 2
        counts[ray] = ways[ray, 2] * cosine * self.areas[found[ray]] > _NEAR * np.pi * square
        return found[counts], self.edges[-1] / self.shot * self.colour[row[counts]]

    def _aimed(self, u: Array) -> tuple[Index, Array]:
        """Rays to points of patches, those of a patch one after the other: those that arrive."""
        row, origins, normals = self._points(u[:, 2], u[:, 3])
        side, within = self.sides.pick_of(np.repeat(np.arange(len(self.emission)), self.each), u[:, 0])
        way = self.sides.points(side, np.column_stack([within, u[:, 1]])) - origins
        distance = np.sqrt((way**2).sum(axis=1))
        way /= np.maximum(distance, 1e-30)[:, None]
        cosines = (way * normals).sum(axis=1), -(way * self.sides.normals[side]).sum(axis=1)
        ahead = np.flatnonzero((cosines[0] > 0) & (cosines[1] > 0) & (distance > 0))
        hits = self.scene.first_hits(origins[ahead], way[ahead])
        seen = ahead[hits.ray][hits.face == self.sides.face[side[ahead[hits.ray]]]]
        target = self.sides.patch[side[seen]]
        share = self.areas[target] * cosines[0][seen] * cosines[1][seen] / (np.pi * distance[seen] ** 2)
        share[share > _NEAR] = 0.0
        return target, (self.edges[-1] / self.each * share)[:, None] * self.colour[row[seen]]

    def _points(self, u: Array, v: Array) -> tuple[Index, Array, Array]:
        """Even points of emitters, by power: rows of ``lit``, places just outside, and normals."""
        place = u * self.edges[-1]
        row = np.clip(np.searchsorted(self.edges, place, side="right") - 1, 0, len(self.lit) - 1)
        within = (place - self.edges[row]) / (self.edges[row + 1] - self.edges[row])
        side = self.lit[row]
        normals = self.sides.normals[side]
        points = self.sides.points(side, np.column_stack([np.clip(within, 0, np.nextafter(1, 0)), v]))
        return row, points + STEP * normals, normals


def small_emitters(patches: Patches, rays_per_segment: float) -> NDArray[np.bool_]:
    """(n,) the emitters whose light is better shot, if there are so many rays for each segment of global lines.

    A ray from an emitter tells as much of its light as a line that meets it, and more if it is aimed. Rays are shared
    out by power, lines by area: the brightest emitters are taken, as long as each gets more rays than lines; but none,
    if others keep half of the variance, in the mean over equal patches the sum of ``E^2 A``.
    """
    strength, areas = patches.emission.sum(axis=1), patches.areas
    order = np.argsort(-strength, kind="stable")
    ranked = strength[order]
    power = np.cumsum(ranked * areas[order])
    alike = np.searchsorted(-ranked, -ranked, side="right") - 1  # the last one of equal strength
    # Of s segments, 2 s A / sum(A) meet a patch; of r s rays, r s E A / power leave it.
    taken = order[(ranked > 0) & (ranked * rays_per_segment * areas.sum() >= 2 * power[alike])]
    chosen = np.zeros(len(patches), dtype=bool)
    chosen[taken] = True
    variance = strength**2 * areas
    return chosen if variance[chosen].sum() > _MOST * variance.sum() else np.zeros_like(chosen)


def _emission(patches: Patches, emitters: NDArray[np.bool_] | None) -> Array:
    emission = patches.emission if emitters is None else np.where(emitters[:, None], patches.emission, 0.0)
    if not emission.any():
        raise RadiosityError("no patch emits light: there is no first shot")
    return emission


def _shot(patches: Patches, emission: Array, mean: Array, square: Array, parts: int, rays: int) -> FirstShot:
    """From the mean of what the parts bring, and the mean of the squares."""
    areas = patches.areas[:, None]
    scatter = np.sqrt(np.maximum(square - mean**2, 0) / (parts - 1)) if parts > 1 else np.full_like(mean, np.inf)
    sent, received, leaving = (areas * emission).sum(axis=0), mean[:-2].sum(axis=0), mean[-2:].sum(axis=0)
    # Only rays by the cosine law leave the scene: they say less than those that arrive, and give way to them.
    leaves = (leaving > 0) & (received < sent)
    outside = np.divide(sent - received, leaving, out=np.ones_like(sent), where=leaves)
    inside = np.divide(sent - outside * leaving, received, out=np.zeros_like(sent), where=received > 0)
    arrived, away = mean[:-2] * np.maximum(inside, 0), mean[-2:] * outside
    return FirstShot(patches, emission, arrived / areas, scatter[:-2] / areas, away[0], away[1], rays)
