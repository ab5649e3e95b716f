"""Units: the share of one process in a scene of parts, copies of a part that lies directly in the root."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import RadiosityError
from ..method import PartProblem
from ..parts import Part, Tree

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Unit:
    """A distinct part that lies directly in the root, the parts inside it, and some or all of its copies.

    nodes: (k,) these copies, as nodes of the whole tree. problem: these copies alone, in their places, in an empty
    root. whole: (m,) for each node of the problem's tree except its root, the node of the whole tree. rows: (patches,)
    indices of their patches in the whole scene, counted node by node.
    """

    part: Part
    nodes: Index
    problem: PartProblem
    whole: Index
    rows: Index


def check_divisible(root: Part) -> None:
    """Raise :class:`RadiosityError` for a scene without boxes."""
    if not root.children:
        raise RadiosityError(
            "the scene has no boxes that could be on different workers: group its objects by a lower threshold or "
            "least number of patches, or do not divide it"
        )


def units_of(tree: Tree, least: int = 1) -> list[Unit]:
    """The units of a scene: each distinct part in the root with all of its copies, in the order of their first copies.
    While there are fewer than ``least`` units, the unit of several copies with the most patches is halved. Raises
    :class:`RadiosityError` for a scene without boxes."""
    check_divisible(tree.root)
    top = np.array(tree.levels[1])
    kinds = tree.part[top]
    _, first = np.unique(kinds, return_index=True)
    groups = [top[kinds == kinds[k]] for k in np.sort(first)]
    while len(groups) < least:
        patches = [len(nodes) * tree.parts[tree.part[nodes[0]]].total if len(nodes) > 1 else 0 for nodes in groups]
        if not any(patches):
            break
        k = int(np.argmax(patches))
        groups[k : k + 1] = np.array_split(groups[k], 2)
    return [_unit(tree, nodes) for nodes in groups]


def _unit(tree: Tree, nodes: Index) -> Unit:
    part = tree.parts[tree.part[nodes[0]]]
    # Transforms of the root's copies, not of the tree: a tree made of them has the same transforms, bit for bit.
    transforms = np.array([tree.root.children[node - 1][1] for node in nodes])
    alone = Part(None, [(part, transforms)])
    inner = Tree(alone)
    whole = np.full(len(inner), -1)
    whole[1 : 1 + len(nodes)] = nodes
    for node in range(1, len(inner)):
        count = len(inner.parts[inner.part[node]].children)
        children = tree.first[whole[node]] + np.arange(count)
        whole[inner.first[node] : inner.first[node] + count] = children
    rows = [np.arange(tree.offsets[node], tree.offsets[node + 1]) for node in whole[1:]]
    return Unit(part, nodes, PartProblem(alone), whole[1:], np.concatenate(rows))
