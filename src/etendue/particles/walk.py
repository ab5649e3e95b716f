"""The light walk whose hits are particles, and their store on the device."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import SampleSource, on_device
from etendue.transport import (
    EmissionScheme,
    Proposal,
    Scattered,
    SubPath,
    Walker,
    WalkVertex,
    emit,
    ones,
    scatter_light,
)

from .particles import WORDS, Rows
from .surfaces import SurfaceTable

#: Words of a stored particle: packets of four are written at once.
_STORED = 16
#: Roulette by the throughput lets a path survive with at most this probability.
_LIVES = 0.95


class Keep(enum.Enum):
    """Which hits of a path become particles."""

    ALL = "all"
    FIRST = "first"  #: the first on a surface with a diffuse or glossy part
    ABSORBED = "absorbed"  #: the last, where the path ends, with the flux that the surface absorbs


@dataclass(kw_only=True)
class LightPath(SubPath):
    """Loop state, one lane a path."""

    bounce: mi.UInt32  #: as ``depth``, but null surfaces do not count
    met: mi.Bool  #: the path has been scattered by a surface with a diffuse or glossy part
    nonfinite: mi.UInt32


class ParticleStore:
    """At most ``capacity`` particles in device memory, in an order that is not repeatable; :meth:`rows` sorts them.

    A full store drops particles but counts them in ``wanted``, so that the caller can repeat the pass."""

    def __init__(self, capacity: int, surfaces: SurfaceTable) -> None:
        self._limit = dr.opaque(mi.UInt32, capacity)
        self._data = dr.empty(mi.Float, _STORED * capacity)
        #: Particles of all paths, one number on the device.
        self.wanted = dr.zeros(mi.UInt32, 1)
        self._shape_of = on_device(mi.UInt32, surfaces.number_of_pointer)
        self._is_mesh = on_device(mi.UInt32, surfaces.is_mesh_pointer.astype(np.uint32))
        self._first = on_device(mi.UInt32, surfaces.first_of_pointer)

    def append(
        self, path: mi.UInt32, bounce: mi.UInt32, vertex: WalkVertex, power: mi.Color3f, active: mi.Bool
    ) -> None:
        """Store one particle per active lane, inside the walk."""
        slot = dr.scatter_inc(self.wanted, mi.UInt32(0), active)
        active = active & (slot < self._limit)
        si, hit = vertex.si, vertex.hit
        # Inside an instance, the preliminary hit does not have the shape.
        inner = dr.reinterpret_array(mi.UInt32, si.shape)
        instance = dr.reinterpret_array(mi.UInt32, hit.instance)
        shape = dr.gather(mi.UInt32, self._shape_of, dr.select(instance != 0, instance, inner), active)
        is_mesh = dr.gather(mi.UInt32, self._is_mesh, inner, active) != 0
        uv = dr.select(is_mesh, hit.prim_uv, si.uv)
        primitive = dr.gather(mi.UInt32, self._first, inner, active) + dr.select(is_mesh, hit.prim_index, 0)
        p, d, first = si.p, vertex.incoming, slot * (_STORED // 4)
        packets = (
            mi.Vector4f(p.x, p.y, p.z, d.x),
            mi.Vector4f(d.y, d.z, power.x, power.y),
            mi.Vector4f(power.z, _bits(shape), _bits(primitive), uv.x),
            mi.Vector4f(uv.y, _bits(path), _bits(bounce), _bits(vertex.number)),
        )
        for k, packet in enumerate(packets):
            dr.scatter(self._data, packet, first + k, active)

    def launch(self) -> None:
        """Launch the kernel of the walk, with everything that is scheduled."""
        dr.eval(self.wanted, self._data)

    @property
    def count(self) -> int:
        """Particles of all paths; waits for the device."""
        return int(self.wanted[0])

    def rows(self) -> Rows:
        """The particles in the order of their paths, in the units of the render space."""
        return in_path_order(self.numbered())

    def numbered(self) -> NDArray[np.uint32]:
        """The particles in any order, each with the number of its vertex in an additional column."""
        rows = np.asarray(self._data).view(np.uint32).reshape(-1, _STORED)[: self.count]
        return rows[:, : WORDS + 1]


def in_path_order(numbered: NDArray[np.uint32]) -> Rows:
    """Numbered particles as rows in the order of their paths."""
    # By path and vertex, not bounce, which is the same before and behind a null surface.
    order = np.argsort((numbered[:, WORDS - 2].astype(np.uint64) << np.uint64(32)) | numbered[:, WORDS])
    return np.ascontiguousarray(numbered[order, :WORDS])


@dataclass(kw_only=True)
class ParticleWalk(Walker):
    """Traces light paths; :meth:`trace` is one kernel."""

    proposal: Proposal = scatter_light
    keep: Keep = Keep.ALL
    after: mi.UInt32  #: opaque; hits with this number of bounces or fewer are left out
    specular: bool = False  #: also keep hits on surfaces without a diffuse or glossy part
    scheme: EmissionScheme = emit  #: samples the rays of the lights

    def trace(
        self, paths: int, source: SampleSource, number: mi.UInt32, store: ParticleStore
    ) -> tuple[mi.UInt32, mi.UInt32]:
        """Trace ``paths`` light paths, with the numbers ``number``, into ``store``. Returns (rays, non-finite
        particles, which are left out), one lane a path, not yet evaluated."""
        state = self.follow(self.start(paths, source), source, number, store)
        return state.rays, state.nonfinite

    def start(self, paths: int, source: SampleSource) -> LightPath:
        """Light paths before their first edge."""
        emitted = self.scheme(self.lights, source, dr.full(mi.Bool, True, paths))
        return LightPath(
            active=emitted.active & (self.max_edges > 0),
            ray=emitted.ray,
            throughput=emitted.throughput,
            eta=None,
            depth=dr.full(mi.UInt32, 1, paths),
            travelled=mi.Float(0.0),
            rays=dr.zeros(mi.UInt32, paths),
            bounce=dr.full(mi.UInt32, 1, paths),
            met=dr.full(mi.Bool, False, paths),
            nonfinite=dr.zeros(mi.UInt32, paths),
        )

    def follow(self, state: LightPath, source: SampleSource, number: mi.UInt32, store: ParticleStore) -> LightPath:
        """Trace light paths to their ends, not yet evaluated."""
        return self.walk(state, lambda s: self._edge(s, number, source, store), "particle walk")

    def _edge(self, s: LightPath, number: mi.UInt32, source: SampleSource, store: ParticleStore) -> LightPath:
        """Trace one edge; scatter and store at its end."""
        vertex = self.arrive(s)
        s.active &= vertex.valid
        arrived, bounce, incident = mi.Bool(s.active), mi.UInt32(s.bounce), mi.Color3f(s.throughput)
        goes_on = s.depth < self.max_edges
        smooth = mi.Bool(vertex.smooth)
        kept = arrived & (bounce > self.after) & (mi.Bool(True) if self.specular else smooth)
        if self.keep is Keep.FIRST:
            kept &= ~s.met

        scattered, _ = vertex.sample(source, arrived)
        # For absorbed flux, roulette keeps the largest channel of a path unchanged, so that paths end with about equal
        # power.
        whole = dr.max(incident) if self.keep is Keep.ABSORBED else self.lights.flux
        relative = s.throughput * scattered.weight / whole
        self.advance(s, vertex, scattered, source, roulette_by=(relative, 1.0))
        s.active &= goes_on
        s.bounce = self.keep_if_null(scattered, bounce, bounce + 1)
        s.met = self.keep_if_null(scattered, s.met, s.met | (arrived & smooth))

        power = incident
        if self.keep is Keep.FIRST:
            kept &= ~scattered.is_null
        if self.keep is Keep.ABSORBED:
            kept &= ~s.active
            power = _absorbed(incident, scattered, relative, goes_on)
            kept &= ~dr.all(power == 0.0)
        finite = dr.all(dr.isfinite(power))
        store.append(number, bounce, vertex, power, kept & finite)
        s.nonfinite += ones(kept & ~finite)
        return s


def _absorbed(incident: mi.Color3f, scattered: Scattered, relative: mi.Color3f, goes_on: mi.Bool) -> mi.Color3f:
    """Flux that a path deposits where it ends: the flux that scattering removes, divided by the probability of the end,
    which is 1 at the last edge. With roulette from the first hit on, its expected value is the flux that the surface
    absorbs."""
    ends = dr.select(goes_on, 1.0 - dr.minimum(dr.max(relative), _LIVES), 1.0)
    return dr.select(scattered.active, incident * (1.0 - scattered.weight) / ends, incident)


def _bits(value: mi.UInt32) -> mi.Float:
    return dr.reinterpret_array(mi.Float, value)
