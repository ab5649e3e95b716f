"""Power in a scene of parts, by part, copy and patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from .parts import Tree

#: (parts,) whether a part is held in this process; other parts are held in other processes.
Held = NDArray[np.bool_]


@dataclass(frozen=True)
class Light:
    """Power of patches in a scene of parts; ``of_parts`` has an array (copies, n, c) for each part."""

    of_parts: list[Array]

    @classmethod
    def none(cls, tree: Tree, held: Held | None = None) -> Light:
        """No power; with ``held``, arrays of other parts are empty."""
        mine = [True] * len(tree.parts) if held is None else held
        known = zip(tree.parts, tree.nodes, mine, strict=True)
        return cls([np.zeros((len(n) if is_mine else 0, len(p), p.channels)) for p, n, is_mine in known])

    @classmethod
    def of_rows(cls, tree: Tree, rows: Array) -> Light:
        """Light from a copy of ``rows`` (patches, c), node by node; inverse of :meth:`by_node`."""
        light = cls.none(tree)
        for node in range(len(tree)):
            light.of(tree, node)[:] = rows[tree.offsets[node] : tree.offsets[node + 1]]
        return light

    def only(self, held: Held) -> Light:
        """The same arrays for the parts ``held``; empty arrays for other parts."""
        return Light([part if is_mine else part[:0] for part, is_mine in zip(self.of_parts, held, strict=True)])

    def of(self, tree: Tree, node: int) -> Array:
        """(n, c) power of the patches of a node, a view."""
        rows: Array = self.of_parts[tree.part[node]][tree.rank[node]]
        return rows

    def by_node(self, tree: Tree, first: int = 0) -> Array:
        """(patches, c) power, node by node from node ``first`` on; see ``Tree.offsets``."""
        return np.concatenate([self.of(tree, node) for node in range(first, len(tree))])


@dataclass(frozen=True)
class Shot:
    """Light that emitters sent once: power ``received`` by patches, and power (c,) ``sent``, ``to_sky``, and ``lost``
    to backs of faces; they add up exactly. ``rays``: number of rays."""

    received: Light
    sent: Array
    to_sky: Array
    lost: Array
    rays: int
