"""The rays of a method: what a pass traces for one pixel, recorded by the walks of the method itself; and light paths.

The light paths of a pass are traced completely. Of these, the paths that were connected to or merged with the camera
paths of the pixel, or reach the sensor near it, are traced again and recorded edge by edge.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import drjit as dr
import mitsuba as mi

from etendue.core import IndependentSource, OptionError, SampleSource, on_device
from etendue.scene import LightTable, Problem
from etendue.transport import (
    Edge,
    RayRecorder,
    Rays,
    Recording,
    SubPath,
    Visibility,
    Walker,
    WalkRecorder,
    dimensions as dim,
    emit,
    joined_to,
    recorded,
    scatter_light,
)

from .base import ImageMethod

#: Most paths that are recorded.
MOST_RECORDED = 1 << 16
#: Longest light path of :class:`LightRays`, in edges, and the edge from which on it may end by Russian roulette.
_MOST_EDGES, _ROULETTE = 64, 5
#: Expected edges of a path, with those that join it to others; if there are more, the paths are traced again.
_EDGES = 24


@runtime_checkable
class ShowsRays(Protocol):
    """A method whose camera paths belong to pixels. The walkers of ``ImageMethod.walker`` are recorded."""

    def trace_through(self, lanes: mi.UInt32, samples: int, iteration: int, seed: int) -> None:
        """Trace what pass ``iteration`` would trace for the camera paths ``lanes``, if it had ``samples`` of them in
        each pixel: the paths of pixel i are numbered from i * ``samples`` on. Light paths are those of the pass."""
        ...


@runtime_checkable
class _HasLightPaths(Protocol):
    def trace_from_lights(self, number: mi.UInt32, iteration: int, seed: int) -> None:
        """Trace light paths of the latest :meth:`ShowsRays.trace_through` again, by their numbers, without storing or
        connecting their vertices."""
        ...


def rays_through(
    method: ImageMethod, x: float, y: float, paths: int, iteration: int = 0, seed: int = 0, near: float = 2.0
) -> Rays | None:
    """The rays of ``paths`` camera paths of a prepared method through the pixel at (x, y), in pixels from the upper
    left corner, as in pass ``iteration`` with the method's current state; also of the light paths that contribute to
    them, or to the film within ``near`` pixels: those that contribute most, at most ``paths``.

    None for a method whose paths do not belong to pixels. The state of a method that carries one on must be entered
    again before its next pass. Raises :class:`OptionError` for a place off the film, or too many paths.
    """
    if not isinstance(method, ShowsRays):
        return None
    width, height = method.problem.size
    if not (0.0 <= x <= width and 0.0 <= y <= height):
        raise OptionError(f"({x:g}, {y:g}) is off the film of {width}x{height} pixels")
    _check(paths)
    paths = min(paths, (1 << 32) // (width * height) - 1)  # so that the number of a path has 32 bits
    pixel = min(int(y), height - 1) * width + min(int(x), width - 1)

    def trace(recorder: RayRecorder) -> None:
        number = dr.arange(mi.UInt32, paths)
        splats = WalkRecorder(recorder, None, film=(x, y, near))
        method.recording = Recording(WalkRecorder(recorder, Edge.CAMERA, number), splats)
        lanes = number + dr.opaque(mi.UInt32, pixel * paths)
        method.trace_through(lanes, paths, iteration, seed)
        joined = joined_to(recorder.rays(), paths)
        if joined and isinstance(method, _HasLightPaths):
            number = on_device(mi.UInt32, joined)
            method.recording = Recording(light=WalkRecorder(recorder, Edge.LIGHT, number))
            method.trace_from_lights(number, iteration, seed)

    try:
        method.take_wavelengths(iteration, seed)
        return recorded(trace, _EDGES * paths, _reach(method.lights), method.packet)
    finally:
        method.recording = Recording()


class LightRays:
    """Light paths of one scene, with its lights and geometry at the time of construction."""

    def __init__(self, problem: Problem) -> None:
        self.lights = LightTable(problem.scene)
        self._visibility = Visibility(problem.scene, problem.sensor, self.lights.packet)

    def trace(self, light: int | None, paths: int, seed: int = 0) -> Rays:
        """Light paths from the light with a number in ``scene.emitters()``; ``None``: from all, by power. Raises
        :class:`OptionError` for an unknown light, one that emits nothing, or too many paths."""
        _check(paths)
        if light is not None and not 0 <= light < self.lights.count:
            raise OptionError(f"the scene has no light {light}; choose one of 0 to {self.lights.count - 1}")
        share, power = 1.0, self.lights.total_power
        if light is not None:
            share, power = float(self.lights.probabilities[light]), float(self.lights.powers[light]) or 1.0
        if share == 0.0:
            raise OptionError(f"light {light} of the scene emits nothing; choose another")
        return recorded(
            lambda recorder: self._walk(recorder, light, paths, seed, share, power),
            _EDGES * paths,
            _reach(self.lights),
            self.lights.packet,
        )

    def _walk(
        self, recorder: RayRecorder, light: int | None, paths: int, seed: int, share: float, power: float
    ) -> None:
        number, most = dr.arange(mi.UInt32, paths), dr.opaque(mi.UInt32, _MOST_EDGES)
        source: SampleSource = IndependentSource(number, seed, "light rays", 0)
        if light is not None:
            source = _FromLight(source, self.lights, light)
        emitted, whole = emit(self.lights, source, dr.full(mi.Bool, True, paths)), dr.opaque(mi.Float, power)
        path = SubPath(
            active=emitted.active,
            ray=emitted.ray,
            throughput=emitted.throughput * dr.opaque(mi.Float, share),
            eta=None,
            depth=dr.full(mi.UInt32, 1, paths),
            travelled=mi.Float(0.0),
            rays=dr.zeros(mi.UInt32, paths),
        )
        walker = Walker(
            visibility=self._visibility,
            lights=self.lights,
            max_edges=most,
            rr_depth=_ROULETTE,
            proposal=scatter_light,
            rays=WalkRecorder(recorder, Edge.LIGHT, number),
        )
        path.flight = walker.flight_from(emitted.light, emitted.ray)

        def edge(s: SubPath) -> SubPath:
            vertex = walker.arrive(s, source)
            s.active &= vertex.valid & (vertex.number < most)
            scattered, _ = vertex.sample(source, s.active)
            walker.advance(s, vertex, scattered, source, (s.throughput * scattered.weight / whole, mi.Float(1.0)))
            return s

        dr.eval(walker.walk(path, edge, "light rays").rays)


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


def _check(paths: int) -> None:
    if not 1 <= paths <= MOST_RECORDED:
        raise OptionError(f"1 to {MOST_RECORDED} paths can be recorded, not {paths}")


def _reach(lights: LightTable) -> float:
    """Length of edges that leave the scene."""
    return 0.5 * float(lights.bound.w[0])
