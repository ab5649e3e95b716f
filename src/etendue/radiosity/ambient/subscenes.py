"""The ambient term of a scene in parts, such as rooms: each part gets only the light that enters it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array
from etendue.surfaces import AmbientTerm, Patches, class_factors, class_weights, incoming

from ..errors import RadiosityError
from ..hierarchical_multipath.parts import Part, Tree

Index = NDArray[np.int64]
#: Class of the opposite normal of each class.
_OPPOSITE = np.array([1, 0, 3, 2, 5, 4])


@dataclass(frozen=True)
class SubScene:
    """Part of a scene: its own ``patches``, ``parts`` inside it, and the box from ``low`` to ``high``; light passes its
    sides. The box of a whole scene is not used."""

    patches: Index
    parts: tuple[SubScene, ...] = ()
    low: Array = field(default_factory=lambda: np.zeros(3))
    high: Array = field(default_factory=lambda: np.zeros(3))

    def walls(self, classes: int) -> Array:
        """(classes,) areas of the sides, by the class of their normal: the same for inward and outward normals."""
        x, y, z = self.high - self.low
        sides = np.repeat([y * z, z * x, x * y], 2)
        return sides if classes > 1 else sides.sum(keepdims=True)

    def all(self) -> Iterator[SubScene]:
        """This part and all parts inside it."""
        yield self
        for part in self.parts:
            yield from part.all()


@dataclass(frozen=True)
class HierarchicalAmbient:
    """``irradiance``: (n, c). ``left``: (c,) power that is still at the walls between parts. ``iterations``: number of
    iterations."""

    irradiance: Array
    left: Array
    iterations: int


def sub_scenes(patches: Patches, parts: ArrayLike) -> SubScene:
    """A scene in parts of one level, each with the box of its patches. ``parts`` (n,): index of the part of each patch,
    negative for none. Raises :class:`RadiosityError` for other than n whole numbers."""
    number = np.asarray(parts)
    if number.shape != (len(patches),) or number.dtype.kind not in "iu":
        raise RadiosityError(
            f"parts of a scene are whole numbers, one for each of {len(patches)} patches, not {number.dtype} "
            f"{number.shape}"
        )
    made = []
    sides = np.stack([patches.front, np.where(patches.back < 0, patches.front, patches.back)], axis=1)
    known = np.append(number, -1)  # the last is that of obstacles
    for part in np.unique(number[number >= 0]):
        corners = patches.vertices[patches.faces[(known[sides] == part).any(axis=1)]].reshape(-1, 3)
        made.append(SubScene(np.flatnonzero(number == part), (), corners.min(axis=0), corners.max(axis=0)))
    return SubScene(np.flatnonzero(number < 0), tuple(made))


def sub_scenes_of(root: Part, *, is_joined: bool = False) -> SubScene:
    """A scene of parts as sub-scenes, each with the axis-aligned box around the box of its part. Patches are those of
    the mesh that the parts were made of, or with ``is_joined`` those of ``root.joined()``."""
    tree = Tree(root)
    numbers = tree.numbers_in_joined if is_joined else np.concatenate([tree.parts[k].numbers for k in tree.part])

    def of(node: int) -> SubScene:
        part, world = tree.parts[tree.part[node]], tree.world[node]
        inner = tuple(of(int(tree.first[node]) + k) for k in range(len(part.children)))
        low, high = part.bounds
        corners = np.array([np.where([k & 1, k & 2, k & 4], high, low) for k in range(8)])
        placed = corners @ world[:3, :3].T + world[:3, 3]
        own = numbers[tree.offsets[node] : tree.offsets[node + 1]]
        return SubScene(own, inner, placed.min(axis=0), placed.max(axis=0))

    return of(0)


def hierarchical_ambient(
    patches: Patches,
    scene: SubScene,
    power: Array,
    term: AmbientTerm = "fuzzy",
    *,
    tolerance: float = 1e-6,
    iterations: int = 1000,
) -> HierarchicalAmbient:
    """Irradiance from ``power`` (n, c) that leaves patches, spread by an ambient term within each part of a scene
    [Castro 2002, sec. 6.4.4, figs. 6.2 and 6.3].

    The sides of boxes take part as black surfaces. Light that meets them from outside is sent inside in the same
    iteration, when the part is processed; light that meets them from inside is sent outside in the next iteration. This
    ends when at most the share ``tolerance`` of the power is at walls, or after ``iterations`` iterations (in the
    thesis 3 or 4). The method does not know that solid walls of a room keep light in: half of the light that is sent
    inside a box of six solid sides leaves it.

    Raises :class:`RadiosityError` if a patch is in no part or in several.
    """
    _check(patches, scene)
    root = _Part(patches, scene, power, term, is_root=True)
    sent = power.sum(axis=0)
    left, done = sent, 0
    while done < iterations and (left > tolerance * sent).any():
        root.spread()
        done, left = done + 1, root.on_the_way()
    irradiance = np.zeros_like(patches.reflectance)
    root.collect(irradiance)
    return HierarchicalAmbient(irradiance, left, done)


class _Part:
    """A part with the light at its walls, by the class of the normal of the side from which the light leaves."""

    def __init__(self, patches: Patches, scene: SubScene, power: Array, term: AmbientTerm, is_root: bool) -> None:
        own = scene.patches
        self.own, self.weights = own, class_weights(term, patches.normals[own])
        areas = patches.areas[own]
        classes = self.weights.shape[1]
        self.walls = np.zeros(classes) if is_root else scene.walls(classes)
        self.opposite = _OPPOSITE if classes > 1 else np.zeros(1, np.int64)
        self.parts = [_Part(patches, part, power, term, is_root=False) for part in scene.parts]
        all_areas = self.weights.T @ areas + self.walls + sum(part.walls for part in self.parts)
        self._inverse = np.divide(1.0, all_areas, out=np.zeros_like(all_areas), where=all_areas > 0)[:, None]
        self._rho = (self.weights.T @ (areas[:, None] * patches.reflectance[own])) * self._inverse
        self._factors = class_factors(all_areas) if all_areas.any() else np.zeros((classes, classes))
        self._emitted = self.weights.T @ power[own]
        self.inside, self.outside, self.light = np.zeros((3, *self._emitted.shape))

    def spread(self) -> None:
        """Send the light at the walls and of the part's own patches once, to patches and walls."""
        source = self._emitted + self.inside + sum(part.outside for part in self.parts)
        light = incoming(source * self._inverse, self._rho, self._factors)
        self._emitted, self.inside = np.zeros((2, *light.shape))
        self.light += light
        self.outside = (self.walls[:, None] * light)[self.opposite]
        for part in self.parts:
            part.inside = (part.walls[:, None] * light)[self.opposite]
            part.spread()

    def on_the_way(self) -> Array:
        """(c,) power that waits at walls."""
        return sum((part.on_the_way() for part in self.parts), start=self.outside.sum(axis=0))

    def collect(self, irradiance: Array) -> None:
        """Write the irradiance of the part's patches into an array for all patches."""
        irradiance[self.own] = self.weights @ self.light
        for part in self.parts:
            part.collect(irradiance)


def _check(patches: Patches, scene: SubScene) -> None:
    counts = np.zeros(len(patches), np.int64)
    for part in scene.all():
        counts += np.bincount(part.patches, minlength=len(patches))
    wrong = np.flatnonzero((counts != 1) & ~patches.empty)
    if len(wrong):
        first = wrong[0]
        where = "none" if counts[first] == 0 else "several"
        raise RadiosityError(
            f"patch {first} is in {where} of the parts of the scene, as {len(wrong) - 1} others: each patch is in one"
        )
