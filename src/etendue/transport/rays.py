"""Rays that walks trace and test, recorded inside the walks of a method, for pictures of rays.

A walk with a :class:`WalkRecorder` writes every edge that it traces, and the edges by which it joins a vertex to a
light point, to a light vertex or to the sensor. It is otherwise the walk of the picture, with the same random numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import Packet

if TYPE_CHECKING:
    from .scattering import Scattered
    from .vertex import WalkVertex
    from .walk import SubPath

#: Most edges that are recorded; further ones are counted.
MOST_EDGES = 1 << 20
#: Packets of four words per edge: start, tag; end, path; value, light path.
_PACKETS = 3


class Edge(IntEnum):
    """Kind of an edge."""

    CAMERA = 0  #: of a camera path
    LIGHT = 1  #: of a light path
    NEXT_EVENT = 2  #: from a vertex to a light point that it sees
    CONNECTION = 3  #: from a vertex of a camera path to one of a light path
    MERGE = 4  #: from a vertex of a camera path to a photon that is merged with it
    SPLAT = 5  #: from a vertex of a light path to the sensor


class Event(IntEnum):
    """What happens at the end of an edge of a path."""

    NONE = 0  #: the edge joins two vertices
    SCATTERED = 2  #: by a component without delta functions
    REFLECTED = 3  #: by a mirror
    REFRACTED = 4  #: by smooth glass
    PASSED = 5  #: through a null surface
    ENDED = 6  #: absorbed, ended by roulette or by the method, or the last edge that was asked for
    LEFT = 7  #: the ray met nothing; the end is out of the scene
    GUIDED = 8  #: scattered in a direction of the guide


@dataclass(frozen=True)
class Rays:
    """Recorded edges, in the order of kind, path and number.

    Attributes
    ----------
    kind: (edges,) uint8, see :class:`Edge`.
    event: (edges,) uint8, see :class:`Event`.
    smooth: (edges,), whether the edge of a path ends at a surface with a component without delta functions, so that a
        light path leaves a photon.
    number: (edges,) uint16, number of the edge in its path, from 1; for a join, of the edge that ends at the vertex.
    path: (edges,) uint32, number of the path; 0 for a splat.
    light: (edges,) uint32, for connections, merges and splats the number of the light path.
    start, end: (edges, 3) float32, in render space.
    value: (edges, 3) float32, throughput of the edge of a path, for a light path a flux in watts which over the number
        of paths is that of one path; for a join its contribution, with the weights of the method.
    """

    kind: NDArray[np.uint8]
    event: NDArray[np.uint8]
    smooth: NDArray[np.bool_]
    number: NDArray[np.uint16]
    path: NDArray[np.uint32]
    light: NDArray[np.uint32]
    start: NDArray[np.float32]
    end: NDArray[np.float32]
    value: NDArray[np.float32]
    dropped: int = 0  #: edges beyond :data:`MOST_EDGES`

    def __len__(self) -> int:
        return len(self.kind)

    def __getitem__(self, chosen: NDArray[np.bool_ | np.intp]) -> Rays:
        """The edges where a mask holds, or with these indices."""
        arrays = {name: value[chosen] for name, value in vars(self).items() if name != "dropped"}
        return Rays(**arrays, dropped=self.dropped)

    def of(self, *kinds: Edge) -> Rays:
        """The edges of some kinds."""
        return self[np.isin(self.kind, kinds)]


class _Sheet:
    """Edges that one operation of a walk writes, in an order that is not repeatable. Operations cannot share a sheet:
    within a loop, Dr.Jit increments a counter in one place only."""

    def __init__(self, capacity: int, packet: Packet) -> None:
        self.capacity, self._packet = capacity, packet
        self.wanted = dr.opaque(mi.UInt32, 0, 1)  # edges, also those beyond the capacity
        self._limit = dr.opaque(mi.UInt32, capacity)
        self._words = dr.empty(mi.Float, 4 * _PACKETS * capacity)

    def put(
        self,
        tag: mi.UInt32,
        ends: tuple[mi.Point3f, mi.Point3f],
        value: mi.Spectrum,
        owners: tuple[mi.UInt32, mi.UInt32],
        active: mi.Bool,
    ) -> mi.UInt32:
        """Write an edge per active lane; returns its slot. ``owners``: path, and light path that it was joined to."""
        slot = dr.scatter_inc(self.wanted, mi.UInt32(0), active)
        for packet, (vector, word) in enumerate(zip((*ends, self._packet.rgb(value)), (tag, *owners), strict=True)):
            row = mi.Vector4f(vector.x, vector.y, vector.z, dr.reinterpret_array(mi.Float, word))
            dr.scatter(self._words, row, slot * _PACKETS + packet, active & (slot < self._limit))
        return slot

    def change(self, slot: mi.UInt32, tag: mi.UInt32, active: mi.Bool) -> None:
        """Write the tag of an edge again."""
        word = dr.reinterpret_array(mi.Float, tag)
        dr.scatter(self._words, word, slot * (4 * _PACKETS) + 3, active & (slot < self._limit))

    def rows(self) -> NDArray[np.float32]:
        """(edges, 12) words."""
        count = min(int(self.wanted[0]), self.capacity)
        rows: NDArray[np.float32] = np.array(self._words, np.float32).reshape(-1, 4 * _PACKETS)[:count]
        return rows


class RayRecorder:
    """The edges of some walks; at most ``capacity`` of each operation are kept.

    reach: length of an edge that leaves the scene. packet: wavelengths of the walks.
    """

    def __init__(self, capacity: int, reach: float, packet: Packet) -> None:
        self._capacity, self.reach, self._packet = capacity, dr.opaque(mi.Float, reach), packet
        self._sheets: list[_Sheet] = []

    def sheet(self) -> _Sheet:
        """A new sheet, for an operation that is being traced."""
        self._sheets.append(_Sheet(self._capacity, self._packet))
        return self._sheets[-1]

    @property
    def wanted(self) -> int:
        """Most edges of an operation."""
        return max((int(sheet.wanted[0]) for sheet in self._sheets), default=0)

    def rays(self) -> Rays:
        """The edges so far."""
        rows = np.concatenate([np.empty((0, 4 * _PACKETS), np.float32), *(sheet.rows() for sheet in self._sheets)])
        tag, path, light = (rows[:, k].copy().view(np.uint32) for k in (3, 7, 11))
        found = Rays(
            kind=(tag & 15).astype(np.uint8),
            event=((tag >> 4) & 15).astype(np.uint8),
            smooth=(tag & 256) != 0,
            number=(tag >> 16).astype(np.uint16),
            path=path,
            light=light,
            start=rows[:, 0:3],
            end=rows[:, 4:7],
            value=rows[:, 8:11],
            dropped=sum(max(0, int(sheet.wanted[0]) - sheet.capacity) for sheet in self._sheets),
        )
        found = found[np.lexsort((found.light, found.number, found.path, found.kind))]
        key = np.stack([found.kind, found.path])
        last = np.append((key[:, 1:] != key[:, :-1]).any(axis=0), True)[: len(found)]
        found.event[last & (found.event != Event.NONE) & (found.event != Event.LEFT)] = Event.ENDED
        return found


class WalkRecorder:
    """Records the edges of one walk.

    Parameters
    ----------
    recorder: where the edges are written.
    kind: of the edges of the walk's paths; None to record only the edges that join.
    path: number of the path in each lane, if paths are recorded.
    film: centre (x, y) and half side, in pixels, of the square of the film whose splats are recorded.
    """

    def __init__(
        self,
        recorder: RayRecorder,
        kind: Edge | None,
        path: mi.UInt32 | int = 0,
        film: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self._recorder, self._kind, self._path = recorder, kind, mi.UInt32(path)
        self._film = [dr.opaque(mi.Float, number) for number in film]
        self._edge: tuple[_Sheet, mi.UInt32, mi.UInt32] | None = None  # that was traced last: sheet, slot, tag

    def arrived(self, s: SubPath, vertex: WalkVertex) -> None:
        """Record the edge of a path."""
        if self._kind is None:
            return
        end = dr.select(vertex.valid, vertex.position, s.ray.o + s.ray.d * self._recorder.reach)
        tag = mi.UInt32(int(self._kind)) | (vertex.number << 16)
        tag |= dr.select(vertex.valid & vertex.smooth, mi.UInt32(256), mi.UInt32(0))
        event = dr.select(vertex.valid, mi.UInt32(Event.SCATTERED), mi.UInt32(Event.LEFT))
        sheet, owners = self._recorder.sheet(), (self._path, mi.UInt32(0))
        slot = sheet.put(tag | (event << 4), (s.ray.o, end), s.throughput, owners, s.active)
        self._edge = sheet, slot, tag

    def scattered(self, vertex: WalkVertex, scattered: Scattered, active: mi.Bool) -> None:
        """Record how paths leave the vertex of :meth:`arrived`. Whether they go on is known at the end only."""
        if self._edge is None:
            return
        side = dr.dot(scattered.direction, vertex.si.n) * dr.dot(vertex.incoming, vertex.si.n)
        event = dr.select(side > 0.0, mi.UInt32(Event.REFRACTED), mi.UInt32(Event.REFLECTED))
        event = dr.select(scattered.is_delta, event, mi.UInt32(Event.SCATTERED))
        if scattered.by_guide is not None:
            event = dr.select(scattered.by_guide, mi.UInt32(Event.GUIDED), event)
        event = dr.select(scattered.is_null, mi.UInt32(Event.PASSED), event)
        sheet, slot, tag = self._edge
        sheet.change(slot, tag | (event << 4), active)
        self._edge = None

    def joined(
        self,
        kind: Edge,
        vertex: WalkVertex,
        target: mi.Point3f,
        value: mi.Spectrum,
        active: mi.Bool,
        light: mi.UInt32 | int = 0,
    ) -> None:
        """Record an edge that joins a vertex to ``target``, where it contributes. ``light``: number of the light
        path."""
        tag, owners = mi.UInt32(int(kind)) | (vertex.number << 16), (self._path, mi.UInt32(light))
        self._recorder.sheet().put(tag, (vertex.position, target), value, owners, active & ~dr.all(value == 0.0))

    def on_film(self, position: mi.Point2f) -> mi.Bool:
        """Whether a position on the film, in pixels, is in the square whose splats are recorded."""
        x, y, half = self._film
        return (dr.abs(position.x - x) <= half) & (dr.abs(position.y - y) <= half)


@dataclass
class Recording:
    """The recorders of a method's walks; None for walks that are not recorded."""

    camera: WalkRecorder | None = None
    light: WalkRecorder | None = None


def recorded(trace: Callable[[RayRecorder], object], capacity: int, reach: float, packet: Packet) -> Rays:
    """The edges that ``trace`` records; it is called again if there are more than ``capacity``."""
    while True:
        recorder = RayRecorder(capacity, reach, packet)
        trace(recorder)
        if recorder.wanted <= capacity or capacity >= MOST_EDGES:
            return recorder.rays()
        capacity = min(recorder.wanted + recorder.wanted // 8, MOST_EDGES)


def joined_to(rays: Rays, most: int) -> Sequence[int]:
    """Numbers of the light paths that were joined to camera paths or to the sensor, those that contribute most first;
    at most ``most``."""
    joins = rays.of(Edge.CONNECTION, Edge.MERGE, Edge.SPLAT)
    number, place = np.unique(joins.light, return_inverse=True)
    brought = np.bincount(place, np.abs(joins.value).sum(axis=1), minlength=len(number))
    found: list[int] = number[np.argsort(-brought, kind="stable")][:most].tolist()
    return found
