"""Light sub-path vertices in device memory: written once by the light walk, read by index, never copied to the host.

A vertex is a few packets of four floats, so that one read brings one cache line's worth. Two layouts: *framed* keeps
the two normals and texture coordinates, enough for every material that looks at nothing else; *indexed* keeps what
recomputes the whole surface interaction (primitive and shape), for bump and normal maps, mesh attributes and
anisotropic materials, at twice the cost of reading.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.scene import materials

from ..scattering import Evaluated, evaluate_light_end
from ..vertex import Vertex, WalkVertex
from .mis import RadiusFree
from .photons import Photons, depth_of, number_of, packed_direction, packed_normal, unpacked_direction

#: Packets of four floats in a record: of a vertex that is connected to, and of one that is only merged with.
_PACKETS = 6
_PHOTON_PACKETS = 3
#: Bits of a depth, and those that are left to it where the vertex number takes four.
_DEPTH_BITS = 16
_NUMBERED_DEPTH_BITS = 12
#: Paths that are numbered together, position by position.
_BLOCK = 16


#: Materials and textures that look at more than normals and texture coordinates, without a flag that says so.
_READ_MORE = ("BumpMap", "NormalMap", "MeshAttribute")


def needs_interaction(scene: Any) -> bool:
    """Whether some material reads more of a surface than the framed layout keeps."""
    return any(
        node.class_name() in _READ_MORE
        or (isinstance(node, mi.BSDF) and mi.has_flag(node.flags(), mi.BSDFFlags.Anisotropic))
        for node in materials(scene)
    )


class Kind(enum.IntEnum):
    """What contribution light to a vertex, in Heckbert's notation [Heckbert 1990]."""

    INDIRECT = 0  #: L...D...D
    DIRECT = 1  #: LD
    CAUSTIC = 2  #: LS+D


@dataclass(kw_only=True)
class LightVertex(Vertex):
    """Vertices read back, one lane each."""

    direction: mi.Vector3f  #: world, towards the light side
    throughput: mi.Color3f
    d_vcm: mi.Float
    d_vc: mi.Float | RadiusFree
    depth: mi.UInt32  #: edges from the light
    number: mi.UInt32  #: the same without the surfaces that were crossed, where these are counted

    def evaluate(self, direction: mi.Vector3f, active: mi.Bool) -> Evaluated:
        """The BSDF towards the eye side; its value, times :func:`cosine_ratio`, is the adjoint BSDF times its
        cosine."""
        return evaluate_light_end(self.bsdf, self.si, self.si.to_local(direction), active)


class LightVertices:
    """A store of at most ``capacity`` vertices of ``paths`` light sub-paths.

    Slots are claimed by an atomic counter, in no repeatable order. :meth:`number` therefore gives vertices numbers that
    depend on the paths alone, and :meth:`slot` leads from number to slot. Nothing here waits for the device: the count
    stays on it, and arrays are as wide as the capacity.

    Parameters
    ----------
    indexed: the layout that recomputes surface interactions (see above).
    connected: vertices will be connected to; if not, only what merging reads is kept.
    radius_free: d_vc comes as a :class:`RadiusFree`, of two numbers.
    numbered: keep also which vertex of its path each is, the light point being 0, up to 15. Without, its depth stands
        for that: the two differ where surfaces are crossed unbent.
    """

    def __init__(
        self,
        capacity: int,
        paths: int,
        indexed: bool,
        connected: bool,
        numbered: bool = False,
        radius_free: bool = False,
    ) -> None:
        self.capacity = capacity
        self.indexed = indexed
        self.connected = connected
        self.numbered = numbered
        self._depth_bits = _NUMBERED_DEPTH_BITS if numbered else _DEPTH_BITS
        self._packets = _PACKETS if connected else _PHOTON_PACKETS
        #: Vertices that the paths wanted to store, one number on the device; may exceed the capacity.
        self.wanted = dr.zeros(mi.UInt32, 1)
        # One record a vertex, of packets: position, depth | index on path; throughput (fluence if vertices are only
        # merged with), d_vcm; world direction to the light side, normal, d_vc; two packets of the surface; BSDF, path,
        # fluence of unit throughput.
        self._limit = dr.opaque(mi.UInt32, capacity)  # measured, so another seed has another: no constant of a kernel
        self._records = dr.empty(mi.Float, 4 * self._packets * capacity)
        self._slopes = dr.empty(mi.Float, capacity) if radius_free else None  # the second number of d_vc
        padded = -(-paths // _BLOCK) * _BLOCK
        self._stored = dr.zeros(mi.UInt32, padded if connected else 1)  # vertices of each path
        self._order: Any = None
        self._start: Any = None

    @staticmethod
    def bytes_per_vertex(connected: bool, merged: bool, radius_free: bool = False) -> int:
        """Device memory that a stored vertex takes, the copy and the grid of merging included."""
        bytes_ = 16 * (_PACKETS if connected else _PHOTON_PACKETS) + (4 if connected else 0)
        return bytes_ + (48 + 24 if merged else 0) + (8 if radius_free else 0)

    @staticmethod
    def floats_per_vertex(connected: bool) -> int:
        """Numbers of a vertex in the array of records; an array has fewer than 2^32."""
        return 4 * (_PACKETS if connected else _PHOTON_PACKETS)

    def _put(self, packet: int, value: Any, slot: Any, active: Any) -> None:
        dr.scatter(self._records, value, slot * self._packets + packet, active)

    def _get(self, packet: int, slot: Any, active: Any = True) -> Any:
        return dr.gather(mi.Vector4f, self._records, slot * self._packets + packet, active)

    def append(
        self,
        path: mi.UInt32,
        index: mi.UInt32,
        vertex: WalkVertex,
        throughput: mi.Color3f,
        fluence: mi.Float,
        mis: tuple[mi.Float, mi.Float | RadiusFree],
        kind: mi.UInt32,
        active: mi.Bool,
        number: mi.UInt32,
    ) -> None:
        """Store one vertex per active lane, inside the walk; ``fluence`` is what the throughput is multiplied by for
        merging (see :meth:`Mis.fluence`), ``index`` counts the vertices that the path has stored, ``kind`` is one of
        :class:`Kind`, ``number`` counts the path's vertices and is kept if the store is ``numbered``.

        A full store drops vertices but goes on counting, so that the caller sees ``wanted > capacity`` and repeats
        the pass with more room."""
        slot = dr.scatter_inc(self.wanted, mi.UInt32(0), active)
        active = active & (slot < self._limit)
        si, hit, depth = vertex.si, vertex.hit, vertex.number
        if self.numbered:
            depth = dr.minimum(depth, (1 << self._depth_bits) - 1) | (dr.minimum(number, 15) << self._depth_bits)
        tag = _as_float(depth | (index << 16) | (kind << 30))
        direction = si.to_world(si.wi)
        self._put(0, mi.Vector4f(si.p.x, si.p.y, si.p.z, tag), slot, active)
        flux = throughput if self.connected else throughput * fluence
        self._put(1, mi.Vector4f(flux.x, flux.y, flux.z, mis[0]), slot, active)
        d_vc = mis[1]
        if self._slopes is not None:
            dr.scatter(self._slopes, d_vc.b, slot, active)
            d_vc = d_vc.a
        lit = dr.select(dr.dot(si.n, direction) < 0.0, -si.n, si.n)
        self._put(2, mi.Vector4f(*packed_direction(direction), packed_normal(lit), d_vc), slot, active)
        if not self.connected:
            return
        if self.indexed:
            uv = hit.prim_uv
            first = mi.Vector4f(uv.x, uv.y, _as_float(hit.prim_index), _as_float(_pointer(hit.shape)))
            second = mi.Vector4f(_as_float(_pointer(hit.instance)), _as_float(hit.shape_index), 0.0, 0.0)
        else:
            n, g = si.sh_frame.n, si.n
            first, second = mi.Vector4f(n.x, n.y, n.z, si.uv.x), mi.Vector4f(g.x, g.y, g.z, si.uv.y)
        self._put(3, first, slot, active)
        self._put(4, second, slot, active)
        self._put(5, mi.Vector4f(_as_float(_pointer(vertex.bsdf)), _as_float(path), fluence, 0.0), slot, active)

    def close_paths(self, path: Any, stored: Any) -> None:
        """Record how many vertices each path has stored; called once after the walk, in the same kernel."""
        if self.connected:
            dr.scatter(self._stored, stored, path)

    def launch(self) -> None:
        """Start the walk's kernel, with whatever else is scheduled."""
        dr.eval(self.wanted, self._records, self._stored, self._slopes)

    @property
    def count(self) -> Any:
        """Vertices held, one number on the device."""
        return dr.minimum(self.wanted, self._limit)

    def number(self, by_path: bool) -> None:
        """Number the vertices, repeatably: path after path (``by_path``), or block of paths after block and in it by
        position on the path, so that neighbouring numbers are slots that lie together in memory. Numbers count what a
        full store has dropped, so they may lie beyond it; such a pass is thrown away, but must touch nothing else."""
        self._start = dr.prefix_reduce(dr.ReduceOp.Add, self._stored, exclusive=True)
        slot = dr.arange(mi.UInt32, self.capacity)
        held = slot < self.count
        path = _as_uint(self._get(_PACKETS - 1, slot, held).y)
        index = (_as_uint(self._get(0, slot, held).w) >> 16) & 0x3FFF
        if by_path:
            number = dr.gather(mi.UInt32, self._start, path, held) + index
        else:
            first = path & ~mi.UInt32(_BLOCK - 1)
            number = dr.gather(mi.UInt32, self._start, first, held)
            for lane in range(_BLOCK):
                stored = dr.gather(mi.UInt32, self._stored, first + lane, held)
                number += dr.minimum(stored, index)
                number += dr.select((first + lane < path) & (stored > index), mi.UInt32(1), mi.UInt32(0))
        self._order = dr.zeros(mi.UInt32, self.capacity)
        dr.scatter(self._order, slot, number, held & (number < self._limit))
        dr.eval(self._order, self._start)

    def slot(self, number: Any, active: Any) -> Any:
        """Slot of the vertex with this number."""
        return dr.gather(mi.UInt32, self._order, number, active & (number < self._limit))

    def path_vertices(self, path: Any, active: Any) -> tuple[Any, Any]:
        """(first number, how many) of a path's vertices."""
        return dr.gather(mi.UInt32, self._start, path, active), dr.gather(mi.UInt32, self._stored, path, active)

    def read(self, slot: Any, active: Any) -> LightVertex:
        """Read whole vertices."""
        position, throughput, direction, first, second, owner = (self._get(i, slot, active) for i in range(_PACKETS))
        bsdf = dr.reinterpret_array(mi.BSDFPtr, _as_uint(owner.x))
        world = unpacked_direction(direction.x, direction.y)
        p = mi.Point3f(position.x, position.y, position.z)
        si = self._recompute(p, world, first, second, active) if self.indexed else _framed(p, first, second)
        si.wi = si.to_local(world)
        return LightVertex(
            si=si,
            bsdf=bsdf,
            direction=world,
            throughput=mi.Color3f(throughput.x, throughput.y, throughput.z),
            d_vcm=throughput.w,
            d_vc=_d_vc(direction.w, self._slopes, slot, active),
            depth=depth_of(position.w, self._depth_bits),
            number=number_of(position.w, self._depth_bits),
        )

    def _recompute(self, p: Any, world: Any, first: Any, second: Any, active: Any) -> Any:
        pi = dr.zeros(mi.PreliminaryIntersection3f)
        pi.t = mi.Float(1.0)
        pi.valid = mi.Bool(True)
        pi.prim_uv = mi.Point2f(first.x, first.y)
        pi.prim_index = _as_uint(first.z)
        pi.shape = dr.reinterpret_array(mi.ShapePtr, _as_uint(first.w))
        pi.shape_index = _as_uint(second.y)
        pi.instance = dr.reinterpret_array(mi.ShapePtr, _as_uint(second.x))
        return pi.compute_surface_interaction(mi.Ray3f(p + world, -world), active=active)

    def positions(self) -> tuple[Any, Any, Any]:
        """(positions, :class:`Kind`, mask of the slots that hold a vertex), one lane a slot."""
        slot = dr.arange(mi.UInt32, self.capacity)
        held = slot < self.count
        p = self._get(0, slot, held)
        return mi.Point3f(p.x, p.y, p.z), _as_uint(p.w) >> 30, held

    def sorted_by(self, destination: Any, active: Any = True) -> Photons:
        """The packets that merging reads, in the order that a search structure gives to the ``active`` slots."""
        slot = dr.arange(mi.UInt32, self.capacity)
        held = (slot < self.count) & active
        position = dr.empty(mi.Float, 4 * self.capacity)
        flux = dr.empty(mi.Float, 8 * self.capacity)
        dr.scatter(position, self._get(0, slot, held), destination, held)
        first = self._get(1, slot, held)
        if self.connected:
            fluence = self._get(_PACKETS - 1, slot, held).z
            first = mi.Vector4f(first.x * fluence, first.y * fluence, first.z * fluence, first.w)
        dr.scatter(flux, first, 2 * destination, held)
        dr.scatter(flux, self._get(2, slot, held), 2 * destination + 1, held)
        slopes = None
        if self._slopes is not None:
            slopes = dr.empty(mi.Float, self.capacity)
            dr.scatter(slopes, dr.gather(mi.Float, self._slopes, slot, held), destination, held)
        dr.eval(position, flux, slopes)
        return Photons(position, flux, slopes, self._depth_bits)


def _framed(p: Any, first: Any, second: Any) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = mi.Float(0.0)
    si.p = p
    si.sh_frame = mi.Frame3f(mi.Normal3f(first.x, first.y, first.z))
    si.n = mi.Normal3f(second.x, second.y, second.z)
    si.uv = mi.Point2f(first.w, second.w)
    return si


def _d_vc(value: Any, slopes: Any, index: Any, active: Any) -> Any:
    return value if slopes is None else RadiusFree(value, dr.gather(mi.Float, slopes, index, active))


def _as_float(bits: Any) -> Any:
    return dr.reinterpret_array(mi.Float, bits)


def _as_uint(value: Any) -> Any:
    return dr.reinterpret_array(mi.UInt32, value)


def _pointer(pointer: Any) -> Any:
    return dr.reinterpret_array(mi.UInt32, pointer)
