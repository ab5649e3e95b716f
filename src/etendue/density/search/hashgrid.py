"""A hash grid over points: every point within a fixed radius of a query, on device arrays.

Cells have side ``2 r``, so a ball of radius ``r`` touches two cells per axis. A cell's bucket is ``hash(y, z) + x``:
neighbours along x are neighbours in the table, and a query reads four rows of two adjacent buckets, four ranges of the
sorted points. Rows whose hashes collide share buckets; each bucket is read once. Built by counting sort [Green 2008].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

#: State of a search: any state of a Dr.Jit loop.
S = TypeVar("S")
#: Largest number of cells along x; to stay below it cells become wider, which only costs time.
_MAX_CELLS_X = 1 << 22
#: Number of candidates that are tested, one bit each, before the neighbours among them are visited. Alternating between
#: testing and visiting keeps the lanes of a packet coherent: one candidate in five is a neighbour, so visiting each at
#: once would leave most lanes idle.
_BATCH = 32


@dataclass
class Query:
    """Candidates of one query point per lane: ``total`` of them in up to four ranges."""

    total: mi.UInt32
    _first: list[mi.UInt32]  #: sorted index minus number of a candidate in range k
    _end: list[mi.UInt32]  #: number of candidates in ranges 0..k


class HashGrid:
    """Points sorted by cell.

    Parameters
    ----------
    points: Point3f, a lane per point.
    radius: search radius, scene units, a host number above zero.
    lower, upper: corners of a box that contains the points (host sequences of three numbers).
    active: mask of the points to insert; the others get no destination.

    Attributes
    ----------
    destination: UInt32, index of point i in sorted order. The caller scatters the payload that queries read.
    """

    def __init__(
        self,
        points: mi.Point3f,
        radius: float,
        lower: Sequence[float] | Array,
        upper: Sequence[float] | Array,
        active: mi.Bool | bool = True,
    ) -> None:
        extent_x = max(float(upper[0]) - float(lower[0]), 0.0)
        cell = max(2.0 * radius, extent_x / _MAX_CELLS_X)
        count = dr.width(points)
        cells_x = int(extent_x / cell) + 3
        self._mask = dr.opaque(mi.UInt32, (1 << max(count - 1, 1).bit_length()) - 1)
        self._radius_squared = dr.opaque(mi.Float, radius * radius)
        self._inverse_cell = dr.opaque(mi.Float, 1.0 / cell)
        self._origin = mi.Point3f(*(dr.opaque(mi.Float, float(v) - cell) for v in lower))
        self._last_x = dr.opaque(mi.Int32, cells_x)
        buckets = (1 << max(count - 1, 1).bit_length()) + cells_x + 3

        x, y, z = self._cell(points)
        bucket = self._row(y, z) + mi.UInt32(x)
        population = dr.zeros(mi.UInt32, buckets)
        rank = dr.scatter_inc(population, bucket, active)
        dr.eval(rank, population)
        self._start = dr.prefix_reduce(dr.ReduceOp.Add, population, exclusive=True)
        self.destination = dr.gather(mi.UInt32, self._start, bucket, active) + rank

    def occupied(self, points: mi.Point3f) -> tuple[Array, Array, NDArray[np.int64]]:
        """(lower corner, upper corner, number of points) of every cell that holds some of ``points``, on the host:
        (cells, 3), (cells, 3), (cells,)."""
        x, y, z = self._cell(points)
        dr.eval(x, y, z)
        places = np.stack([np.array(v, np.int64) for v in (x, y, z)], axis=1)
        cells, counts = np.unique(places, axis=0, return_counts=True)
        side = 1.0 / float(np.array(self._inverse_cell, dtype=np.float64).ravel()[0])
        lower = np.array(self._origin, dtype=np.float64).ravel() + side * cells
        return lower, lower + side, counts

    def _cell(self, p: mi.Point3f, offset: float = 0.0) -> tuple[mi.Int32, mi.Int32, mi.Int32]:
        q = (p - self._origin) * self._inverse_cell - offset
        x = dr.clip(mi.Int32(dr.floor(q.x)), 0, self._last_x)
        return x, mi.Int32(dr.floor(q.y)), mi.Int32(dr.floor(q.z))

    def _row(self, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
        return ((mi.UInt32(y) * 73856093) ^ (mi.UInt32(z) * 19349663)) & self._mask

    def query(self, point: mi.Point3f, active: mi.Bool | bool) -> Query:
        """Prepare the search around ``point``; lanes that are not active find nothing."""
        x, y, z = self._cell(point, 0.5)
        rows = [self._row(v, w) + mi.UInt32(x) for v, w in ((y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1))]
        q = Query(mi.UInt32(0), [], [])
        for k, row in enumerate(rows):
            begin, end = mi.UInt32(row), row + 2
            for earlier in rows[:k]:  # skip a bucket that an earlier row reads already
                same = row == earlier
                begin = dr.select(same | (row + 1 == earlier + 2), row + 1, begin)
                end = dr.select(same | (row + 1 == earlier), row + 1, end)
            begin = dr.minimum(begin, end)
            first = dr.gather(mi.UInt32, self._start, begin, active)
            count = dr.gather(mi.UInt32, self._start, end, active) - first
            q._first.append(first - q.total)
            q.total = q.total + count
            q._end.append(q.total)
        return q

    def candidate(self, query: Query, i: mi.UInt32) -> mi.UInt32:
        """Sorted index of the query's ``i``-th candidate."""
        low = dr.select(i < query._end[0], query._first[0], query._first[1])
        high = dr.select(i < query._end[2], query._first[2], query._first[3])
        return i + dr.select(i < query._end[1], low, high)

    def within(
        self,
        point: mi.Point3f,
        read: Callable[[mi.UInt32], tuple[mi.Point3f, mi.Bool]],
        visit: Callable[[mi.UInt32, S], S],
        state: S,
        active: mi.Bool | bool,
        radius_squared: mi.Float | None = None,
    ) -> S:
        """Visit every point within the radius around ``point``, inside a kernel; returns the last state.

        Parameters
        ----------
        point: Point3f, a query per lane.
        read: ``read(place) -> (position, wanted)`` of a sorted point; one that is not wanted is not visited.
        visit: ``visit(place, state)`` returns the next state. Traced once.
        state: any state of a Dr.Jit loop.
        radius_squared: a smaller radius of each lane, squared; by default the radius of the grid.
        """
        query = self.query(point, active)
        limit = self._radius_squared if radius_squared is None else radius_squared

        def batch(first: mi.UInt32, state: S) -> tuple[mi.UInt32, S]:
            end = dr.minimum(first + _BATCH, query.total)

            def test(i: mi.UInt32, near: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
                """Test one candidate; a neighbour sets its bit."""
                position, wanted = read(self.candidate(query, i))
                hit = wanted & (dr.squared_norm(position - point) <= limit)
                return i + 1, near | dr.select(hit, mi.UInt32(1) << (i - first), 0)

            def take(near: mi.UInt32, state: S) -> tuple[mi.UInt32, S]:
                """Visit the neighbour of the lowest bit."""
                return near & (near - 1), visit(self.candidate(query, first + dr.tzcnt(near)), state)

            _, near = dr.while_loop((mi.UInt32(first), mi.UInt32(0)), lambda i, _: i < end, test, label="grid: search")
            _, state = dr.while_loop((near, state), lambda near, _: near != 0, take, label="grid: visit")
            return end, state

        return dr.while_loop(
            (mi.UInt32(0), state), lambda first, _: active & (first < query.total), batch, label="grid"
        )[1]
