"""The first shot: light of emitters, sent to the patches of all copies, not to boxes [Castro 2002, sec. 5.3.5]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, in_order
from etendue.points import PointSet
from etendue.surfaces import Sides

from ..compiling import compiled
from ..errors import RadiosityError
from .light import Light, Shot
from .lists import PartRays
from .parts import Part, Tree

Index = NDArray[np.int64]

#: Number of cosine-distributed rays per aimed ray, and number of rays that are cast together.
_COSINE, _BLOCK = 1 / 8, 1 << 14
#: Limit of the share of a lamp's light that a patch receives by aimed rays. Above this limit, near a lamp,
#: cosine-distributed rays are better.
_NEAR = 0.3


@dataclass(frozen=True)
class _Lamps:
    """Emitting triangles of all copies, in coordinates of the scene."""

    corners: Array  # (l, 3, 3)
    normals: Array
    edges: Array  # (l + 1,) cumulative power, summed over channels
    colours: Array  # (l, c) power by channel, relative to the sum over channels


class FirstShots:
    """First shots in one scene. Raises :class:`RadiosityError` if nothing emits, and if too many boxes are inside each
    other."""

    def __init__(self, tree: Tree, rays: Mapping[Part, PartRays]) -> None:
        self.tree = tree
        self._sides = [None if part.patches is None else _in_part(part) for part in tree.parts]
        self._lamps = self._find_lamps()
        inner_first = [rays[part] for part in tree.parts]
        places, most = _places(inner_first), compiled("hierarchical_multipath.rays").STACK
        if places > most:
            raise RadiosityError(
                f"too many boxes of parts are inside each other: a ray needs {places} places on its stack, there are "
                f"{most}; put inner parts into one"
            )
        self._pack(inner_first)
        self._size = rays[tree.root].size
        #: From the scene into the coordinates of each node, the linear part.
        self._linear = np.linalg.inv(tree.world[:, :3, :3])

    def cast(self, rays: float, points: PointSet, first: int, seed: int) -> Shot:
        """Cast about ``rays`` aimed rays, the same number at each patch and at least one, and in addition an eighth as
        many cosine-distributed rays. ``points``: of four dimensions, from ``first`` on, in units of a shot. ``seed``:
        seeds the shifts of the points for each patch."""
        tree, each = self.tree, max(round(rays / self.tree.root.total), 1)
        aimed_at = points.block(each, first * each)
        received, loops = Light.none(tree), compiled("hierarchical_multipath.rays")
        lamps = self._lamps.corners, self._lamps.normals, self._lamps.edges, self._lamps.colours

        def aim(node: int) -> None:
            sides = self._sides[tree.part[node]]
            if sides is not None:
                loops.aim(
                    *(self._world, self._root, node, tree.world[node], tree.scale[node]),
                    *(sides.corners, sides.normals, sides.edges, self._starts[tree.part[node]]),
                    *(*lamps, aimed_at, seed, _NEAR, received.of(tree, node)),
                )

        for _ in in_order(partial(aim, node) for node in range(len(tree))):
            pass
        count = max(int(_COSINE * each * tree.root.total), 1)

        def shoot(start: int) -> Any:
            u = points.block(min(_BLOCK, count - start), first * count + start)
            return loops.shoot(
                *(self._world, self._root, self._size, self._face_sides, self._face_areas, self._linear),
                *(*lamps, u, _NEAR),
            )

        away = np.zeros((2, tree.root.channels))
        power = self._lamps.edges[-1] / count
        for found in in_order(partial(shoot, start) for start in range(0, count, _BLOCK)):
            self._add(found, power, received, away)
        return self._balanced(received, away, each * tree.root.total + count)

    def _add(self, found: Index, power: float, received: Light, away: Array) -> None:
        """Add the light of cosine-distributed rays to the sky, to backs of faces, and to patches near a lamp."""
        node, patch, lamp = found.T
        brought = power * self._lamps.colours[lamp]
        away[0] += brought[node == -1].sum(axis=0)
        away[1] += brought[(node >= 0) & (patch < 0)].sum(axis=0)
        for k in np.flatnonzero((node >= 0) & (patch >= 0)):
            received.of(self.tree, node[k])[patch[k]] += brought[k]

    def _balanced(self, received: Light, away: Array, rays: int) -> Shot:
        """The shot with its powers scaled to the sent power. Few rays leave the scene, so the power that leaves is
        scaled first."""
        sent = (self._lamps.colours * np.diff(self._lamps.edges)[:, None]).sum(axis=0)
        arrived = sum((part.sum(axis=(0, 1)) for part in received.of_parts), start=np.zeros_like(sent))
        leaving = away.sum(axis=0)
        outside = np.divide(sent - arrived, leaving, out=np.ones_like(sent), where=(leaving > 0) & (arrived < sent))
        inside = np.divide(sent - outside * leaving, arrived, out=np.zeros_like(sent), where=arrived > 0)
        for part in received.of_parts:
            part *= np.maximum(inside, 0)
        to_sky, lost = away * outside
        return Shot(received, sent, to_sky, lost, rays)

    def _find_lamps(self) -> _Lamps:
        tree, found = self.tree, []
        for node, k in enumerate(tree.part):
            sides, patches = self._sides[k], tree.parts[k].patches
            if sides is None or patches is None or not patches.emission.any():
                continue
            world, scale = tree.world[node], tree.scale[node]
            lit = np.flatnonzero(patches.emission[sides.patch].any(axis=1))
            power = patches.emission[sides.patch[lit]] * (sides.areas[lit] * scale**2)[:, None]
            corners = sides.corners[lit] @ world[:3, :3].T + world[:3, 3]
            found.append((corners, sides.normals[lit] @ world[:3, :3].T / scale, power))
        if not found:
            raise RadiosityError("no patch emits light: there is no first shot")
        corners, normals, power = (np.concatenate(rows) for rows in zip(*found, strict=True))
        strength = power.sum(axis=1)
        return _Lamps(corners, normals, np.concatenate([[0], np.cumsum(strength)]), power / strength[:, None])

    def _pack(self, rays: list[PartRays]) -> None:
        """The world of :mod:`.rays`, the patches and areas of its faces, and the first triangle of each patch."""
        tree = self.tree
        number = {id(part): k for k, part in enumerate(tree.parts)}
        nodes = np.cumsum([0, *(len(r.corners) for r in rays)])
        places = np.cumsum([0, *(len(r.order) for r in rays)])
        faces = np.cumsum([0, *(len(r.faces) for r in rays)])
        copies = np.cumsum([0, *(len(r.matrices) for r in rays)])
        links, order, sides, areas = [], [], [], []
        roots: list[int] = []
        ranks: list[int] = []
        for k, r in enumerate(rays):
            link = r.links.copy()
            is_leaf = link[:, 1] > 0
            link[:, 0] += np.where(is_leaf, places[k], nodes[k])
            links.append(link)
            is_face = r.order < len(r.faces)
            order.append(np.where(is_face, r.order + faces[k], -1 - (r.order - len(r.faces)) - copies[k]))
            roots += [nodes[number[id(child)]] for child, _ in r.part.children]
            ranks += range(len(r.part.children))
            known = np.concatenate([[] if r.part.patches is None else r.part.patches.areas, [0.0, 0.0]])
            sides.append(np.where(r.sides < len(r.part), r.sides, -1))
            areas.append(known[r.sides])
        self._world = (
            np.concatenate([r.corners for r in rays]),
            np.concatenate(links),
            np.concatenate(order),
            np.concatenate([r.faces for r in rays]),
            np.concatenate([r.normals for r in rays]),
            np.concatenate([r.matrices for r in rays]),
            np.array(roots, dtype=np.int64),
            np.array(ranks, dtype=np.int64),
            tree.first,
        )
        self._root = int(nodes[number[id(tree.root)]])
        self._face_sides, self._face_areas = np.concatenate(sides), np.concatenate(areas)
        self._starts = [
            np.zeros(1, np.int64) if s is None else np.searchsorted(s.patch, np.arange(len(p) + 1))
            for s, p in zip(self._sides, tree.parts, strict=True)
        ]


def _places(inner_first: list[PartRays]) -> int:
    """Largest number of places that a ray through the last of some parts needs on its stack: at each depth of a tree
    one for the other child, and for a leaf all of its copies, one of which is replaced by what is inside."""
    needed: dict[int, int] = {}
    for rays in inner_first:
        copies = np.cumsum([0, *(rays.order >= len(rays.faces))])
        first, count = rays.links[rays.links[:, 1] > 0, :2].T
        in_leaf = int((copies[first + count] - copies[first]).max())
        inside = max((needed[id(copy.part)] for copy in rays.part.copies), default=0)
        needed[id(rays.part)] = rays.depth + max(in_leaf - 1 + inside, 1)
    return needed[id(inner_first[-1].part)]


def _in_part(part: Part) -> Sides:
    """Sides of the patches of a part in its own coordinates."""
    assert part.patches is not None
    sides, (centre, radius) = Sides.of(part.patches), part.patches.sphere
    return Sides(sides.corners * radius + centre, sides.normals, sides.patch, sides.face, sides.edges * radius**2)
