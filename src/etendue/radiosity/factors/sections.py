"""Exact form factors of surfaces without end along y: of the segments of their section."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from etendue.core import Array, free_memory, sparse
from etendue.surfaces import Patches, endless_faces

from ..compiling import compiled
from ..errors import RadiosityError
from ..lines.engine import warn_of_backs
from .formfactors import FormFactors, numbers_of

Index = NDArray[np.int64]

#: Points closer than this, in sizes of the section, are one; edges below may be of two neighbours whose ends are just
#: further apart; exchanges below are none; ends of a run.
_SAME, _SHORT, _NONE, _RUN = 1e-9, 1e-8, 1e-13, 16
#: The length, in sizes of the section, by which the exchange of a patch may differ from its own.
_BALANCE = 1e-6
#: Bytes for each pair of patches.
_BYTES = 40


@dataclass(frozen=True)
class Section:
    """The section of patches that go on without end along y, as segments that meet in their ends only.

    points: (v, 2) x and z, from the middle, in units of ``size``. edges: (e, 2). sides: (e, 2) the patches to the left
    and to the right, n for backs and obstacles. touching: (c, 3) two patches in contact and their length. length:
    of the period.
    """

    patches: Patches
    points: Array
    edges: Index
    sides: Index
    touching: Array
    size: float
    length: float

    @classmethod
    def of(cls, patches: Patches) -> Section | None:
        """``None`` unless the surfaces go on without end along y, as rectangles from end to end of the period.

        Raises :class:`RadiosityError` for faces on each other that face the same way."""
        faces = endless_faces(patches.vertices, patches.faces, patches.period)
        if faces is None or patches.period is None:
            return None
        flat = patches.vertices[faces[:, :2]][..., ::2]
        size = float(np.ptp(flat, axis=(0, 1)).max())
        begin, end, n = flat[:, 0], flat[:, 1], len(patches)
        left = np.stack([begin[:, 1] - end[:, 1], end[:, 0] - begin[:, 0]], axis=1)
        turned = (left * patches.face_normals[:, ::2]).sum(axis=1) < 0
        begin, end = (np.where(turned[:, None], b, a) for a, b in ((begin, end), (end, begin)))
        sides = np.stack([patches.front, patches.back], axis=1)
        middle = (flat.min(axis=(0, 1)) + flat.max(axis=(0, 1))) / 2
        points, edges, of = pieces((begin - middle) / size, (end - middle) / size)
        edges, sides, touching = _merged(patches, points, edges, np.where(sides < 0, n, sides)[of], of)
        return cls(patches, points, edges, sides, touching, size, patches.period[1])

    def form_factors(self) -> FormFactors:
        """Without error but rounding, below 1e-10 of the sum of a row. Raises :class:`RadiosityError` if points are so
        close that edges cross."""
        patches, n = self.patches, len(self.patches)
        exchange = self._room()
        self._add(0, len(self.points), exchange)
        i, j = self.touching[:, :2].astype(np.int64).T
        np.add.at(exchange, (i, j), self.touching[:, 2])
        both = exchange + exchange.T
        both = np.where(both < _NONE, 0.0, both) * self.size * self.length
        off = np.abs(both[:n].sum(axis=1) - patches.areas)
        if off.max() > _BALANCE * self.size * self.length:
            raise RadiosityError(
                f"what patch {off.argmax()} exchanges is not its area: corners closer than {_SHORT * self.size:.2g} "
                "are not told apart; merge them, or cast lines (method lines)"
            )
        shares = both[:n] / patches.divisors[:, None]
        matrix, dark, sky = sparse().csr_array(shares[:, :n]), shares[:, n], shares[:, n + 1]
        warn_of_backs(float(dark @ patches.areas / patches.areas.sum()), "of what patches see is")
        nothing = np.zeros(n, np.int64)
        return FormFactors(matrix, matrix * 0.0, sky, patches.areas, nothing, dark, **numbers_of(patches))

    def seconds(self) -> float:
        """The time that :meth:`form_factors` is going to take, from that of some ends."""
        exchange, total = self._room(), len(self.points)
        self._add(0, 1, exchange)  # loads or compiles
        began = time.perf_counter()
        self._add(0, min(_RUN, total), exchange)
        return (time.perf_counter() - began) * total / min(_RUN, total)

    def _add(self, first: int, last: int, exchange: Array) -> None:
        sky = len(self.patches) + 1
        compiled("factors.sightlines").exchange_of_ends(
            *(self.points, self.edges, self.sides, sky, first, last, exchange)
        )

    def _room(self) -> Array:
        n = len(self.patches) + 2
        need, free = _BYTES * n**2, free_memory()
        if free is not None and need > free:
            raise RadiosityError(
                f"form factors of {n - 2} patches need {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free: cast lines "
                "(method lines)"
            )
        return np.zeros((n, n))


def pieces(begin: Array, end: Array) -> tuple[Array, Index, Index]:
    """Points (v, 2), and the segments between them (e, 2) that given ones (k, 2) consist of, with the number of each:
    segments are divided where others cross them or end on them."""
    crossings = [_crossings(k, begin, end) for k in range(len(begin))]
    points = _distinct(np.concatenate([begin, end, *crossings]))
    edges, of = [], []
    for k, (a, b) in enumerate(zip(begin, end, strict=True)):
        along = b - a
        length = np.linalg.norm(along)
        place, off = (points - a) @ along / length, (points - a) @ (-along[1], along[0]) / length
        ours = np.flatnonzero((np.abs(off) <= 2 * _SAME) & (place >= -2 * _SAME) & (place <= length + 2 * _SAME))
        ours = ours[np.argsort(place[ours])]
        edges.append(np.stack([ours[:-1], ours[1:]], axis=1))
        of.append(np.full(len(ours) - 1, k))
    return points, np.concatenate(edges), np.concatenate(of)


def _crossings(k: int, begin: Array, end: Array) -> Array:
    """(m, 2) where later segments cross segment ``k`` between its ends and theirs."""
    a, along = begin[k], end[k] - begin[k]
    start, other = begin[k + 1 :] - a, end[k + 1 :] - begin[k + 1 :]
    across = along[0] * other[:, 1] - along[1] * other[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        here = (start[:, 0] * other[:, 1] - start[:, 1] * other[:, 0]) / across
        there = (start[:, 0] * along[1] - start[:, 1] * along[0]) / across
    met = np.abs(across) > 1e-12 * np.linalg.norm(along) * np.linalg.norm(other, axis=1)
    met &= (here > 0) & (here < 1) & (there > 0) & (there < 1)
    return np.asarray(a + here[met, None] * along)


def _distinct(points: Array) -> Array:
    """One of each group of points that are the same."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(_SAME, output_type="ndarray")
    kept = np.ones(len(points), bool)
    kept[pairs[:, 1]] = False  # the first of each pair is the one before
    return points[kept]


def _merged(patches: Patches, points: Array, edges: Index, sides: Index, of: Index) -> tuple[Index, Index, Array]:
    """One edge in each place, with the sides of all that lie there, and (e, 3) two patches in contact and their length:
    those that lie on each other between solids, as a box on the ground does."""
    n, turned = len(patches), edges[:, 0] > edges[:, 1]
    edges = np.where(turned[:, None], edges[:, ::-1], edges)
    sides = np.where(turned[:, None], sides[:, ::-1], sides)
    places, which = np.unique(edges, axis=0, return_inverse=True)
    merged, owner = np.full((len(places), 2), n), np.full((len(places), 2), -1)
    lengths = np.linalg.norm(points[places[:, 1]] - points[places[:, 0]], axis=1)
    for k, place in enumerate(which.reshape(-1)):
        for side in range(2):
            if sides[k, side] == n:
                continue
            if merged[place, side] < n:
                if lengths[place] < _SHORT:
                    continue
                raise RadiosityError(
                    f"faces {patches.numbers[owner[place, side]]} and {patches.numbers[of[k]]} lie on each other and "
                    "face the same way: remove one, or cut what it covers"
                )
            merged[place, side], owner[place, side] = sides[k, side], of[k]
    double = (owner >= 0).all(axis=1) & (owner[:, 0] != owner[:, 1])
    around, touching = _Regions(points, places), []
    for k in np.flatnonzero(double).tolist():
        if all(around.is_solid(k, side, merged == n, double) for side in range(2)):
            touching.append((*merged[k], lengths[k]))
            merged[k] = n
    return np.ascontiguousarray(places), merged, np.array(touching).reshape(-1, 3)


class _Regions:
    """The regions between edges, of which each edge has one to its left and one to its right."""

    def __init__(self, points: Array, edges: Index) -> None:
        self._edges = edges
        self._around: dict[int, list[tuple[float, int]]] = {}
        for k, (a, b) in enumerate(edges.tolist()):
            for one, other in ((a, b), (b, a)):
                x, y = points[other] - points[one]
                self._around.setdefault(one, []).append((float(np.arctan2(y, x)), k))
        for found in self._around.values():
            found.sort()

    def is_solid(self, edge: int, side: int, backs: NDArray[np.bool_], double: NDArray[np.bool_]) -> bool:
        """Whether the region beside an edge is within a solid: the next edge of its border that is not ``double`` shows
        its back."""
        at, start = int(self._edges[edge, 1 - side]), (edge, side)
        while True:
            found = self._around[at]
            place = next(k for k, (_, other) in enumerate(found) if other == edge)
            edge = found[place - 1][1]  # the next one clockwise
            side = int(self._edges[edge, 0] != at)
            at = int(self._edges[edge, 1 - side])
            if (edge, side) == start:
                return False
            if not double[edge]:
                return bool(backs[edge, side])
