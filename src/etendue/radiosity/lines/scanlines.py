"""Loops compiled for the CPU by Numba: bundles of lines through all faces, as segments.

A *segment* is a pair of patch indices, or a patch index and ``n`` for the sky, ``n + 1`` for dark (the back of a face).

A *hit* is a 64-bit number: the depth, then twice the face index, plus 1 if the line hits its back. Depths are 32-bit
integers over the extent of the scene, so that hits can be sorted as integers.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from etendue.core import Array

from .gaps import GAP, PAIR_GAP

Pairs = NDArray[np.uint32]
G = TypeVar("G", bound=np.generic)

#: Depths of the scene, which has the radius 1, are from -_REACH to _REACH.
_REACH = 1.001
_UNIT = 2.0**31 / _REACH
#: Faces closer to each other than this are ordered by their orientation, in units of depth.
_GAP = int(GAP * _UNIT)
#: The same for faces that are known to lie back to back, whose depths differ along flat lines.
_PAIR = int(PAIR_GAP * _UNIT)
#: Two faces this close coincide, in units of depth.
_SAME = 1
_NONE = np.int32(-1)
_HALF, _ONE, _LOW = np.uint64(32), np.uint64(1), np.uint64(0xFFFFFFFF)
#: Up to this number of hits of a line are sorted without branches.
_FEW = 8


@njit(nogil=True, cache=True, error_model="numpy")
def rasterise(
    vertices: Array,
    faces: NDArray[np.uint32],
    ends: NDArray[np.uint32],
    coincident: NDArray[np.uint8],
    frames: Array,
    shifts: Array,
    wraps: NDArray[np.int64],
    spacing: float,
    centre: Array,
    reach: float,
    patches: int,
    room: int,
    solid: bool,
) -> tuple[Pairs, NDArray[np.int64]]:
    """Segments (k, 2) of the lines of some bundles, line by line, from the near end of each line on, and the number of
    segments (b,) of each bundle.

    vertices (v, 3) in the unit sphere; faces (f, 4), flat and convex; ends (2 f, 2): near and far patch of each face
    seen from the front, then seen from the back, ``patches + 1`` for none; coincident (f,), 1 for faces that lie back
    to back on others, 2 for those of them that are part of no solid, else 0; frames (b, 3, 3) as of
    :meth:`Bundles.frames`; shifts (b, 2) of the grid in units of ``spacing``; wraps (b, 3) of grids that repeat, as of
    :meth:`Bundles.wraps`; centre (3,), reach: only lines at most
    ``reach`` from ``centre`` along both axes of the grid are cast; room, the initial capacity for hits of a bundle;
    solid, whether the scene is an interior, so that lines begin behind the backs of faces.

    Each line has a list of its hits, in order of their discovery; see :func:`_settle` for hits that are too close to
    each other to be ordered by depth.
    """
    # Growing arrays are passed as arguments: reassigning them in a loop would update reference counts in each
    # iteration.
    place = np.empty((len(vertices), 3))
    heads = np.empty(1, np.int32)
    hits, nexts = np.empty(room, np.uint64), np.empty(room, np.int32)
    order = np.empty(64, np.uint64)
    counts = np.zeros(len(frames), np.int64)
    zero = counts[0]  # loops that are given a constant would be compiled once more, for it alone
    pairs, made = np.empty((room * (len(frames) + 3) * 3 // 5, 2), np.uint32), zero
    for b in range(len(frames)):
        before = made
        low_x, high_x, low_y, high_y = _project(vertices, frames[b], shifts[b], spacing, place)
        if reach < np.inf:
            x, y = -shifts[b, 0], -shifts[b, 1]
            for axis in range(3):
                x += frames[b, 0, axis] * centre[axis] / spacing
                y += frames[b, 1, axis] * centre[axis] / spacing
            low_x, high_x = max(low_x, x - reach / spacing), min(high_x, x + reach / spacing)
            low_y, high_y = max(low_y, y - reach / spacing), min(high_y, y + reach / spacing)
        column, row = math.ceil(low_x), math.ceil(low_y)
        columns, rows = math.ceil(high_x) - column, math.ceil(high_y) - row
        window = column, row, column + columns, row + rows
        columns, rows, skew = wraps[b, 0] or columns, wraps[b, 1] or rows, wraps[b, 2]
        if columns <= 0 or rows <= 0:
            continue
        if columns * rows > len(heads):
            heads = np.empty(columns * rows, np.int32)
        for line in range(columns * rows):
            heads[line] = _NONE
        face, count, wanted = zero, zero, zero
        while True:
            face, count, wanted = _fill(place, faces, window, columns, rows, skew, heads, hits, nexts, face, count)
            if face == len(faces):
                break
            room = max(2 * len(hits), count + wanted)
            hits, nexts = _grown(hits, room, count), _grown(nexts, room, count)
        if made + 2 * count + 1 > len(pairs):
            pairs = _grown_pairs(pairs, 2 * (made + 2 * count) + 1, made)
        line = zero
        while True:
            line, made = _walk(
                heads, columns * rows, hits, nexts, ends, coincident, order, pairs, line, made, patches, solid
            )
            if line == columns * rows:
                break
            order = np.empty(2 * len(order), np.uint64)
        counts[b] = made - before
    return pairs[:made], counts


@njit(nogil=True, cache=True, error_model="numpy")
def _project(
    vertices: Array, frame: Array, shift: Array, spacing: float, place: Array
) -> tuple[float, float, float, float]:
    """Write column, row and depth of the vertices to ``place`` (v, 3), and return the bounds of the first two."""
    xx, xy, xz = frame[0, 0] / spacing, frame[0, 1] / spacing, frame[0, 2] / spacing
    yx, yy, yz = frame[1, 0] / spacing, frame[1, 1] / spacing, frame[1, 2] / spacing
    zx, zy, zz = frame[2, 0] * _UNIT, frame[2, 1] * _UNIT, frame[2, 2] * _UNIT
    shift_x, shift_y = shift[0], shift[1]
    low_x = low_y = np.inf
    high_x = high_y = -np.inf
    for v in range(len(vertices)):
        px, py, pz = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        x = xx * px + xy * py + xz * pz - shift_x
        y = yx * px + yy * py + yz * pz - shift_y
        place[v, 0], place[v, 1], place[v, 2] = x, y, zx * px + zy * py + zz * pz + _REACH * _UNIT
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    return low_x, high_x, low_y, high_y


@njit(nogil=True, cache=True, error_model="numpy")
def _fill(
    place: Array,
    faces: NDArray[np.uint32],
    window: tuple[int, int, int, int],
    columns: int,
    rows: int,
    skew: int,
    heads: NDArray[np.int32],
    hits: NDArray[np.uint64],
    nexts: NDArray[np.int32],
    start: int,
    count: int,
) -> tuple[int, int, int]:
    """Put the hits of the faces from ``start`` on into the lists, as far as the hits are in the ``window``: its first
    column and row, and those behind its last. Lines repeat after ``rows``, shifted by ``skew``, and after ``columns``.

    Returns the face at which the capacity was exceeded (``len(faces)`` if it was not), the number of hits, and the
    largest number of hits of that face.

    A face covers the half-open interval of a row between its edges, and an edge is computed in the same way for both
    faces that share it: a line hits exactly one of them.
    """
    first_column, first_row, end_column, end_row = window
    for f in range(start, len(faces)):
        i0, i1, i2, i3 = faces[f, 0], faces[f, 1], faces[f, 2], faces[f, 3]
        y0, y1, y2, y3 = place[i0, 1], place[i1, 1], place[i2, 1], place[i3, 1]
        top, end = math.ceil(min(min(y0, y1), min(y2, y3))), math.ceil(max(max(y0, y1), max(y2, y3)))
        top, end = max(top, first_row), min(end, end_row)
        if top >= end:
            continue
        x0, x1, x2, x3 = place[i0, 0], place[i1, 0], place[i2, 0], place[i3, 0]
        width = min(math.ceil(max(max(x0, x1), max(x2, x3))), end_column)
        width -= max(math.ceil(min(min(x0, x1), min(x2, x3))), first_column)
        if width <= 0:
            continue
        if count + (end - top) * width > len(hits):
            return f, count, (end - top) * width
        z0, z1, z2, z3 = place[i0, 2], place[i1, 2], place[i2, 2], place[i3, 2]
        # The normal from the diagonals is right also for triangles, which repeat their last corner.
        ax, ay, az = x2 - x0, y2 - y0, z2 - z0
        bx, by, bz = x3 - x1, y3 - y1, z3 - z1
        nz = ax * by - ay * bx
        if nz == 0.0:
            continue
        slope_x, slope_y = -(ay * bz - az * by) / nz, -(az * bx - ax * bz) / nz
        z_low, z_high = min(min(z0, z1), min(z2, z3)), max(max(z0, z1), max(z2, z3))
        side = np.uint64(2 * f + (nz > 0))
        # Edges as x over y from their lower end; edges along a row have infinite slope and cross no row.
        slant0, slant1, slant2, slant3 = (
            (x1 - x0) / (y1 - y0),
            (x2 - x1) / (y2 - y1),
            (x3 - x2) / (y3 - y2),
            (x0 - x3) / (y0 - y3),
        )
        from0, from1, from2, from3 = y0 <= y1, y1 <= y2, y2 <= y3, y3 <= y0
        xa0, ya0 = (x0, y0) if from0 else (x1, y1)
        xa1, ya1 = (x1, y1) if from1 else (x2, y2)
        xa2, ya2 = (x2, y2) if from2 else (x3, y3)
        xa3, ya3 = (x3, y3) if from3 else (x0, y0)
        for row in range(top, end):
            up0, up1, up2, up3 = y0 <= row, y1 <= row, y2 <= row, y3 <= row
            e0 = xa0 + (row - ya0) * slant0
            e1 = xa1 + (row - ya1) * slant1
            e2 = xa2 + (row - ya2) * slant2
            e3 = xa3 + (row - ya3) * slant3
            left = min(
                min(e0 if up0 != up1 else np.inf, e1 if up1 != up2 else np.inf),
                min(e2 if up2 != up3 else np.inf, e3 if up3 != up0 else np.inf),
            )
            right = max(
                max(e0 if up0 != up1 else -np.inf, e1 if up1 != up2 else -np.inf),
                max(e2 if up2 != up3 else -np.inf, e3 if up3 != up0 else -np.inf),
            )
            begin, stop = max(math.ceil(left), first_column), min(math.ceil(right), end_column)
            depth = z0 + slope_y * (row - y0) + slope_x * (begin - x0)
            turn = (row - first_row) // rows
            line = (row - first_row - turn * rows) * columns
            column = (begin - first_column - turn * skew) % columns
            for _ in range(begin, stop):
                z = np.uint64(np.int64(min(max(depth, z_low), z_high)))
                hits[count], nexts[count] = (z << _HALF) | side, heads[line + column]
                heads[line + column] = count
                count += 1
                depth += slope_x
                column += 1
                if column == columns:
                    column = 0
    return len(faces), count, 0


@njit(nogil=True, cache=True, error_model="numpy")
def _walk(
    heads: NDArray[np.int32],
    lines: int,
    hits: NDArray[np.uint64],
    nexts: NDArray[np.int32],
    ends: NDArray[np.uint32],
    coincident: NDArray[np.uint8],
    order: NDArray[np.uint64],
    pairs: Pairs,
    start: int,
    made: int,
    patches: int,
    solid: bool,
) -> tuple[int, int]:
    """Sort the hits of the lines from ``start`` on, and write the segments between them from ``pairs[made]`` on.

    Returns the line whose hits ``order`` cannot hold (``lines`` if there is none) and the number of segments.
    """
    sky, dark = np.uint32(patches), np.uint32(patches + 1)
    reach = _PAIR if coincident.any() else _GAP
    for line in range(start, lines):
        hit = heads[line]
        if hit < 0:
            continue
        count = 0
        while hit >= 0:
            key, at = hits[hit], count
            if count < _FEW:
                while at > 0:
                    other = order[at - 1]
                    order[at], key = max(other, key), min(other, key)
                    at -= 1
            else:
                if count == len(order):
                    return line, made
                while at > 0 and order[at - 1] > key:
                    order[at] = order[at - 1]
                    at -= 1
            order[at] = key
            count += 1
            hit = nexts[hit]
        before, ordered = sky, 0
        for k in range(count):
            if k >= ordered and k + 1 < count and _apart(order, k) < reach:
                ordered = _settle(k, before == dark, count, order, ends, coincident, dark, solid)
            side = order[k] & _LOW
            after = ends[side, 0]
            pairs[made, 0], pairs[made, 1] = before, after
            made += (before < sky) | (after < sky)
            before = ends[side, 1]
        pairs[made, 0], pairs[made, 1] = before, sky
        made += int(before < sky)
    return lines, made


@njit(nogil=True, cache=True, error_model="numpy")
def _apart(order: NDArray[np.uint64], k: int) -> np.int64:
    """Depth difference of hit ``k`` of a line and the next hit."""
    return np.int64(order[k + 1] >> _HALF) - np.int64(order[k] >> _HALF)


@njit(nogil=True, cache=True, error_model="numpy")
def _settle(
    k: int,
    inside: bool,
    count: int,
    order: NDArray[np.uint64],
    ends: NDArray[np.uint32],
    coincident: NDArray[np.uint8],
    dark: np.uint32,
    solid: bool,
) -> int:
    """Order hit ``k`` of a line and the next one, which are close to each other. Returns the next hit to be examined.

    Two such faces of opposite orientation may be a sheet, or solids that touch (a box on the floor). Their order is not
    decided by rounding but by whether the line is inside a solid, that is, behind the back of a face.
    """
    if not _touch(k, count, order, ends, coincident, dark):
        return k
    leaves, kind = ends[order[k] & _LOW, 0] == dark, _kind(k, order, coincident)
    if kind == 2:  # a sheet, whatever is around it
        inside = False
    elif k == 0:
        # The outside may be solid or open: the first face that is not part of a pair decides.
        alone = k + 2
        while _touch(alone, count, order, ends, coincident, dark):
            alone += 2
        if alone < count:
            inside = ends[order[alone] & _LOW, 0] == dark
        elif kind == 1 and alone == 2:  # a sheet
            inside = False
        elif solid:  # through a box in a corner of a room, or boxes on each other from its floor to its ceiling
            inside = True
        elif leaves:  # the faces of a touched corner keep their order, two coincident faces are a sheet
            inside = kind == 0 and _apart(order, k) > _SAME
        else:
            inside = False
    if inside != leaves:
        order[k], order[k + 1] = order[k + 1], order[k]
    return k + 2


@njit(nogil=True, cache=True, error_model="numpy")
def _touch(
    k: int,
    count: int,
    order: NDArray[np.uint64],
    ends: NDArray[np.uint32],
    coincident: NDArray[np.uint8],
    dark: np.uint32,
) -> bool:
    """Whether hit ``k`` of a line and the next hit have opposite orientation and nearly the same position."""
    if k + 1 >= count or _apart(order, k) >= (_PAIR if _kind(k, order, coincident) else _GAP):
        return False
    a, b = order[k] & _LOW, order[k + 1] & _LOW
    enters, leaves = ends[a, 1] == dark, ends[a, 0] == dark
    return enters != leaves and enters == (ends[b, 0] == dark) and leaves == (ends[b, 1] == dark)


@njit(nogil=True, cache=True, error_model="numpy")
def _kind(k: int, order: NDArray[np.uint64], coincident: NDArray[np.uint8]) -> int:
    """0 unless the faces of hit ``k`` of a line and of the next hit both lie back to back on others, 2 if both are part
    of no solid."""
    return min(coincident[(order[k] & _LOW) >> _ONE], coincident[(order[k + 1] & _LOW) >> _ONE])


@njit(nogil=True, cache=True, error_model="numpy")
def _grown(array: NDArray[G], size: int, used: int) -> NDArray[G]:
    larger = np.empty(size, array.dtype)
    for k in range(used):
        larger[k] = array[k]
    return larger


@njit(nogil=True, cache=True, error_model="numpy")
def _grown_pairs(array: NDArray[G], size: int, used: int) -> NDArray[G]:
    larger = np.empty((size, 2), array.dtype)
    for k in range(used):
        larger[k, 0], larger[k, 1] = array[k, 0], array[k, 1]
    return larger
