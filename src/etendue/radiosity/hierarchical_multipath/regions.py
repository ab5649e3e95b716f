"""Regions of a virtual box, by face, place on the face and direction; the light through a region is summed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array

from ..errors import RadiosityError

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Regions:
    """``grid`` x ``grid`` places on each of the six faces of a box, each with ``around`` sectors times ``up`` rings of
    directions. Lines of uniform density cross all regions of a face equally often. The thesis has 4 x 4 places and 8
    directions, 768 regions in all [Castro 2002, sec. 5.3.2]."""

    grid: int = 4
    around: int = 4
    up: int = 2

    def __post_init__(self) -> None:
        if min(self.grid, self.around, self.up) < 1:
            raise RadiosityError(f"a box needs one place and one direction on each face at least, not {self}")

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Faces, places along two axes, rings, sectors: the order of regions."""
        return 6, self.grid, self.grid, self.up, self.around

    def __len__(self) -> int:
        return int(np.prod(self.shape))

    def neighbours(self) -> Index:
        """(r, 8) the neighbours of each region in place on its face and in direction; the region itself at a border."""
        own = np.arange(len(self)).reshape(self.shape)
        found = []
        for axis, wraps in ((1, False), (2, False), (3, False), (4, True)):
            for step in (1, -1):
                moved = np.roll(own, step, axis=axis)
                if not wraps:
                    edge = [slice(None)] * 5
                    edge[axis] = slice(0, 1) if step == 1 else slice(-1, None)
                    moved[tuple(edge)] = own[tuple(edge)]
                found.append(moved.ravel())
        return np.stack(found, axis=1)

    def interpolated(self, values: Array, known: NDArray[np.bool_]) -> Array:
        """(r,) ``values`` where they are ``known``; elsewhere the mean of neighbours, repeated until all regions have a
        value. On a face without known values: the mean of the box; 1 if no value is known."""
        result, known = np.where(known, values, 0.0), known.copy()
        around = self.neighbours()
        while not known.all():
            lines = known[around] & (around != np.arange(len(self))[:, None])
            count = lines.sum(axis=1)
            fresh = ~known & (count > 0)
            if not fresh.any():
                result[~known] = result[known].mean() if known.any() else 1.0
                break
            result[fresh] = (result[around] * lines).sum(axis=1)[fresh] / count[fresh]
            known |= fresh
        return result

    def donors(self, weights: Array) -> Index:
        """(r,) the region that takes the light of each region: itself if its weight is above zero, else the nearest
        region of positive weight, the one of largest weight among several; on a face without any, the region of largest
        weight of the box."""
        own = np.arange(len(self))
        target = np.where(weights > 0, own, -1)
        if not (weights > 0).any():
            return own
        around = self.neighbours()
        while (target < 0).any():
            reached = target[around]
            weight = np.where(reached >= 0, weights[reached], -1.0)
            best = np.argmax(weight, axis=1)
            fresh = (target < 0) & (weight[own, best] > 0)
            if not fresh.any():
                target[target < 0] = np.argmax(weights)
                break
            target[fresh] = reached[own, best][fresh]
        return target
