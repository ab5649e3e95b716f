"""A hash grid over points: every point within a fixed radius of a query, on device arrays.

Cells have side ``2 r``, so a ball of radius ``r`` touches two cells an axis. A cell's bucket is ``hash(y, z) + x``:
neighbours along x are neighbours in the table, and a query reads four rows of two adjacent buckets, four ranges of the
sorted points. Rows whose hashes collide share buckets; each bucket is read once. Built by counting sort [Green 2008].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

#: Cells along x at most; a finer grid than this gets wider cells, which costs time and nothing else.
_MAX_CELLS_X = 1 << 22


@dataclass
class Query:
    """Candidates of one query point per lane: ``total`` of them in up to four ranges."""

    point: Any
    total: Any
    _first: list[Any]  #: sorted index of candidate 0 as seen from range k
    _end: list[Any]  #: number of candidates in ranges 0..k


class HashGrid:
    """Points sorted by cell.

    Parameters
    ----------
    points: Point3f, one lane a point.
    radius: search radius, scene units, a host number above zero.
    lower, upper: corners of a box that holds the points (host sequences of three numbers).
    active: mask of the points to insert; the others get no destination.

    Attributes
    ----------
    destination: UInt32, where point i goes in sorted order. The caller scatters whatever payload a query shall read.
    """

    def __init__(self, points: Any, radius: float, lower: Any, upper: Any, active: Any = True) -> None:
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

    def _cell(self, p: Any, offset: float = 0.0) -> tuple[Any, Any, Any]:
        q = (p - self._origin) * self._inverse_cell - offset
        x = dr.clip(mi.Int32(dr.floor(q.x)), 0, self._last_x)
        return x, mi.Int32(dr.floor(q.y)), mi.Int32(dr.floor(q.z))

    def _row(self, y: Any, z: Any) -> Any:
        return ((mi.UInt32(y) * 73856093) ^ (mi.UInt32(z) * 19349663)) & self._mask

    def query(self, point: Any, active: Any) -> Query:
        """Prepare the search around ``point``: lanes that are not active find nothing."""
        x, y, z = self._cell(point, 0.5)
        rows = [self._row(v, w) + mi.UInt32(x) for v, w in ((y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1))]
        q = Query(point, mi.UInt32(0), [], [])
        for k, row in enumerate(rows):
            begin, end = mi.UInt32(row), row + 2
            for earlier in rows[:k]:  # a bucket that an earlier row reads is left to it
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

    def candidate(self, query: Query, i: Any) -> Any:
        """Sorted index of the query's ``i``-th candidate."""
        low = dr.select(i < query._end[0], query._first[0], query._first[1])
        high = dr.select(i < query._end[2], query._first[2], query._first[3])
        return i + dr.select(i < query._end[1], low, high)

    def accepts(self, query: Query, position: Any) -> Any:
        """Whether the candidate at ``position`` is within the radius."""
        return dr.squared_norm(position - query.point) <= self._radius_squared
