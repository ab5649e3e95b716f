"""Local lines: from points on patches into their hemispheres, to the first hit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.points import PointSet
from etendue.surfaces import BATCH, RayScene, RaySource, Sides, columns, cosine_lanes, pairs_of

from ..factors.covered import CoveredSides, covered_lamps
from .engine import LineEngine
from .segments import Directed, Pairs


class LocalRays(LineEngine):
    """Rays from uniform points of all patches by the cosine law; each is a segment for both of its ends.

    They have the density of global lines [Sbert 1993], but a ray finds one segment only. They are better than global
    lines for few surfaces in a large space.

    bundle: number of rays that count as one bundle; each ray has its own point.

    Raises :class:`RadiosityError` for faces on each other of which it is not known which one is in front.
    """

    def __init__(self, scene: RayScene, points: PointSet | None = None, bundle: int = 1) -> None:
        super().__init__(scene.patches, points)
        self.scene, self.bundle = scene, bundle
        sides = Sides.of(scene.patches)
        self._source, self._covered = RaySource(scene, sides), CoveredSides(scene, sides)

    def expected(self, count: int) -> Array:
        """See :class:`LineEngine`: as many rays leave a patch as hit it."""
        return 2 * count * self.bundle * self.patches.areas / self.patches.areas.sum()

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`: at least sixteen pieces, so that there are enough batches."""
        return max(min(BATCH // self.bundle, -(-count // 16)), 1)

    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        return (made.pairs for made in self._cast(count, first, size, directed=False))

    def directed(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Directed]:
        """See :class:`LineEngine`."""
        return self._cast(count, first, size, directed=True)

    def _cast(self, count: int, first: int, size: int | None, directed: bool) -> Iterator[Directed]:
        for start, number in self._pieces(count, first, size):
            u = self.points.lanes(mi.UInt32, number * self.bundle, start * self.bundle)
            places = self._source.any(u[0], u[1])
            directions = places.directions(cosine_lanes(u[2], u[3]))
            found = self._covered.meets(places, self.scene.meets(places.origin, directions))
            pairs = pairs_of(self._source.patch_of(places.side), found)
            # A patch receives as many rays from another patch as it sends there, but none from the sky or from backs of
            # faces: segments to these count twice.
            twice = pairs[:, 1] >= len(self.patches)
            ways = np.empty((0, 4))
            if directed:
                ways = np.column_stack([np.array(directions).T, np.ones(len(pairs))])
                ways = np.concatenate([ways, ways[twice]])
            yield Directed(np.concatenate([pairs, pairs[twice]]), ways)


@dataclass(frozen=True)
class Rays:
    """Rays that carry power: origins and unit directions (k, 3) in unit coordinates, power (k, c)."""

    origins: Array
    directions: Array
    power: Array


class Emission:
    """Rays of cosine density that carry the ``power`` (n, c) of patches.

    Rays are distributed by power, summed over channels, and have the colour of their source. They are scaled so that
    the total power of each channel is sent.
    """

    def __init__(self, scene: RayScene, power: Array) -> None:
        self.scene, self.power = scene, power
        sides = Sides.of(scene.patches).emitting(power.sum(axis=1))
        self._source, self._covered = RaySource(scene, sides), covered_lamps(scene, sides)

    def rays(self, u: Array) -> Rays:
        """A ray for each point ``u`` (k, 4)."""
        lanes = columns(u)
        places = self._source.any(lanes[0], lanes[1])
        directions = np.array(places.directions(cosine_lanes(lanes[2], lanes[3])), dtype=np.float64).T
        source = np.array(self._source.patch_of(places.side))
        return Rays(np.array(places.origin).T, directions, self._carried(source))

    def received(self, u: Array) -> Array:
        """Power (n + 2, c) that patches, the sky and the backs of faces receive by the rays of ``u`` (k, 4)."""
        lanes, n = columns(u), len(self.power)
        places = self._source.any(lanes[0], lanes[1])
        found = self.scene.meets(places.origin, places.directions(cosine_lanes(lanes[2], lanes[3])))
        found = self._covered.meets(places, found)
        pairs = pairs_of(self._source.patch_of(places.side), found)
        return np.stack([np.bincount(pairs[:, 1], column, n + 2) for column in self._carried(pairs[:, 0]).T], axis=1)

    def _carried(self, source: NDArray[np.uint32]) -> Array:
        carried = self.power[source] / self.power[source].sum(axis=1, keepdims=True)
        sent = carried.sum(axis=0)
        return carried * np.divide(self.power.sum(axis=0), sent, out=np.zeros_like(sent), where=sent > 0)
