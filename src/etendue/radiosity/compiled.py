"""Loops compiled for the CPU by Numba: rasterising bundles of lines, and running over stored segments.

This is the only file that knows Numba. Its functions let go of Python's lock, so that threads run them side by side.
What they return does not depend on the number of threads, but for the order of additions.

A *segment* is a pair of patch numbers, or of one and ``n`` for the sky, ``n + 1`` for darkness (the back of a face).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def rasterise(
    vertices: Any,
    faces: Any,
    front: Any,
    back: Any,
    frames: Any,
    shifts: Any,
    spacing: Any,
    gap: Any,
    patches: Any,
    room: Any,
) -> Any:
    """Segments (k, 2) of the lines of some bundles, line by line, each from its near end on.

    vertices (v, 3); faces (f, 4), flat and convex; front, back (f,) patch of each side, ``patches + 1`` for none;
    frames (b, 3, 3) as of :meth:`Bundles.frames`; shifts (b, 2) of the grid in units of ``spacing``; room, the
    hits of a bundle to be ready for.

    Each line has a list of its hits, in order of their discovery; see :func:`_walk` for the ``gap``.
    """
    # What may grow is passed on as an argument: arrays that change hands in a loop are counted at every turn of it.
    place = np.empty((len(vertices), 3))
    heads = np.empty(1, np.int32)
    depths, sides, nexts = np.empty(room), np.empty((room, 2), np.uint32), np.empty(room, np.int32)
    stack, order = np.empty(32, np.int32), np.empty(32)
    pairs, made = np.empty((room * (len(frames) + 3) * 3 // 5, 2), np.uint32), 0
    for b in range(len(frames)):
        low_x, high_x, low_y, high_y = _project(vertices, frames[b], shifts[b], spacing, place)
        column, row = math.ceil(low_x), math.ceil(low_y)
        columns, rows = math.ceil(high_x) - column, math.ceil(high_y) - row
        if columns <= 0 or rows <= 0:
            continue
        if columns * rows > len(heads):
            heads = np.empty(columns * rows, np.int32)
        heads[: columns * rows] = -1
        face, count, wanted = 0, 0, 0
        while True:
            face, count, wanted = _fill(
                *(place, faces, front, back, column, row, columns, heads, depths, sides, nexts, face, count)
            )
            if face == len(faces):
                break
            room = max(2 * len(depths), count + wanted)
            depths, nexts = _grown(depths, room, count), _grown(nexts, room, count)
            sides = _grown_pairs(sides, room, count)
        if made + 2 * count > len(pairs):
            pairs = _grown_pairs(pairs, 2 * (made + 2 * count), made)
        line = 0
        while True:
            line, made = _walk(
                heads, columns * rows, depths, sides, nexts, stack, order, pairs, line, made, patches, gap
            )
            if line == columns * rows:
                break
            stack, order = np.empty(2 * len(stack), np.int32), np.empty(2 * len(stack))
    return pairs[:made]


@njit(nogil=True, cache=True, error_model="numpy")
def _project(vertices: Any, frame: Any, shift: Any, spacing: Any, place: Any) -> Any:
    """Write column, row and depth of the vertices to ``place`` (v, 3), and return the bounds of the first two."""
    xx, xy, xz = frame[0, 0] / spacing, frame[0, 1] / spacing, frame[0, 2] / spacing
    yx, yy, yz = frame[1, 0] / spacing, frame[1, 1] / spacing, frame[1, 2] / spacing
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for v in range(len(vertices)):
        px, py, pz = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        x = xx * px + xy * py + xz * pz - shift[0]
        y = yx * px + yy * py + yz * pz - shift[1]
        place[v, 0], place[v, 1] = x, y
        place[v, 2] = frame[2, 0] * px + frame[2, 1] * py + frame[2, 2] * pz
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    return low_x, high_x, low_y, high_y


@njit(nogil=True, cache=True, error_model="numpy")
def _fill(
    place: Any,
    faces: Any,
    front: Any,
    back: Any,
    first_column: Any,
    first_row: Any,
    columns: Any,
    heads: Any,
    depths: Any,
    sides: Any,
    nexts: Any,
    start: Any,
    count: Any,
) -> Any:
    """Put the hits of the faces from ``start`` on into the lists: depth, patch of the near side and of the far side.

    Returns the face before which room has run out (``len(faces)`` if it has not), the number of hits, and how many more
    that face may have.

    A face covers the half-open interval of a row between its edges, and an edge is computed alike for both faces that
    share it: a line meets exactly one of them.
    """
    for f in range(start, len(faces)):
        i0, i1, i2, i3 = faces[f, 0], faces[f, 1], faces[f, 2], faces[f, 3]
        y0, y1, y2, y3 = place[i0, 1], place[i1, 1], place[i2, 1], place[i3, 1]
        top, end = math.ceil(min(min(y0, y1), min(y2, y3))), math.ceil(max(max(y0, y1), max(y2, y3)))
        if top >= end:
            continue
        x0, x1, x2, x3 = place[i0, 0], place[i1, 0], place[i2, 0], place[i3, 0]
        width = math.ceil(max(max(x0, x1), max(x2, x3))) - math.ceil(min(min(x0, x1), min(x2, x3)))
        if width <= 0:
            continue
        if count + (end - top) * width > len(depths):
            return f, count, (end - top) * width
        z0, z1, z2, z3 = place[i0, 2], place[i1, 2], place[i2, 2], place[i3, 2]
        # Normal from the diagonals; of a triangle, whose last corner is there twice, as well.
        ax, ay, az = x2 - x0, y2 - y0, z2 - z0
        bx, by, bz = x3 - x1, y3 - y1, z3 - z1
        nz = ax * by - ay * bx
        if nz == 0.0:
            continue
        slope_x, slope_y = -(ay * bz - az * by) / nz, -(az * bx - ax * bz) / nz
        z_low, z_high = min(min(z0, z1), min(z2, z3)), max(max(z0, z1), max(z2, z3))
        if nz > 0:
            near, far = back[f], front[f]
        else:
            near, far = front[f], back[f]
        for row in range(top, end):
            left, right = np.inf, -np.inf
            for edge in range(4):
                if edge == 0:
                    xa, ya, xb, yb = x0, y0, x1, y1
                elif edge == 1:
                    xa, ya, xb, yb = x1, y1, x2, y2
                elif edge == 2:
                    xa, ya, xb, yb = x2, y2, x3, y3
                else:
                    xa, ya, xb, yb = x3, y3, x0, y0
                if ya > yb:
                    xa, ya, xb, yb = xb, yb, xa, ya
                if ya <= row < yb:
                    x = xa + (row - ya) * ((xb - xa) / (yb - ya))
                    left, right = min(left, x), max(right, x)
            if left >= right:
                continue
            depth = z0 + slope_y * (row - y0)
            line = (row - first_row) * columns - first_column
            for column in range(math.ceil(left), math.ceil(right)):
                depths[count] = min(max(depth + slope_x * (column - x0), z_low), z_high)
                sides[count, 0], sides[count, 1], nexts[count] = near, far, heads[line + column]
                heads[line + column] = count
                count += 1
    return len(faces), count, 0


@njit(nogil=True, cache=True, error_model="numpy")
def _walk(
    heads: Any,
    lines: Any,
    depths: Any,
    sides: Any,
    nexts: Any,
    stack: Any,
    order: Any,
    pairs: Any,
    start: Any,
    made: Any,
    patches: Any,
    gap: Any,
) -> Any:
    """Sort the hits of the lines from ``start`` on, and write the segments between them from ``pairs[made]`` on.

    Two faces of opposite sense that are nearer than ``gap`` may be a sheet, or solids that touch (a box on the floor).
    Rounding does not decide which comes first, but whether the line is inside a solid, behind the back of a face.

    Returns the line whose hits ``stack`` cannot hold (``lines`` if there is none) and the number of segments.
    """
    sky, dark = np.uint32(patches), np.uint32(patches + 1)
    for line in range(start, lines):
        hit = heads[line]
        if hit < 0:
            continue
        hits = 0
        while hit >= 0:
            if hits == len(stack):
                return line, made
            depth, at = depths[hit], hits
            while at > 0 and order[at - 1] > depth:
                order[at], stack[at] = order[at - 1], stack[at - 1]
                at -= 1
            order[at], stack[at] = depth, hit
            hits += 1
            hit = nexts[hit]
        before, ordered = sky, 0
        for k in range(hits):
            if k >= ordered and k + 1 < hits and order[k + 1] - order[k] < gap:
                ordered = _settle(k, before == dark, hits, stack, order, sides, dark, gap)
            after = sides[stack[k], 0]
            if before < sky or after < sky:
                pairs[made, 0], pairs[made, 1] = before, after
                made += 1
            before = sides[stack[k], 1]
        if before < sky:
            pairs[made, 0], pairs[made, 1] = before, sky
            made += 1
    return lines, made


@njit(nogil=True, cache=True, error_model="numpy")
def _settle(k: Any, inside: Any, hits: Any, stack: Any, order: Any, sides: Any, dark: Any, gap: Any) -> Any:
    """Put hit ``k`` of a line and the next, which are near to each other, into the right order. Returns the hit from
    which on order is still to be looked at."""
    if not _touch(k, hits, stack, order, sides, dark, gap):
        return k
    if k == 0:
        # Outside of everything may be a solid or the open: the first face by itself tells.
        alone = 2
        while _touch(alone, hits, stack, order, sides, dark, gap):
            alone += 2
        if alone < hits:
            inside = sides[stack[alone], 0] == dark
        else:  # a corner that is touched keeps its order, two faces in the same place are a sheet
            inside = sides[stack[k], 0] == dark and order[k + 1] - order[k] > 1e-5 * gap
    if inside != (sides[stack[k], 0] == dark):
        stack[k], stack[k + 1] = stack[k + 1], stack[k]
    return k + 2


@njit(nogil=True, cache=True, error_model="numpy")
def _touch(k: Any, hits: Any, stack: Any, order: Any, sides: Any, dark: Any, gap: Any) -> Any:
    """Whether hit ``k`` of a line and the next are of opposite sense and nearer than ``gap``."""
    if k + 1 >= hits or order[k + 1] - order[k] >= gap:
        return False
    a, b = stack[k], stack[k + 1]
    enters, leaves = sides[a, 1] == dark, sides[a, 0] == dark
    return enters != leaves and enters == (sides[b, 0] == dark) and leaves == (sides[b, 1] == dark)


@njit(nogil=True, cache=True, error_model="numpy")
def _grown(array: Any, size: Any, used: Any) -> Any:
    larger = np.empty(size, array.dtype)
    larger[:used] = array[:used]
    return larger


@njit(nogil=True, cache=True, error_model="numpy")
def _grown_pairs(array: Any, size: Any, used: Any) -> Any:
    larger = np.empty((size, 2), array.dtype)
    larger[:used] = array[:used]
    return larger


@njit(nogil=True, cache=True, error_model="numpy")
def gather(pairs: Any, values: Any, sums: Any) -> None:
    """Add to ``sums`` (n + 2, c) of each end of a segment the ``values`` (n + 2, c) of the other end."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        for c in range(values.shape[1]):
            sums[i, c] += values[j, c]
            sums[j, c] += values[i, c]


@njit(nogil=True, cache=True, error_model="numpy")
def gather_one(pairs: Any, values: Any, sums: Any) -> None:
    """:func:`gather` for one channel, (n + 2,)."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        sums[i] += values[j]
        sums[j] += values[i]


@njit(nogil=True, cache=True, error_model="numpy")
def count_ends(pairs: Any, counts: Any) -> None:
    """Add to ``counts`` (n + 2, 3) of each end: segments, those whose other end is the sky, those that is dark."""
    sky = len(counts) - 2
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        counts[i, 0] += 1
        counts[j, 0] += 1
        if i >= sky:
            counts[j, 1 + i - sky] += 1
        if j >= sky:
            counts[i, 1 + j - sky] += 1


@njit(nogil=True, cache=True, error_model="numpy")
def count_rows(pairs: Any, patches: Any, rows: Any) -> None:
    """Add to ``rows`` (n,) the segments between patches whose smaller number is that row's."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if i < patches and j < patches:
            rows[min(i, j)] += 1


@njit(nogil=True, cache=True, error_model="numpy")
def fill_rows(pairs: Any, patches: Any, ends: Any, columns: Any) -> None:
    """Write the larger patch number of each such segment to its row of ``columns``, ``ends`` being the next places."""
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        if i < patches and j < patches:
            row = min(i, j)
            columns[ends[row]] = max(i, j)
            ends[row] += 1


@njit(nogil=True, cache=True, error_model="numpy")
def merge_rows(starts: Any, columns: Any, patches: Any) -> Any:
    """Row starts, columns and numbers of repetition: ``columns`` with each column of a row once. Overwrites it."""
    begin = np.zeros(patches + 1, np.int64)
    counts = np.empty(len(columns), np.float64)
    where = np.full(patches, -1, np.int64)
    made = 0
    for row in range(patches):
        first = made
        for k in range(starts[row], starts[row + 1]):
            column = columns[k]
            if where[column] >= first:
                counts[where[column]] += 1
            else:
                where[column] = made
                columns[made], counts[made] = column, 1
                made += 1
        begin[row + 1] = made
    return begin, columns[:made].copy(), counts[:made].copy()


@njit(nogil=True, cache=True, error_model="numpy")
def multipath(pairs: Any, reflectance: Any, per_line: Any, unshot: Any, received: Any) -> None:
    """Exchange power along segments one after the other [Sbert 1996]; arrays (n + 2, c), the last two changed.

    Each end sends what it has unshot and its own power for a line; what the other end reflects of it replaces what that
    had unshot. Sky and darkness must have no reflectance.
    """
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        for c in range(reflectance.shape[1]):
            to_j = unshot[i, c] + per_line[i, c]
            to_i = unshot[j, c] + per_line[j, c]
            received[i, c] += to_i
            received[j, c] += to_j
            unshot[i, c] = to_i * reflectance[i, c]
            unshot[j, c] = to_j * reflectance[j, c]


@njit(nogil=True, cache=True, error_model="numpy")
def gauss_seidel(starts: Any, columns: Any, data: Any, reflectance: Any, known: Any, radiosity: Any) -> None:
    """One sweep over a CSR matrix F: each row of ``radiosity`` (n, c) at once becomes ``known + reflectance F B``."""
    sums = np.empty(radiosity.shape[1])
    for i in range(len(radiosity)):
        sums[:] = 0.0
        own = 0.0
        for k in range(starts[i], starts[i + 1]):
            if columns[k] == i:
                own = data[k]
            else:
                for c in range(len(sums)):
                    sums[c] += data[k] * radiosity[columns[k], c]
        for c in range(len(sums)):
            radiosity[i, c] = (known[i, c] + reflectance[i, c] * sums[c]) / (1 - reflectance[i, c] * own)


@njit(nogil=True, cache=True, error_model="numpy")
def shoot(
    starts: Any, rows: Any, data: Any, areas: Any, reflectance: Any, unshot: Any, radiosity: Any, steps: Any
) -> None:
    """Steps of progressive refinement over the columns (CSC) of F: the patch of most unshot power sends it to all
    [Cohen 1988]. ``unshot``, ``radiosity`` (n, c) are changed."""
    power = np.empty(len(areas))
    for i in range(len(areas)):
        power[i] = areas[i] * unshot[i].sum()
    sent = np.empty(unshot.shape[1])
    for _ in range(steps):
        shooter = np.argmax(power)
        sent[:] = unshot[shooter]
        unshot[shooter] = 0.0
        power[shooter] = 0.0
        for k in range(starts[shooter], starts[shooter + 1]):
            i = rows[k]
            gained = 0.0
            for c in range(len(sent)):
                more = reflectance[i, c] * data[k] * sent[c]
                radiosity[i, c] += more
                unshot[i, c] += more
                gained += more
            power[i] += areas[i] * gained
