"""Many densities on the unit square, each a quadtree that is refined where its mass is concentrated.

A tree halves the square on both axes wherever a quadrant holds more than a given share of the tree's mass
[Muller 2017]. All trees share one array of nodes on the device, roots first, so that each lane can look up or sample a
point of its tree by a few gathers. Refinement happens on the host, level by level for all trees together.

A node has four quadrants, numbered ``x + 2 y``. A *place* is a quadrant of a node, ``4 node + quadrant``; the undivided
places cover the square of their tree, and samples are counted per place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, copied_to_device

#: Largest depth: the smallest quadrant has the side 2^-12.
DEEPEST = 12
#: Number of lowest bits of the fourth word of a node, which mark the divided quadrants. The other bits are the number
#: of the node that divides the first of these.
_BITS = 4


@dataclass(frozen=True)
class Quadtrees:
    """A forest on the host.

    tree, level: (nodes,) of each node. parent: (nodes,) the place that a node divides, -1 for a root. child: (nodes, 4)
    the node that divides each quadrant, -1 for none. mass: (nodes, 4) of each quadrant, in units of the tree's own.
    Nodes are ordered by level; the root of tree t is node t.
    """

    tree: NDArray[np.int64]
    level: NDArray[np.int64]
    parent: NDArray[np.int64]
    child: NDArray[np.int64]
    mass: NDArray[np.float64]

    @classmethod
    def even(cls, count: int) -> Self:
        """``count`` trees of one node: uniform densities."""
        return cls(
            np.arange(count),
            np.zeros(count, np.int64),
            np.full(count, -1),
            np.full((count, 4), -1),
            np.full((count, 4), 0.25),
        )

    @property
    def count(self) -> int:
        """Number of trees."""
        return int(np.count_nonzero(self.parent < 0))

    @property
    def places(self) -> int:
        """Number of places, including divided ones."""
        return 4 * len(self.tree)

    def tree_of_place(self) -> NDArray[np.int64]:
        """The tree that each place belongs to."""
        return np.repeat(self.tree, 4)

    def with_mass(self, found: NDArray[np.float64]) -> Quadtrees:
        """The same trees with the masses ``found`` (one per place; those of divided places are summed up here). A tree
        without mass keeps its old one."""
        mass = np.where(self.child < 0, found.reshape(-1, 4), 0.0)
        flat = mass.reshape(-1)
        for level in range(int(self.level.max()), 0, -1):
            nodes = np.flatnonzero(self.level == level)
            flat[self.parent[nodes]] = mass[nodes].sum(axis=1)  # each place has one child
        empty = mass[: self.count].sum(axis=1)[self.tree] <= 0.0
        mass[empty] = self.mass[empty]
        return Quadtrees(self.tree, self.level, self.parent, self.child, mass)

    def refined(self, source: NDArray[np.int64], share: float | Array) -> Quadtrees:
        """Trees of the same densities, divided wherever a quadrant holds more than ``share`` of its tree's mass, and
        nowhere else. ``source``: the old tree that each new tree is made from. ``share``: a number, or one for each
        new tree."""
        levels = []
        tree = np.arange(len(source))
        old, mass, parent = source.copy(), self.mass[source], np.full(len(source), -1)
        threshold = share * mass.sum(axis=1)
        first = 0  # node of this level
        for level in range(DEEPEST):
            deep = mass > threshold[tree, None]
            if level == DEEPEST - 1:
                deep[:] = False
            row, quadrant = np.nonzero(deep)
            child = np.full(deep.shape, -1)
            child[row, quadrant] = first + len(tree) + np.arange(len(row))
            levels.append((tree, np.full(len(tree), level), parent, child, mass))
            if not len(row):
                break
            parent = 4 * (first + row) + quadrant
            first += len(tree)
            below = np.where(old[row] >= 0, self.child[old[row], quadrant], -1)
            even = np.repeat(mass[row, quadrant, None] / 4.0, 4, axis=1)
            mass = np.where((below >= 0)[:, None], self.mass[below], even)
            tree, old = tree[row], below
        return Quadtrees(*(np.concatenate(parts) for parts in zip(*levels, strict=True)))

    def density(self) -> NDArray[np.float64]:
        """(nodes, 4): density of each quadrant as if it were not divided."""
        total = self.mass[: self.count].sum(axis=1)[self.tree]
        return self.mass / total[:, None] * 4.0 ** (self.level + 1)[:, None]

    def to_arrays(self) -> dict[str, NDArray[np.int64] | Array]:
        """Arrays from which :meth:`from_arrays` restores the trees."""
        return {"parent": self.parent, "mass": self.mass}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """Inverse of :meth:`to_arrays`."""
        parent, mass = np.asarray(arrays["parent"], np.int64), np.asarray(arrays["mass"], np.float64)
        nodes = len(parent)
        tree, level = np.arange(nodes), np.zeros(nodes, np.int64)
        child = np.full((nodes, 4), -1)
        divided = np.flatnonzero(parent >= 0)
        child.reshape(-1)[parent[divided]] = divided
        above = np.where(parent >= 0, parent // 4, np.arange(nodes))
        for _ in range(DEEPEST):  # a node is correct once its ancestors are
            tree[divided] = tree[above[divided]]
            level[divided] = level[above[divided]] + 1
        return cls(tree, level, parent, child, mass)


class QuadtreeSampler:
    """A forest on the device: samples its densities, and evaluates them.

    Kernels do not depend on the number or the shape of the trees.
    """

    def __init__(self, trees: Quadtrees) -> None:
        mass = trees.mass.astype(np.float64)

        def share(part: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float32]:
            return np.divide(part, whole, out=np.full(len(part), 0.5), where=whole > 0.0).astype(np.float32)

        divided = trees.child >= 0
        first = np.where(divided, trees.child, np.iinfo(np.int64).max).min(axis=1)
        mask = (divided << np.arange(4)).sum(axis=1)
        words = np.empty((len(mass), 4), np.uint32)
        words[:, 0] = share(mass[:, 0] + mass[:, 2], mass.sum(axis=1)).view(np.uint32)
        words[:, 1] = share(mass[:, 0], mass[:, 0] + mass[:, 2]).view(np.uint32)
        words[:, 2] = share(mass[:, 1], mass[:, 1] + mass[:, 3]).view(np.uint32)
        words[:, 3] = np.where(mask > 0, first << _BITS | mask, 0)
        self._nodes = copied_to_device(mi.UInt32, words)
        self._density = copied_to_device(mi.Float, trees.density().astype(np.float32))

    def sample(
        self, tree: mi.UInt32, u: mi.Point2f, active: mi.Bool | bool = True
    ) -> tuple[mi.Point2f, mi.Float, mi.UInt32]:
        """A point of the square sampled with the two numbers ``u``: (point, density, place)."""

        def step(
            going: mi.Bool, node: mi.UInt32, u: mi.Point2f, corner: mi.Point2f, side: mi.Float, place: mi.UInt32
        ) -> tuple[Any, ...]:
            words = dr.gather(mi.Vector4u, self._nodes, node, going)
            left, low_left, low_right = (dr.reinterpret_array(mi.Float, words[i]) for i in range(3))
            x, right = _halve(u.x, left)
            y, high = _halve(u.y, dr.select(right, low_right, low_left))
            side = 0.5 * side
            corner = corner + side * mi.Point2f(dr.select(right, 1.0, 0.0), dr.select(high, 1.0, 0.0))
            place, node, deeper = _descend(words[3], node, right, high)
            return going & deeper, node, mi.Point2f(x, y), corner, side, place

        start = (
            mi.Bool(active),
            mi.UInt32(tree),
            mi.Point2f(u),
            mi.Point2f(0.0),
            mi.Float(1.0),
            mi.UInt32(0),
        )
        _, _, u, corner, side, place = dr.while_loop(start, lambda going, *_: going, step, label="quadtree: sample")
        return corner + side * u, dr.gather(mi.Float, self._density, place, active), place

    def find(self, tree: mi.UInt32, point: mi.Point2f, active: mi.Bool | bool = True) -> tuple[mi.Float, mi.UInt32]:
        """(density, place) at points of the square."""

        def step(going: mi.Bool, node: mi.UInt32, p: mi.Point2f, place: mi.UInt32) -> tuple[Any, ...]:
            word = dr.gather(mi.UInt32, self._nodes, 4 * node + 3, going)
            p = p + p
            right, high = p.x >= 1.0, p.y >= 1.0
            p = p - mi.Point2f(dr.select(right, 1.0, 0.0), dr.select(high, 1.0, 0.0))
            place, node, deeper = _descend(word, node, right, high)
            return going & deeper, node, p, place

        start = mi.Bool(active), mi.UInt32(tree), mi.Point2f(point), mi.UInt32(0)
        place = dr.while_loop(start, lambda going, *_: going, step, label="quadtree: find")[3]
        return dr.gather(mi.Float, self._density, place, active), place


def _halve(u: mi.Float, split: mi.Float) -> tuple[mi.Float, mi.Bool]:
    """Select the second half with probability 1 - split: (the number rescaled to [0, 1), whether it was selected)."""
    second = u >= split
    scaled = dr.select(second, (u - split) / (1.0 - split), u / split)
    return dr.minimum(scaled, 1.0 - 2.0**-24), second


def _descend(word: mi.UInt32, node: mi.UInt32, right: mi.Bool, high: mi.Bool) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
    """(place, the node that divides it, whether there is one)."""
    quadrant = dr.select(right, mi.UInt32(1), 0) | dr.select(high, mi.UInt32(2), 0)
    bit = mi.UInt32(1) << quadrant
    below = (word >> _BITS) + dr.popcnt(word & (bit - 1))
    return 4 * node + quadrant, below, (word & bit) != 0
