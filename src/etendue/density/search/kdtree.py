"""A kd-tree over points on device arrays: range search and the distance of the k-th neighbour, in symbolic kernels.

Built level by level: the points of a node are sorted along the longest side of their box and cut into two halves
[Bentley 1975], all nodes of a level by one sort. The tree is complete and implicit: node ``i`` has the children ``2 i``
and ``2 i + 1``, a leaf holds 16 points, and every node stores the box of its points. The next node follows by
arithmetic on ``i``, so a search needs neither recursion nor a stack.

The k-th distance is found by counting: a heap would need memory for each lane. One search counts the points below
several thresholds, the next subdivides the interval that contains the k-th distance, and when few points are left in
it, a last search finds the exact distance. All searches compare the same rounded squared distances, so the answer is
exact.
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

from .halving import LEAF, highest, lowest, sorted_into_halves

#: State of a search: any state of a Dr.Jit loop.
S = TypeVar("S")
_THRESHOLDS = 8  #: number of thresholds at which one search counts points
_KEPT = 8  #: number of sorted distances that the last search keeps
#: Factor of the first threshold. Below the k-th distance it costs another search, far above it the first search is
#: slower.
_MARGIN = 1.1
_LARGEST = 3.4e38  #: bound of finite squared distances; an empty place has an infinite one
_UNKNOWN = 0xFFFFFFFF


@dataclass
class _Interval:
    """Squared distances that may be that of the k-th neighbour: above ``lower``, at most ``upper``."""

    lower: mi.Float
    below: mi.UInt32  #: number of points up to ``lower``
    upper: mi.Float
    total: mi.UInt32  #: number of points up to ``upper``, or ``_UNKNOWN``
    turn: mi.UInt32
    wide: mi.Bool  #: whether another division is needed


class KdTree:
    """Points in the order of a kd-tree, and a box for each node.

    Parameters
    ----------
    points: Point3f, a lane per point. Points that are not finite are left out.
    active: mask of the points to insert.
    reach: radius of influence of each point, for :meth:`covering`; scene units, a lane per point.

    Attributes
    ----------
    count: number of points in the tree.
    order: UInt32 of ``count`` lanes, the index in ``points`` of the point at each place. The caller gathers the payload
        that searches read by it.

    All searches may be called in a kernel, also inside loops; building evaluates. The mean of the 50 nearest values::

        tree = KdTree(points)
        values = dr.gather(mi.Float, values, tree.order)
        squared = tree.kth_distance_squared(si.p, 50, radius * radius, active)
        add = lambda place, _, state: (state[0] + 1, state[1] + dr.gather(mi.Float, values, place))
        number, total = tree.within(si.p, squared, (mi.UInt32(0), mi.Float(0)), add, active)

    The payload must be evaluated before a symbolic loop gathers from it. The cost of a search is the number of points
    compared, which is large if many points coincide or have nearly the k-th distance (a query in the centre of a
    sphere).
    """

    def __init__(self, points: mi.Point3f, active: mi.Bool | bool = True, reach: mi.Float | None = None) -> None:
        width = dr.width(points)
        chosen = dr.compress(dr.full(mi.Bool, True, width) & active & dr.all(dr.isfinite(points))) if width else []
        self.count = len(chosen)
        self._count = dr.opaque(mi.UInt32, self.count)
        leaves = 1 << max(-(-self.count // LEAF) - 1, 0).bit_length()
        self._first_leaf = dr.opaque(mi.UInt32, leaves)
        place = dr.arange(mi.UInt32, leaves * LEAF)
        # Empty places are at infinity, so they come last here and in every sort.
        filled = place < self._count
        index = dr.gather(mi.UInt32, chosen, place, filled) if self.count else place
        sides = [dr.full(mi.Float, dr.inf, leaves * LEAF) for _ in range(3)]
        if self.count:
            sides = [dr.select(filled, dr.gather(mi.Float, side, index, filled), dr.inf) for side in points]
        index, sides = sorted_into_halves(index, sides)
        self.order = dr.gather(mi.UInt32, index, dr.arange(mi.UInt32, self.count))
        self._points = dr.zeros(mi.Float, 4 * leaves * LEAF)
        self._boxes = dr.zeros(mi.Float, 16 * leaves)
        felt = dr.gather(mi.Float, reach, index, filled) if reach is not None and self.count else mi.Float(0)
        dr.scatter(self._points, mi.Vector4f(*sides, felt), place)
        dr.eval(self.order, self._points, self._boxes)
        self._build_boxes(sides, None if reach is None else felt + dr.zeros(mi.Float, leaves * LEAF), leaves)

    def within(
        self,
        point: mi.Point3f,
        radius_squared: mi.Float | None,
        state: S,
        visit: Callable[[mi.UInt32, mi.Float, S], S],
        active: mi.Bool | bool = True,
    ) -> S:
        """Visit every point whose squared distance from ``point`` is at most ``radius_squared``.

        Parameters
        ----------
        point: Point3f, a query per lane. Points are found in no particular order.
        radius_squared: per lane, scene units squared.
        state: arrays, or a tuple or other container of them that a Dr.Jit loop takes.
        visit: ``visit(place, distance_squared, state)`` returns the next state, which has the types of ``state``. It is
            traced once; ``place`` is the place of the point in ``order``.
        active: mask; the other lanes get ``state`` back.
        """
        radius_squared = dr.minimum(radius_squared, _LARGEST)

        def leaf(first: mi.UInt32, found: mi.Bool, state: S) -> S:
            near = mi.UInt32(0)
            for i in range(LEAF):
                inside = found & (self.distance_squared(first + i, point, found) <= radius_squared)
                near |= dr.select(inside, mi.UInt32(1 << i), 0)
            return self._visited(first, near, point, state, visit)

        return self._search(point, radius_squared, active, state, leaf)

    def covering(
        self, point: mi.Point3f, state: S, visit: Callable[[mi.UInt32, mi.Float, S], S], active: mi.Bool | bool = True
    ) -> S:
        """Visit every point whose ``reach`` is at least its distance from ``point``; otherwise as :meth:`within`."""

        def leaf(first: mi.UInt32, found: mi.Bool, state: S) -> S:
            near = mi.UInt32(0)
            for i in range(LEAF):
                position = dr.gather(mi.Vector4f, self._points, first + i, found)
                distance = _squared_norm(position.x - point.x, position.y - point.y, position.z - point.z)
                near |= dr.select(found & (distance <= dr.square(position.w)), mi.UInt32(1 << i), 0)
            return self._visited(first, near, point, state, visit)

        return self._search(point, None, active, state, leaf)

    def kth_distance_squared(
        self, point: mi.Point3f, k: mi.UInt32 | int, limit: mi.Float | float, active: mi.Bool | bool = True
    ) -> mi.Float:
        """Squared distance from ``point`` to its ``k``-th nearest point, exact, or ``limit`` if fewer are within it.

        Points at equal distances are all counted, so a range search with the result visits at least ``k`` points, more
        if several are at the k-th distance, and fewer where ``limit`` was reached first.

        Parameters
        ----------
        point: Point3f, a query per lane.
        k: a host number or UInt32 per lane, at least 1.
        limit: squared maximum radius, a host number or per lane; infinity is allowed.
        active: mask; the other lanes get ``limit``, as do those whose point is not finite.
        """
        k, limit = mi.UInt32(k), mi.Float(limit)
        active = mi.Bool(active) & (k <= self._count) & (limit >= 0.0) & dr.all(dr.isfinite(point))

        def divide(interval: _Interval) -> tuple[_Interval]:
            return (self._divided(interval, point, k, limit),)

        start = _Interval(
            lower=mi.Float(-1.0),  # a distance of zero is above it
            below=mi.UInt32(0),
            upper=dr.minimum(self._first_guess(point, k, active), limit),
            total=mi.UInt32(_UNKNOWN),
            turn=mi.UInt32(0),
            wide=mi.Bool(active),
        )
        (last,) = dr.while_loop((start,), lambda interval: interval.wide, divide, label="kd-tree: k-th distance")

        found = active & (last.total != _UNKNOWN)
        few = found & (last.total - last.below <= _KEPT)
        smallest = self._smallest_above(last.lower, point, last.upper, few)
        result = dr.select(found, last.upper, limit)
        for number, value in enumerate(smallest, start=1):
            result = dr.select(few & (k - last.below == number), value, result)
        return result

    def distance_squared(self, place: mi.UInt32, point: mi.Point3f, active: mi.Bool | bool = True) -> mi.Float:
        """Squared distance of ``point`` from the point at ``place``; all searches compare exactly this value."""
        position = dr.gather(mi.Vector4f, self._points, place, active)
        return _squared_norm(position.x - point.x, position.y - point.y, position.z - point.z)

    def boxes(self) -> tuple[NDArray[np.int64], Array, Array]:
        """(level, lower corner, upper corner) of every node with points, on the host: (nodes,), (nodes, 3) each."""
        corners = np.array(self._boxes, dtype=np.float64).reshape(-1, 2, 4)[1:, :, :3]
        held = np.flatnonzero(np.isfinite(corners).all(axis=(1, 2)))
        return np.log2(held + 1).astype(np.int64), corners[held, 0], corners[held, 1]

    # Traversal

    def _visited(
        self,
        first: mi.UInt32,
        near: mi.UInt32,
        point: mi.Point3f,
        state: S,
        visit: Callable[[mi.UInt32, mi.Float, S], S],
    ) -> S:
        """The state after visiting each point of a leaf whose bit in ``near`` is set."""

        def one(near: mi.UInt32, state: S) -> tuple[mi.UInt32, S]:
            """Take the neighbour of the lowest bit."""
            place = first + dr.tzcnt(near)
            return near & (near - 1), visit(place, self.distance_squared(place, point), state)

        return dr.while_loop((near, state), lambda near, _: near != 0, one, label="kd-tree: neighbours")[1]

    def _search(
        self,
        point: mi.Point3f,
        radius_squared: mi.Float | None,
        active: mi.Bool | bool,
        state: S,
        leaf: Callable[[mi.UInt32, mi.Bool, S], S],
    ) -> S:
        """``state = leaf(first place, found, state)`` for every leaf whose box the ball touches.

        Without a radius: for every leaf whose box, widened by the largest reach of its points, holds the point.
        """

        def descend(node: mi.UInt32, _: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
            limit = dr.square(self._reach(node)) if radius_squared is None else radius_squared
            touched = self._box_distance_squared(node, point) <= limit
            found = touched & (node >= self._first_leaf)
            node = dr.select(found, node, dr.select(touched, 2 * node, _behind(node)))
            return node, ~found & (node != 0)

        def advance(node: mi.UInt32, state: S) -> tuple[mi.UInt32, S]:
            """Go to the next leaf, so that all lanes are at a leaf when points are compared."""
            node, _ = dr.while_loop((mi.UInt32(node), node != 0), lambda _, go: go, descend, label="kd-tree: descend")
            found = node != 0
            state = leaf((node - self._first_leaf) * LEAF, found, state)
            return dr.select(found, _behind(node), 0), state

        root = dr.select(mi.Bool(active) & (self._count > 0), mi.UInt32(1), 0)
        return dr.while_loop((root, state), lambda node, _: node != 0, advance, label="kd-tree: search")[1]

    def _box_distance_squared(self, node: mi.UInt32, point: mi.Point3f) -> mi.Float:
        """Rounding is monotonic, so this is never above the ``distance_squared`` of a point in the box."""
        lower, upper = self._box(node)
        outside = dr.maximum(dr.maximum(lower - point, point - upper), 0.0)
        return _squared_norm(*outside)

    # The k-th distance

    def _divided(
        self, interval: _Interval, point: mi.Point3f, k: mi.UInt32 | int, limit: mi.Float | float
    ) -> _Interval:
        """The part of ``interval`` that holds the k-th distance, or the interval above it."""
        thresholds = _thresholds(interval)

        def count(first: mi.UInt32, found: mi.Bool, counts: tuple[mi.UInt32, ...]) -> tuple[mi.UInt32, ...]:
            added = list(counts)
            for i in range(LEAF):
                distance = dr.select(found, self.distance_squared(first + i, point, found), dr.inf)
                for j, threshold in enumerate(thresholds):
                    added[j] = added[j] + dr.select(distance <= threshold, mi.UInt32(1), 0)
            return tuple(added)

        reach = dr.minimum(interval.upper, _LARGEST)
        counts = self._search(point, reach, interval.wide, tuple(mi.UInt32(0) for _ in thresholds), count)

        # With too few points up to the last threshold, search beyond it: on a surface, the number of points is
        # proportional to the squared distance.
        growth = dr.clip(1.5 * mi.Float(k) / mi.Float(dr.maximum(counts[-1], 1)), 2.0, 16.0)
        lower, below, upper = thresholds[-1], counts[-1], dr.minimum(thresholds[-1] * growth, limit)
        total = mi.UInt32(_UNKNOWN)
        for j in reversed(range(_THRESHOLDS)):
            reached = counts[j] >= k
            before = (thresholds[j - 1], counts[j - 1]) if j else (interval.lower, interval.below)
            lower, below = dr.select(reached, before[0], lower), dr.select(reached, before[1], below)
            upper, total = dr.select(reached, thresholds[j], upper), dr.select(reached, counts[j], total)

        unknown = total == _UNKNOWN
        # Adjacent floats: all points in between have the same distance, that of the upper one.
        adjacent = _bits(upper) - _bits(dr.maximum(lower, 0.0)) <= dr.select(lower < 0.0, mi.UInt32(0), 1)
        wide = dr.select(unknown, interval.upper < limit, (total - below > _KEPT) & ~adjacent)
        return _Interval(lower, below, upper, total, interval.turn + 1, interval.wide & wide)

    def _smallest_above(
        self, lower: mi.Float, point: mi.Point3f, upper: mi.Float, active: mi.Bool | bool
    ) -> tuple[mi.Float, ...]:
        """The ``_KEPT`` smallest squared distances above ``lower``, ascending; those beyond ``upper`` may be wrong."""

        def keep(first: mi.UInt32, found: mi.Bool, kept: tuple[mi.Float, ...]) -> tuple[mi.Float, ...]:
            smallest = list(kept)
            for i in range(LEAF):
                value = self.distance_squared(first + i, point, found)
                value = dr.select(found & (value > lower), value, dr.inf)
                for j in range(_KEPT):
                    smallest[j], value = dr.minimum(smallest[j], value), dr.maximum(smallest[j], value)
            return tuple(smallest)

        nothing = tuple(mi.Float(dr.inf) for _ in range(_KEPT))
        kept: tuple[mi.Float, ...] = self._search(point, dr.minimum(upper, _LARGEST), active, nothing, keep)
        return kept

    def _first_guess(self, point: mi.Point3f, k: mi.UInt32 | int, active: mi.Bool | bool) -> mi.Float:
        """A squared distance near that of the k-th neighbour, from the smallest node here with ``k`` places or more."""

        def descend(node: mi.UInt32, places: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
            near = [self._box_distance_squared(child, point) for child in (2 * node, 2 * node + 1)]
            far = [self._farthest_squared(child, point) for child in (2 * node, 2 * node + 1)]
            # If both boxes contain the point, the smaller one: the other may extend from one surface to another.
            second = (near[1] < near[0]) | ((near[1] == near[0]) & (far[1] < far[0]))
            return 2 * node + dr.select(second, mi.UInt32(1), 0), places >> 1

        node, places = dr.while_loop(
            (dr.select(active, mi.UInt32(1), 0), self._first_leaf * LEAF),
            lambda node, places: (node != 0) & (node < self._first_leaf) & (places >= 2 * k),
            descend,
            label="kd-tree: guess",
        )
        side = self._extent(node)
        share = mi.Float(k) / mi.Float(places)
        # Points on a surface through the box cover a disc, points on a line a segment.
        disc = share * (side.x * side.y + side.y * side.z + side.z * side.x) * dr.inv_pi
        segment = dr.square(0.5 * share) * dr.squared_norm(side)
        guess = self._box_distance_squared(node, point) + _MARGIN * dr.maximum(disc, segment)
        return dr.maximum(guess, dr.maximum(1e-12 * dr.squared_norm(self._extent(mi.UInt32(1))), 1e-36))

    def _farthest_squared(self, node: mi.UInt32, point: mi.Point3f) -> mi.Float:
        lower, upper = self._box(node)
        return dr.squared_norm(dr.maximum(point - lower, upper - point))

    # Boxes

    def _build_boxes(self, sides: Sequence[mi.Float], reach: mi.Float | None, leaves: int) -> None:
        """From the leaves to the root; an empty node has its corners reversed, at infinity."""
        felt = 0.0 if reach is None else dr.block_reduce(dr.ReduceOp.Max, reach, LEAF)
        lower = mi.Point3f(*(lowest(side, LEAF) for side in sides))
        upper = mi.Point3f(*(highest(side, LEAF) for side in sides))
        self._put_box(dr.arange(mi.UInt32, leaves) + self._first_leaf, lower, upper, felt)
        while leaves > 1:
            leaves //= 2
            dr.eval(self._boxes)  # a level is read before the next is written
            node = dr.arange(mi.UInt32, leaves) + dr.opaque(mi.UInt32, leaves)
            left, right = self._box(2 * node), self._box(2 * node + 1)
            if reach is not None:
                felt = dr.maximum(self._reach(2 * node), self._reach(2 * node + 1))
            self._put_box(node, dr.minimum(left[0], right[0]), dr.maximum(left[1], right[1]), felt)
        dr.eval(self._boxes)

    def _put_box(self, node: mi.UInt32, lower: mi.Float, upper: mi.Float, reach: mi.Float | None) -> None:
        dr.scatter(self._boxes, mi.Vector4f(*lower, reach), 2 * node)
        dr.scatter(self._boxes, mi.Vector4f(*upper, 0.0), 2 * node + 1)

    def _box(self, node: mi.UInt32) -> tuple[mi.Point3f, mi.Point3f]:
        lower = dr.gather(mi.Vector4f, self._boxes, 2 * node)
        upper = dr.gather(mi.Vector4f, self._boxes, 2 * node + 1)
        return mi.Point3f(lower.x, lower.y, lower.z), mi.Point3f(upper.x, upper.y, upper.z)

    def _reach(self, node: mi.UInt32) -> mi.Float:
        return dr.gather(mi.Float, self._boxes, 8 * node + 3)

    def _extent(self, node: mi.UInt32) -> mi.Vector3f:
        lower, upper = self._box(node)
        return upper - lower


def _thresholds(interval: _Interval) -> list[mi.Float]:
    """Ascending, the last is the upper end. They are evenly spaced, alternately in value and in bit pattern.

    Values converge quickly for evenly spread points; bit patterns need at most eleven turns in any case.
    """
    lower = dr.maximum(interval.lower, 0.0)
    difference = _bits(interval.upper) - _bits(lower)
    step, rest = difference // _THRESHOLDS, difference % _THRESHOLDS
    thresholds = []
    for j in range(1, _THRESHOLDS):
        even = dr.minimum(dr.fma(interval.upper - lower, j / _THRESHOLDS, lower), interval.upper)
        bits = _bits(lower) + step * j + rest * j // _THRESHOLDS
        thresholds.append(dr.select(interval.turn % 2 == 0, even, dr.reinterpret_array(mi.Float, bits)))
    return [*thresholds, interval.upper]


def _bits(value: mi.Float) -> mi.UInt32:
    """The bit pattern of a non-negative number, a monotonic function of it."""
    return dr.reinterpret_array(mi.UInt32, value)


def _squared_norm(x: mi.Float, y: mi.Float, z: mi.Float) -> mi.Float:
    """Always with the same three roundings, also if a compiler would fuse operations."""
    return dr.fma(x, x, dr.fma(y, y, z * z))


def _behind(node: mi.UInt32) -> mi.UInt32:
    """The node after ``node`` and all below it, in depth-first order; 0 after the last."""
    node = node + 1
    node = node >> dr.tzcnt(node)
    return dr.select(node == 1, 0, node)
