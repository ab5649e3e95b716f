"""The order of the points in a kd-tree: recursive halving by sorts, one for each level."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

#: Points of a leaf.
LEAF = 16
#: A sort key has the number of a node in its upper bits, and below them a position along an axis, of at most 24 bits.
_KEY_BITS = 32
_AXIS_BITS = 24


def lowest(side: mi.Float, block: int) -> mi.Float:
    """Smallest value of each block of ``block`` lanes."""
    return dr.block_reduce(dr.ReduceOp.Min, side, block)


def highest(side: mi.Float, block: int) -> mi.Float:
    """Largest value of each block of ``block`` lanes, empty places excluded."""
    return dr.block_reduce(dr.ReduceOp.Max, dr.select(side == dr.inf, -dr.inf, side), block)


def sorted_into_halves(index: mi.UInt32, sides: list[mi.Float]) -> tuple[mi.UInt32, list[mi.Float]]:
    """Reorder the points, so that every aligned block of a leaf's size times a power of two is a node of the kd-tree.

    Each level takes one sort, by the number of the node and the position along the axis of its cut. The position is
    rounded to the remaining bits: a cut need not be exact, since the boxes are computed from the points afterwards.
    """
    places = dr.width(index)
    block, depth = places, 0
    while block > LEAF:
        lower = [lowest(side, block) for side in sides]
        extent = [highest(side, block) - a for side, a in zip(sides, lower, strict=True)]
        axis = dr.select(extent[1] > extent[0], mi.UInt32(1), 0)
        axis = dr.select(extent[2] > dr.maximum(extent[0], extent[1]), 2, axis)
        bits = min(_AXIS_BITS, _KEY_BITS - depth)
        steps, shift = dr.opaque(mi.Float, float(1 << bits)), dr.opaque(mi.UInt32, bits)
        origin, scale = _along(axis, lower), steps / _along(axis, extent)
        dr.eval(axis, origin, scale)

        node = dr.arange(mi.UInt32, places) // dr.opaque(mi.UInt32, block)
        position = _along(dr.gather(mi.UInt32, axis, node), sides) - dr.gather(mi.Float, origin, node)
        position = position * dr.gather(mi.Float, scale, node)
        # NaN if a box has no extent, or between two empty places.
        position = dr.select(position < steps - 1.0, mi.UInt32(position), mi.UInt32(steps - 1.0))
        permutation = dr.argsort((node << shift) | position)
        index = dr.gather(mi.UInt32, index, permutation)
        sides = [dr.gather(mi.Float, side, permutation) for side in sides]
        dr.eval(index, sides)
        block, depth = block // 2, depth + 1
    return index, sides


def _along(axis: mi.UInt32, values: Sequence[mi.Float]) -> mi.Float:
    return dr.select(axis == 0, values[0], dr.select(axis == 1, values[1], values[2]))
