"""Bundles of parallel lines by rasterisation of the faces: all hits of all lines, without ray casting."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from itertools import starmap, tee
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, in_order, logger, uses_cuda
from etendue.points import PointSet
from etendue.surfaces import Patches, is_interior

from ..compiling import compiled
from ..errors import RadiosityError
from .engine import LineEngine
from .generators import Bundles
from .periodic import PeriodicBundles
from .rasteriser import Rasteriser
from .segments import Directed, Pairs
from .spiral import SpiralPoints

#: The rasteriser: loops for the CPU, or kernels of the current variant; ``auto`` takes the kernels under CUDA.
Backend = Literal["auto", "compiled", "drjit"]

#: Bundles of one task of the compiled loops.
_BUNDLES = 8
#: Lanes, and slots for hits, of one set of kernels on the CPU, and on a GPU, which needs more. A slot takes about 80
#: bytes.
_PLACES, _PLACES_CUDA = 1 << 21, 1 << 24
#: Default mean number of lines per patch and bundle, and smallest number of lines.
LINES_PER_PATCH, _FEWEST = 4.0, 16384
#: Default limit on the lines of a bundle: in total, or per patch if that is more. A line of the grid takes some bytes
#: on each thread, even without hits.
_MOST, _MOST_PER_PATCH, _LINE_BYTES = 1 << 24, 32, 8


class ABuffer(LineEngine):
    """Lines in parallel bundles, one for each point (:class:`Bundles`).

    For each bundle all faces are projected along its direction and rasterised row by row, but each line of the grid
    keeps all faces that it hits. Sorted by depth, neighbours see each other [Carpenter 1984]. In double precision, no
    line passes between two faces of a closed mesh.

    points: by default :class:`SpiralPoints`, a spiral for the bundles of each call.
    A periodic domain (``period`` of the patches) has :class:`PeriodicBundles`, which need the compiled loops.

    lines: number of lines of a bundle through the bounding sphere, or of a vertical one through a period; by default
        four per patch in the mean, and at least 16384. If few surfaces in a large space need more than 2^24 lines, or
        32 per patch if that is more, a bundle has that number, with a warning; :class:`LocalRays` are then better. The
        squared error of a patch falls with the number of bundles times the power 3/2 of their lines, as long as there
        are enough directions: use a few hundred bundles, or a thousand for errors of 0.2 %.
    backend: ``compiled`` loops on the CPU (Numba), or ``drjit``, on the device of the current variant. ``auto`` takes
        ``drjit`` on a GPU. Both find the same segments, except for single lines at an edge.

    Raises :class:`RadiosityError` for another backend, and for more lines than fit into memory.
    """

    def __init__(
        self,
        patches: Patches,
        points: PointSet | None = None,
        lines: float | None = None,
        backend: Backend = "auto",
    ) -> None:
        super().__init__(patches, SpiralPoints() if points is None else points)
        self._default = self.points if points is None else None
        if backend not in get_args(Backend):
            raise RadiosityError(f"the backend is one of {', '.join(get_args(Backend))}, not {backend!r}")
        is_periodic = patches.period is not None
        if is_periodic and backend == "drjit":
            raise RadiosityError("lines of a periodic domain are cast by the compiled loops: leave out backend='drjit'")
        on_device = uses_cuda() and not is_periodic
        self.backend = ("drjit" if on_device else "compiled") if backend == "auto" else backend
        if lines is None:
            wanted, most = wanted_lines(patches)
            if wanted > most:
                logger.warning(
                    "bundles have %.2g lines in place of %.2g: surfaces are few in a large space, and few lines meet "
                    "them; take LocalRays",
                    *(most, wanted),
                )
            lines = min(wanted, most)
        if (free := free_memory()) is not None and _LINE_BYTES * lines > free:
            raise RadiosityError(
                f"a bundle of {lines:.2g} lines needs {_LINE_BYTES * lines / 1e9:.2g} GB on each thread, "
                f"{free / 1e9:.2g} GB are free: ask for fewer lines, or take LocalRays"
            )
        self.bundles: Bundles = (PeriodicBundles if is_periodic else Bundles)(patches, lines)
        used, faces = np.unique(patches.faces, return_inverse=True)
        #: Spacing and vertices are in radii of the scene.
        self._spacing = self.bundles.spacing / self.bundles.radius
        self._vertices = (patches.vertices[used] - self.bundles.centre) / self.bundles.radius
        self._faces = np.ascontiguousarray(faces.reshape(-1, 4), dtype=np.uint32)
        #: Whether the scene is an interior.
        self.solid = is_interior(patches)
        front, back = patches.sides.T
        self._ends = np.stack([front, back, back, front], axis=1).reshape(-1, 2).astype(np.uint32)
        self._coincident = patches.coincident.kinds

    @property
    def arrays(self) -> tuple[Array, NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint8]]:
        """Vertices, faces, their sides and which coincide, for the compiled loops, in radii of the scene."""
        return self._vertices, self._faces, self._ends, self._coincident

    @staticmethod
    def suits(patches: Patches) -> bool:
        """Whether bundles with a moderate number of lines hit the patches; if not, use :class:`LocalRays`."""
        wanted, most = wanted_lines(patches)
        return wanted <= most

    def expected(self, count: int) -> Array:
        """See :class:`LineEngine`."""
        return self.bundles.expected(self.patches.areas, count)

    def piece(self, count: int) -> int:
        """See :class:`LineEngine`; at least sixteen pieces with the kernels, so that there are enough batches."""
        if self.backend == "compiled":
            return _BUNDLES
        once = max(self._rasteriser.lanes, self.expected(1).sum() + self.bundles.lines_per_point)
        return max(min(int((_PLACES_CUDA if uses_cuda() else _PLACES) / once), -(-count // 16)), 1)

    def stream(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Pairs]:
        """See :class:`LineEngine`."""
        grids = self._grids(count, first, size)
        if self.backend == "drjit":
            return (self._rasteriser.segments(*grid) for grid in grids)
        return (pairs for pairs, _ in self._rasterised(grids))

    def directed(self, count: int, first: int = 0, size: int | None = None) -> Iterator[Directed]:
        """See :class:`LineEngine`."""
        return self.along(self._grids(count, first, size))

    def along(self, grids: Iterable[tuple[Array, Array]]) -> Iterator[Directed]:
        """The segments of bundles, given by their frames (b, 3, 3), as of :meth:`Bundles.frames_along`, and the shifts
        of their grids (b, 2) in units of the spacing; one item for each of ``grids``."""
        kept, used = tee(grids)
        on_device = self.backend == "drjit"
        made = starmap(self._rasteriser.counted, used) if on_device else self._rasterised(used)
        for (frames, _), (pairs, counts) in zip(kept, made, strict=True):
            yield Directed(pairs, np.column_stack([self.bundles.directions(frames), counts]))

    def _rasterised(self, grids: Iterable[tuple[Array, Array]]) -> Iterator[tuple[Pairs, NDArray[np.int64]]]:
        rasterise = compiled("lines.scanlines").rasterise
        # Hits of a bundle vary with its direction.
        room = int(1.2 * self.expected(1).sum()) + 1024

        def task(grid: tuple[Array, Array]) -> Callable[[], tuple[Pairs, NDArray[np.int64]]]:
            arrays = *self.arrays, *grid, self.bundles.wraps(grid[0])
            return lambda: rasterise(*arrays, self._spacing, np.zeros(3), np.inf, len(self.patches), room, self.solid)

        return in_order(task(grid) for grid in grids)

    def _points_of(self, count: int) -> PointSet:
        return SpiralPoints(directions=count) if self.points is self._default else self.points

    def _grids(self, count: int, first: int, size: int | None) -> Iterator[tuple[Array, Array]]:
        """Frames and shifts of the bundles of each piece."""
        points = self._points_of(count)
        for start, number in self._pieces(count, first, size):
            u = points.block(number, start)
            yield self.bundles.frames(u), np.ascontiguousarray(u[:, 2:])

    @cached_property
    def _rasteriser(self) -> Rasteriser:
        return Rasteriser(
            self._vertices,
            self._faces,
            self._ends[::2],
            self._coincident,
            len(self.patches),
            radius=1.0,
            spacing=self._spacing,
            solid=self.solid,
        )


def wanted_lines(patches: Patches) -> tuple[float, float]:
    """Lines of a bundle through the bounding sphere, or of a vertical one through a period, for the default mean number
    per patch, and their limit."""
    sparse = 2 * np.pi * patches.sphere[1] ** 2 / patches.areas.sum()
    if patches.period is not None:
        sparse = 1 / PeriodicBundles(patches, 1.0).expected(patches.areas, 1).sum()
    return max(LINES_PER_PATCH * sparse * len(patches), _FEWEST), max(_MOST, _MOST_PER_PATCH * len(patches))
