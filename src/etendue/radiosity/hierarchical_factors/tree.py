"""A hierarchy of spheres around the objects of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, logger
from etendue.surfaces import Objects, bounding_sphere, joint_sphere

Index = NDArray[np.int64]

#: Ranks of the walls, and of the sky and backs of faces.
_WALL, _NOTHING = -1, -2


@dataclass(frozen=True)
class SphereTree:
    """Spheres around sub-scenes: single objects, groups of them, and the whole scene with its walls.

    The first sphere is the main sphere around everything; the others are a binary tree of groups of objects, parents
    before their children. k objects make 2 k spheres. Each sphere contains the spheres of its children.

    Attributes
    ----------
    objects: the leaves.
    centres, radii: (m, 3), (m,).
    parents: (m,) the sphere above, -1 for the main sphere.
    first, last: (m,) the objects of a sphere have a ``rank`` from ``first`` to ``last - 1``; walls have the rank -1,
        and belong to the main sphere only.
    rank: (k,) ranks of the objects.
    """

    objects: Objects
    centres: Array
    radii: Array
    parents: Index
    first: Index
    last: Index
    rank: Index

    def __len__(self) -> int:
        return len(self.radii)

    @cached_property
    def areas(self) -> Array:
        """(m,) summed areas of the objects in each sphere, without walls."""
        return self.summed(np.where(self.objects.of_patch < 0, 0.0, self.objects.patches.areas))

    @cached_property
    def surfaces(self) -> Array:
        """(m,) areas of the spheres themselves."""
        return 4 * np.pi * self.radii**2

    @cached_property
    def levels(self) -> Index:
        """(m,) number of spheres above each sphere."""
        levels = np.zeros(len(self), dtype=np.int64)
        for node in range(1, len(self)):
            levels[node] = levels[self.parents[node]] + 1
        return levels

    @cached_property
    def ranks(self) -> Index:
        """(n + 2,) the rank of each patch; -2 for the sky and the back of a face, which belong to no sphere."""
        of_patch = self.objects.of_patch
        ranks = np.where(of_patch < 0, _WALL, self.rank[of_patch])
        return np.concatenate([ranks, [_NOTHING, _NOTHING]])

    @cached_property
    def leaves(self) -> Index:
        """(k,) the sphere of the object of each rank."""
        single = np.flatnonzero(self.last - self.first == 1)
        single = single[self.first[single] >= 0]
        leaves = np.empty(self.objects.count, dtype=np.int64)
        leaves[self.first[single]] = single
        return leaves

    def summed(self, values: Array) -> Array:
        """(m,) sums of ``values`` (n,) over the patches that belong to each sphere."""
        ranks, count = self.ranks[:-2], self.objects.count
        single = ranks >= 0
        ends = np.concatenate([[0.0], np.cumsum(np.bincount(ranks[single], values[single], count))])
        sums = ends[self.last] - ends[np.maximum(self.first, 0)]
        sums[0] += values[~single].sum()
        return np.asarray(sums)

    def densities(self, lines: Array) -> Array:
        """(m,) expected lines through a flat patch of area 1 that belongs to a sphere: the sum of 2 N / S over the
        sphere and the spheres above it [Castro 2002, sec. 2.3.2]. lines: (m,), N."""
        densities = 2 * lines / self.surfaces
        for node in range(1, len(self)):
            densities[node] += densities[self.parents[node]]
        return np.asarray(densities)

    def of_patches(self, values: Array) -> Array:
        """(n,) the value, of ``values`` (m,), of the smallest sphere that each patch belongs to."""
        return np.asarray(values[self.lowest])

    @cached_property
    def lowest(self) -> Index:
        """(n,) the smallest sphere that each patch belongs to: the sphere of its object, or the main sphere."""
        leaves = np.concatenate([self.leaves, [0]])  # the rank -1 of walls is the last entry
        return leaves[self.ranks[:-2]]

    def belong(self, spheres: Index, patches: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Whether patches belong to spheres; the sky ``n`` and the back of a face ``n + 1`` belong to none."""
        ranks = self.ranks[patches]
        return (ranks >= self.first[spheres]) & (ranks < self.last[spheres])

    def common(self, one: Index, other: Index) -> Index:
        """The smallest sphere to which both of two patches belong; arrays of equal length."""
        a, b = self.lowest[one], self.lowest[other]
        while len(apart := np.flatnonzero(a != b)):
            deeper = self.levels[a[apart]] >= self.levels[b[apart]]
            up, down = apart[deeper], apart[~deeper]
            a[up], b[down] = self.parents[a[up]], self.parents[b[down]]
        return a


def sphere_tree(objects: Objects) -> SphereTree:
    """Spheres around objects; the two spheres with the closest centres are joined repeatedly [Castro 2002, sec. 4.2.2].

    The sphere of a group is the smallest sphere around its two parts. The spheres of objects and the main sphere are
    the smallest around their vertices. A group whose sphere is not inside the main sphere gets the main sphere.
    """
    k = objects.count
    if k == 1:
        logger.warning("there is one object: nothing to group, and little to gain over lines of the whole scene")
    centres, radii = np.zeros((2 * k - 1, 3)), np.zeros(2 * k - 1)
    centres[:k], radii[:k] = objects.spheres
    children = _closest_pairs(centres, radii, k)
    patches = objects.patches
    used = patches.vertices[np.unique(patches.faces)]
    middle, radius = bounding_sphere(used)

    # From the top down: parents come before children, and the objects of a sphere have consecutive ranks.
    order, parents, first, last, rank = [-1], [-1], [-1], [k], np.empty(k, dtype=np.int64)
    stack, ranked = [(2 * k - 2, 0)], 0
    sizes = np.ones(2 * k - 1, dtype=np.int64)
    for node, (a, b) in enumerate(children, start=k):
        sizes[node] = sizes[a] + sizes[b]
    while stack:
        node, parent = stack.pop()
        here = len(order)
        order.append(node)
        parents.append(parent)
        first.append(ranked)
        last.append(ranked + int(sizes[node]))
        if node < k:
            rank[node] = ranked
            ranked += 1
        else:
            a, b = children[node - k]
            stack += [(b, here), (a, here)]
    centres, radii = centres[order[1:]], radii[order[1:]]
    out = np.linalg.norm(centres - middle, axis=1) + radii > radius
    centres = np.vstack([middle, np.where(out[:, None], middle, centres)])
    radii = np.concatenate([[radius], np.where(out, radius, radii)])
    return SphereTree(objects, centres, radii, np.array(parents), np.array(first), np.array(last), rank)


def _closest_pairs(centres: Array, radii: Array, count: int) -> list[tuple[int, int]]:
    """Join spheres until one is left; new spheres are written after the first ``count``. Returns the two parts of each
    new sphere."""
    alive = np.zeros(len(radii), dtype=bool)
    alive[:count] = True
    nearest = np.zeros(len(radii), dtype=np.int64)
    distance = np.full(len(radii), np.inf)

    def look(node: int) -> None:
        """Find the nearest neighbour of a sphere."""
        others = np.flatnonzero(alive)
        others = others[others != node]
        if len(others) == 0:
            distance[node] = np.inf
            return
        square = ((centres[others] - centres[node]) ** 2).sum(axis=1)
        best = int(np.argmin(square))
        nearest[node], distance[node] = others[best], square[best]

    for node in range(count):
        look(node)
    pairs = []
    for made in range(count, 2 * count - 1):
        a = int(np.argmin(distance))
        b = int(nearest[a])
        pairs.append((min(a, b), max(a, b)))
        centres[made], radii[made] = joint_sphere(centres[a], radii[a], centres[b], radii[b])
        alive[[a, b]], alive[made] = False, True
        distance[[a, b]] = np.inf
        look(made)
        others = np.flatnonzero(alive[:made])
        square = ((centres[others] - centres[made]) ** 2).sum(axis=1)
        closer = square < distance[others]
        nearest[others[closer]], distance[others[closer]] = made, square[closer]
        for node in others[~closer]:
            if nearest[node] in (a, b):
                look(int(node))
    return pairs
