"""Light sub-path vertices in device memory: written once by the light walk, read by index, never copied to the host.

A vertex is a few packets of four floats, which are read together. There are two layouts. *Framed* stores the two
normals and the texture coordinates, which is enough for most materials. *Indexed* stores primitive and shape, from
which the surface interaction is computed again, for bump and normal maps, mesh attributes and anisotropic materials;
reading it takes twice the time.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.scene import Material, Media, hero_alone, is_spectral, materials

from ..flight import mean
from ..packing import packed_direction, packed_light, packed_normal, unpacked_direction, unpacked_light
from ..scattering import Evaluated, evaluate_light_end
from ..vertex import Vertex, WalkVertex
from ..visibility import Visibility
from .linear import Carried, Linear
from .photons import (
    HERO_ALONE,
    INDEX_BITS,
    Photons,
    depth_of,
    is_hero_alone,
    kind_of,
    number_of,
    weighting,
)

#: Packets of four floats per vertex, for connections and merging, and for merging only.
_PACKETS = 6
_PHOTON_PACKETS = 3
#: Bits of a depth, without and with a vertex number, which takes four.
_DEPTH_BITS = 16
_NUMBERED_DEPTH_BITS = 12
#: Bit of an index on a path that marks vertices in media, if there may be any.
_IN_MEDIUM = 1 << INDEX_BITS - 1
#: Paths whose vertices are numbered together.
_BLOCK = 16


#: Materials and textures that read more than normals and texture coordinates, but have no flag that says so.
_READ_MORE = ("BumpMap", "NormalMap", "MeshAttribute")


def needs_interaction(scene: mi.Scene) -> bool:
    """Whether some material reads more of a surface interaction than the framed layout stores."""
    return any(
        node.class_name() in _READ_MORE
        or (isinstance(node, mi.BSDF) and mi.has_flag(node.flags(), mi.BSDFFlags.Anisotropic))
        for node in materials(scene)
    )


@dataclass(kw_only=True)
class LightVertex(Vertex):
    """Vertices read back, one lane each."""

    direction: mi.Vector3f  #: world, towards the light side
    throughput: mi.Spectrum
    d_vcm: mi.Float | Linear
    d_vc: mi.Float | Linear
    depth: mi.UInt32  #: edges from the light
    number: mi.UInt32  #: as ``depth``, without null surfaces if the store is ``numbered``
    path: mi.UInt32  #: number of its light path
    place: mi.UInt32  #: its class, if it was stored with one
    kind: mi.UInt32  #: a :class:`Kind`

    def evaluate(self, direction: mi.Vector3f, active: mi.Bool) -> Evaluated:
        """The BSDF for a world direction of the eye side; the value times :func:`cosine_ratio` is the adjoint BSDF
        times its cosine."""
        return evaluate_light_end(self.bsdf, self.si, self.si.to_local(direction), active)


class LightVertices:
    """A store of at most ``capacity`` vertices of ``paths`` light sub-paths.

    Slots are assigned by an atomic counter, in an order that is not repeatable. :meth:`number` therefore gives vertices
    numbers that depend on the paths only, and :meth:`slot` maps numbers to slots. No function waits for the device: the
    count stays there, and arrays have the width of the capacity.

    Parameters
    ----------
    indexed: the layout that recomputes surface interactions (see above).
    connected: vertices are used for connections; if not, only the data for merging is stored.
    linear: d_vcm and d_vc are :class:`Linear`.
    owned: store the path of each vertex, also for merging.
    numbered: store the number of each vertex on its path, up to 15; the light point is 0. Otherwise the depth is used,
        which differs from the number after null surfaces.
    volumes: vertices may be in media.
    disperses: materials may disperse light.
    """

    def __init__(
        self,
        capacity: int,
        paths: int,
        indexed: bool,
        connected: bool,
        numbered: bool = False,
        linear: bool = False,
        owned: bool = False,
        volumes: bool = False,
        disperses: bool = False,
    ) -> None:
        self.volumes, self._disperses = volumes, disperses
        #: Bits of an index on a path that mark vertices.
        self._marks = (_IN_MEDIUM if volumes else 0) | (HERO_ALONE if disperses else 0)
        self.capacity = capacity
        self.indexed = indexed
        self.connected = connected
        self.numbered = numbered
        self._depth_bits = _NUMBERED_DEPTH_BITS if numbered else _DEPTH_BITS
        self._packets = _PACKETS if connected else _PHOTON_PACKETS
        #: Vertices of all paths, one number on the device; may exceed the capacity.
        self.wanted = dr.zeros(mi.UInt32, 1)
        # Packets of a vertex: position, depth | index on path | kind; throughput (fluence if only merged), d_vcm; world
        # direction to the light side, normal, d_vc; two packets of the surface; BSDF, path, fluence of unit
        # throughput, class.
        self._limit = dr.opaque(mi.UInt32, capacity)  # opaque, because the capacity depends on the seed
        self._records = dr.empty(mi.Float, 4 * self._packets * capacity)
        self._more = dr.empty(mi.Float, 4 * capacity) if linear else None  # further coefficients of d_vcm and d_vc
        self._owners = dr.empty(mi.UInt32, capacity) if owned else None
        self._fourth = dr.empty(mi.Float, capacity) if is_spectral() else None  # number of the throughput
        padded = -(-paths // _BLOCK) * _BLOCK
        self._stored = dr.zeros(mi.UInt32, padded if connected else 1)  # vertices of each path
        self._order: mi.UInt32 | None = None
        self._start: mi.UInt32 | None = None

    @staticmethod
    def bytes_per_vertex(
        connected: bool, merged: bool, linear: bool = False, owned: bool = False, classed: bool = False
    ) -> int:
        """Device memory of a stored vertex in bytes, including the copy and the grid for merging, and what sorting it
        by its class takes."""
        bytes_ = 16 * (_PACKETS if connected else _PHOTON_PACKETS) + (4 if connected else 0) + 8 * is_spectral()
        return (
            bytes_ + (48 + 24 if merged else 0) + (32 if linear else 0) + (8 if owned else 0) + (24 if classed else 0)
        )

    @staticmethod
    def floats_per_vertex(connected: bool) -> int:
        """Numbers of a vertex in the array of records; an array can have fewer than 2^32."""
        return 4 * (_PACKETS if connected else _PHOTON_PACKETS)

    def _put(self, packet: int, value: mi.Vector4f, slot: mi.UInt32, active: mi.Bool) -> None:
        dr.scatter(self._records, value, slot * self._packets + packet, active)

    def _get(self, packet: int, slot: mi.UInt32, active: mi.Bool | bool = True) -> mi.Vector4f:
        return dr.gather(mi.Vector4f, self._records, slot * self._packets + packet, active)

    def append(
        self,
        path: mi.UInt32,
        index: mi.UInt32,
        vertex: WalkVertex,
        throughput: mi.Spectrum,
        fluence: mi.Float,
        mis: tuple[Carried, Carried],
        kind: mi.UInt32,
        active: mi.Bool,
        number: mi.UInt32,
        place: mi.UInt32 | None = None,
    ) -> None:
        """Store one vertex per active lane, inside the walk. ``index``: vertices that the path has stored before;
        ``fluence``: factor on the throughput for merging (see :meth:`Mis.fluence`); ``kind``: one of :class:`Kind`;
        ``number``: number of the vertex on its path, stored if the store is ``numbered``; ``place``: class of the
        vertex.

        A full store drops vertices but counts them, so that the caller can repeat the pass with a larger capacity if
        ``wanted > capacity``."""
        slot = dr.scatter_inc(self.wanted, mi.UInt32(0), active)
        active = active & (slot < self._limit)
        si, hit, depth = vertex.si, vertex.hit, vertex.depth
        if self.numbered:
            depth = dr.minimum(depth, (1 << self._depth_bits) - 1) | (dr.minimum(number, 15) << self._depth_bits)
        if self.volumes:
            index = index | dr.select(vertex.bsdf.in_medium, _IN_MEDIUM, mi.UInt32(0))
        if self._disperses:
            index = index | dr.select(hero_alone(si.wavelengths), HERO_ALONE, mi.UInt32(0))
        tag = _as_float(depth | (index << 16) | (kind << 16 + INDEX_BITS))
        direction = si.to_world(si.wi)
        self._put(0, mi.Vector4f(si.p.x, si.p.y, si.p.z, tag), slot, active)
        flux = throughput if self.connected else throughput * fluence
        if self._owners is not None:
            dr.scatter(self._owners, path, slot, active)
        d_vcm, d_vc = mis
        if self._more is not None:
            assert isinstance(d_vcm, Linear) and isinstance(d_vc, Linear)
            packet = mi.Vector4f(d_vcm.end, d_vc.connection, d_vc.merge, 0.0)
            dr.scatter(self._more, packet, slot, active)
            d_vcm, d_vc = d_vcm.connection, d_vc.end
        light, fourth = packed_light(flux)
        self._put(1, mi.Vector4f(*light, d_vcm), slot, active)
        if self._fourth is not None:
            dr.scatter(self._fourth, fourth, slot, active)
        lit = dr.select(dr.dot(si.n, direction) < 0.0, -si.n, si.n)
        surface = packed_normal(lit)
        if self.volumes:
            surface = dr.select(vertex.bsdf.in_medium, _as_float(_medium(vertex)), surface)
        self._put(2, mi.Vector4f(*packed_direction(direction), surface, d_vc), slot, active)
        if not self.connected:
            return
        if self.indexed:
            uv = hit.prim_uv
            first = mi.Vector4f(uv.x, uv.y, _as_float(hit.prim_index), _as_float(_pointer(hit.shape)))
            medium = _as_float(_medium(vertex)) if self.volumes else 0.0
            second = mi.Vector4f(_as_float(_pointer(hit.instance)), _as_float(hit.shape_index), medium, 0.0)
        else:
            n, g, u = si.sh_frame.n, si.n, si.uv.x
            if self.volumes:
                u = dr.select(vertex.bsdf.in_medium, _as_float(_medium(vertex)), u)
            first, second = mi.Vector4f(n.x, n.y, n.z, u), mi.Vector4f(g.x, g.y, g.z, si.uv.y)
        self._put(3, first, slot, active)
        self._put(4, second, slot, active)
        own = 0.0 if place is None else _as_float(place)
        self._put(5, mi.Vector4f(_as_float(_pointer(vertex.bsdf.pointer)), _as_float(path), fluence, own), slot, active)

    def close_paths(self, path: mi.UInt32, stored: mi.UInt32) -> None:
        """Store the number of vertices of each path; called once after the walk, in the same kernel."""
        if self.connected:
            dr.scatter(self._stored, stored, path)

    def launch(self) -> None:
        """Launch the walk's kernel, and all that is scheduled."""
        dr.eval(self.wanted, self._records, self._stored, self._more, self._owners, self._fourth)

    @property
    def count(self) -> mi.UInt32:
        """Stored vertices, one number on the device."""
        return dr.minimum(self.wanted, self._limit)

    def number(self, by_path: bool) -> None:
        """Number the vertices, independently of the order of the slots: path by path (``by_path``), or by block of
        paths and in a block by position on the path, so that consecutive numbers are close in memory. Dropped vertices
        are numbered, too; numbers may therefore exceed the capacity, and are masked where they do."""
        self._start = dr.prefix_reduce(dr.ReduceOp.Add, self._stored, exclusive=True)
        slot = dr.arange(mi.UInt32, self.capacity)
        held = slot < self.count
        path = _as_uint(self._get(_PACKETS - 1, slot, held).y)
        index = (_as_uint(self._get(0, slot, held).w) >> 16) & ((1 << INDEX_BITS) - 1 & ~self._marks)
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

    def sort(self, classes: int) -> mi.UInt32:
        """Number the vertices anew, class by class, and by their numbers within a class. Returns the first number of
        each class, and the end: (classes + 1,)."""
        number = dr.arange(mi.UInt32, self.capacity)
        held = number < self.count
        place = _as_uint(self._get(_PACKETS - 1, self.slot(number, held), held).w)
        place = dr.select(held, dr.minimum(place, classes - 1), classes)
        population = dr.zeros(mi.UInt32, classes + 1)
        dr.scatter_add(population, mi.UInt32(1), place, held)
        dr.eval(place, population)
        self._order = dr.gather(mi.UInt32, self._order, dr.argsort(place))
        first = dr.prefix_reduce(dr.ReduceOp.Add, population, exclusive=True)
        dr.eval(self._order, first)
        return first

    def slot(self, number: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Slot of the vertex with a number."""
        return dr.gather(mi.UInt32, self._order, number, active & (number < self._limit))

    def path_vertices(self, path: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
        """(first number, count) of a path's vertices."""
        return dr.gather(mi.UInt32, self._start, path, active), dr.gather(mi.UInt32, self._stored, path, active)

    def read(self, slot: mi.UInt32, active: mi.Bool, visibility: Visibility) -> LightVertex:
        """Read whole vertices. ``visibility``: that of the scene."""
        position, throughput, direction, first, second, owner = (self._get(i, slot, active) for i in range(_PACKETS))
        bsdf = Material(dr.reinterpret_array(mi.BSDFPtr, _as_uint(owner.x)), visibility.bsdfs)
        world = unpacked_direction(direction.x, direction.y)
        d_vcm, d_vc = weighting(throughput.w, direction.w, self._more, slot, active)
        p, medium, extinction = mi.Point3f(position.x, position.y, position.z), None, None
        if self.volumes and visibility.media is not None:
            flag, medium = (second.z, second.z) if self.indexed else (dr.squared_norm(second.xyz), first.w)
            bsdf.in_medium = active & ((_as_uint(flag) != 0) == self.indexed)
            medium = dr.select(bsdf.in_medium, _as_uint(medium), 0)
            extinction = dr.select(bsdf.in_medium, visibility.media.at(medium, p, bsdf.in_medium)[0], 1.0)
        si = self._recompute(p, world, first, second, active) if self.indexed else _framed(p, first, second)
        if self.indexed and bsdf.in_medium is not None:
            si = dr.select(bsdf.in_medium, _framed(p, mi.Vector4f(0.0, 0.0, 1.0, 0.0), mi.Vector4f(0.0)), si)
        si.wi, si.wavelengths = si.to_local(world), visibility.packet.wavelengths
        if self._disperses:
            hero = mi.Spectrum(si.wavelengths[0])
            si.wavelengths = dr.select(is_hero_alone(position.w), hero, si.wavelengths)
        return LightVertex(
            si=si,
            bsdf=bsdf,
            medium=medium,
            extinction=extinction,
            direction=world,
            throughput=unpacked_light(throughput, self._fourth_of(slot, active)),
            d_vcm=d_vcm,
            d_vc=d_vc,
            depth=depth_of(position.w, self._depth_bits),
            number=number_of(position.w, self._depth_bits),
            path=_as_uint(owner.y),
            place=_as_uint(owner.w),
            kind=kind_of(position.w),
        )

    def _recompute(
        self, p: mi.Point3f, world: mi.Vector3f, first: mi.Vector4f, second: mi.Vector4f, active: mi.Bool
    ) -> mi.SurfaceInteraction3f:
        pi = dr.zeros(mi.PreliminaryIntersection3f)
        pi.t = mi.Float(1.0)
        pi.valid = mi.Bool(True)
        pi.prim_uv = mi.Point2f(first.x, first.y)
        pi.prim_index = _as_uint(first.z)
        pi.shape = dr.reinterpret_array(mi.ShapePtr, _as_uint(first.w))
        pi.shape_index = _as_uint(second.y)
        pi.instance = dr.reinterpret_array(mi.ShapePtr, _as_uint(second.x))
        return pi.compute_surface_interaction(mi.Ray3f(p + world, -world), active=active)

    def _fourth_of(self, slot: mi.UInt32, active: mi.Bool) -> mi.Float | None:
        return None if self._fourth is None else dr.gather(mi.Float, self._fourth, slot, active)

    def positions(self, in_media: bool = False) -> tuple[mi.Point3f, mi.UInt32, mi.Bool]:
        """(positions, :class:`Kind`, mask of the slots in use by vertices on surfaces, or ``in_media``), one lane a
        slot."""
        slot = dr.arange(mi.UInt32, self.capacity)
        held = slot < self.count
        p = self._get(0, slot, held)
        if self.volumes:
            held &= ((_as_uint(p.w) >> 16) & _IN_MEDIUM != 0) == in_media
        return mi.Point3f(p.x, p.y, p.z), kind_of(p.w), held

    def sorted_by(self, destination: mi.UInt32, active: mi.Bool | bool = True, media: Media | None = None) -> Photons:
        """The data for merging, copied to the order of a search structure: slot i to ``destination[i]``. ``media``: of
        the scene, if the vertices are in media."""
        slot = dr.arange(mi.UInt32, self.capacity)
        held = (slot < self.count) & active
        position = dr.empty(mi.Float, 4 * self.capacity)
        flux = dr.empty(mi.Float, 8 * self.capacity)
        dr.scatter(position, self._get(0, slot, held), destination, held)
        first = self._get(1, slot, held)
        light = unpacked_light(first, self._fourth_of(slot, held))
        if self.connected:
            light *= self._get(_PACKETS - 1, slot, held).z
        extinction = None
        if media is not None:
            # Collisions over the scattering coefficient, by which the throughput was multiplied, are fluence.
            p, medium = self._get(0, slot, held), _as_uint(self._get(2, slot, held).z)
            sampled, scattering = media.at(medium, mi.Point3f(p.x, p.y, p.z), held)
            if media.heterogeneous:
                extinction = dr.empty(mi.Float, self.capacity)
                dr.scatter(extinction, mean(sampled), destination, held)
            light = dr.select(scattering > 0.0, light / scattering, 0.0)
        numbers, own = packed_light(light)
        dr.scatter(flux, mi.Vector4f(*numbers, first.w), 2 * destination, held)
        fourth = None
        if own is not None:
            fourth = dr.empty(mi.Float, self.capacity)
            dr.scatter(fourth, own, destination, held)
        dr.scatter(flux, self._get(2, slot, held), 2 * destination + 1, held)
        more = None
        if self._more is not None:
            more = dr.empty(mi.Float, 4 * self.capacity)
            dr.scatter(more, dr.gather(mi.Vector4f, self._more, slot, held), destination, held)
        owners = None
        if self._owners is not None:
            owners = dr.empty(mi.UInt32, self.capacity)
            dr.scatter(owners, dr.gather(mi.UInt32, self._owners, slot, held), destination, held)
        dr.eval(position, flux, more, owners, extinction, fourth)
        return Photons(position, flux, more, self._depth_bits, owners, extinction, fourth, self._disperses)


def _medium(vertex: WalkVertex) -> mi.UInt32:
    """The medium of a vertex in one; 0 on surfaces."""
    in_medium = vertex.bsdf.in_medium
    return mi.UInt32(0) if in_medium is None or vertex.medium is None else dr.select(in_medium, vertex.medium, 0)


def _framed(p: mi.Point3f, first: mi.Vector4f, second: mi.Vector4f) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.t = mi.Float(0.0)
    si.p = p
    si.sh_frame = mi.Frame3f(mi.Normal3f(first.x, first.y, first.z))
    si.n = mi.Normal3f(second.x, second.y, second.z)
    si.uv = mi.Point2f(first.w, second.w)
    return si


def _as_float(bits: mi.UInt32 | mi.Float) -> mi.Float:
    return dr.reinterpret_array(mi.Float, bits)


def _as_uint(value: mi.Float) -> mi.UInt32:
    return dr.reinterpret_array(mi.UInt32, value)


def _pointer(pointer: mi.ShapePtr | mi.BSDFPtr) -> mi.UInt32:
    return dr.reinterpret_array(mi.UInt32, pointer)
