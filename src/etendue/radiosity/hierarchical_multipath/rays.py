"""Loops compiled by Numba for the first shot: rays through a tree of parts, down into copies.

A *world* is a tuple of arrays, each with the data of all parts one after the other. For nodes of the trees: corners and
links; primitives (a face, or -1 - c for copy c). For faces: corners and normals. For copies: the matrix (3, 4) into
their coordinates, the root of their tree, and their index among their siblings. The last array has the first child of
each scene node.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from .casting import enter, meets, slab

#: Places on the stack of a ray.
STACK = 2048
#: Number of successive patches that sample lamps by the same weights.
_TOGETHER = 64
#: Length that is skipped at both ends of a ray between two surfaces, relative to its length, and at the origin of other
#: rays, relative to the size of the scene.
_END = 1e-7


@njit(nogil=True, cache=True, error_model="numpy")
def trace(world: Any, root: Any, o: Any, d: Any, least: Any, most: Any, is_any: Any, room: Any) -> Any:
    """The first face that a ray meets at distances from ``least`` to ``most``, or with ``is_any`` any face: scene node,
    face (-1 for none) and distance.

    ``room``: work arrays, see :func:`space`.
    """
    corners, links, order, faces, normals, matrices, roots, ranks, first = world
    frames, frame_node, stack = room
    frames[0, 0], frames[0, 1], frame_node[0] = o, d, 0
    used, top = 1, 1
    stack[0, 0], stack[0, 1] = root, 0
    found_node, found_face, found = -1, -1, most
    inverse = np.empty(3)
    current = -1
    while top > 0:
        top -= 1
        node, frame = stack[top]
        if frame != current:
            current = frame
            for a in range(3):
                inverse[a] = 1 / frames[frame, 1, a]
        near, far = slab(corners[node], frames[frame, 0], inverse)
        if near > far + 1e-12 * abs(far) or far < least or near > found:
            continue
        if links[node, 1] == 0 and links[node, 0] > 0:
            one, other = node + 1, links[node, 0]
            if inverse[links[node, 2]] < 0:
                one, other = other, one
            stack[top, 0], stack[top, 1] = other, frame
            stack[top + 1, 0], stack[top + 1, 1] = one, frame
            top += 2
            continue
        for k in range(links[node, 0], links[node, 0] + links[node, 1]):
            p = order[k]
            if p >= 0:
                t = meets(faces[p], normals[p], frames[frame, 0], frames[frame, 1])
                if least < t < found:
                    found, found_node, found_face = t, frame_node[frame], p
                    if is_any:
                        return found_node, found_face, found
                continue
            copy = -1 - p
            enter(matrices[copy], frames[frame, 0], frames[frame, 1], frames[used, 0], frames[used, 1])
            frame_node[used] = first[frame_node[frame]] + ranks[copy]
            stack[top, 0], stack[top, 1] = roots[copy], used
            top += 1
            used += 1
    return found_node, found_face, found


@njit(nogil=True, cache=True, error_model="numpy")
def space(nodes: Any) -> Any:
    """Work arrays of :func:`trace` for a scene of ``nodes`` nodes; a ray enters each node at most once."""
    return np.empty((nodes + 1, 2, 3)), np.empty(nodes + 1, np.int64), np.empty((STACK, 2), np.int64)


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _hashed(a: Any, b: Any, c: Any) -> Any:
    """A number in [0, 1), the hash of three integers (splitmix64)."""
    x = np.uint64(a) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(b) * np.uint64(0xC2B2AE3D27D4EB4F) + np.uint64(c)
    for _ in range(2):
        x += np.uint64(0x9E3779B97F4A7C15)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        x = x ^ (x >> np.uint64(31))
    return float(x >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _point(corners: Any, u: Any, v: Any, out: Any) -> None:
    """A uniform point of a triangle (3, 3)."""
    root = np.sqrt(u)
    for a in range(3):
        out[a] = (1 - root) * corners[0, a] + root * ((1 - v) * corners[1, a] + v * corners[2, a])


@njit(nogil=True, cache=True, error_model="numpy")
def _sample(edges: Any, first: Any, end: Any, u: Any) -> Any:
    """The interval between ascending ``edges`` that contains the share u of their range, and the position in it, in
    [0, 1)."""
    place = edges[first] + u * (edges[end] - edges[first])
    k = min(max(np.searchsorted(edges[first : end + 1], place, side="right") - 1 + first, first), end - 1)
    width = edges[k + 1] - edges[k]
    return k, min(max((place - edges[k]) / width if width > 0 else 0.5, 0.0), 1.0 - 1e-16)


@njit(nogil=True, cache=True, error_model="numpy")
def aim(
    world: Any,
    root: Any,
    node: Any,
    matrix: Any,
    scale: Any,
    triangles: Any,
    normals: Any,
    edges: Any,
    starts: Any,
    lamps: Any,
    lamp_normals: Any,
    lamp_edges: Any,
    colours: Any,
    points: Any,
    seed: Any,
    limit: Any,
    received: Any,
) -> None:
    """Add to ``received`` (n, c) the light of lamps on the patches of a node, by rays between points of both.

    In coordinates of the part: ``triangles`` (s, 3, 3), their ``normals`` and cumulative areas ``edges``; ``starts``
    (n + 1,), the first triangle of each patch. In coordinates of the scene: ``lamps`` (l, 3, 3), their cumulative power
    ``lamp_edges`` and ``colours`` (l, c). ``points`` (k, 4) are shifted for each patch. Shares above ``limit`` are left
    out. Lamps are sampled by power over squared distance, with the same weights for successive patches.
    """
    room = space(len(world[8]))
    target, lamp, way, local = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    shift, u = np.empty(4), np.empty(4)
    chosen = np.empty(len(lamps) + 1)
    for patch in range(len(starts) - 1):
        if patch % _TOGETHER == 0:
            last = min(patch + _TOGETHER, len(starts) - 1)
            _weigh(triangles[starts[patch] : starts[last]], matrix, lamps, lamp_edges, chosen)
        area = (edges[starts[patch + 1]] - edges[starts[patch]]) * scale * scale
        for a in range(4):
            shift[a] = _hashed(seed, node, 4 * patch + a)
        for k in range(len(points)):
            for a in range(4):
                u[a] = points[k, a] + shift[a]
                u[a] -= np.floor(u[a])
            side, rest = _sample(edges, starts[patch], starts[patch + 1], u[0])
            _point(triangles[side], rest, u[1], local)
            source, rest = _sample(chosen, 0, len(lamps), u[2])
            _point(lamps[source], rest, u[3], lamp)
            square, at_lamp, at_patch = 0.0, 0.0, 0.0
            for a in range(3):
                target[a] = matrix[a, 3]
                normal = 0.0
                for b in range(3):
                    target[a] += matrix[a, b] * local[b]
                    normal += matrix[a, b] * normals[side, b]
                way[a] = lamp[a] - target[a]
                square += way[a] * way[a]
                at_lamp -= way[a] * lamp_normals[source, a]
                at_patch += way[a] * normal / scale
            if at_lamp <= 0 or at_patch <= 0:
                continue
            share = area * at_lamp * at_patch / (np.pi * square * square)
            if share > limit:
                continue
            if trace(world, root, target, way, _END, 1 - _END, True, room)[1] >= 0:
                continue
            power = lamp_edges[source + 1] - lamp_edges[source]
            share *= power * chosen[-1] / ((chosen[source + 1] - chosen[source]) * len(points))
            for c in range(received.shape[1]):
                received[patch, c] += share * colours[source, c]


@njit(nogil=True, cache=True, error_model="numpy")
def _weigh(triangles: Any, matrix: Any, lamps: Any, lamp_edges: Any, chosen: Any) -> None:
    """Cumulative weights of lamps for some triangles of a part: power over the squared distance from the middle of the
    triangles, or over their squared extent if that is larger. A tenth of the weight is by power alone, in case the
    distance underestimates a lamp."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for k in range(len(triangles)):
        for i in range(3):
            for a in range(3):
                x = matrix[a, 3]
                for b in range(3):
                    x += matrix[a, b] * triangles[k, i, b]
                low[a], high[a] = min(low[a], x), max(high[a], x)
    extent = 0.0
    for a in range(3):
        extent += (high[a] - low[a]) ** 2
    chosen[0] = 0.0
    for k in range(len(lamps)):
        square = 0.0
        for a in range(3):
            middle = (lamps[k, 0, a] + lamps[k, 1, a] + lamps[k, 2, a]) / 3
            square += (middle - (low[a] + high[a]) / 2) ** 2
        chosen[k + 1] = chosen[k] + (lamp_edges[k + 1] - lamp_edges[k]) / max(square, extent, 1e-30)
    whole = chosen[-1]
    for k in range(1, len(chosen)):
        chosen[k] = 0.9 * chosen[k] / whole + 0.1 * lamp_edges[k] / lamp_edges[-1]


@njit(nogil=True, cache=True, error_model="numpy")
def shoot(
    world: Any,
    root: Any,
    size: Any,
    sides: Any,
    face_areas: Any,
    scales: Any,
    lamps: Any,
    lamp_normals: Any,
    lamp_edges: Any,
    colours: Any,
    points: Any,
    limit: Any,
) -> Any:
    """Cast rays from the lamps by the cosine law, one for each of the ``points`` (k, 4). Returns (k, 3): scene node (-1
    for the sky), patch (-1 for the back of a face), and lamp. The node is -2 for light that :func:`aim` counts, which
    has a share of at most ``limit``.

    ``sides`` (f, 2): patches of faces, -1 for none; ``face_areas`` (f, 2): areas of these patches; ``scales`` (m, 3,
    3): linear part of the transform from the scene into each node."""
    room = space(len(world[8]))
    found = np.empty((len(points), 3), np.int64)
    origin, way, across = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(points)):
        lamp, rest = _sample(lamp_edges, 0, len(lamps), points[k, 0])
        _point(lamps[lamp], rest, points[k, 1], origin)
        normal = lamp_normals[lamp]
        # The direction to a uniform point of the unit sphere around the tip of the normal has cosine density.
        z, angle = 1 - 2 * points[k, 2], 2 * np.pi * points[k, 3]
        r = np.sqrt(max(1 - z * z, 0.0))
        across[0], across[1], across[2] = r * np.cos(angle), r * np.sin(angle), z
        length = 0.0
        for a in range(3):
            way[a] = normal[a] + across[a]
            length += way[a] * way[a]
        length = np.sqrt(max(length, 1e-24))
        at_lamp = 0.0
        for a in range(3):
            way[a] /= length
            at_lamp += way[a] * normal[a]
        node, face, distance = trace(world, root, origin, way, _END * size, np.inf, False, room)
        found[k, 0], found[k, 1], found[k, 2] = -1, -1, lamp
        if face < 0:
            continue
        found[k, 0] = node
        # The normal is in coordinates of the part, so the direction is transformed into them.
        along, square = 0.0, 0.0
        for a in range(3):
            inner = 0.0
            for b in range(3):
                inner += scales[node, a, b] * way[b]
            along += world[4][face, a] * inner
            square += inner * inner
        cosine = abs(along) / np.sqrt(square)
        side = 1 if along > 0 else 0
        found[k, 1] = sides[face, side]
        if found[k, 1] >= 0:
            area = face_areas[face, side] / square
            if area * at_lamp * cosine / (np.pi * distance * distance) <= limit:
                found[k, 0] = -2
    return found
