"""Light paths in a scene that is cut into boxes: a process has the shapes of one box, and a path that leaves the box
becomes a record for the process of the next box.

A ray is traced against the shapes that touch its box. A hit inside the box is also the hit in the whole scene, since
the ray has crossed all boxes before without a hit. Without a hit, the unchanged ray continues in the box behind the
face by which it leaves. Random numbers depend on the path and the vertex only, so the particles are those of the
undivided scene. This applies the parameterisation of paths by voxels of [Leeson 2001, sec. 5.6.4] to whole boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array, OptionError, SampleSource, copied_to_device, is_whole
from etendue.points import MixedRadix
from etendue.transport import SubPath, WalkVertex

from .walk import LightPath, ParticleStore, ParticleWalk

#: Words of the record of a path.
RECORD_WORDS = 16
#: A shape touches a box at less than this distance, relative to the scene's size plus largest coordinate: rays start at
#: an offset from surfaces, and hits are rounded.
_MARGIN = 1e-4
_FAR = 3.4e38


@dataclass(frozen=True)
class BoxGrid:
    """A scene cut by planes perpendicular to the axes. The number of a box is its code in :attr:`codes`; boxes at the
    border extend to infinity. planes: the inner planes of each axis, ascending."""

    planes: tuple[tuple[float, ...], ...]

    @staticmethod
    def check_counts(counts: Sequence[int]) -> None:
        """Raise :class:`OptionError` unless these are numbers of boxes along x, y and z."""
        if len(counts) != 3 or not all(is_whole(n) and 1 <= n <= 64 for n in counts):
            raise OptionError(f"a scene is cut into three whole numbers of boxes from 1 to 64, not {counts}")

    @classmethod
    def even(cls, boxes: Array, counts: tuple[int, int, int]) -> BoxGrid:
        """Cuts of equal widths through shapes with the bounding ``boxes`` (n, 6). Raises :class:`OptionError`."""
        cls.check_counts(counts)
        lower, upper = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)
        return cls(
            tuple(
                tuple(float(np.float32(a + (b - a) * k / n)) for k in range(1, n))
                for a, b, n in zip(lower, upper, counts, strict=True)
            )
        )

    @property
    def codes(self) -> MixedRadix:
        """The numbers of boxes."""
        return MixedRadix(tuple(len(planes) + 1 for planes in self.planes))

    def __len__(self) -> int:
        return len(self.codes)

    def bounds(self, code: int) -> NDArray[np.float32]:
        """(2, 3): lower and upper corner of a box."""
        found = np.full((2, 3), [[-_FAR], [_FAR]], np.float32)
        for axis, digit in enumerate(self.codes.digits(code)):
            planes = self.planes[axis]
            if digit > 0:
                found[0, axis] = planes[digit - 1]
            if digit < len(planes):
                found[1, axis] = planes[digit]
        return found

    def touching(self, code: int, boxes: Array) -> NDArray[np.int64]:
        """Indices of the shapes with the bounding ``boxes`` (n, 6) that touch a box."""
        lower, upper = self.bounds(code).astype(np.float64)
        size = float(np.linalg.norm(boxes[:, 3:].max(axis=0) - boxes[:, :3].min(axis=0)))
        margin = _MARGIN * (size + float(np.abs(boxes).max()))
        return np.flatnonzero(((boxes[:, :3] <= upper + margin) & (boxes[:, 3:] >= lower - margin)).all(axis=1))

    def of_points(self, points: ArrayLike) -> NDArray[np.int64]:
        """The boxes of points (n, 3)."""
        rows = np.asarray(points, np.float32)
        places = [np.searchsorted(np.array(p, np.float32), rows[:, k], "right") for k, p in enumerate(self.planes)]
        return np.asarray(self.codes.code(places), np.int64)

    def of_points_on_device(self, p: mi.Point3f) -> mi.UInt32:
        """The boxes of points, one lane each."""
        code, unit = mi.UInt32(0), 1
        for x, planes, count in zip((p.x, p.y, p.z), self.planes, self.codes.counts, strict=True):
            for plane in planes:
                code += dr.select(x >= plane, mi.UInt32(unit), mi.UInt32(0))
            unit *= count
        return code


@dataclass(kw_only=True)
class BoxedPath(LightPath):
    """Loop state of a path in a box."""

    number: mi.UInt32  #: of the path in its pass


class PathStore:
    """Records of at most ``capacity`` paths that leave a box, in device memory."""

    def __init__(self, capacity: int) -> None:
        self._data = dr.empty(mi.Float, RECORD_WORDS * max(capacity, 1))
        self._count = dr.zeros(mi.UInt32, 1)

    def append(self, s: BoxedPath, box: mi.UInt32, active: mi.Bool) -> None:
        """Store paths that continue in ``box``, inside the walk. A path leaves a box once, so there is room for all."""
        slot = dr.scatter_inc(self._count, mi.UInt32(0), active)
        for k, packet in enumerate(_packets(s, box)):
            dr.scatter(self._data, packet, slot * (RECORD_WORDS // 4) + k, active)

    def launch(self) -> None:
        """Schedule the kernel."""
        dr.schedule(self._data, self._count)

    def rows(self) -> NDArray[np.uint32]:
        """(n, ``RECORD_WORDS``), in the order of paths."""
        rows = np.asarray(self._data).view(np.uint32).reshape(-1, RECORD_WORDS)[: int(self._count[0])]
        return np.ascontiguousarray(rows[np.argsort(rows[:, 0], kind="stable")])


def _packets(s: BoxedPath, box: mi.UInt32) -> list[mi.Vector4f]:
    """The words of records, four at a time."""
    o, d, w = s.ray.o, s.ray.d, s.throughput
    met = dr.select(s.met, mi.UInt32(1), mi.UInt32(0))
    return [
        mi.Vector4f(_bits(s.number), _bits(box), _bits(s.depth), _bits(s.bounce)),
        mi.Vector4f(o.x, o.y, o.z, d.x),
        mi.Vector4f(d.y, d.z, w.x, w.y),
        mi.Vector4f(w.z, s.travelled, _bits(met), 0.0),
    ]


def paths_of(rows: NDArray[np.uint32]) -> BoxedPath:
    """The paths of records, one lane each."""

    def word(k: int) -> mi.UInt32:
        return copied_to_device(mi.UInt32, np.ascontiguousarray(rows[:, k]))

    def number(k: int) -> mi.Float:
        return copied_to_device(mi.Float, np.ascontiguousarray(rows[:, k]).view(np.float32))

    count = len(rows)
    return BoxedPath(
        active=dr.full(mi.Bool, True, count),
        ray=mi.Ray3f(mi.Point3f(*map(number, (4, 5, 6))), mi.Vector3f(*map(number, (7, 8, 9)))),
        throughput=mi.Color3f(*map(number, (10, 11, 12))),
        eta=None,
        depth=word(2),
        travelled=number(13),
        rays=dr.zeros(mi.UInt32, count),
        bounce=word(3),
        met=word(14) != 0,
        nonfinite=dr.zeros(mi.UInt32, count),
        number=word(0),
    )


@dataclass(kw_only=True)
class BoxWalk(ParticleWalk):
    """Traces light paths as long as they stay in one box."""

    grid: BoxGrid
    box: int

    def __post_init__(self) -> None:
        # Opaque, so that all boxes share the kernel.
        bounds = self.grid.bounds(self.box)
        self._lower, self._upper = (mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in row)) for row in bounds)
        self._code = dr.opaque(mi.UInt32, self.box)
        self._leaving: PathStore | None = None
        # Set by `arrive` for `_edge`: whether the current edge leaves the box, and into which box.
        self._crossing, self._behind = mi.Bool(False), mi.UInt32(0)

    def carry(
        self, rows: NDArray[np.uint32], source: SampleSource, store: ParticleStore
    ) -> tuple[BoxedPath, PathStore]:
        """Trace the paths of records until they end or leave the box: (their state at the end, records of those that
        leave), not yet evaluated."""
        path = paths_of(rows)
        self._leaving = leaving = PathStore(len(rows))
        path = self.follow(path, source, path.number, store)  # type: ignore[assignment]
        return path, leaving

    def emitted(self, paths: int, source: SampleSource, number: mi.UInt32) -> NDArray[np.uint32]:
        """Records of light paths before their first edge."""
        start = self.start(paths, source)
        known = {field.name: getattr(start, field.name) for field in fields(LightPath)}
        path = BoxedPath(**known, number=number)
        packets = _packets(path, self.grid.of_points_on_device(start.ray.o))
        active = mi.Bool(start.active)
        dr.eval(packets, active)
        words = [np.broadcast_to(np.asarray(x), (paths,)) for packet in packets for x in packet]
        rows = np.stack(words, axis=1).astype(np.float32, copy=False).view(np.uint32)
        return np.ascontiguousarray(rows[np.broadcast_to(np.asarray(active), (paths,))])

    def arrive(self, s: SubPath, source: SampleSource | None = None) -> WalkVertex:
        """Trace the next edge within the box."""
        vertex = super().arrive(s, source)
        end, self._behind = self._exit(s.ray)
        inside = vertex.valid & (vertex.si.t <= end)
        self._crossing = s.active & ~inside & (end < dr.inf)
        vertex.valid = inside
        return vertex

    def _edge(self, s: LightPath, number: mi.UInt32, source: SampleSource, store: ParticleStore) -> LightPath:
        assert isinstance(s, BoxedPath) and self._leaving is not None
        before = replace(s)
        s = super()._edge(s, number, source, store)
        assert isinstance(s, BoxedPath)
        # A ray starts at an offset from the surface, perhaps in a neighbouring box.
        start = self.grid.of_points_on_device(s.ray.o)
        away = s.active & (start != self._code)
        s.active &= ~away
        # Both kinds are stored by one call: a loop may increment the counter at one place only.
        crossing = self._crossing
        self._leaving.append(dr.select(crossing, before, s), dr.select(crossing, self._behind, start), crossing | away)
        return s

    def _exit(self, ray: mi.Ray3f) -> tuple[mi.Float, mi.UInt32]:
        """(distance at which rays leave the box, infinite at the border of the scene; the box behind it)."""
        end, behind, unit = mi.Float(dr.inf), mi.UInt32(self._code), 1
        for axis, count in enumerate(self.grid.codes.counts):
            o, d = ray.o[axis], ray.d[axis]
            ahead, back = self._upper[axis], self._lower[axis]
            t = dr.select(d > 0.0, (ahead - o) / d, dr.select(d < 0.0, (back - o) / d, dr.inf))
            border = dr.select(d > 0.0, ahead >= _FAR, back <= -_FAR)
            t = dr.select(border, dr.inf, dr.maximum(t, 0.0))
            nearer = t < end
            step = dr.select(d > 0.0, self._code + unit, self._code - unit)
            behind = dr.select(nearer, step, behind)
            end = dr.select(nearer, t, end)
            unit *= count
        return end, behind


def _bits(value: mi.UInt32) -> mi.Float:
    return dr.reinterpret_array(mi.Float, value)
