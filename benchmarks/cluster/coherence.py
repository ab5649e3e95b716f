"""The sequence of boxes of a scene that light paths visit, and the misses of a cache of boxes
[Leeson 2001, sec. 5.6.4]."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.particles import BoxGrid, Particles


def visits(particles: Particles, grid: BoxGrid) -> NDArray[np.int64]:
    """The boxes of the hits in the order in which they are traced, path by path."""
    return grid.of_points(particles.position)


def distinct_in_windows(boxes: NDArray[np.int64], size: int) -> Array:
    """Number of different boxes in each window of ``size`` consecutive visits; windows do not overlap."""
    rows = np.sort(boxes[: len(boxes) // size * size].reshape(-1, size), axis=1)
    return np.asarray(1.0 + (np.diff(rows, axis=1) != 0).sum(axis=1))


def lru_misses(boxes: Sequence[int] | NDArray[np.int64], capacity: int) -> int:
    """Number of visits to boxes that are not among the ``capacity`` most recently visited ones."""
    held: OrderedDict[int, None] = OrderedDict()
    misses = 0
    for box in boxes:
        box = int(box)
        if box in held:
            held.move_to_end(box)
            continue
        misses += 1
        held[box] = None
        if len(held) > capacity:
            held.popitem(last=False)
    return misses
