"""Power in a scene of parts, by part, copy and patch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.core import Array

from .parts import Tree


@dataclass(frozen=True)
class Light:
    """Power by patch in a scene of parts: of each part (copies, n, c). What copies received of one kind."""

    of_parts: list[Array]

    @classmethod
    def none(cls, tree: Tree) -> Light:
        """Darkness."""
        return cls([np.zeros((len(n), len(p), p.channels)) for p, n in zip(tree.parts, tree.nodes, strict=True)])

    def of(self, tree: Tree, node: int) -> Array:
        """(n, c) of a node, a view."""
        rows: Array = self.of_parts[tree.part[node]][tree.rank[node]]
        return rows

    def by_node(self, tree: Tree) -> Array:
        """(patches, c) node by node, see ``Tree.offsets``."""
        return np.concatenate([self.of(tree, node) for node in range(len(tree))])


@dataclass(frozen=True)
class Shot:
    """Power received by patches of light that was sent once, and (c,) what was ``sent``, went ``to_sky``, and was
    ``lost`` to backs of faces; they add up exactly. ``rays``: how many."""

    received: Light
    sent: Array
    to_sky: Array
    lost: Array
    rays: int
