"""All hits of arbitrary lines, by successive rays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.points import PointSet
from etendue.surfaces import STEP, Hits, RayScene

from ..errors import RadiosityError
from .engine import LineEngine
from .generators import Bundles, LineGenerator, Lines, SpherePairs
from .segments import Pairs

Index = NDArray[np.int64]

#: Number of lines that are cast together, and largest number of hits of a line.
_BATCH, _MOST_HITS = 1 << 18, 10_000


class ChainedRays(LineEngine):
    """Lines of any generator: each ray starts at the hit of the previous one, until a ray hits nothing.

    This is the reference for :class:`ABuffer`, which is ten times as fast. A line with k hits costs k + 1 rays in
    single precision. Of two faces closer to each other than 1e-6 of the scene, only one is found.
    """

    def __init__(self, generator: LineGenerator, scene: RayScene, points: PointSet | None = None) -> None:
        super().__init__(scene.patches, points)
        self.generator, self.scene = generator, scene
        self.bundles = generator if isinstance(generator, Bundles) else None

    @classmethod
    def through(cls, scene: RayScene, points: PointSet | None = None) -> ChainedRays:
        """Lines through pairs of points of the bounding sphere."""
        return cls(SpherePairs(scene.patches), scene, points)

    def expected(self, count: int) -> Array:
        """See :class:`LineEngine`."""
        return self.generator.expected(self.patches.areas, count)

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`: at least sixteen pieces, so that there are enough batches."""
        return max(min(int(_BATCH / self.generator.lines_per_point), -(-count // 16)), 1)

    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        for start, number in self._pieces(count, first, size):
            yield self.segments(self.generator.lines(self.points.block(number, start)))

    def segments(self, lines: Lines) -> Pairs:
        """The segments of given lines, line by line, in order along each line."""
        pairs, line = self.segments_within(lines, np.full(len(lines), np.inf))
        return pairs[np.argsort(line, kind="stable")]

    def segments_within(self, lines: Lines, reach: Array) -> tuple[Pairs, Index]:
        """Segments of parts of lines, in arbitrary order of the lines, and the line of each segment.

        reach: (n,) lengths of the parts, infinite for whole lines. A part of finite length begins with the patch that
            its origin sees backwards, and ends at its first hit beyond its length; it has no segments if it has no hit
            within its length.
        """
        sky, ends_at = len(self.patches), reach / self.scene.radius
        origins, directions = self.scene.local(lines.origins), lines.directions
        line, travelled = np.arange(len(lines)), np.zeros(len(lines))
        hits = self.scene.first_hits(origins, directions)
        ends = np.isfinite(reach)
        if ends.any():
            hits, line = _within(hits, ends_at)
            travelled = travelled[line]
        before, last_face = np.full(len(line), sky), np.full(len(line), -1)  # patch and face that each line left last
        back = np.flatnonzero(ends[line])
        before[back] = self.scene.first_patches(origins[line[back]], -directions[line[back]])
        found: list[tuple[Index, Index, Index]] = []
        for _ in range(_MOST_HITS):
            ends = np.ones(len(line), dtype=bool)
            ends[hits.ray] = False
            found.append((line[ends], before[ends], np.full(np.count_nonzero(ends), sky)))
            line, before, last_face = line[hits.ray], before[hits.ray], last_face[hits.ray]
            if len(line) == 0:
                break
            travelled = travelled[hits.ray] + hits.distance + STEP
            again = hits.face == last_face
            near, far = self.scene.sides(hits.face, directions[line])
            found.append((line[~again], before[~again], near[~again]))
            before, last_face = np.where(again, before, far), hits.face
            on = travelled <= ends_at[line]
            if not on.all():
                line, before, last_face, travelled = line[on], before[on], last_face[on], travelled[on]
                if len(line) == 0:
                    break
            hits = self.scene.first_hits(origins[line] + travelled[:, None] * directions[line], directions[line])
        else:
            raise RadiosityError(f"a line meets more than {_MOST_HITS} faces; check the mesh for coincident faces")
        of, one, other = (np.concatenate([part[i] for part in found]) for i in range(3))
        real = (one < sky) | (other < sky)
        return np.stack([one[real], other[real]], axis=1).astype(np.uint32), of[real]


def _within(hits: Hits, reach: Array) -> tuple[Hits, Index]:
    """The hits within the lengths ``reach``, renumbered, and their rays."""
    near = hits.distance <= reach[hits.ray]
    return Hits(np.arange(np.count_nonzero(near)), hits.distance[near], hits.face[near]), hits.ray[near]
