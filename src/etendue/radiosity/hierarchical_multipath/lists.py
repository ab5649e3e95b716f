"""The preprocess: lines through every distinct part, stored as lists of their hits [Castro 2002, sec. 5.3.3]."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, in_order
from etendue.points import PointSet
from etendue.surfaces import REACH_OF_PAIRS, box_tree, is_interior

from ..compiling import compiled
from ..errors import RadiosityError
from ..lines.generators import GENERATORS, BoxWalls, LineGenerator, box_lines
from .parts import Part
from .regions import Regions

Index = NDArray[np.int64]

#: Number of lines that are cast together.
_BLOCK = 1 << 15
#: Points for a part, by its index among the distinct parts.
PointsOf = Callable[[int], PointSet]


class Transmits(Protocol):
    """The data of a part that the part around its copies needs."""

    @property
    def transmittance(self) -> Array:
        """(r,) share of the light through each region of the box that meets nothing inside."""
        ...


class PartRays:
    """A part in arrays for the compiled loops: a tree over its primitives, and the matrices into its copies.

    generator: the name of that of the lines. ``surface`` is the area of the convex body that it takes them from."""

    def __init__(self, part: Part, generator: str = BoxWalls.name) -> None:
        self.part = part
        self.own = np.stack(part.bounds)
        self.size = float(np.linalg.norm(self.own[1] - self.own[0]))
        self._generator: LineGenerator | None = None
        self.surface = part.box_area
        if generator != BoxWalls.name:
            self._generator = GENERATORS[generator](sphere=(self.own.mean(axis=0), self.size / 2))
            self.surface = self._generator.surface
        patches, children = part.patches, part.children
        self.faces = np.zeros((0, 4, 3))
        self.normals = np.zeros((0, 3)) if patches is None else patches.face_normals
        self.sides = np.zeros((0, 2), dtype=np.int64)
        #: Which faces lie back to back, the largest distance of two of them, and whether faces bound a room.
        self.coincident = np.zeros(0, np.uint8), 0.0, False
        if patches is not None:
            patches.coincident.warn(patches)
            vertices, faces = patches.coincident.apart(patches)
            self.faces = np.ascontiguousarray(vertices[faces])
            self.coincident = patches.coincident.kinds, REACH_OF_PAIRS * patches.sphere[1], is_interior(patches)
            self.sides = patches.sides
        self.boxes = np.array([np.stack(child.bounds) for child, _ in children]).reshape(-1, 2, 3)
        self.matrices = np.array([np.linalg.inv(matrix)[:3] for _, matrix in children]).reshape(-1, 3, 4)
        low, high = [self.faces.min(axis=1)], [self.faces.max(axis=1)]
        for child, matrix in children:
            ends = np.stack(child.bounds)
            points = np.array([[ends[k >> a & 1][a] for a in range(3)] for k in range(8)])
            placed = points @ matrix[:3, :3].T + matrix[:3, 3]
            low.append(placed.min(axis=0)[None])
            high.append(placed.max(axis=0)[None])
        self.corners, self.links, self.order, self.depth = box_tree(np.concatenate(low), np.concatenate(high))

    def lines(self, u: Array) -> tuple[Array, Array]:
        """Origins and directions of the lines of points (n, 4)."""
        if self._generator is None:
            return box_lines(u, *self.own)
        made = self._generator.lines(u)
        return made.origins, made.directions


@dataclass(frozen=True)
class Lists:
    """Stretches of lines through a part; see :func:`.casting.lists`, which makes them.

    ``lines``: number of lines, from a convex body with the area ``surface``.
    ``ends``: (k, 2); ``begins``: (k + 1,) into ``crossings``: (x, 2); both ``None`` without crossings.
    ``transmittance``: (r,) of the regions of the part's own box. ``counted``: (n,) number of stretch ends at each
    patch. For the regions of the own box: ``through`` (r,), the number of lines, and ``hitting`` (r,), the number of
    these that hit something, with fractions from boxes that transmit light. ``child_lines``: (children * r,) lines
    through each region of each child. ``firsts``: (y, 2) region, and the face that a line entering there hits
    first.
    """

    part: Part
    regions: Regions
    lines: int
    surface: float
    ends: NDArray[np.int32]
    begins: Index | None
    crossings: NDArray[np.int32] | None
    transmittance: Array
    counted: Index
    through: Array
    hitting: Array
    child_lines: Index
    child_transmittance: Array
    firsts: NDArray[np.int32]

    @property
    def nbytes(self) -> int:
        """Memory of the lists."""
        more = 0 if self.begins is None or self.crossings is None else self.begins.nbytes + self.crossings.nbytes
        return self.ends.nbytes + more

    @cached_property
    def donors(self) -> Index:
        """(r,) the region through which the light that arrives at each region enters; see :meth:`Regions.donors`."""
        return self.regions.donors(self.hitting)

    @cached_property
    def child_donors(self) -> Index:
        """(children * r,) the region of the same child from which the light that leaves each region continues."""
        rows = self.child_lines.reshape(-1, len(self.regions))
        found = [self.regions.donors(row.astype(float)) + k * len(self.regions) for k, row in enumerate(rows)]
        return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)

    @cached_property
    def polygons(self) -> dict[int, Index]:
        """Faces associated with each region, in descending order of the number of lines that hit them first."""
        if len(self.firsts) == 0:
            return {}
        pairs, count = np.unique(self.firsts, axis=0, return_counts=True)
        order = np.lexsort((-count, pairs[:, 0]))
        region, start = np.unique(pairs[order, 0], return_index=True)
        return dict(zip(region.tolist(), np.split(pairs[order, 1].astype(np.int64), start[1:]), strict=True))


def preprocess(
    rays: Mapping[Part, PartRays], root: Part, lines: Mapping[Part, int], regions: Regions, points: PointsOf, first: int
) -> dict[Part, Lists]:
    """Lists of ``lines`` of every distinct part, inner parts first: the parts around them need their transmittances.

    ``first``: index of the first point of each part, in units of its number of lines. Raises :class:`RadiosityError`
    for a line with too many hits, and for a copy that no line of the part around it crosses.
    """
    made: dict[Part, Lists] = {}
    for number, part in enumerate(root.distinct):
        count = lines[part]
        made[part] = lists_of(rays[part], part is root, count, regions, made, points(number), first * count)
    return made


def lists_of(
    rays: PartRays,
    is_root: bool,
    count: int,
    regions: Regions,
    inner: Mapping[Part, Transmits],
    points: PointSet,
    first: int,
) -> Lists:
    """Lists of ``count`` lines of one part, by points from ``first`` on. ``inner``: data of the parts of its copies.
    Raises the errors of :func:`preprocess`."""
    part, n = rays.part, len(rays.part)
    transmittances = np.array([inner[child].transmittance for child, _ in part.children]).ravel()
    resolution = np.array([regions.grid, regions.around, regions.up, n])
    tree = rays.corners, rays.links, rays.order
    known = *tree, rays.faces, rays.normals, rays.sides, *rays.coincident, rays.boxes, rays.matrices

    def cast(start: int) -> Any:
        u = points.block(min(_BLOCK, count - start), first + start)
        return _loops().lists(*rays.lines(u), *known, transmittances, rays.own, resolution, rays.size, is_root)

    blocks = list(in_order(partial(cast, start) for start in range(0, count, _BLOCK)))
    if any(block[-1] for block in blocks):
        raise RadiosityError("a line through a part meets more than 4096 faces; are they in each other's place?")
    ends = np.concatenate([block[0] for block in blocks])
    crossings = np.concatenate([block[2] for block in blocks])
    through, passed = (np.sum([block[k] for block in blocks], axis=0) for k in (3, 4))
    begins = None
    if len(crossings):
        shifts = np.cumsum([0, *(len(block[2]) for block in blocks)])
        begins = np.concatenate(
            [*(block[1][:-1] + shift for block, shift in zip(blocks, shifts, strict=False)), shifts[-1:]]
        )
    child_lines = np.bincount(crossings.ravel(), minlength=len(part.children) * len(regions))
    for k, row in enumerate(child_lines.reshape(-1, len(regions))):
        if not row.any():
            raise RadiosityError(f"no line crosses the box of copy {k} of {len(part.children)}: set more lines")
    share = np.divide(passed, through, out=np.zeros(len(regions)), where=through > 0)
    return Lists(
        part=part,
        regions=regions,
        lines=count,
        surface=rays.surface,
        ends=ends,
        begins=begins,
        crossings=crossings if len(crossings) else None,
        transmittance=regions.interpolated(share, through > 0),
        counted=np.bincount(ends.ravel(), minlength=n + 2)[:n],
        through=through,
        hitting=np.maximum(through - passed, 0),
        child_lines=child_lines,
        child_transmittance=transmittances,
        firsts=np.concatenate([block[5] for block in blocks]),
    )


def _loops() -> Any:
    return compiled("hierarchical_multipath.casting")
