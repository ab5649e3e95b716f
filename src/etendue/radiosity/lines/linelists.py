"""Lists of the hits of lines, on the device: sorting, and the segments between neighbours.

A hit is a 64-bit number: the depth in the upper half, then the face; the last bit is set if the line hits the back of
the face.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

#: Number of hits of a half line (see :class:`LineHits`) that are sorted in registers; few lines have more.
_FEW = 4
#: No hit, or no segment.
_NOTHING = 0xFFFFFFFFFFFFFFFF


@dataclass
class LineHits:
    """Hits in the order of their discovery, and the half line of each, ``2 line + (key & 1)``: hits of fronts and of
    backs are separate."""

    key: mi.UInt64
    half: mi.UInt32


@dataclass
class Lists:
    """Hits line by line: ``count`` hits of a line from ``first`` on, and space for one more."""

    key: mi.UInt64
    first: mi.UInt32  #: a lane for each line that has hits
    count: mi.UInt32
    starts: mi.UInt32  #: a lane for each line: the place of its first hit, or of the next one that there is


def by_depth(hits: LineHits, lines: int) -> Lists:
    """The sorted hits of each line."""
    # Plane k has the k-th hit of each half line. All hits write to a plane at once; hits that were overwritten are
    # written to the next plane. Atomic operations would take ten times as long on a CPU.
    planes: list[mi.UInt64] = []
    halves, others = dr.zeros(mi.UInt32, 2 * lines), LineHits(hits.key, hits.half)
    while len(planes) < _FEW and len(others.key):
        planes.append(dr.empty(mi.UInt64, 2 * lines))
        dr.scatter(planes[-1], others.key, others.half)
        dr.scatter(halves, dr.opaque(mi.UInt32, len(planes)), others.half)
        dr.eval(planes[-1], halves, others)
        rest = dr.compress(dr.gather(mi.UInt64, planes[-1], others.half) != others.key)
        others = LineHits(dr.gather(mi.UInt64, others.key, rest), dr.gather(mi.UInt32, others.half, rest))

    few, many = dr.sum(dr.gather(mi.Vector2u, halves, dr.arange(mi.UInt32, lines))), dr.zeros(mi.UInt32, lines)
    if len(others.key):
        rank = dr.gather(mi.UInt32, few, others.half >> 1) + dr.scatter_inc(many, others.half >> 1)
        dr.eval(few, many, rank, others)
    count = few + many
    first = dr.prefix_reduce(dr.ReduceOp.Add, count + dr.select(count > 0, mi.UInt32(1), 0), exclusive=True)
    met = dr.compress(count > 0)
    room = dr.empty(mi.UInt64, len(hits.key) + len(met))
    lists = Lists(room, dr.gather(mi.UInt32, first, met), dr.gather(mi.UInt32, count, met), first)
    _sort_few(planes, dr.gather(mi.Vector2u, halves, met), met, lists)
    if len(others.key):
        place = dr.gather(mi.UInt32, first, others.half >> 1) + rank
        dr.scatter(lists.key, others.key, place, mode=dr.ReduceMode.Permute)
        _sort_many(lists, dr.gather(mi.UInt32, many, met) > 0)
    dr.eval(lists)
    return lists


def _sort_few(planes: list[mi.UInt64], counts: mi.Vector2u, line: mi.UInt32, lists: Lists) -> None:
    """Sort the hits of the planes in registers, by a sorting network [Batcher 1968], and write them to the lists."""
    size = 1 << (2 * len(planes) - 1).bit_length()
    keys = [mi.UInt64(_NOTHING)] * size
    for i, plane in enumerate(planes):
        found = dr.gather(mi.Array2u64, plane, line)
        for side in range(2):
            keys[2 * i + side] = dr.select(i < counts[side], found[side], _NOTHING)
    for i, j in _network(size):
        keys[i], keys[j] = dr.minimum(keys[i], keys[j]), dr.maximum(keys[i], keys[j])
    for i in range(2 * len(planes)):
        dr.scatter(lists.key, keys[i], lists.first + i, i < counts.x + counts.y, mode=dr.ReduceMode.Permute)


def _network(size: int) -> list[tuple[int, int]]:
    """Comparisons of a sorting network by odd-even merging; ``size`` is a power of two."""
    pairs = []
    p = 1
    while p < size:
        k = p
        while k >= 1:
            for j in range(k % p, size - k, 2 * k):
                for i in range(min(k, size - j - k)):
                    if (i + j) // (2 * p) == (i + j + k) // (2 * p):
                        pairs.append((i + j, i + j + k))
            k //= 2
        p *= 2
    return pairs


def _sort_many(lists: Lists, chosen: mi.Bool) -> None:
    """Sort the hits of the chosen lines: count for each hit the hits before it, which needs no memory per line."""
    dr.eval(lists, chosen)
    chosen = dr.compress(chosen)
    first, count = dr.gather(mi.UInt32, lists.first, chosen), dr.gather(mi.UInt32, lists.count, chosen)
    keys = dr.gather(mi.UInt64, lists.key, dr.arange(mi.UInt32, len(lists.key)))
    dr.eval(first, count, keys)

    def place(i: mi.UInt32) -> tuple[mi.UInt32]:
        key = dr.gather(mi.UInt64, keys, first + i)

        def compare(j: mi.UInt32, rank: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
            return j + 1, rank + dr.select(dr.gather(mi.UInt64, keys, first + j) < key, mi.UInt32(1), 0)

        _, rank = dr.while_loop((zero, zero), lambda j, _: j < count, compare, label="line lists: rank")
        dr.scatter(lists.key, key, first + rank, mode=dr.ReduceMode.Permute)
        return (i + 1,)

    zero = dr.zeros(mi.UInt32, len(first))
    dr.while_loop((zero,), lambda i: i < count, place, label="line lists: many hits")


def exchanges(
    lists: Lists, sides: mi.UInt32, coincident: mi.UInt32, sky: mi.UInt32, gaps: list[mi.UInt32], solid: mi.Bool
) -> tuple[mi.UInt64, mi.UInt32]:
    """Segments of all lines as numbers of 64 bits, the near patch in the lower half, and their places in the lists,
    which ascend.

    ``sides``: two patches for each face, of front and back; ``sky`` and ``sky + 1`` stand for the sky and for the back
    of a face; ``coincident``: for each face 1 if it lies back to back on others, 2 if it is also part of no solid. Two
    faces of opposite orientation closer to each other than the first of the ``gaps`` (coincident ones: the second) may
    be a sheet, or solids that touch (a box on the floor). Their order is not decided by rounding but by whether the
    line is inside a solid, that is, behind the back of a face. ``solid``: whether the scene is an interior, so that
    lines begin inside a solid.
    """
    dark = sky + 1
    lines, first, count = _Lines(lists, sides, coincident, dark, gaps, solid), lists.first, lists.count
    found = dr.empty(mi.UInt64, len(lists.key))

    def write(i: mi.UInt32, before: mi.UInt32, after: mi.UInt32) -> None:
        segment = mi.UInt64(before) | (mi.UInt64(after) << 32)
        segment = dr.select((before < sky) | (after < sky), segment, _NOTHING)
        dr.scatter(found, segment, first + i, mode=dr.ReduceMode.Permute)

    def hit(
        i: mi.UInt32, at: mi.UInt32, near: mi.UInt32, far: mi.UInt32, before: mi.UInt32, free: mi.UInt32
    ) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.UInt32, mi.UInt32, mi.Bool]:
        following, near_2, far_2 = lines.hit(i + 1)
        kind = lines.kind(i)
        close = free & lines.touch(i, kind, at, near, far, following, near_2, far_2)
        inside = lines.inside(i, kind, at, near, following, before, close)
        swap = close & (inside != (near == dark))
        write(i, before, dr.select(swap, near_2, near))
        before = dr.select(swap, far_2, far)
        return (
            i + 1,
            dr.select(swap, at, following),
            dr.select(swap, near, near_2),
            dr.select(swap, far, far_2),
            before,
            ~close,
        )

    zero = dr.zeros(mi.UInt32, len(first))
    state = (zero, *lines.hit(zero), sky + zero, dr.full(mi.Bool, True, len(first)))
    *_, before, _ = dr.while_loop(state, lambda i, *_: i < count, hit, label="line lists: exchanges")
    write(count, before, sky)
    dr.eval(found)
    places = dr.compress(found != _NOTHING)
    return dr.gather(mi.UInt64, found, places), places


class _Lines:
    """Sorted hits of lines, a lane each."""

    def __init__(
        self,
        lists: Lists,
        sides: mi.UInt32,
        coincident: mi.UInt32,
        dark: mi.UInt32,
        gaps: list[mi.UInt32],
        solid: mi.Bool,
    ) -> None:
        self._key, self._first, self._count = lists.key, lists.first, lists.count
        self._sides, self._coincident, self._dark, self._gaps, self._solid = sides, coincident, dark, gaps, solid

    def hit(self, i: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        """Depth of a hit, patch of its near side, and patch of its far side; arbitrary values after the last hit."""
        there = i < self._count
        key = dr.gather(mi.UInt64, self._key, self._first + i, there)
        identity = mi.UInt32(key & 0xFFFFFFFF)
        front, back = dr.gather(mi.Vector2u, self._sides, identity >> 1, there)
        is_back = (identity & 1) != 0
        return mi.UInt32(key >> 32), dr.select(is_back, back, front), dr.select(is_back, front, back)

    def kind(self, i: mi.UInt32) -> mi.UInt32:
        """0 unless the faces of a hit and of the next one both lie back to back on others, 2 if both are part of no
        solid."""
        kinds = []
        for k in (i, i + 1):
            there = k < self._count
            face = mi.UInt32(dr.gather(mi.UInt64, self._key, self._first + k, there) & 0xFFFFFFFF) >> 1
            kinds.append(dr.gather(mi.UInt32, self._coincident, face, there))
        return dr.minimum(*kinds)

    def touch(
        self,
        i: mi.UInt32,
        kind: mi.UInt32,
        at: mi.UInt32,
        near: mi.UInt32,
        far: mi.UInt32,
        following: mi.UInt32,
        near_2: mi.UInt32,
        far_2: mi.UInt32,
    ) -> mi.Bool:
        """Whether a hit and the next have opposite orientation and are closer than the gap."""
        enters, leaves = far == self._dark, near == self._dark
        opposite = (enters != leaves) & (enters == (near_2 == self._dark)) & (leaves == (far_2 == self._dark))
        gap = dr.select(kind > 0, self._gaps[1], self._gaps[0])
        return (i + 1 < self._count) & (following - at < gap) & opposite

    def inside(
        self,
        i: mi.UInt32,
        kind: mi.UInt32,
        at: mi.UInt32,
        near: mi.UInt32,
        following: mi.UInt32,
        before: mi.UInt32,
        close: mi.Bool,
    ) -> mi.Bool:
        """Whether the line is inside a solid before hit ``i``, if that is ``close`` to the next hit."""
        # The outside may be solid or open: the first face that is not part of a pair decides.
        begins = close & (i == 0)

        def pair_after(k: mi.UInt32, _near: mi.UInt32, _again: mi.Bool) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
            hit, following = self.hit(k), self.hit(k + 1)
            again = self.touch(k, self.kind(k), *hit, *following)
            return k + dr.select(again, mi.UInt32(2), 0), hit[1], again

        alone, near_alone, _ = dr.while_loop(
            (mi.UInt32(i + 2), mi.UInt32(near), mi.Bool(begins)),
            lambda _k, _near, again: again,
            pair_after,
            label="line lists: first face",
        )
        # The line has only pairs: a sheet, or, if there are several, boxes from wall to wall of a room. Faces that do
        # not coincide are a touched corner: they keep their order.
        is_box = (kind == 1) & (alone - i > 2)
        of_pairs = self._solid & ((kind == 0) | is_box)
        corner = of_pairs | ((kind == 0) & (near == self._dark) & (following - at > 1))
        at_first = dr.select(alone < self._count, near_alone == self._dark, corner)
        return (kind < 2) & dr.select(begins, at_first, before == self._dark)
