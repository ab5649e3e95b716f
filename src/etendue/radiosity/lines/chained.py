"""All hits of arbitrary lines, by successive rays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array
from etendue.points import PointSet
from etendue.surfaces import REACH_OF_PAIRS, STEP, Hits, RayScene, is_interior

from ..errors import RadiosityError, check_no_period
from .engine import LineEngine
from .generators import Bundles, LineGenerator, Lines, SpherePairs
from .segments import Pairs

Index = NDArray[np.int64]

#: Number of lines that are cast together, and largest number of hits of a line.
_BATCH, _MOST_HITS = 1 << 18, 10_000


class ChainedRays(LineEngine):
    """Lines of any generator: each ray starts at the hit of the previous one, until a ray hits nothing.

    This is the reference for :class:`ABuffer`, which is ten times as fast. A line with k hits costs k + 1 rays in
    single precision. Of two faces closer to each other than 1e-6 of the scene, only one is found, unless they lie back
    to back.
    """

    def __init__(self, generator: LineGenerator, scene: RayScene, points: PointSet | None = None) -> None:
        check_no_period(scene.patches, "single lines")
        super().__init__(scene.patches, points)
        self.generator, self.scene = generator, scene
        self.bundles = generator if isinstance(generator, Bundles) else None
        self._solid = is_interior(scene.patches)

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
        first = np.full(len(lines), sky)  # the patch where each line begins
        back = line[ends[line]]
        first[back] = self.scene.first_patches(origins[back], -directions[back])
        is_open = np.zeros(len(lines), dtype=bool)  # lines that end in the sky
        last_face = np.full(len(line), -1)
        found: list[tuple[Index, Index, Array]] = []
        for _ in range(_MOST_HITS):
            ended = np.ones(len(line), dtype=bool)
            ended[hits.ray] = False
            is_open[line[ended]] = True
            line, last_face = line[hits.ray], last_face[hits.ray]
            if len(line) == 0:
                break
            travelled = travelled[hits.ray] + hits.distance
            new = hits.face != last_face
            found.append((line[new], hits.face[new], travelled[new]))
            last_face = hits.face
            travelled = travelled + STEP
            on = travelled <= ends_at[line]
            if not on.all():
                line, last_face, travelled = line[on], last_face[on], travelled[on]
                if len(line) == 0:
                    break
            hits = self.scene.first_hits(origins[line] + travelled[:, None] * directions[line], directions[line])
        else:
            raise RadiosityError(f"a line meets more than {_MOST_HITS} faces; check the mesh for coincident faces")
        if not found:
            return np.empty((0, 2), np.uint32), np.empty(0, np.int64)
        of, face, depth = (np.concatenate([part[i] for part in found]) for i in range(3))
        order = np.argsort(of, kind="stable")
        of, face, depth = of[order], face[order], depth[order]
        near, far = self._settled(of, face, depth, directions[of], first)
        # Each hit ends a segment; the last one begins another if its line ends in the sky.
        begins = np.diff(of, prepend=-1) != 0
        before = np.where(begins, first[of], np.roll(far, 1))
        last = np.flatnonzero(np.append(begins[1:], True)[: len(of)] & is_open[of])
        one, other = np.concatenate([before, far[last]]), np.concatenate([near, np.full(len(last), sky)])
        real = (one < sky) | (other < sky)
        return np.stack([one[real], other[real]], axis=1).astype(np.uint32), np.concatenate([of, of[last]])[real]

    def _settled(self, line: Index, face: Index, depth: Array, directions: Array, first: Index) -> tuple[Index, Index]:
        """Near and far patch of each hit, line by line. Of two faces that lie back to back, a line meets the one that
        faces it first, since they are set apart for rays; inside a solid that touches another one (a box on a floor) it
        leaves the solid first, as in :class:`ABuffer`."""
        dark = len(self.patches) + 1
        near, far = self.scene.sides(face, directions)
        paired = self.patches.coincident.back_to_back[face]
        if not paired.any():
            return near, far
        away = np.abs((self.patches.face_normals[face] * directions).sum(axis=1)) * np.diff(depth, append=np.inf)
        follows = paired & (np.diff(line, append=-1) == 0) & np.roll(paired, -1) & (away < REACH_OF_PAIRS)
        one = np.flatnonzero(follows & (far == dark) & (np.roll(near, -1) == dark))
        # What is outside of a pair, before it or else after it, decides whether a line is inside a solid.
        alone = np.ones(len(line), dtype=bool)
        alone[one] = alone[one + 1] = False
        place = np.arange(len(line))
        earlier = np.maximum.accumulate(np.where(alone, place, -1))[one]
        later = np.minimum.accumulate(np.where(alone, place, len(line))[::-1])[::-1][one]
        known, known_later = _of_line(line, one, earlier), _of_line(line, one, later)
        inside = np.where(known, far[earlier] == dark, first[line[one]] == dark)
        unknown = ~known & (first[line[one]] == dark - 1)
        # A line of pairs only meets plates, or, if their number is even, the walls of a box in a corner of a room.
        is_box = self._solid & (np.bincount(line[one])[line[one]] % 2 == 0)
        ahead = np.where(known_later, near[np.minimum(later, len(line) - 1)] == dark, is_box)
        is_flat = self.patches.coincident.flat[face]
        swapped = one[np.where(unknown, ahead, inside) & ~(is_flat[one] & is_flat[one + 1])]
        near[swapped], near[swapped + 1] = near[swapped + 1], near[swapped]
        far[swapped], far[swapped + 1] = far[swapped + 1], far[swapped]
        return near, far


def _of_line(line: Index, at: Index, other: Index) -> NDArray[np.bool_]:
    """Whether the hits ``other``, where there are any, are of the same line as the hits ``at``."""
    exists = (other >= 0) & (other < len(line))
    return exists & (line[np.clip(other, 0, len(line) - 1)] == line[at])


def _within(hits: Hits, reach: Array) -> tuple[Hits, Index]:
    """The hits within the lengths ``reach``, renumbered, and their rays."""
    near = hits.distance <= reach[hits.ray]
    return Hits(np.arange(np.count_nonzero(near)), hits.distance[near], hits.face[near]), hits.ray[near]
