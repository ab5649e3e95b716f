"""Power in a scene of parts, by part, copy and patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from .parts import Tree

#: (parts,) whether a part is held here; others are in other processes.
Held = NDArray[np.bool_]


@dataclass(frozen=True)
class Light:
    """Power by patch in a scene of parts: of each part (copies, n, c). What copies received of one kind."""

    of_parts: list[Array]

    @classmethod
    def none(cls, tree: Tree, held: Held | None = None) -> Light:
        """Darkness; in the parts ``held`` only, where some are."""
        mine = [True] * len(tree.parts) if held is None else held
        known = zip(tree.parts, tree.nodes, mine, strict=True)
        return cls([np.zeros((len(n) if is_mine else 0, len(p), p.channels)) for p, n, is_mine in known])

    @classmethod
    def of_rows(cls, tree: Tree, rows: Array) -> Light:
        """Of (patches, c), node by node; see :meth:`by_node`. A copy."""
        light = cls.none(tree)
        for node in range(len(tree)):
            light.of(tree, node)[:] = rows[tree.offsets[node] : tree.offsets[node + 1]]
        return light

    def only(self, held: Held) -> Light:
        """The same arrays of the parts ``held``; none of the others."""
        return Light([part if is_mine else part[:0] for part, is_mine in zip(self.of_parts, held, strict=True)])

    def of(self, tree: Tree, node: int) -> Array:
        """(n, c) of a node, a view."""
        rows: Array = self.of_parts[tree.part[node]][tree.rank[node]]
        return rows

    def by_node(self, tree: Tree, first: int = 0) -> Array:
        """(patches, c) node by node, see ``Tree.offsets``; from node ``first`` on."""
        return np.concatenate([self.of(tree, node) for node in range(first, len(tree))])


@dataclass(frozen=True)
class Shot:
    """Power received by patches of light that was sent once, and (c,) what was ``sent``, went ``to_sky``, and was
    ``lost`` to backs of faces; they add up exactly. ``rays``: how many."""

    received: Light
    sent: Array
    to_sky: Array
    lost: Array
    rays: int
