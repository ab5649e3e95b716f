"""Lines of equal values, by marching squares."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Sides of a square that a line joins, for each set of corners that are not below the level: bit 0 upper left, 1 upper
#: right, 2 lower right, 3 lower left. Sets 5 and 10 have two lines, which depend on the middle of the square.
_JOINED = {
    ("left", "top"): (1, 14),
    ("top", "right"): (2, 13),
    ("left", "right"): (3, 12),
    ("right", "bottom"): (4, 11),
    ("top", "bottom"): (6, 9),
    ("left", "bottom"): (7, 8),
}
#: Of the sets 5 and 10: those whose middle is below the level, and those whose middle is not.
_SADDLES = {
    ("left", "top"): (5, 10),
    ("right", "bottom"): (5, 10),
    ("top", "right"): (10, 5),
    ("left", "bottom"): (10, 5),
}


def isolines(values: ArrayLike, level: float) -> list[Array]:
    """The lines on which ``values``, (height, width), interpolated linearly between neighbours, are ``level``.

    Each is (k, 2): x and y, in units of columns and rows, with whole numbers at the values; a closed line ends where it
    begins. Squares with a corner that is NaN have no lines.
    """
    v = np.asarray(values, dtype=np.float64)
    if min(v.shape) < 2:
        return []
    number = np.arange(v.size).reshape(v.shape)
    sides = {  # each side has a number: that of its left or upper end, and more for upright ones
        "top": number[:-1, :-1],
        "bottom": number[1:, :-1],
        "left": number[:-1, :-1] + v.size,
        "right": number[:-1, 1:] + v.size,
    }
    corners = v[:-1, :-1], v[:-1, 1:], v[1:, 1:], v[1:, :-1]
    kind = sum((corner >= level) << bit for bit, corner in enumerate(corners))
    kind = np.where(np.isnan(sum(corners)), 0, kind)
    is_high = sum(corners) >= 4.0 * level
    pairs = []
    for joined, kinds in _JOINED.items():
        has = np.isin(kind, kinds)
        if (saddle := _SADDLES.get(joined)) is not None:
            has |= kind == np.where(is_high, saddle[1], saddle[0])
        pairs.append(np.stack([sides[name][has] for name in joined], axis=1))
    chains = _chains(np.concatenate(pairs))
    if not chains:
        return []
    ends = np.cumsum([len(chain) for chain in chains])
    return np.split(_points(np.concatenate(chains), v, level), ends[:-1])


def _chains(pairs: NDArray[np.int64]) -> list[list[int]]:
    """Sequences of sides from pairs of them; a side is in two pairs at most."""
    next_to: dict[int, list[int]] = defaultdict(list)
    for a, b in pairs.tolist():
        next_to[a].append(b)
        next_to[b].append(a)
    chains = []
    ends = [side for side, others in next_to.items() if len(others) == 1]
    for start in (*ends, *list(next_to)):  # first those with ends, then the closed ones
        if not next_to[start]:
            continue
        chain = [start]
        while others := next_to[chain[-1]]:
            following = others.pop()
            next_to[following].remove(chain[-1])
            chain.append(following)
        chains.append(chain)
    return chains


def _points(sides: NDArray[np.int64], v: Array, level: float) -> Array:
    """Where the level is on sides."""
    upright = sides >= v.size
    row, column = np.divmod(sides - v.size * upright, v.shape[1])
    one, other = v[row, column], v[row + upright, column + ~upright]
    share = (level - one) / (other - one)
    return np.stack([column + share * ~upright, row + share * upright], axis=1)
