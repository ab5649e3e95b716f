"""Lines in the spheres of a tree, ray by ray and in rasterised bundles."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, in_order
from etendue.points import PointSet
from etendue.surfaces import RayScene

from ..compiling import compiled
from ..errors import RadiosityError
from ..lines.abuffer import ABuffer
from ..lines.chained import ChainedRays
from ..lines.engine import LineEngine
from ..lines.generators import Bundles, Lines, SpherePairs
from ..lines.segments import Pairs
from .segments import marked
from .tree import SphereTree

Index = NDArray[np.int64]

#: Number of lines that are cast together.
_BATCH = 1 << 16
#: Number of bundles of one task.
_BUNDLES = 8


class TreeLines(LineEngine):
    """Lines in the spheres of a tree; see :class:`TreeRays` and :class:`TreeBundles`.

    A point of the engine, called a *bundle*, makes lines in every sphere, by the share of the sphere; each sphere has
    its own point set. Segments are those of :class:`PartialSegments`. They depend only on the spheres, the points and
    the shares, not on the number of threads.

    Attributes
    ----------
    tree, sequences: the spheres, and the point set of each.
    lines: (m,) mean number of lines of a bundle in each sphere.
    """

    def __init__(self, tree: SphereTree, sequences: Sequence[PointSet], lines: Array) -> None:
        super().__init__(tree.objects.patches, sequences[0])
        if len(sequences) != len(tree) or len(lines) != len(tree):
            raise RadiosityError(f"{len(tree)} spheres have a point set and a number of lines each")
        if not lines[0] > 0:
            raise RadiosityError("the main sphere needs lines, or walls would have none: cast more lines in a bundle")
        self.tree, self.sequences = tree, list(sequences)
        self.lines: Array = np.asarray(lines, dtype=np.float64)

    def densities(self, count: int) -> Array:
        """(m,) densities of the lines of ``count`` bundles: see :meth:`SphereTree.densities`."""
        return self.tree.densities(count * self.lines)

    def expected(self, count: int) -> Array:
        """See :class:`LineEngine`: lines of the spheres that a patch belongs to."""
        return self.tree.of_patches(self.densities(count)) * self.patches.areas

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`: at least sixteen pieces."""
        return max(min(int(_BATCH / self.lines.sum()), -(-count // 16)), 1)


class TreeRays(TreeLines):
    """Lines through pairs of points of each sphere, followed from the last hit before the sphere to the first hit
    behind it.

    lines: (m,) whole numbers.
    """

    def __init__(self, tree: SphereTree, scene: RayScene, sequences: Sequence[PointSet], lines: Index) -> None:
        super().__init__(tree, sequences, lines.astype(np.float64))
        self._rays = ChainedRays(SpherePairs(scene.patches), scene, sequences[0])
        self._counts = np.asarray(lines, dtype=np.int64)
        spheres = zip(tree.centres, tree.radii, strict=True)
        self._generators = [SpherePairs(scene.patches, sphere) for sphere in spheres]

    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        used = np.flatnonzero(self._counts)
        for start, number in self._pieces(count, first, size):
            made = [self._lines(node, start, number) for node in used.tolist()]
            lines = Lines(*(np.concatenate([getattr(x, name) for x in made]) for name in ("origins", "directions")))
            node = np.repeat(used, [len(x) for x in made])
            pairs, of = self._rays.segments_within(lines, self._reach(lines, node))
            yield marked(pairs, node[of], self.tree)

    def _lines(self, node: int, start: int, number: int) -> Lines:
        each = int(self._counts[node])
        return self._generators[node].lines(self.sequences[node].block(number * each, start * each))

    def _reach(self, lines: Lines, node: Index) -> Array:
        """Lengths of lines through their spheres, with equal margins at both ends; infinite for the main sphere."""
        to_centre = self.tree.centres[node] - lines.origins
        along = (to_centre * lines.directions).sum(axis=1)
        return np.where(node == 0, np.inf, 2 * along)


class TreeBundles(TreeLines):
    """Bundles of parallel lines through each sphere, in which all faces are rasterised (:class:`ABuffer`).

    The grid of a sphere covers its disc, with the number of lines of its share, at least one. The loops are those for
    the CPU, also under CUDA. Every sphere tests all faces: with hundreds of objects, use :class:`TreeRays`.
    """

    def __init__(self, tree: SphereTree, sequences: Sequence[PointSet], lines: Array) -> None:
        super().__init__(tree, sequences, np.maximum(lines, 1.0))
        patches = self.patches
        self._buffer = ABuffer(patches, sequences[0], float(self.lines.max()), backend="compiled")
        spheres = zip(self.lines, tree.centres, tree.radii, strict=True)
        self._generators = [Bundles(patches, number, (centre, radius)) for number, centre, radius in spheres]

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`."""
        return _BUNDLES

    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        rasterise = compiled("lines.scanlines").rasterise
        scene = self._buffer.arrays

        def task(start: int, number: int) -> Callable[[], Pairs]:
            grids: list[Any] = []
            for node, generator in enumerate(self._generators):
                u = self.sequences[node].block(number, start)
                frames = generator.frames(u)
                shifts = np.ascontiguousarray(u[:, 2:])
                grids.append((frames, shifts, generator.wraps(frames), *self._disc(node)))

            def run() -> Pairs:
                made = [rasterise(*scene, *grid, len(self.patches), 4096, self._buffer.solid)[0] for grid in grids]
                node = np.repeat(np.arange(len(made)), [len(pairs) for pairs in made])
                return marked(np.concatenate(made), node, self.tree)

            return run

        return in_order(task(*piece) for piece in self._pieces(count, first, size))

    def _disc(self, node: int) -> tuple[float, Array, float]:
        """Spacing of lines, centre and radius of a sphere, in radii of the scene."""
        centre, radius = self.patches.sphere
        generator = self._generators[node]
        middle = np.ascontiguousarray((self.tree.centres[node] - centre) / radius)
        return generator.spacing / radius, middle, float(self.tree.radii[node] / radius)
