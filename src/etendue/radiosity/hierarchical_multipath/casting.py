"""Loops compiled by Numba that cast lines through a part and find all hits of a line, in double precision.

Primitives of a part are its faces and the boxes of its copies, in a tree of boxes (bounding volume hierarchy).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

#: Depth of the stack: that of the deepest tree of :func:`etendue.surfaces.box_tree`.
_DEPTH = 128
#: Largest number of hits of a line.
MOST_HITS = 4096
#: Hits closer to each other than this, in units of the part's size, are at the same place.
_SAME_PLACE = 1e-10


@njit(nogil=True, cache=True, error_model="numpy")
def slab(corners: Any, o: Any, inverse: Any) -> Any:
    """Distances at which a line enters and leaves a box; it misses the box if the first is larger."""
    near, far = -np.inf, np.inf
    for a in range(3):
        x, y = (corners[0, a] - o[a]) * inverse[a], (corners[1, a] - o[a]) * inverse[a]
        if x > y:
            x, y = y, x
        if x > near:  # false for 0 times infinity (NaN): a line in the plane of a wall
            near = x
        if y < far:
            far = y
    return near, far


@njit(nogil=True, cache=True, error_model="numpy")
def meets(corners: Any, normal: Any, o: Any, d: Any) -> Any:
    """Distance at which a line meets a face (4, 3), NaN if it does not. For a shared edge both faces compute the same
    number up to its sign, so that no line passes between them."""
    positive, negative = False, False
    bx, by, bz = corners[0, 0] - o[0], corners[0, 1] - o[1], corners[0, 2] - o[2]
    x0, y0, z0 = bx, by, bz
    for k in range(4):
        ax, ay, az = bx, by, bz
        if k == 3:
            bx, by, bz = x0, y0, z0
        else:
            bx, by, bz = corners[k + 1, 0] - o[0], corners[k + 1, 1] - o[1], corners[k + 1, 2] - o[2]
        side = d[0] * (ay * bz - az * by) + d[1] * (az * bx - ax * bz) + d[2] * (ax * by - ay * bx)
        positive |= side > 0
        negative |= side < 0
        if positive and negative:
            return np.nan
    along = normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2]
    if along == 0 or not (positive or negative):
        return np.nan
    return (normal[0] * x0 + normal[1] * y0 + normal[2] * z0) / along


@njit(nogil=True, cache=True, error_model="numpy")
def enter(matrix: Any, o: Any, d: Any, inner_o: Any, inner_d: Any) -> None:
    """Transform a line into coordinates of a copy by ``matrix`` (3, 4). Distances along the line keep their values."""
    for a in range(3):
        inner_d[a] = matrix[a, 0] * d[0] + matrix[a, 1] * d[1] + matrix[a, 2] * d[2]
        inner_o[a] = matrix[a, 0] * o[0] + matrix[a, 1] * o[1] + matrix[a, 2] * o[2] + matrix[a, 3]


@njit(nogil=True, cache=True, error_model="numpy")
def region(corners: Any, o: Any, d: Any, t: Any, leaves: Any, grid: Any, around: Any, up: Any) -> Any:
    """The region of a box that a line crosses at distance t, where it ``leaves`` or enters the box.

    Regions are ordered by face (low x, high x, low y, ...), place on the face (grid x grid), ring and sector. Lines of
    cosine density cross the ``around`` sectors times ``up`` rings of directions equally often.
    """
    # The face whose plane is nearest to the point at t. `sign * d` points out of the box.
    sign = 1.0 if leaves else -1.0
    axis, best = 0, np.inf
    for a in range(3):
        if d[a] != 0:
            wall = corners[1, a] if sign * d[a] > 0 else corners[0, a]
            off = abs((wall - o[a]) / d[a] - t)
            if off < best:
                axis, best = a, off
    high = 1 if sign * d[axis] > 0 else 0
    b, c = (axis + 1) % 3, (axis + 2) % 3
    u = (o[b] + t * d[b] - corners[0, b]) / (corners[1, b] - corners[0, b])
    v = (o[c] + t * d[c] - corners[0, c]) / (corners[1, c] - corners[0, c])
    i, j = min(max(int(u * grid), 0), grid - 1), min(max(int(v * grid), 0), grid - 1)
    x, y, z = sign * d[b], sign * d[c], d[axis]
    ring = min(int((x * x + y * y) / (x * x + y * y + z * z) * up), up - 1)
    sector = int((np.arctan2(y, x) / (2 * np.pi) + 0.5) * around) % around
    return (((2 * axis + high) * grid + i) * grid + j) * around * up + ring * around + sector


@njit(nogil=True, cache=True, error_model="numpy")
def lists(
    origins: Any,
    directions: Any,
    corners: Any,
    links: Any,
    order: Any,
    faces: Any,
    normals: Any,
    sides: Any,
    coincident: Any,
    reach: Any,
    is_interior: Any,
    boxes: Any,
    matrices: Any,
    transmittances: Any,
    own: Any,
    resolution: Any,
    size: Any,
    is_root: Any,
) -> Any:
    """Cut lines through a part into stretches: two ends, and the boxes of copies that are crossed between them.

    An end is a patch (``sides`` (f, 2) of faces: front, back), n the sky, n + 1 dark, or n + 2 + r region r of the
    part's own box. ``coincident`` (f,): 1 for faces that lie back to back on others and are set apart, 2 for those of
    them that are part of no solid, else 0; ``reach``: largest distance of two such faces; ``is_interior``: whether
    faces bound a room. Returns ends (k, 2); index of the first crossing of each stretch (k + 1,); crossings (x, 2), the
    regions of children where a line enters and leaves; number of lines through each region (r,), and the sum of their
    transmittances (r,); regions and the faces hit first behind them (y, 2); whether a line had too many hits.
    """
    grid, around, up = resolution[0], resolution[1], resolution[2]
    regions = 6 * grid * grid * around * up
    sky = resolution[3]
    ends, begins = np.empty((1024, 2), np.int32), np.empty(1024, np.int64)
    crossings, firsts = np.empty((1024, 2), np.int32), np.empty((1024, 2), np.int32)
    made, crossed, seen = 0, 0, 0
    through, passed = np.zeros(regions), np.zeros(regions)
    at, what = np.empty(MOST_HITS), np.empty(MOST_HITS, np.int64)
    leaves = np.empty(MOST_HITS, np.bool_)
    place = np.empty((MOST_HITS, 2), np.int64)
    stack = np.empty(_DEPTH, np.int64)
    inverse, inner_o, inner_d, inner_inverse = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    pairs_exist = coincident.any()
    for line in range(len(origins)):
        o, d = origins[line], directions[line]
        for a in range(3):
            inverse[a] = 1 / d[a]
        hits, top = 0, 1
        stack[0] = 0
        while top > 0:
            top -= 1
            node = stack[top]
            near, far = slab(corners[node], o, inverse)
            if near > far + size * _SAME_PLACE:
                continue
            if links[node, 1] == 0 and links[node, 0] > 0:
                stack[top], stack[top + 1] = node + 1, links[node, 0]
                top += 2
                continue
            for k in range(links[node, 0], links[node, 0] + links[node, 1]):
                p = order[k]
                if hits == MOST_HITS:
                    return ends[:0], begins[:1], crossings[:0], through, passed, firsts[:0], True
                if p < len(faces):
                    t = meets(faces[p], normals[p], o, d)
                    if not np.isnan(t):
                        at[hits], what[hits] = t, p
                        along = normals[p, 0] * d[0] + normals[p, 1] * d[1] + normals[p, 2] * d[2]
                        leaves[hits] = along > 0
                        hits += 1
                    continue
                child = p - len(faces)
                enter(matrices[child], o, d, inner_o, inner_d)
                for a in range(3):
                    inner_inverse[a] = 1 / inner_d[a]
                near, far = slab(boxes[child], inner_o, inner_inverse)
                if far - near > size * _SAME_PLACE:
                    at[hits], what[hits], leaves[hits] = (near + far) / 2, p, False
                    place[hits, 0] = child * regions + region(
                        boxes[child], inner_o, inner_d, near, False, grid, around, up
                    )
                    place[hits, 1] = child * regions + region(
                        boxes[child], inner_o, inner_d, far, True, grid, around, up
                    )
                    hits += 1
        # Sort hits by distance. At the same place, faces that the line leaves come first, as for solids that touch.
        for i in range(1, hits):
            t, w, leave, p0, p1 = at[i], what[i], leaves[i], place[i, 0], place[i, 1]
            j = i - 1
            while j >= 0:
                same = abs(at[j] - t) <= size * _SAME_PLACE
                if not ((leave and not leaves[j]) if same else at[j] > t):
                    break
                at[j + 1], what[j + 1], leaves[j + 1] = at[j], what[j], leaves[j]
                place[j + 1, 0], place[j + 1, 1] = place[j, 0], place[j, 1]
                j -= 1
            at[j + 1], what[j + 1], leaves[j + 1], place[j + 1, 0], place[j + 1, 1] = t, w, leave, p0, p1
        if pairs_exist:
            _settle(at, what, leaves, hits, len(faces), normals, d, coincident, reach, is_interior)
        left, last = sky, sky
        if not is_root:
            near, far = slab(own, o, inverse)
            left = sky + 2 + region(own, o, d, near, False, grid, around, up)
            last = sky + 2 + region(own, o, d, far, True, grid, around, up)
            through[left - sky - 2] += 1
            through[last - sky - 2] += 1
        passes, returns, waiting = 1.0, 1.0, crossed
        for i in range(hits + 1):
            if i < hits and what[i] >= len(faces):
                if crossed == len(crossings):
                    crossings = _grown(crossings)
                crossings[crossed, 0], crossings[crossed, 1] = place[i, 0], place[i, 1]
                crossed += 1
                passes *= transmittances[place[i, 0]]
                returns *= transmittances[place[i, 1]]
                continue
            right, after = last, last
            if i < hits:
                face, back = what[i], int(leaves[i])
                right, after = sides[face, back], sides[face, 1 - back]
            # Stretches between sky and dark, or between two regions, matter only if they cross copies.
            is_empty = (left == sky or left == sky + 1) and (right == sky or right == sky + 1)
            is_through = left > sky + 1 and right > sky + 1
            if is_through:
                passed[left - sky - 2] += passes
                passed[right - sky - 2] += returns
            if crossed > waiting or not (is_empty or is_through):
                if made + 1 >= len(ends):
                    ends = _grown(ends)
                    wider = np.empty(2 * len(begins), np.int64)
                    wider[: len(begins)] = begins
                    begins = wider
                ends[made, 0], ends[made, 1], begins[made] = left, right, waiting
                made += 1
                if seen + 2 > len(firsts):
                    firsts = _grown(firsts)
                if i < hits and left > sky + 1:
                    firsts[seen, 0], firsts[seen, 1] = left - sky - 2, what[i]
                    seen += 1
                if right > sky + 1 and left <= sky + 1 and i > 0:
                    k = i - 1
                    while k >= 0 and what[k] >= len(faces):
                        k -= 1
                    if k >= 0:
                        firsts[seen, 0], firsts[seen, 1] = right - sky - 2, what[k]
                        seen += 1
                waiting = crossed
            left, passes, returns = after, 1.0, 1.0
    begins[made] = crossed
    return (
        ends[:made].copy(),
        begins[: made + 1].copy(),
        crossings[:crossed].copy(),
        through,
        passed,
        firsts[:seen].copy(),
        False,
    )


@njit(nogil=True, cache=True, error_model="numpy")
def _settle(
    at: Any,
    what: Any,
    leaves: Any,
    hits: Any,
    count: Any,
    normals: Any,
    d: Any,
    coincident: Any,
    reach: Any,
    is_interior: Any,
) -> None:
    """Order the hits of faces that lie back to back and are set apart: outside of solids a line meets the front of one
    first, inside a solid that touches another one it leaves the solid first. The faces that are in no pair tell whether
    a line is inside."""
    inside, is_known, pairs = False, False, 0
    k = 0
    while k < hits:  # the first face that is in no pair
        if what[k] < count:
            if not _is_pair(k, at, what, leaves, hits, count, normals, d, coincident, reach):
                inside, is_known = leaves[k], True
                break
            pairs += 1
            k += 1
        k += 1
    if not is_known:
        inside = is_interior and pairs % 2 == 0
    k = 0
    while k < hits:
        if what[k] < count:
            if _is_pair(k, at, what, leaves, hits, count, normals, d, coincident, reach):
                if inside and min(coincident[what[k]], coincident[what[k + 1]]) < 2:
                    at[k], at[k + 1] = at[k + 1], at[k]
                    what[k], what[k + 1] = what[k + 1], what[k]
                    leaves[k], leaves[k + 1] = True, False
                k += 1
            else:
                inside = not leaves[k]
        k += 1


@njit(nogil=True, cache=True, error_model="numpy")
def _is_pair(
    k: Any,
    at: Any,
    what: Any,
    leaves: Any,
    hits: Any,
    count: Any,
    normals: Any,
    d: Any,
    coincident: Any,
    reach: Any,
) -> Any:
    """Whether hit ``k`` and the next one are of two faces that lie back to back and were set apart."""
    if k + 1 >= hits or what[k + 1] >= count or leaves[k] or not leaves[k + 1]:
        return False
    p = what[k]
    if coincident[p] == 0 or coincident[what[k + 1]] == 0:
        return False
    along = normals[p, 0] * d[0] + normals[p, 1] * d[1] + normals[p, 2] * d[2]
    return abs(along) * (at[k + 1] - at[k]) < reach * np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])


@njit(nogil=True, cache=True, error_model="numpy")
def _grown(rows: Any) -> Any:
    wider = np.empty((2 * len(rows), 2), np.int32)
    for k in range(len(rows)):  # to assign arrays takes Numba some seconds to compile
        wider[k, 0], wider[k, 1] = rows[k, 0], rows[k, 1]
    return wider
