"""Stratification of the random numbers of light paths, without exploration [Leeson 2001, sec. 5.6.4]."""

from __future__ import annotations

import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from .. import dimensions as dim

#: Numbers of emission, and of the first direction after it, as (vertex, component).
EMISSION = (
    (0, dim.LIGHT_PICK),
    (0, dim.LIGHT_POINT),
    (0, dim.LIGHT_POINT + 1),
    (0, dim.LIGHT_DIRECTION),
    (0, dim.LIGHT_DIRECTION + 1),
)
FIRST_BOUNCE = ((1, dim.DIRECTION), (1, dim.DIRECTION + 1))


def strata(paths: int, dimensions: int) -> list[int]:
    """Segments of each dimension, as equal as possible, whose product is at most ``paths``."""
    counts = [max(1, int(paths ** (1.0 / dimensions) + 1e-9))] * dimensions
    for i in range(dimensions):
        if math.prod(counts) // counts[i] * (counts[i] + 1) <= paths:
            counts[i] += 1
    return counts


class StratifiedSource:
    """A :class:`SampleSource` that is stratified in some dimensions: path v is in segment
    ``floor(v / prod_{j<i} n_j) mod n_i`` of dimension i, at a random place.

    The last paths, fewer than the strata, are not stratified, so that each number remains uniform.

    base: numbers within the segments, and of other dimensions. index: numbers of the paths, below ``paths``.
    """

    def __init__(
        self,
        base: SampleSource,
        index: mi.UInt32,
        paths: int,
        dimensions: Sequence[tuple[int, int]] = EMISSION + FIRST_BOUNCE,
    ) -> None:
        self._base = base
        #: (segment, number of segments) of each dimension.
        self._segments: dict[tuple[int, int], tuple[mi.UInt32, mi.UInt32]] = {}
        counts = strata(paths, len(dimensions))
        total = math.prod(counts)
        # Opaque, so that other numbers of paths share the kernel.
        self._even = index < dr.opaque(mi.UInt32, paths // total * total)
        code = mi.UInt32(index)
        for place, count in zip(dimensions, counts, strict=True):
            segments = dr.opaque(mi.UInt32, count)
            self._segments[place] = code % segments, segments
            code = code // segments

    def _one(self, vertex: mi.UInt32 | int, component: int, u: mi.Float) -> mi.Float:
        for (own_vertex, own_component), (segment, count) in self._segments.items():
            if component != own_component or (isinstance(vertex, int) and vertex != own_vertex):
                continue
            here = self._even & (mi.UInt32(vertex) == own_vertex)
            inside = dr.minimum((mi.Float(segment) + u) / mi.Float(count), 1.0 - 2.0**-24)
            u = dr.select(here, inside, u)
        return u

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._one(vertex, component, self._base.next_1d(vertex, component))

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        u, v = self._base.next_2d(vertex, component)
        return self._one(vertex, component, u), self._one(vertex, component + 1, v)

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._one(vertex, component, self._base.decide(vertex, component))
