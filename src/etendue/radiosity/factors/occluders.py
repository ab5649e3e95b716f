"""Faces that may hide others: coplanar neighbours joined to few convex polygons, in a tree of boxes."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

Index = NDArray[np.int64]

#: Most corners of a joined polygon.
MOST = 8
#: A vertex is behind a face if it is further behind than this, in radii of the scene.
_BEHIND = 1e-6
#: Faces are in one plane, and corners on one line, if they are this close to it, in radii of the scene.
_FLAT = 1e-7
#: Most faces of a leaf of the tree.
_LEAF = 4


class Occluders(NamedTuple):
    """Convex ``polygons`` (b, MOST, 3) that repeat their last corner, their number of corners and areas (b,), and
    their ``planes`` (b, 5) with the largest distance of a corner, in the order of a tree of ``boxes`` (t, 2, 3) and
    ``nodes`` (t, 3): the first polygon of a leaf and the one behind its last, or zeros, and the node behind those below
    it."""

    polygons: Array
    counts: Index
    areas: Array
    planes: Array
    boxes: Array
    nodes: Index


def occluders(corners: Array, planes: Array) -> Occluders:
    """Those of faces (f, 4, 3) with ``planes`` (f, 4), which have corners on both sides of their plane."""
    faces = corners[_may_block(corners, planes)]
    rings = _joined(faces) if len(faces) else []
    polygons = np.array([ring[[*range(len(ring)), *[-1] * (MOST - len(ring))]] for ring in rings])
    polygons, counts = polygons.reshape(-1, MOST, 3), np.array([len(ring) for ring in rings], np.int64)
    across = np.cross(polygons[:, 1:-1] - polygons[:, :1], polygons[:, 2:] - polygons[:, :1])
    normals = across.sum(axis=1)
    areas = np.linalg.norm(normals, axis=1) / 2
    normals /= 2 * areas[:, None]
    height = (normals[:, None] * polygons).sum(axis=2)
    planes = np.column_stack([normals, height.mean(axis=1), np.ptp(height, axis=1)])
    order, boxes, nodes = _tree(polygons)
    return Occluders(polygons[order], counts[order], areas[order], planes[order], boxes, nodes)


def _may_block(corners: Array, planes: Array) -> NDArray[np.bool_]:
    """(f,) whether there are vertices on both sides of the plane of a face."""
    vertices = np.unique(corners.reshape(-1, 3), axis=0)
    both = np.empty(len(corners), dtype=bool)
    for start in range(0, len(corners), 256):
        some = slice(start, start + 256)
        height = vertices @ planes[some, :3].T - planes[some, 3]
        both[some] = (height < -_BEHIND).any(axis=0) & (height > _BEHIND).any(axis=0)
    return both


def _joined(faces: Array) -> list[Array]:
    """Convex polygons (k, 3) that cover the same points as the ``faces`` (f, 4, 3).

    Neighbours are joined across edges of one direction after the other, those of the greatest total length first:
    triangles become quadrilaterals, these strips, and strips rectangles.
    """
    vertices, place = np.unique(faces.reshape(-1, 3), axis=0, return_inverse=True)
    normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    triangles = (faces[:, 2] == faces[:, 3]).all(axis=1)
    normals[triangles] = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])[triangles]
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 0] / lengths[lengths > 0, None]
    rings = [list(dict.fromkeys(ring)) for ring in place.reshape(-1, 4)[lengths > 0].tolist()]
    while _join(rings, normals, vertices):
        pass
    return [vertices[ring] for ring in rings if ring]


def _join(rings: list[list[int]], normals: Array, vertices: Array) -> bool:
    """Join neighbours across the edges that there are now, and say whether there were any. Rings that are joined to
    others become empty."""
    of_edge: dict[tuple[int, int], list[int]] = defaultdict(list)
    for number, corners in enumerate(rings):
        for a, b in zip(corners, [*corners[1:], *corners[:1]], strict=True):
            of_edge[min(a, b), max(a, b)].append(number)
    inner = [edge for edge, both in of_edge.items() if len(both) == 2]
    into: dict[int, int] = {}
    for k in _by_direction(np.array(inner, np.int64).reshape(-1, 2), vertices):
        first, second = of_edge[inner[k]]
        while first in into:
            first = into[first]
        while second in into:
            second = into[second]
        if first == second:
            continue
        ring = _union(rings[first], rings[second], inner[k], normals[first], vertices)
        if ring is not None:
            rings[first], rings[second], into[second] = ring, [], first
    return bool(into)


def _by_direction(edges: Index, vertices: Array) -> list[int]:
    """The order of edges (e, 2) by direction, those of the greatest total length first."""
    along = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    lengths = np.linalg.norm(along, axis=1)
    unit = np.round(along / lengths[:, None], 5) + 0.0
    first = np.take_along_axis(unit, (unit != 0).argmax(axis=1)[:, None], axis=1)
    _, direction = np.unique(unit * np.sign(first), axis=0, return_inverse=True)
    direction = direction.reshape(-1)
    total = np.bincount(direction, lengths)
    order: list[int] = np.lexsort([direction, -total[direction]]).tolist()
    return order


def _union(
    ours: list[int], theirs: list[int], edge: tuple[int, int], normal: Array, vertices: Array
) -> list[int] | None:
    """The union of two polygons with a common edge; None if they have it no longer, if they are not in one plane and
    beside each other, or if the union is not convex or has too many corners."""
    a, b = edge
    if _after(ours, b) == a:
        a, b = b, a
    if _after(ours, a) != b:
        return None
    theirs = theirs if _after(theirs, b) == a else theirs[::-1]
    if _after(theirs, b) != a:
        return None
    start, offsets = vertices[a], vertices[theirs] - vertices[a]
    outside = np.dot(np.cross(vertices[b] - start, offsets.mean(axis=0)), normal) < 0
    if not outside or np.abs(offsets @ normal).max() > _FLAT:
        return None
    i, j = ours.index(b), theirs.index(a)
    ring = ours[i:] + ours[:i] + (theirs[j:] + theirs[:j])[1:-1]
    for corner in (a, b):
        k = ring.index(corner)
        before, after = vertices[ring[k - 1]], vertices[ring[(k + 1) % len(ring)]]
        across = after - before
        height = np.dot(np.cross(vertices[corner] - before, across), normal) / np.linalg.norm(across)
        if height < -_FLAT:
            return None
        if height <= _FLAT:
            ring.remove(corner)
    return ring if len(ring) <= MOST else None


def _after(ring: list[int], corner: int) -> int | None:
    """The corner that follows another; None if that is not in the ring."""
    return ring[(ring.index(corner) + 1) % len(ring)] if corner in ring else None


def _tree(polygons: Array) -> tuple[Index, Array, Index]:
    """The order of polygons in a tree, and its boxes and nodes; see :class:`Occluders`."""
    boxes: list[Array] = []
    nodes: list[list[int]] = []
    order: list[Index] = []
    middle = polygons.mean(axis=1)

    def add(some: Index) -> None:
        number = len(nodes)
        boxes.append(np.stack([polygons[some].min(axis=(0, 1)), polygons[some].max(axis=(0, 1))]))
        nodes.append([0, 0, 0])
        if len(some) <= _LEAF:
            first = sum(map(len, order))
            nodes[number][:2] = [first, first + len(some)]
            order.append(some)
        else:
            axis = np.ptp(middle[some], axis=0).argmax()
            sorted_ = some[np.argsort(middle[some, axis], kind="stable")]
            for part in np.array_split(sorted_, 2):
                add(part)
        nodes[number][2] = len(nodes)

    if len(polygons):
        add(np.arange(len(polygons)))
    chosen = np.concatenate([np.zeros(0, np.int64), *order])
    return chosen, np.array(boxes).reshape(-1, 2, 3), np.array(nodes, np.int64).reshape(-1, 3)
