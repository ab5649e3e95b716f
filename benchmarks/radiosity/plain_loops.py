"""Loops compiled by Numba for a ray caster without a tree that counts its tests of polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from etendue.radiosity.hierarchical_multipath.casting import enter, meets, region, slab


@njit(nogil=True, cache=True, error_model="numpy")
def first_hits(
    origins: Any,
    directions: Any,
    matrices: Any,
    first_face: Any,
    faces: Any,
    normals: Any,
    boxes: Any,
    starts: Any,
    items: Any,
    resolution: Any,
    uses_boxes: Any,
    trusts: Any,
    hits: Any,
    distance: Any,
) -> Any:
    """The first face that each ray meets: ``hits`` (k, 2), scene node and face of its part or -1, and ``distance``.

    Node m has the faces from ``first_face[m, 0]`` to ``first_face[m, 1]``, in its own coordinates. With ``uses_boxes``,
    faces in a box that a ray misses are skipped. If there are lists (``starts``), only the ``items`` of the region
    where the ray enters are tested, from ``starts[first_face[m, 2] + region]`` on. With ``trusts``, a hit on one of
    the items counts as the first in the box; all faces are tested if no item is hit. Returns the numbers of tests of
    polygons and of boxes.
    """
    o, d, inverse = np.empty(3), np.empty(3), np.empty(3)
    tests, box_tests = 0, 0
    for k in range(len(origins)):
        best, node, face = np.inf, -1, -1
        for m in range(len(matrices)):
            enter(matrices[m], origins[k], directions[k], o, d)
            begin, end = first_face[m, 0], first_face[m, 1]
            is_listed = False
            if uses_boxes and m > 0:
                box_tests += 1
                for a in range(3):
                    inverse[a] = 1 / d[a]
                near, far = slab(boxes[m], o, inverse)
                if near > far or far < 0:
                    continue
                # A ray that begins inside the box has no region.
                is_listed = len(starts) > 0 and near > 0
                if is_listed:
                    grid, around, up = resolution[0], resolution[1], resolution[2]
                    r = first_face[m, 2] + region(boxes[m], o, d, near, False, grid, around, up)
                    found = False
                    for i in range(starts[r], starts[r + 1]):
                        f = begin + items[i]
                        tests += 1
                        t = meets(faces[f], normals[f], o, d)
                        if t > 0:
                            found = True
                            if t < best:
                                best, node, face = t, m, items[i]
                    if found or not trusts:
                        continue
            for f in range(begin, end):
                tests += 1
                t = meets(faces[f], normals[f], o, d)
                if 0 < t < best:
                    best, node, face = t, m, f - begin
        hits[k, 0], hits[k, 1], distance[k] = node, face, best
    return tests, box_tests


@njit(nogil=True, cache=True, error_model="numpy")
def line_tests(origins: Any, directions: Any, matrices: Any, first_face: Any, boxes: Any) -> Any:
    """Number of polygon tests that find all hits of lines, without polygons in boxes that a line misses."""
    o, d, inverse = np.empty(3), np.empty(3), np.empty(3)
    tests = 0
    for k in range(len(origins)):
        for m in range(len(matrices)):
            if m > 0:
                enter(matrices[m], origins[k], directions[k], o, d)
                for a in range(3):
                    inverse[a] = 1 / d[a]
                near, far = slab(boxes[m], o, inverse)
                if near > far:
                    continue
            tests += first_face[m, 1] - first_face[m, 0]
    return tests
