"""Line engines cast lines for the points of a point set, and return segments."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from copy import copy
from typing import Any, Self

import numpy as np

from etendue.core import Array, free_memory, logger
from etendue.points import OwenSobol, PointSet
from etendue.surfaces import Patches

from ..errors import RadiosityError
from .generators import Bundles
from .segments import Directed, Pairs, Segments
from .spiral import ShuffledPoints

#: Share of segments to backs of faces above which a warning is given.
_DARK = 0.01


class LineEngine(ABC):
    """Casts a line, or a bundle of lines, through patches for each point of a four-dimensional point set.

    points: by default a scrambled Sobol' sequence.

    The same points give the same segments, on any number of threads. Warns of faces that lie on each other and face the
    same way, of which a line finds an arbitrary one. Raises :class:`RadiosityError` for points of
    another dimension.
    """

    #: The lines of a point: a bundle of parallel lines, or one line (``None``).
    bundles: Bundles | None = None

    def __init__(self, patches: Patches, points: PointSet | None = None) -> None:
        patches.coincident.warn(patches)
        self.patches = patches
        self.points = OwenSobol(4) if points is None else points
        if self.points.dimension != 4:
            raise RadiosityError(f"a line takes points of four dimensions, not of {self.points.dimension}")

    @property
    def shares_directions(self) -> bool:
        """Whether successive lines are parallel: bundles of more than one line."""
        # The number of lines is computed from their distance: for a single line it may be 1 + 1e-16.
        return self.bundles is not None and self.bundles.lines_per_point > 1 + 1e-9

    def shuffled(self, count: int, first: int = 0) -> Self:
        """An engine with the same ``count`` points from ``first`` on, in a random order."""
        return self.with_points(ShuffledPoints(self._points_of(count), count, first))

    def with_points(self, points: PointSet) -> Self:
        """The same engine with other points."""
        engine = copy(self)
        engine.points = points
        return engine

    @abstractmethod
    def piece(self, count: int) -> int:
        """Points per piece of :meth:`stream` if ``count`` points are cast; the last piece may have fewer."""

    @abstractmethod
    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """The segments of ``count`` points from ``first`` on, without storing them: (k, 2) arrays in the order of the
        points, one for each :meth:`piece`, or for each ``size`` points."""

    def directed(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Directed]:
        """:meth:`stream` with the directions of the lines. Raises :class:`RadiosityError` if they are not kept."""
        raise RadiosityError(f"{type(self).__name__} keeps no directions of its lines: take ABuffer or LocalRays")

    @abstractmethod
    def expected(self, count: int) -> Array:
        """(n,) expected number of segments of each patch, if it is flat, for ``count`` points."""

    def cast(self, count: int, first: int = 0, batches: int = 16, warn: bool = True) -> Segments:
        """The segments of ``count`` points from ``first`` on, in at most ``batches`` batches.

        Warns, if that is not switched off, of patches that no line has met, and if many lines meet backs of faces.

        Raises :class:`RadiosityError` for less than one point, and if the segments do not fit into memory.
        """
        if count < 1:
            raise RadiosityError(f"line casting needs at least one point, not {count}")
        need, free = 4 * float(self.expected(count).sum()), free_memory()
        if free is not None and need > free:
            raise RadiosityError(
                f"segments of {count} points need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: cast fewer "
                "points, or take stream()"
            )
        chunks = list(self.stream(count, first))
        batches = min(batches, len(chunks))
        number = np.arange(len(chunks)) * batches // len(chunks)
        segments = Segments(self.patches, chunks, number, self.expected(count))
        if warn:
            warn_of_faults(segments)
        return segments

    def _points_of(self, count: int) -> PointSet:
        """The points of a call for ``count`` of them."""
        return self.points

    def _pieces(self, count: int, first: int, size: int | None = None) -> Iterator[tuple[int, int]]:
        """First point and number of points of each piece."""
        size = size or self.piece(count)
        return ((start, min(size, first + count - start)) for start in range(first, first + count, size))


def warn_of_faults(segments: Segments | Any) -> None:
    """Warn of patches that no line has met, and if many lines meet backs of faces."""
    if len(segments.unseen):
        logger.warning(
            "no line has met %d of %d patches, such as patch %d: cast more, make patches larger, or take "
            "with_local_rays()",
            *(len(segments.unseen), len(segments.patches), segments.unseen[0]),
        )
    warn_of_backs(float(segments.to_dark.sum() / max(segments.counted.sum(), 1)), "of what patches see is")


def warn_of_backs(share: float, what: str) -> None:
    """Warn if backs of faces have a large share of something."""
    if share > _DARK:
        logger.warning(
            "%.2g %s backs of faces, which absorb everything: faces are turned the wrong way or lie on each other, the "
            "mesh is open, or there are obstacles; see etendue.radiosity.diagnose",
            *(share, what),
        )
