"""The hierarchy of boxes: objects that fill the box around them well become a part [Castro 2002, sec. 5.3.1]."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, logger
from etendue.surfaces import Patches

from ..errors import RadiosityError
from .parts import Part, box_area, faces_in_box

Index = NDArray[np.int64]

#: Sum of the areas of the boxes of objects over that of the box around them all, above which they become a part.
THRESHOLD = 0.8
#: Patches that a box is worth.
LEAST = 64


@dataclass(frozen=True)
class _Item:
    """An object, or a group of objects and groups."""

    low: Array
    high: Array
    areas: float  # of the boxes of what is grouped
    objects: tuple[int, ...]
    groups: tuple[_Item, ...] = ()  # those of the level below that are inside
    grows: bool = False  # it was made on this level

    def with_(self, other: _Item) -> _Item:
        """Both in one."""
        inner = (item.groups if item.grows else (item,) * (len(item.objects) > 1) for item in (self, other))
        members = tuple(group for groups in inner for group in groups)
        return _Item(
            *(np.minimum(self.low, other.low), np.maximum(self.high, other.high), self.areas + other.areas),
            *(self.objects + other.objects, members, True),
        )

    def overlaps(self, other: _Item) -> bool:
        slack = 1e-6 * np.linalg.norm(np.maximum(self.high, other.high) - np.minimum(self.low, other.low))
        return bool((np.minimum(self.high, other.high) - np.maximum(self.low, other.low) > slack).all())


def grouped(
    patches: Patches,
    objects: ArrayLike,
    threshold: float = THRESHOLD,
    least: int = LEAST,
    levels: int = 1,
) -> Part:
    """Patches as a scene of parts, by what object each belongs to.

    Groups grow from single objects: the two of them that fill the box around both best, by the sum of the areas of
    their objects' boxes over the area of that box, become one, until that quotient is at most the ``threshold``. Groups
    whose boxes overlap become one whatever it is. With several ``levels`` the groups, as objects with their boxes, are
    grouped again. What then has fewer than ``least`` patches stays in what is around it, as does a group into whose box
    a wall reaches; an object by itself that has as many is a part, too.

    objects: (n,) the number of the object that each patch belongs to, -1 for walls, which are part of the whole scene
        only.

    Raises :class:`RadiosityError` for another number of objects than patches.
    """
    of = np.asarray(objects)
    if of.shape != (len(patches),) or of.dtype.kind not in "iu":
        raise RadiosityError(f"objects are whole numbers, one for each of {len(patches)} patches, not {of.shape}")
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
        """The root: walls, what is not grouped, and copies of each group."""
        parts, loose = self._boxed(items)
        mine = (self.of < 0) | np.isin(self.of, loose)
        if not mine.any() and self.patches.sky.any():
            raise RadiosityError(
                "all patches are in boxes, so that no part is left that sees the sky: add a ground or walls, or leave "
                "an object without a box by a larger 'least'"
            )
        return self._part(mine, parts, 1, is_root=True)

    def _boxed(self, items: list[_Item]) -> tuple[list[Part], list[int]]:
        """Parts of the items that are worth a box, and objects of the others."""
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
    corners = patches.vertices[patches.faces]
    found = []
    for k in np.unique(front[front >= 0]):
        points = corners[front == k].reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        found.append(_Item(low, high, box_area(low, high), (int(k),)))
    return found


def _merged(items: list[_Item], threshold: float) -> list[_Item]:
    """One level of groups: pairs that overlap first, then the best quotient first."""
    alive: dict[int, _Item] = dict(enumerate(items))
    quotients = {(i, j): _quotient(alive[i], alive[j]) for i in alive for j in alive if i < j}
    while quotients:
        (i, j), best = max(quotients.items(), key=lambda entry: entry[1])
        if best <= threshold:
            break
        new = max(alive) + 1
        both = alive.pop(i).with_(alive.pop(j))
        quotients = {pair: q for pair, q in quotients.items() if not {i, j} & set(pair)}
        quotients |= {(k, new): _quotient(item, both) for k, item in alive.items()}
        alive[new] = both
    return list(alive.values())


def _quotient(one: _Item, other: _Item) -> float:
    if one.overlaps(other):
        return np.inf
    whole = box_area(np.minimum(one.low, other.low), np.maximum(one.high, other.high))
    return (one.areas + other.areas) / whole
