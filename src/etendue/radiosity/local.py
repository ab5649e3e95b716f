"""Local lines: from points of the patches into their hemispheres, to what they meet first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.points import PointSet

from .engine import LineEngine
from .faces import triangles
from .lines import across
from .patches import Patches
from .raycasting import STEP, RayScene
from .segments import Pairs

Index = NDArray[np.int64]

#: Rays at once.
_BATCH = 1 << 20


class LocalRays(LineEngine):
    """Rays from even points of all patches by the cosine law; each makes a segment for both of its ends.

    They have the density of global lines [Sbert 1993], but each end of a segment is looked for by one ray, and nothing
    behind it is found. Better than global lines where surfaces are few in a large space.
    """

    def __init__(self, scene: RayScene, points: PointSet | None = None) -> None:
        super().__init__(scene.patches, points)
        self.scene = scene
        self._sides = Sides.of(scene.patches)

    def expected(self, count: int) -> Array:
        """See :class:`LineEngine`: as many from a patch as to it."""
        return 2 * count * self.patches.areas / self.patches.areas.sum()

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`: sixteen pieces at least, so that batches can be made of them."""
        return max(min(_BATCH, -(-count // 16)), 1)

    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        for start, number in self._pieces(count, first, size):
            u = self.points.block(number, start)
            side, within = self._sides.pick(u[:, 0])
            found = self._sides.cast(self.scene, side, np.column_stack([within, u[:, 1]]), cosine_law(u[:, 2:]))
            source = self._sides.patch[side]
            pairs = np.stack([source, found], axis=1).astype(np.uint32)
            # A patch gets as many lines from another as it sends there, but none from the sky: these count twice.
            yield np.concatenate([pairs, pairs[found >= len(self.patches)]])


@dataclass(frozen=True)
class Sides:
    """Sides of triangles from which rays start, those of a patch one after the other."""

    corners: Array  #: (s, 3, 3), in unit coordinates
    normals: Array  #: (s, 3), to the side's own half-space
    patch: Index  #: (s,) ascending
    face: Index  #: (s,)
    edges: Array  #: (s + 1,) cumulated areas

    @classmethod
    def of(cls, patches: Patches) -> Sides:
        """All that belong to a patch."""
        corner, face = triangles(patches.faces)
        patch = np.concatenate([patches.front[face], patches.back[face]])
        kept = np.flatnonzero(patch >= 0)
        kept = kept[np.argsort(patch[kept], kind="stable")]
        row = kept % len(face)
        centre, radius = patches.sphere
        corners = (patches.vertices[corner[row]] - centre) / radius
        normals = patches.face_normals[face[row]] * np.where(kept < len(face), 1, -1)[:, None]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        return cls(corners, normals, patch[kept], face[row], np.concatenate([[0], np.cumsum(areas)]))

    @property
    def areas(self) -> Array:
        """(s,) in unit coordinates."""
        return np.diff(self.edges)

    def pick(self, u: Array) -> tuple[Index, Array]:
        """Sides by area from numbers in [0, 1), and what is left of the numbers, in [0, 1) again."""
        return self._within(u * self.edges[-1])

    def pick_of(self, patch: Index, u: Array) -> tuple[Index, Array]:
        """Sides of given patches by area."""
        first = self.edges[np.searchsorted(self.patch, patch, side="left")]
        last = self.edges[np.searchsorted(self.patch, patch, side="right")]
        side, within = self._within(first + u * (last - first))
        # Rounding must not lead to a neighbour.
        wrong = self.patch[side] != patch
        side[wrong] = np.searchsorted(self.patch, patch[wrong], side="right") - 1
        return side, within

    def _within(self, place: Array) -> tuple[Index, Array]:
        side = np.clip(np.searchsorted(self.edges, place, side="right") - 1, 0, len(self.patch) - 1)
        within = (place - self.edges[side]) / (self.edges[side + 1] - self.edges[side])
        return side, np.clip(within, 0, np.nextafter(1, 0))

    def points(self, side: Index, u: Array) -> Array:
        """Even points (k, 3) of sides, from (k, 2) numbers."""
        a, b, c = (self.corners[side, i] for i in range(3))
        root = np.sqrt(u[:, :1])
        return (1 - root) * a + root * (1 - u[:, 1:]) * b + root * u[:, 1:] * c

    def cast(self, scene: RayScene, side: Index, u: Array, ways: Array) -> Index:
        """What rays meet, from even points of ``side`` in the directions ``ways`` (k, 3) of a frame whose third axis is
        the normal: a patch, ``n`` for the sky, ``n + 1`` for the back of a face."""
        normal = self.normals[side]
        return scene.first_patches(self.points(side, u) + STEP * normal, around(normal, ways))


def cosine_law(u: Array) -> Array:
    """Directions (k, 3) around the third axis of cosine density, from (k, 2) numbers."""
    r, phi = np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.sqrt(1 - u[:, 0])], axis=1)


def even_angles(u: Array) -> Array:
    """The same, evenly spread over both angles: theta = pi/2 u, phi = 2 pi v."""
    theta, phi = np.pi / 2 * u[:, 0], 2 * np.pi * u[:, 1]
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)


@dataclass(frozen=True)
class Rays:
    """Rays that carry power: origins and unit directions (k, 3) in unit coordinates, power (k, c)."""

    origins: Array
    directions: Array
    power: Array


def emitted(scene: RayScene, power: Array, u: Array) -> Rays:
    """Rays of cosine density that carry the ``power`` (n, c) of patches, one for each point ``u`` (k, 4).

    Rays are shared out by power, all channels together, and have the colour of their source. They are scaled so that of
    each channel all power is sent.
    """
    n, sides = len(scene.patches), Sides.of(scene.patches)
    edges = np.concatenate([[0.0], np.cumsum(power.sum(axis=1))])
    place = u[:, 0] * edges[-1]
    source = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, n - 1)
    within = np.clip((place - edges[source]) / np.diff(edges)[source], 0, np.nextafter(1, 0))
    side, within = sides.pick_of(source, within)
    carried = power[source] / power[source].sum(axis=1, keepdims=True)
    sent = carried.sum(axis=0)
    carried *= np.divide(power.sum(axis=0), sent, out=np.zeros_like(sent), where=sent > 0)
    normal = sides.normals[side]
    origins = sides.points(side, np.column_stack([within, u[:, 1]])) + STEP * normal
    return Rays(origins, around(normal, cosine_law(u[:, 2:])), carried)


def shoot(scene: RayScene, power: Array, u: Array) -> Array:
    """Power (n + 2, c) that patches, the sky and the backs of faces receive, if patches send ``power`` (n, c) by
    rays."""
    rays, n = emitted(scene, power, u), len(scene.patches)
    found = scene.first_patches(rays.origins, rays.directions)
    return np.stack([np.bincount(found, column, n + 2) for column in rays.power.T], axis=1)


def around(normals: Array, ways: Array) -> Array:
    """Directions ``ways`` (k, 3) of frames whose third axes are ``normals``."""
    a, b = across(normals)
    return ways[:, :1] * a + ways[:, 1:2] * b + ways[:, 2:] * normals
