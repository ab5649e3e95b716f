"""The bidirectional estimator as a target: each sample is a pair of sub-paths, all of whose vertices are connected."""

from __future__ import annotations

import functools
import operator
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.film import COMPONENTS, Component
from etendue.integration import Layout
from etendue.transport import (
    CameraConnection,
    CameraSink,
    CameraWalk,
    Contribution as Weighted,
    LightCache,
    LightVertices,
    LightWalk,
    Mis,
    Sink,
    SplatPlace,
    Techniques,
    dimensions as dim,
    needs_interaction,
)

from ..base import ImageMethod, keep_finite
from .targets import ROULETTE, Contribution, Traced, camera_slots, film_place, light_slots, wavelengths_of

#: First capacity for the light vertices of a path, and factor on the wanted capacity where it was too small.
_VERTICES, _GROWTH = 4.0, 1.5
#: Number of longest paths for which there is always room.
_FEW = 32


@dataclass(kw_only=True)
class SplatList(Sink):
    """The splats of each light path, kept apart: one for each of the first ``count`` vertices, and one for the others.

    Of the further vertices j = 1, 2, … one is kept: J, drawn with the probability 2^-J, times 2^J. ``u``: one number a
    path, which draws J.
    """

    camera: Any
    count: int
    u: mi.Float
    components: bool = False  #: whether the component of each splat is kept, too

    def __post_init__(self) -> None:
        lanes = dr.width(self.u)
        self._lane = dr.arange(mi.UInt32, lanes)
        self._kept = mi.UInt32(dr.maximum(-dr.floor(dr.log2(1.0 - self.u)), 1.0)) - 1  # J - 1
        self._rows = 6 if self.components else 5
        self.array = dr.zeros(mi.Float, self._rows * lanes * (self.count + 1))
        self._lanes = dr.opaque(mi.UInt32, lanes)  # opaque, so that any number of paths shares the kernels

    @property
    def splats(self) -> SplatList:
        """See :class:`SplatSink`."""
        return self

    def place(self, connection: CameraConnection, source: SampleSource, vertex: mi.UInt32 | int) -> SplatPlace:
        """The film position itself; no pixel is chosen yet."""
        self._position = connection.position
        return SplatPlace([], mi.Float(1.0), self.camera.on_film(self._position))

    def add(self, s: mi.UInt32, place: SplatPlace, contribution: Weighted, kind: mi.UInt32) -> mi.Bool:
        """Keep the splat of a light sub-path of ``s >= 2`` vertices. Returns the mask of values that are not finite,
        which are not kept."""
        value = self.camera.packet.rgb(contribution.weighted[0])
        finite = dr.all(dr.isfinite(value))
        slot = s - 2
        further = slot - dr.minimum(slot, self.count)
        wanted = (slot < self.count) | (further == self._kept)
        scale = dr.select(slot < self.count, 1.0, dr.power(2.0, mi.Float(further) + 1.0)) / self.camera.pixels
        first = dr.minimum(slot, self.count) * self._rows * self._lanes + self._lane
        numbers = [self._position.x, self._position.y, *(value * scale)]
        if self.components:
            numbers.append(mi.Float(dr.maximum(kind, mi.UInt32(Component.DIRECT))))
        for row, number in enumerate(numbers):
            dr.scatter(self.array, number, first + row * self._lanes, contribution.active & finite & wanted)
        return contribution.active & ~finite

    def contributions(self) -> list[Contribution]:
        """The kept splats, after the walk."""

        def row(slot: int, index: int) -> mi.Float:
            return dr.gather(mi.Float, self.array, self._lane + (self._rows * slot + index) * self._lanes)

        found = [
            Contribution(mi.Point2f(row(i, 0), row(i, 1)), mi.Color3f(row(i, 2), row(i, 3), row(i, 4)))
            for i in range(self.count + 1)
        ]
        if not self.components:
            return found
        return [
            Contribution(one.position, dr.select(row(i, 5) == float(number), one.value, 0.0), number)
            for i, one in enumerate(found)
            for number in range(Component.DIRECT, len(COMPONENTS))
        ]


class PairTarget:
    """A light sub-path and a camera sub-path, connected with each other and with lights and sensor in all ways."""

    def __init__(self, method: ImageMethod, vertices: int, components: bool = False, seen: bool = True) -> None:
        """``seen``: with lights that the camera sees directly."""
        self._method: ImageMethod = weakref.proxy(method)  # which owns the target
        self._vertices, self._components, self._seen = vertices, components, seen
        self._techniques = Techniques(splat=method.camera.can_splat, merge=False)
        self._indexed = needs_interaction(method.scene)
        self._per_path = _VERTICES
        camera, light = camera_slots(method), light_slots(method)
        light[1].append(ROULETTE)
        camera[1].append(ROULETTE)
        self.layouts: Mapping[str, Layout] = {
            "camera": Layout(*camera, vertices),
            "light": Layout(*light, vertices),
        }

    def trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        """See :class:`Target`."""
        with wavelengths_of(self._method, sources["camera"]):
            return self._trace(sources, lanes)

    def _trace(self, sources: Mapping[str, SampleSource], lanes: int) -> Traced:
        method, camera = self._method, self._method.camera
        mis = Mis(self._techniques, [0.0], dr.opaque(mi.Float, float(camera.pixels)))
        common = {"camera": camera, "mis": mis, "dark": dr.opaque(mi.Float, 0.0)}
        splats = None
        if self._techniques.splat:
            u = sources["light"].next_1d(0, dim.SPLAT_SHADOW)  # not in the layout
            splats = SplatList(camera=camera, count=self._vertices, u=u, components=self._components)
        vertices = LightVertices(self._room(lanes), lanes, self._indexed, connected=True)
        walk: LightWalk = method.walker(LightWalk, **common, sink=splats)
        light_rays, light_bad = walk.trace(lanes, sources["light"], vertices)
        dr.schedule(light_rays, light_bad, splats.array if splats else None)
        vertices.launch()
        vertices.number(by_path=True)
        one = dr.full(mi.Float, 1.0)
        cache = LightCache(vertices, mi.UInt32(vertices.count), one, dr.opaque(mi.UInt32, lanes), None)
        sink = CameraSink(split_layers=False, components=self._components)
        eye: CameraWalk = method.walker(CameraWalk, **common, sink=sink, cache=cache, seen=self._seen)
        place = film_place(method, sources["camera"])
        primary = camera.through(place, sources["camera"])
        radiance, rays = eye.follow(primary, dr.zeros(mi.UInt32, lanes), sources["camera"])
        layers = [method.packet.rgb(layer) for layer in radiance.values()]
        whole, bad = keep_finite(functools.reduce(operator.add, layers))
        parts = [dr.select(bad, 0.0, part) for part in layers] if len(layers) > 1 else [whole]
        contributions = [Contribution(place, part, number) for number, part in enumerate(parts)]
        contributions += splats.contributions() if splats else []
        nonfinite = light_bad + dr.select(bad, mi.UInt32(1), 0)
        return Traced(contributions, rays + light_rays, nonfinite, vertices.wanted)

    def reads(self) -> Sequence[object]:
        """See :class:`Target`."""
        return self._method.tables()

    def _room(self, lanes: int) -> int:
        return int(self._per_path * lanes) + _FEW * self._vertices

    def had_room(self, wanted: int, lanes: int) -> bool:
        """See :class:`Target`."""
        if wanted <= self._room(lanes):
            return True
        self._per_path = _GROWTH * wanted / lanes
        return False
