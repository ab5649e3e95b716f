"""Bundles of parallel lines by rasterising the faces: every hit of every line, without a ray."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from etendue.core import Array
from etendue.points import PointSet

from .engine import LineEngine
from .lines import Bundles
from .parallel import compiled, in_order
from .patches import Patches
from .segments import Pairs

#: Bundles of one task.
_BUNDLES = 8
#: The order of faces nearer to each other than this part of the scene's radius follows from how they are turned.
_GAP = 2e-7
#: Lines for each patch and bundle, in the mean, if their number is not given; and the fewest.
_LINES_PER_PATCH, _FEWEST = 2.0, 4096


class ABuffer(LineEngine):
    """Lines in parallel bundles, one for each point (:class:`Bundles`).

    For each bundle all faces are projected along its direction and filled in row by row, like triangles of a picture,
    but each line of the grid keeps all faces that it meets. Sorted by depth, neighbours see each other
    [Carpenter 1984]. In double precision, no line of a closed mesh slips between two faces.

    lines: of a bundle through the bounding sphere; by default as many as meet a patch twice in the mean, and 4096 at
        least. Directions matter more than lines: have some thousand of them.
    """

    def __init__(self, patches: Patches, points: PointSet | None = None, lines: float | None = None) -> None:
        super().__init__(patches, points)
        if lines is None:
            radius = patches.sphere[1]
            once = _LINES_PER_PATCH * 2 * np.pi * radius**2 * len(patches) / patches.areas.sum()
            lines = max(once, _FEWEST)
        self.bundles = Bundles(patches, lines)
        used, faces = np.unique(patches.faces, return_inverse=True)
        self._vertices = np.ascontiguousarray(patches.vertices[used] - self.bundles.centre)
        self._faces = np.ascontiguousarray(faces.reshape(-1, 4), dtype=np.uint32)
        dark = len(patches) + 1
        self._front = patches.front.astype(np.uint32)
        self._back = np.where(patches.back < 0, dark, patches.back).astype(np.uint32)

    def expected(self, count: int) -> Array:
        """See :class:`LineEngine`."""
        return self.bundles.expected(self.patches.areas, count)

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`."""
        return _BUNDLES

    def stream(self, count: int, first: int = 0) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        rasterise = compiled().rasterise
        gap = _GAP * self.bundles.radius
        # Hits of a bundle vary with its direction.
        room = int(1.2 * self.expected(1).sum()) + 1024

        def task(start: int, number: int) -> Callable[[], Pairs]:
            u = self.points.block(number, start)
            frames, shifts = self.bundles.frames(u), np.ascontiguousarray(u[:, 2:])
            arrays = self._vertices, self._faces, self._front, self._back, frames, shifts
            return lambda: rasterise(*arrays, self.bundles.spacing, gap, len(self.patches), room)

        return in_order(task(*piece) for piece in self._pieces(count, first))
