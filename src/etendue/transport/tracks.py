"""Paths recorded vertex by vertex, for pictures of paths: through a point of the film, or from a light.

They are traced edge by edge, with the same operations as in every path method, and with independent random numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import IndependentSource, OptionError, SampleSource
from etendue.scene import LightTable, Problem

from . import dimensions as dim
from .camera import CameraSampler
from .emission import emit
from .scattering import scatter_light
from .visibility import Visibility
from .walk import CameraPath, SubPath, Walker

#: Most paths, and most edges of a path, that are recorded.
MOST_PATHS = 1 << 16
MOST_EDGES = 64
#: Number of the vertex from which on a path may end by Russian roulette.
_ROULETTE = 5


class Event(IntEnum):
    """What happens at a vertex."""

    NONE = 0  #: there is no vertex
    START = 1  #: on the aperture, or on a light
    SCATTERED = 2  #: by a component without delta functions
    REFLECTED = 3  #: by a mirror
    REFRACTED = 4  #: by smooth glass
    PASSED = 5  #: through a null surface
    ENDED = 6  #: absorbed, ended by roulette, or the last edge that was asked for
    LEFT = 7  #: the ray met nothing; the position is out of the scene


@dataclass(frozen=True)
class Tracks:
    """Recorded paths.

    Attributes
    ----------
    positions: (paths, vertices, 3) float32, in render space; NaN where there is no vertex.
    throughput: (paths, vertices, 3) float32, of the edge that ends at the vertex; at the first vertex, of the first
        edge. For a light path it is a flux in watts; divided by the number of paths, it is the flux of one path.
    events: (paths, vertices) int8, see :class:`Event`.
    smooth: (paths, vertices), whether the surface there has a component without delta functions, so that a light path
        leaves a photon.
    emission: (paths, vertices, 3) float32, of a camera path: emitted radiance found at the vertex, times throughput.
    light: (paths, vertices, 3) float32, of a camera path: the light point sampled at the vertex by next event; NaN
        where there is none, or it is occluded.
    direct: (paths, vertices, 3) float32, contribution of that point, without weights against other techniques.
    """

    positions: NDArray[np.float32]
    throughput: NDArray[np.float32]
    events: NDArray[np.int8]
    smooth: NDArray[np.bool_]
    emission: NDArray[np.float32]
    light: NDArray[np.float32]
    direct: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.events)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """(paths,) edges of each path."""
        return np.asarray((self.events != Event.NONE).sum(axis=1) - 1)


class PathRecorder:
    """Records paths in one scene, with its lights and geometry at the time of construction.

    max_depth: longest path in edges, as of methods; -1: as long as :data:`MOST_EDGES`.
    """

    def __init__(self, problem: Problem, max_depth: int = -1) -> None:
        self._problem = problem
        self._most = MOST_EDGES if max_depth < 0 else min(max_depth, MOST_EDGES)
        self._lights = LightTable(problem.scene)
        self._visibility = Visibility(problem.scene)
        self._edges = dr.opaque(mi.UInt32, self._most)

    def look(self, problem: Problem) -> None:
        """Take the sensor of ``problem``, whose scene must be the same."""
        self._problem = problem

    def from_camera(self, x: float, y: float, paths: int, seed: int = 0, spread: float = 1.0) -> Tracks:
        """Camera paths through the film around the place (x, y) in pixels, uniform over a square of side ``spread``.
        Raises :class:`OptionError` for a place off the film, or too many paths."""
        width, height = self._problem.size
        if not (0.0 <= x <= width and 0.0 <= y <= height):
            raise OptionError(f"({x:g}, {y:g}) is off the film of {width}x{height} pixels")
        source = self._source(paths, seed)
        u = source.next_2d(0, dim.FILM)
        place = mi.Point2f(x + spread * (u[0] - 0.5), y + spread * (u[1] - 0.5))
        ray, weight, _ = CameraSampler(self._problem, True).through(place, source)
        walker = Walker(visibility=self._visibility, lights=self._lights, max_edges=self._edges, rr_depth=_ROULETTE)
        active = dr.full(mi.Bool, self._most > 0, paths)
        path = CameraPath.start(ray, self._edges, active=active, throughput=mi.Color3f(weight))
        return self._record(walker, path, source, paths)

    def from_light(self, light: int | None, paths: int, seed: int = 0) -> Tracks:
        """Light paths from the light with a number in ``scene.emitters()``; ``None``: from all, by power. Raises
        :class:`OptionError` for an unknown light, one that emits nothing, or too many paths."""
        if light is not None and not 0 <= light < self._lights.count:
            raise OptionError(f"the scene has no light {light}; choose one of 0 to {self._lights.count - 1}")
        share, power = 1.0, self._lights.total_power
        if light is not None:
            share, power = float(self._lights.probabilities[light]), float(self._lights.powers[light]) or 1.0
        if share == 0.0:
            raise OptionError(f"light {light} of the scene emits nothing; choose another")
        source = self._source(paths, seed)
        if light is not None:
            source = _FromLight(source, self._lights, light)
        emitted = emit(self._lights, source, dr.full(mi.Bool, True, paths))
        path = SubPath(
            active=emitted.active & (self._most > 0),
            ray=emitted.ray,
            throughput=emitted.throughput * share,
            eta=None,
            depth=dr.full(mi.UInt32, 1, paths),
            travelled=mi.Float(0.0),
            rays=dr.zeros(mi.UInt32, paths),
        )
        walker = Walker(
            visibility=self._visibility,
            lights=self._lights,
            max_edges=self._edges,
            rr_depth=_ROULETTE,
            proposal=scatter_light,
        )
        return self._record(walker, path, source, paths, power)

    def _source(self, paths: int, seed: int) -> SampleSource:
        if not 1 <= paths <= MOST_PATHS:
            raise OptionError(f"1 to {MOST_PATHS} paths can be recorded, not {paths}")
        return IndependentSource(dr.arange(mi.UInt32, paths), seed, "tracks", 0)

    def _record(
        self, walker: Walker, path: CameraPath | SubPath, source: SampleSource, paths: int, power: float = 1.0
    ) -> Tracks:
        """Walk edge by edge, with the same kernel for all edges. ``power``: of the lights where light paths begin, with
        which roulette compares their throughput."""
        whole = dr.opaque(mi.Float, power)
        camera = isinstance(path, CameraPath)
        first = dr.select(path.active, mi.UInt32(Event.START), mi.UInt32(Event.NONE))
        columns = [_column(path.ray.o, path.throughput, first, paths)]
        # Values that Dr.Jit knows, such as the number of the edge, would make each edge a kernel of its own.
        dr.make_opaque(path)
        while len(columns) <= self._most and dr.any(path.active):
            was_active, before = mi.Bool(path.active), mi.Color3f(path.throughput)
            vertex = walker.arrive(path)
            emission, light, direct = mi.Color3f(0.0), mi.Point3f(dr.nan), mi.Color3f(0.0)
            at_surface = was_active & vertex.valid
            if camera:
                found = walker.emission(path, vertex)
                emission = dr.select(found.active, before * found.radiance, 0.0)
                point = walker.light_point(vertex, source, at_surface & vertex.smooth & (path.depth < self._edges))
                scattered, (f,) = vertex.sample(source, at_surface, [point])
                reached, visible = walker.next_event(path, vertex, point, f, mi.Float(1.0))
                shown = visible & ~dr.all(reached == 0.0)
                light, direct = dr.select(shown, point.target, light), dr.select(shown, reached, 0.0)
            else:
                scattered, _ = vertex.sample(source, at_surface)
            outside = path.ray.o + path.ray.d * (0.5 * self._lights.bound.w)
            position = dr.select(vertex.valid, vertex.position, outside)
            side = dr.dot(scattered.direction, vertex.si.n) * dr.dot(vertex.incoming, vertex.si.n)
            kind = dr.select(side > 0.0, mi.UInt32(Event.REFRACTED), mi.UInt32(Event.REFLECTED))
            kind = dr.select(scattered.is_delta, kind, mi.UInt32(Event.SCATTERED))
            kind = dr.select(scattered.is_null, mi.UInt32(Event.PASSED), kind)
            path.active &= vertex.valid & (vertex.number < self._edges)
            relative = None if camera else (path.throughput * scattered.weight / whole, mi.Float(1.0))
            walker.advance(path, vertex, scattered, source, roulette_by=relative)
            kind = dr.select(path.active, kind, mi.UInt32(Event.ENDED))
            kind = dr.select(vertex.valid, kind, mi.UInt32(Event.LEFT))
            kind = dr.select(was_active, kind, mi.UInt32(Event.NONE))
            smooth = at_surface & vertex.smooth
            columns.append(_column(position, before, kind, paths, smooth, emission, light, direct, path))
        return _joined(columns)


class _FromLight:
    """Random numbers of ``source`` that always pick the same light."""

    def __init__(self, source: SampleSource, lights: LightTable, light: int) -> None:
        self._source = source
        self._number = lights.number_of(dr.opaque(mi.UInt32, light))

    def next_1d(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        if component == dim.LIGHT_PICK and isinstance(vertex, int) and vertex == 0:
            return self._number
        return self._source.next_1d(vertex, component)

    def next_2d(self, vertex: mi.UInt32 | int, component: int) -> tuple[mi.Float, mi.Float]:
        """See :class:`SampleSource`."""
        return self._source.next_2d(vertex, component)

    def decide(self, vertex: mi.UInt32 | int, component: int) -> mi.Float:
        """See :class:`SampleSource`."""
        return self._source.decide(vertex, component)


_Column = tuple[NDArray[np.float32], NDArray[np.int8], NDArray[np.bool_]]


def _column(
    position: mi.Point3f,
    throughput: mi.Color3f,
    event: mi.UInt32,
    paths: int,
    smooth: mi.Bool | bool = False,
    emission: mi.Color3f | float = 0.0,
    light: mi.Point3f | float = float("nan"),
    direct: mi.Color3f | float = 0.0,
    state: Any = None,
) -> _Column:
    """The vertex of each path, on the host: (paths, 5, 3) numbers, (paths,) events, (paths,) smooth. ``state`` of the
    paths is evaluated by the same kernel."""
    held = event != mi.UInt32(Event.NONE)
    parts = [dr.select(held, position, dr.nan), dr.select(held, throughput, 0.0)]
    parts += [mi.Color3f(emission), mi.Point3f(light), mi.Color3f(direct)]
    parts = [part + dr.zeros(type(part), paths) for part in parts]
    smooth = mi.Bool(smooth) & dr.full(mi.Bool, True, paths)
    dr.make_opaque(parts, event, smooth, state)
    numbers = np.stack([np.array(part, dtype=np.float32).T for part in parts], axis=1)
    events = np.broadcast_to(np.array(event), (paths,)).astype(np.int8)
    return numbers, events, np.array(smooth)


def _joined(columns: list[_Column]) -> Tracks:
    numbers = np.stack([column for column, _, _ in columns], axis=1)
    positions, throughput, emission, light, direct = (np.ascontiguousarray(numbers[:, :, i]) for i in range(5))
    events = np.stack([event for _, event, _ in columns], axis=1)
    smooth = np.stack([flag for _, _, flag in columns], axis=1)
    return Tracks(positions, throughput, events, smooth, emission, light, direct)
