"""Bundles of parallel lines by Dr.Jit: the same code rasterises on a CPU and on a GPU.

A few kernels process many bundles at once:

1. a lane for each face of each bundle counts its hits, to allocate space for them;
2. the same lanes write their hits, each with its line;
3. hits are assigned to their line, and a lane for each line sorts them and writes the segments between neighbours
   (:mod:`.linelists`).

Coordinates are in double precision; in single precision, lines would pass between neighbouring faces whose edges are
divided differently. A hit is one 64-bit number: its depth in fixed point, then its face, so that the order of hits does
not depend on the order of lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, copied_to_device, use_variant

from .gaps import GAP, PAIR_GAP
from .linelists import LineHits, by_depth, exchanges
from .segments import Pairs

#: Rows of a face that one lane rasterises. Larger faces are split, so that no lane takes much longer than the others.
_ROWS = 8
#: Number of depths, and the extent that they span, in diameters of the bounding sphere.
_DEPTHS, _MARGIN = 2.0**32, 1.01


class Rasteriser:
    """Faces on the device of the current variant.

    vertices: (v, 3) relative to the centre of a bounding sphere of ``radius``.
    faces: (f, 4) vertex indices; faces are flat and convex.
    sides: (f, 2) the patch of the front and of the back, ``patches + 1`` for none.
    coincident: (f,) 1 for faces that lie back to back on others, 2 for those of them that are part of no solid, else 0.
    patches: number of patches.
    spacing: distance of neighbouring lines.
    solid: whether the scene is an interior.

    Attributes
    ----------
    lanes: number of lanes for the faces of one bundle.
    """

    def __init__(
        self,
        vertices: Array,
        faces: NDArray[np.uint32],
        sides: NDArray[np.uint32],
        coincident: NDArray[np.uint8],
        patches: int,
        radius: float,
        spacing: float,
        solid: bool,
    ) -> None:
        use_variant()
        items = _items(vertices, faces, spacing)
        self.lanes = len(items)
        self.items = copied_to_device(mi.UInt32, items)
        self.vertices = copied_to_device(mi.Float64, np.column_stack([vertices, np.ones(len(vertices))]))
        self.extent = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
        self.spacing, self.unit = spacing, _DEPTHS / (2 * _MARGIN * radius)
        self._sides = copied_to_device(mi.UInt32, sides)
        self._coincident = copied_to_device(mi.UInt32, coincident)
        self._gaps = [dr.opaque(mi.UInt32, max(int(gap * self.unit), 1)) for gap in (GAP, PAIR_GAP)]
        self._sky = dr.opaque(mi.UInt32, patches)
        self._solid = dr.opaque(mi.Bool, solid)

    def segments(self, frames: Array, shifts: Array) -> Pairs:
        """Segments (k, 2) of the lines of bundles, line by line, from the near end of each line on; see
        :meth:`counted`."""
        return self._exchanged(frames, shifts)[0]

    def counted(self, frames: Array, shifts: Array) -> tuple[Pairs, NDArray[np.int64]]:
        """Segments, and the number (b,) of those of each bundle.

        frames: (b, 3, 3) as of :meth:`Bundles.frames`; shifts: (b, 2) of their grids, in units of the spacing.
        """
        pairs, places, starts = self._exchanged(frames, shifts)
        begin = np.searchsorted(np.array(places), starts)
        return pairs, np.diff(np.append(begin, len(pairs)))

    def _exchanged(self, frames: Array, shifts: Array) -> tuple[Pairs, mi.UInt32, NDArray[np.uint32]]:
        """Segments, their places in the lists of hits, and the place where each bundle begins."""
        grid = _Grid(self, frames, shifts)
        counts = grid.count()
        ends = dr.prefix_reduce(dr.ReduceOp.Add, counts, exclusive=False)
        dr.eval(counts, ends)
        number = int(ends[-1])
        if number == 0:
            return np.empty((0, 2), np.uint32), mi.UInt32(), np.zeros(len(frames), np.uint32)
        hits = grid.fill(ends - counts, number)
        lists = by_depth(hits, grid.pixels)
        pairs, places = exchanges(lists, self._sides, self._coincident, self._sky, self._gaps, self._solid)
        starts = dr.gather(mi.UInt32, lists.starts, mi.UInt32(grid.begin[:-1].astype(np.uint32)))
        return np.array(pairs).view(np.uint32).reshape(-1, 2), places, np.array(starts)


class _Grid:
    """Lines of some bundles: an image per bundle whose pixels are lines, large enough for the box around the scene."""

    def __init__(self, faces: Rasteriser, frames: Array, shifts: Array) -> None:
        self._faces = faces
        axes = np.concatenate([frames[:, :2] / faces.spacing, frames[:, 2:] * faces.unit], axis=1)
        moved = np.concatenate([-shifts, np.full((len(frames), 1), _DEPTHS / 2)], axis=1)
        middle, half = faces.extent.mean(axis=0), np.diff(faces.extent, axis=0)[0] / 2
        centre, reach = axes[:, :2] @ middle + moved[:, :2], np.abs(axes[:, :2]) @ half
        # One more line on each side than the box needs, so that rounding does not leave the image.
        first = np.floor(centre - reach).astype(np.int64) - 1
        columns, rows = (np.ceil(centre + reach).astype(np.int64) + 2 - first).T
        #: The first line of each bundle, and the number of all lines.
        self.begin = begin = np.concatenate([[0], np.cumsum(columns * rows)])
        self.pixels, self._bundles = int(begin[-1]), len(frames)
        # Index of the pixel in row 0 and column 0, modulo 2**32.
        origin = begin[:-1] - first[:, 1] * columns - first[:, 0]
        self._axes = copied_to_device(mi.Float64, np.concatenate([axes, moved[:, :, None]], axis=2))
        self._rows = copied_to_device(mi.UInt32, np.column_stack([columns, origin & 0xFFFFFFFF]).astype(np.uint32))

    def count(self) -> mi.UInt32:
        """Number of hits of each lane."""
        _, counts = self._rows_of(lambda count, stop, column, *_: count + mi.UInt32(stop - column))
        return counts

    def fill(self, places: mi.UInt32, number: int) -> LineHits:
        """All hits; the hits of each lane are consecutive, from its place on."""
        keys, halves = dr.empty(mi.UInt64, number), dr.empty(mi.UInt32, number)

        def row(
            place: mi.UInt32, stop: mi.Int32, column: mi.Int32, half: mi.UInt32, key: Callable[[mi.Int32], mi.UInt64]
        ) -> mi.UInt32:
            def column_of(column: mi.Int32, place: mi.UInt32) -> tuple[mi.Int32, mi.UInt32]:
                dr.scatter(keys, key(column), place, mode=dr.ReduceMode.Permute)
                dr.scatter(halves, half + 2 * mi.UInt32(column), place, mode=dr.ReduceMode.Permute)
                return column + 1, place + 1

            _, place = dr.while_loop(
                (column, place), lambda column, _: column < stop, column_of, label="rasteriser: columns"
            )
            return place

        _ = self._rows_of(row, places)
        dr.eval(keys, halves)
        return LineHits(keys, halves)

    def _rows_of(self, visit: Callable[..., mi.UInt32], state: mi.UInt32 | None = None) -> tuple[mi.Int32, mi.UInt32]:
        faces, lanes = self._faces, self._faces.lanes
        lane = dr.arange(mi.UInt32, self._bundles * lanes)
        bundle = mi.UInt32((mi.Float64(lane) + 0.5) * dr.opaque(mi.Float64, 1 / lanes))
        item = lane - bundle * dr.opaque(mi.UInt32, lanes)
        corners = dr.gather(mi.Vector4u, faces.items, 2 * item)
        share = dr.gather(mi.Vector4u, faces.items, 2 * item + 1)
        axes = [dr.gather(mi.Vector4d, self._axes, 3 * bundle + i) for i in range(3)]
        line = dr.gather(mi.Vector2u, self._rows, bundle)
        x, y, z = zip(*[_projected(axes, dr.gather(mi.Vector4d, faces.vertices, c)) for c in corners], strict=True)
        edges = [_edge(x[i], y[i], x[(i + 1) % 4], y[(i + 1) % 4]) for i in range(4)]

        # The normal from the diagonals is right also for triangles, which repeat their last corner.
        a, b = mi.Vector3d(*(c[2] - c[0] for c in (x, y, z))), mi.Vector3d(*(c[3] - c[1] for c in (x, y, z)))
        normal = dr.cross(a, b)
        slope_x, slope_y = -normal.x / normal.z, -normal.y / normal.z
        low_z, high_z = _least(z), _greatest(z)
        is_back = dr.select(normal.z > 0, mi.UInt32(1), 0)
        identity = mi.UInt64((share[0] << 1) | is_back)

        top, end = _up(_least(y)), _up(_greatest(y))
        end = dr.select((normal.z != 0) & (_up(_least(x)) < _up(_greatest(x))), end, top)

        def row_of(row: mi.Int32, state: mi.UInt32) -> tuple[mi.Int32, mi.UInt32]:
            at = mi.Float64(row)
            left, right = mi.Float64(dr.inf), mi.Float64(-dr.inf)
            for edge_x, low_y, high_y, slope in edges:
                crossed = (low_y <= at) & (at < high_y)
                crossing = dr.fma(at - low_y, slope, edge_x)
                left = dr.select(crossed & (crossing < left), crossing, left)
                right = dr.select(crossed & (crossing > right), crossing, right)
            seen = left < right
            column, stop = _up(dr.select(seen, left, 0)), _up(dr.select(seen, right, 0))
            half = 2 * (line[1] + mi.UInt32(row) * line[0]) + is_back
            depth = dr.fma(slope_y, at - y[0], z[0])

            def key(column: mi.Int32) -> mi.UInt64:
                exact = dr.fma(slope_x, mi.Float64(column) - x[0], depth)
                return (mi.UInt64(dr.clip(exact, low_z, high_z)) << 32) | identity

            return row + mi.Int32(share[2]), visit(state, stop, column, half, key)

        first = top + mi.Int32(share[1])
        state = dr.zeros(mi.UInt32, dr.width(lane)) if state is None else state
        return dr.while_loop((first, state), lambda row, _: row < end, row_of, label="rasteriser: rows")


def _items(vertices: Array, faces: NDArray[np.uint32], spacing: float) -> NDArray[np.uint32]:
    """Work items of lanes, (i, 8): four corners, the face, and the first row and the step of its rows."""
    rows = np.linalg.norm(np.ptp(vertices[faces], axis=1), axis=1) / spacing  # upper bound for any direction
    shares = np.maximum(np.ceil(rows / _ROWS), 1).astype(np.int64)
    face = np.repeat(np.arange(len(faces)), shares)
    share = np.arange(len(face)) - np.repeat(np.cumsum(shares) - shares, shares)
    return np.column_stack([faces[face], face, share, shares[face], np.zeros_like(face)]).astype(np.uint32)


def _projected(axes: list[mi.Vector4d], vertex: mi.Vector4d) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
    """Column, row and depth of a vertex. Explicit ``fma`` gives all faces with this vertex the same numbers."""
    x, y, z = (dr.fma(a.x, vertex.x, dr.fma(a.y, vertex.y, dr.fma(a.z, vertex.z, a.w))) for a in axes)
    return x, y, z


def _edge(
    x: mi.Float64, y: mi.Float64, to_x: mi.Float64, to_y: mi.Float64
) -> tuple[mi.Float64, mi.Float64, mi.Float64, mi.Float64]:
    """Column and row of the lower end of an edge, row of its upper end, and its slope: the same for both faces that
    share the edge."""
    turned = y > to_y
    low_x, high_x = dr.select(turned, to_x, x), dr.select(turned, x, to_x)
    low_y, high_y = dr.select(turned, to_y, y), dr.select(turned, y, to_y)
    return low_x, low_y, high_y, (high_x - low_x) / (high_y - low_y)


def _up(x: mi.Float64) -> mi.Int32:
    return mi.Int32(dr.ceil(x))


def _least(values: Sequence[mi.Float64]) -> mi.Float64:
    return dr.minimum(dr.minimum(values[0], values[1]), dr.minimum(values[2], values[3]))


def _greatest(values: Sequence[mi.Float64]) -> mi.Float64:
    return dr.maximum(dr.maximum(values[0], values[1]), dr.maximum(values[2], values[3]))
