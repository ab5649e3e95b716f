"""The hierarchy of boxes: objects that fill their common box well become a part [Castro 2002, sec. 5.3.1]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, Settings, logger, setting
from etendue.surfaces import Patches

from ..errors import RadiosityError
from .parts import Part, box_area, faces_in_box

Index = NDArray[np.int64]

#: Objects become a part if the sum of the areas of their boxes over the area of their common box is above this.
THRESHOLD = 0.8
#: Smallest number of patches of a part.
LEAST = 64


@dataclass(frozen=True, kw_only=True)
class GroupSettings(Settings):
    """How objects are grouped to boxes, see :func:`grouped`."""

    threshold: float = setting(THRESHOLD, "quotient of areas above which objects become a group", above=0)
    least: int = setting(LEAST, "patches that a box is worth", minimum=1)
    levels: int = setting(1, "levels of groups", minimum=1)


@dataclass(frozen=True)
class _Item:
    """An object, or a group of objects and groups."""

    low: Array
    high: Array
    areas: float  # sum of the areas of the boxes of its members
    objects: tuple[int, ...]
    groups: tuple[_Item, ...] = ()  # groups of the level below inside it
    grows: bool = False  # whether it was made on this level

    def with_(self, other: _Item) -> _Item:
        """The group of both items."""
        inner = (item.groups if item.grows else (item,) * (len(item.objects) > 1) for item in (self, other))
        members = tuple(group for groups in inner for group in groups)
        return _Item(
            *(np.minimum(self.low, other.low), np.maximum(self.high, other.high), self.areas + other.areas),
            *(self.objects + other.objects, members, True),
        )


def grouped(
    patches: Patches,
    objects: ArrayLike,
    threshold: float = THRESHOLD,
    least: int = LEAST,
    levels: int = 1,
) -> Part:
    """Patches as a scene of parts, by the object of each patch.

    Groups grow from single objects: the two groups that best fill their common box are merged, by the quotient of the
    sum of the areas of their objects' boxes and the area of the common box, until the best quotient is at most the
    ``threshold``. Groups whose boxes overlap are always merged. With several ``levels`` the groups, as objects with
    their boxes, are grouped again. A group or object with fewer than ``least`` patches, or into whose box a wall
    reaches, stays in the part around it. Other single objects are parts, too.

    objects: (n,) the index of the object of each patch, -1 for walls, which belong to the root only.

    Raises :class:`RadiosityError` for another number of objects than patches.
    """
    of = np.asarray(objects)
    if of.shape != (len(patches),) or of.dtype.kind not in "iu":
        raise RadiosityError(f"objects are whole numbers, one for each of {len(patches)} patches, not {of.shape}")
    if (patches.front < 0).any():
        raise RadiosityError("boxes have no faces that only occlude: use method lines, or make obstacles patches")
    if not (threshold > 0 and np.isfinite(threshold)):
        raise RadiosityError(f"the threshold of groups is a number above 0, not {threshold!r}")
    of = of.copy()
    backs = np.flatnonzero(patches.other_side >= 0)
    of[backs[backs >= patches.fronts]] = of[patches.other_side[backs[backs >= patches.fronts]]]
    items = _items(patches, of)
    for _ in range(levels):
        before = len(items)
        items = _merged(items, threshold)
        if len(items) == before:
            break
        items = [replace(item, areas=box_area(item.low, item.high), grows=False) for item in items]
    return _Builder(patches, of, least).scene(items)


class _Builder:
    def __init__(self, patches: Patches, of: Index, least: int) -> None:
        self.patches, self.of, self.least = patches, of, least
        self._size = np.bincount(of[of >= 0], minlength=1)
        corners = patches.vertices[patches.faces]
        self._walls = corners[of[patches.front] < 0]

    def scene(self, items: list[_Item]) -> Part:
        """The root: walls, objects that are in no part, and copies of the parts."""
        parts, loose = self._boxed(items)
        mine = (self.of < 0) | np.isin(self.of, loose)
        if not mine.any() and self.patches.sky.any():
            raise RadiosityError(
                "all patches are in boxes, so that no part is left that sees the sky: add a ground or walls, or leave "
                "an object without a box by a larger 'least'"
            )
        return self._part(mine, parts, 1, is_root=True)

    def _boxed(self, items: list[_Item]) -> tuple[list[Part], list[int]]:
        """Parts made of the items with enough patches, and objects of the other items."""
        parts: list[Part] = []
        loose: list[int] = []
        for item in items:
            inner, own = self._boxed(list(item.groups))
            own += [k for k in item.objects if not any(k in group.objects for group in item.groups)]
            centre, axes = (item.low + item.high) / 2, np.diag((item.high - item.low) / 2)
            is_crossed = faces_in_box(self._walls, centre, axes).any()
            if is_crossed:
                logger.info("a wall reaches into a box around %d objects: they stay without one", len(item.objects))
            if is_crossed or (self._size[own].sum() if own else 0) + sum(p.total for p in inner) < self.least:
                parts += inner
                loose += own
            else:
                parts.append(self._part(np.isin(self.of, own), inner, len(item.objects)))
        return parts, loose

    def _part(self, mine: NDArray[np.bool_], inner: list[Part], objects: int, is_root: bool = False) -> Part:
        """A part of these patches and of parts in the same coordinates. The sky is the root's."""
        copies = [(part, np.eye(4)) for part in inner]
        if not mine.any():
            return Part(None, copies, objects=objects)
        patches, numbers = self.patches.only(mine)
        if not is_root:
            patches = patches.with_properties(sky=np.zeros_like(patches.sky))
        return Part(patches, copies, numbers=numbers, objects=objects)


def _items(patches: Patches, of: Index) -> list[_Item]:
    front = of[patches.front]
    order = np.argsort(front, kind="stable")
    order = order[np.searchsorted(front[order], 0) :]
    if len(order) == 0:
        return []
    begins = np.flatnonzero(np.diff(front[order], prepend=-1))
    corners = patches.vertices[patches.faces[order]]
    low = np.minimum.reduceat(corners.min(axis=1), begins)
    high = np.maximum.reduceat(corners.max(axis=1), begins)
    return [
        _Item(*box, box_area(*box), (int(front[order[k]]),))
        for k, box in zip(begins, zip(low, high, strict=True), strict=True)
    ]


def _merged(items: list[_Item], threshold: float) -> list[_Item]:
    """One level of groups: pairs that overlap first, then the best quotient first."""
    pairs = _Pairs(items)
    while (best := pairs.best()) is not None and best[0] > threshold:
        pairs.merge(*best[1:])
    return pairs.left()


class _Pairs:
    """Quotients of all pairs of items: the sum of the areas of their boxes over the area of their common box, infinite
    if the boxes overlap. A pair is evaluated once: k items take at most k^2 evaluations, whatever is merged.

    A merged item takes the place of its second item. ``evaluated``: number of pairs evaluated so far.
    """

    def __init__(self, items: list[_Item]) -> None:
        self._items: list[_Item | None] = list(items)
        self._born = np.arange(len(items))
        self._low, self._high = (np.array([getattr(i, name) for i in items]).reshape(-1, 3) for name in ("low", "high"))
        self._areas = np.array([item.areas for item in items])
        self._quotients = np.full((len(items), len(items)), -np.inf)
        self.evaluated = 0
        for k in range(len(items)):
            self._evaluate(k, np.arange(k))
        self._partner = self._quotients.argmax(axis=1) if items else np.zeros(0, np.int64)

    def best(self) -> tuple[float, int, int] | None:
        """The largest quotient and its pair, ``None`` for less than two items."""
        if len(self._born) < 2:
            return None
        rows = self._quotients[np.arange(len(self._born)), self._partner]
        first = int(rows.argmax())
        one, other = sorted((first, int(self._partner[first])))
        return float(rows[first]), one, other

    def merge(self, one: int, other: int) -> None:
        """Merge two items."""
        first, second = self._items[one], self._items[other]
        assert first is not None and second is not None, "only what is left is merged"
        both = self._items[other] = first.with_(second)
        self._items[one] = None
        self._born[other] = self._born.max() + 1
        self._low[other], self._high[other], self._areas[other] = both.low, both.high, both.areas
        self._quotients[[one, other]] = self._quotients[:, [one, other]] = -np.inf
        others = [k for k, item in enumerate(self._items) if item is not None and k != other]
        self._evaluate(other, np.array(others, dtype=np.int64))
        stale = np.isin(self._partner, [one, other])
        stale[[one, other]] = True
        self._partner[stale] = self._quotients[stale].argmax(axis=1)
        better = self._quotients[:, other] > self._quotients[np.arange(len(self._born)), self._partner]
        self._partner[better] = other

    def left(self) -> list[_Item]:
        """The remaining items, the oldest first."""
        return [item for k in np.argsort(self._born) if (item := self._items[k]) is not None]

    def _evaluate(self, one: int, others: Index) -> None:
        low, high = self._low, self._high
        around = np.maximum(high[one], high[others]) - np.minimum(low[one], low[others])
        common = np.minimum(high[one], high[others]) - np.maximum(low[one], low[others])
        overlap = (common > 1e-6 * np.linalg.norm(around, axis=1)[:, None]).all(axis=1)
        whole = 2 * (around * np.roll(around, 1, axis=1)).sum(axis=1)
        with np.errstate(divide="ignore"):
            found = np.where(overlap, np.inf, (self._areas[one] + self._areas[others]) / whole)
        self._quotients[one, others] = self._quotients[others, one] = found
        self.evaluated += len(others)
