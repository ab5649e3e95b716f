"""First hits of camera rays: albedo, shading normal, depth and emission, and what is seen in mirrors and through glass,
recorded by the walk that traces the rays; the shape in the middle of each pixel, and the shapes that cover the pixel.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.core import IndependentSource, on_device
from etendue.film import matte_attributes, matte_layers
from etendue.scene import Packet, Problem, graph

from . import dimensions as dim
from .camera import CameraSampler
from .packing import packed_normal, unpacked_normal
from .vertex import WalkVertex

#: Camera rays per pixel and pass whose first hits are recorded: the layers have far less noise than the picture.
_MOST_RAYS = 8
#: Rays along each side of a pixel that find the shapes covering it, and the largest number of shapes that are kept.
_RAYS, _RANKS = 8, 6
#: Pixels with more shapes than are kept of which all rays are compared at once.
_CROWDED = 1 << 14


class FirstHits:
    """Albedo, shading normal, depth and emission of the first surfaces that the first ``rays`` camera rays of each
    pixel meet, 0 where they meet none; the emission is that of the environment there. A pass has ``samples`` camera
    rays per pixel.

    With ``specular``, ``seen_albedo`` and ``seen_normal`` are those of the surface at which a path is first scattered
    by something other than a mirror or smooth glass, or ends; the albedo is multiplied by what these reflect or
    transmit. Glass reflects or transmits at random. Only paths that take the more probable way count, so that chance
    does not make the layers noisy; ``seen_share`` is their share. ``packet``: the wavelengths of the pass."""

    def __init__(self, pixels: int, samples: int, specular: bool, packet: Packet) -> None:
        self._packet = packet
        self.rays = min(samples, _MOST_RAYS)
        #: Packets of four floats per camera ray: albedo and depth; emission and the packed shading normal; albedo and
        #: packed normal of what is seen.
        self._each = 3 if specular else 2
        self._samples = samples
        self._count = pixels * self.rays
        self._packets = dr.zeros(mi.Float, 4 * self._each * self._count)
        self._ray: mi.UInt32 | None = None
        self._kept = mi.Bool(True)
        #: Pass whose film positions the rays have.
        self.iteration = 0

    @property
    def through(self) -> mi.Bool | None:
        """Initial :attr:`SubPath.through` of paths; a new one each time, because a walk changes that of its paths."""
        return mi.Bool(True) if self._each == 3 else None

    @property
    def recorded(self) -> bool:
        """Whether a recorder was requested for a walk."""
        return self._ray is not None

    def of(self, ray: mi.UInt32, iteration: int) -> FirstHits:
        """The recorder for a walk whose lanes are the camera rays ``ray`` of the pass, by pixel and number."""
        self._ray, self.iteration = ray, iteration
        if self.rays < self._samples:
            pixel = ray // self._samples
            number = ray - pixel * self._samples
            self._ray, self._kept = pixel * self.rays + number, number < self.rays
        return self

    def lanes(self) -> mi.UInt32:
        """The camera rays of the pass whose first hits are recorded."""
        ray = dr.arange(mi.UInt32, self._count)
        pixel = ray // self.rays
        return pixel * self._samples + (ray - pixel * self.rays)

    def record(
        self, vertex: WalkVertex, emitted: mi.Spectrum, throughput: mi.Spectrum, is_first: mi.Bool, active: mi.Bool
    ) -> None:
        """Record the end of an edge that a path has reached by mirrors and glass only, inside the walk; with
        ``is_first``, also as the first hit, and its emission. ``throughput``: of the path up to the vertex."""

        def put(
            ray: mi.UInt32,
            si: mi.SurfaceInteraction3f,
            pointer: mi.BSDFPtr,
            emitted: mi.Spectrum,
            throughput: mi.Spectrum,
            hit: mi.Bool,
            is_first: mi.Bool,
            active: mi.Bool,
        ) -> mi.Bool:
            n = si.sh_frame.n
            albedo = replace(vertex.bsdf, pointer=pointer).call(mi.BSDF.eval_diffuse_reflectance, si, active=hit)
            seen, albedo = self._packet.albedo(albedo * throughput), self._packet.albedo(albedo)
            emitted = self._packet.rgb(emitted)
            # A packed normal is always finite; therefore NaN marks what does not count, and -1 a missing surface.
            is_normal = dr.all(dr.isfinite(n))
            depth = dr.select(hit, dr.select(is_normal, si.t, dr.nan), 0.0)
            first = mi.Vector4f(albedo.x, albedo.y, albedo.z, depth)
            second = mi.Vector4f(emitted.x, emitted.y, emitted.z, packed_normal(n))
            red = dr.select(hit, dr.select(is_normal, seen.x, dr.nan), -1.0)
            third = mi.Vector4f(red, seen.y, seen.z, packed_normal(n))
            packets = [(first, is_first), (second, is_first), (third, active)]
            for number, (packet, wanted) in enumerate(packets[: self._each]):
                dr.scatter(self._packets, packet, ray * self._each + number, wanted)
            return active

        # A branch, because few of the edges of a path are recorded.
        active &= self._kept
        hit, is_first = active & vertex.valid, active & is_first
        arguments = self._ray, vertex.si, vertex.bsdf.pointer, emitted, throughput, hit, is_first, active
        dr.if_stmt(arguments, active, put, lambda *_: _[-1], label="first hit")

    def discard(self, active: mi.Bool) -> None:
        """What paths see does not count, inside the walk."""
        assert self._ray is not None
        dr.scatter(self._packets, dr.nan, (self._ray * self._each + 2) * 4, active & self._kept)

    def found(self) -> tuple[dict[str, Any], int]:
        """(layers by name, one lane a ray, depth in units of the render space; number of values that were not finite
        and are 0)."""
        ray = dr.arange(mi.UInt32, self._count)
        first, second, *more = (
            dr.gather(mi.Vector4f, self._packets, ray * self._each + number) for number in range(self._each)
        )
        emitted = mi.Color3f(second.x, second.y, second.z)
        finite, shines = dr.all(dr.isfinite(first)), dr.all(dr.isfinite(emitted))
        layers = {
            "albedo": dr.select(finite, mi.Color3f(first.x, first.y, first.z), 0.0),
            "normal": dr.select(first.w > 0.0, unpacked_normal(second.w), 0.0),
            "depth": dr.select(finite, first.w, 0.0),
            "emitted": dr.select(shines, emitted, 0.0),
        }
        for third in more:
            seen = mi.Color3f(third.x, third.y, third.z)
            counts = dr.all(dr.isfinite(seen))
            layers |= {
                "seen_albedo": dr.select(counts & (seen.x >= 0.0), seen, 0.0),
                "seen_normal": dr.select(counts & (seen.x >= 0.0), unpacked_normal(third.w), 0.0),
                "seen_share": dr.select(counts, mi.Float(1.0), 0.0),
            }
        bad = [dr.select(good, mi.UInt32(0), 1) for good in (finite, shines)]
        dr.eval(layers, bad)
        return layers, sum(int(dr.sum(flags)[0]) for flags in bad)


def seen_shapes(problem: Problem, middle: bool, matte: bool) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """(layers, metadata) of the shapes that pixels show. ``middle``: a layer ``shape``, the number (from 1) of the
    shape in the middle of each pixel, 0 for none, and metadata ``shapes``, their names. ``matte``: a Cryptomatte of the
    names; coverage is the share of 64 rays. Names are ids of the scene, or type and number. An instance is one
    shape."""
    if not (middle or matte):
        return {}, {}
    width, height = problem.size
    shapes = list(problem.scene.shapes())
    names = [graph.name(one) or f"{graph.plugin_name(one)} {number}" for number, one in enumerate(shapes, 1)]
    layers: dict[str, NDArray[np.float32]] = {}
    metadata: dict[str, Any] = {}
    if middle:
        pixel = dr.arange(mi.UInt32, width * height)
        y = pixel // width
        place = mi.Point2f((mi.Float(pixel - y * width) + 0.5) / width, (mi.Float(y) + 0.5) / height)
        ray, _ = problem.sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
        seen = _numbered(shapes, np.array(_seen(problem, ray)))
        layers["shape"], metadata["shapes"] = seen.astype(np.float32).reshape(height, width, 1), names
    if matte:
        found, counts = _covering(problem)
        coverage = (counts / np.float32(_RAYS**2)).reshape(height, width, _RANKS)
        layers |= matte_layers(_numbered(shapes, found).reshape(height, width, _RANKS), coverage, names)
        metadata |= matte_attributes(names)
    return layers, metadata


def _seen(problem: Problem, ray: mi.Ray3f) -> mi.UInt32:
    """The pointer to the shape, or to the instance, that rays meet first; 0 for none."""
    hit = problem.scene.ray_intersect_preliminary(ray)
    instance, shape = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (hit.instance, hit.shape))
    return dr.select(hit.is_valid(), dr.select(instance != 0, instance, shape), 0)


def _numbered(shapes: list[mi.Shape], seen: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Numbers from 1 of shapes, by their pointers."""
    pointers = [int(np.ravel(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(one)))[0]) for one in shapes]
    numbers = np.zeros(max([0, int(seen.max()), *pointers]) + 1, np.uint32)
    numbers[pointers] = np.arange(1, len(shapes) + 1)
    numbers[0] = 0
    found: NDArray[np.uint32] = numbers[seen]
    return found


def _covering(problem: Problem) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """(pointers to the shapes that the rays of a pixel hit first, number of rays for each shape), each (pixels, ranks);
    of more shapes, those with most rays. Rays are stratified by the density proportional to the absolute value of the
    film's filter."""
    camera = CameraSampler(problem, independent=True)
    pixel, side = dr.arange(mi.UInt32, camera.pixels), dr.opaque(mi.UInt32, _RAYS)
    source = IndependentSource(pixel, 0, "cover", 0)

    def hit(pixel: mi.UInt32, source: IndependentSource, number: mi.UInt32) -> mi.UInt32:
        y, down = pixel // camera.width, number // side
        u, v = ((mi.Float(k) + 0.5) / _RAYS for k in (number - down * side, down))
        film_x, film_y, _ = camera.filter.camera(pixel - y * camera.width, y, u, v)
        aperture = mi.Point2f(*source.next_2d(number, dim.APERTURE))
        place = mi.Point2f(film_x / camera.width, film_y / camera.height)
        return _seen(problem, problem.sensor.sample_ray(0.0, 0.5, place, aperture)[0])

    def ray(number: mi.UInt32, crowded: mi.Bool, *ranks: mi.UInt32) -> tuple[mi.UInt32 | mi.Bool, ...]:
        shape = hit(pixel, source, number)
        placed, result = shape == 0, []
        for known, count in zip(ranks[:_RANKS], ranks[_RANKS:], strict=True):
            here = ~placed & ((count == 0) | (known == shape))
            placed |= here
            result.append((dr.select(here, shape, known), dr.select(here, count + 1, count)))
        return number + 1, crowded | ~placed, *(known for known, _ in result), *(count for _, count in result)

    nothing = [dr.zeros(mi.Bool, camera.pixels), *(dr.zeros(mi.UInt32, camera.pixels) for _ in range(2 * _RANKS))]
    _, more, *ranks = dr.while_loop((mi.UInt32(0), *nothing), lambda number, *_: number < side * side, ray)
    dr.eval(more, ranks)
    shapes, counts = (np.stack([np.array(rank) for rank in half], 1) for half in (ranks[:_RANKS], ranks[_RANKS:]))
    crowded = np.flatnonzero(np.array(more)).astype(np.uint32)
    for some in np.split(crowded, range(_CROWDED, len(crowded), _CROWDED)) if len(crowded) else ():
        ray_of = dr.arange(mi.UInt32, len(some) * _RAYS**2)
        place = ray_of // _RAYS**2
        lane = dr.gather(mi.UInt32, on_device(mi.UInt32, some), place)
        found = hit(lane, IndependentSource(lane, 0, "cover", 0), ray_of - place * _RAYS**2)
        shapes[some], counts[some] = _largest(np.array(found).reshape(len(some), -1))
    return shapes, counts.astype(np.float32)


def _largest(seen: NDArray[np.uint32]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """(shapes with most rays, number of their rays), each (pixels, ranks), of what each ray has ``seen``, (pixels,
    rays); 0 for none."""
    pixels = np.arange(len(seen), dtype=np.uint64)[:, None]
    both, rays = np.unique((pixels << np.uint64(32)) | seen, return_counts=True)
    pixel, shape = (both >> np.uint64(32)).astype(np.int64), both.astype(np.uint32)
    order = np.lexsort((-rays, shape == 0, pixel))
    pixel, shape, rays = pixel[order], shape[order], rays[order]
    rank = np.arange(len(pixel)) - np.searchsorted(pixel, pixel)
    kept = (rank < _RANKS) & (shape != 0)
    shapes, counts = np.zeros((2, len(seen), _RANKS), np.uint32)
    shapes[pixel[kept], rank[kept]], counts[pixel[kept], rank[kept]] = shape[kept], rays[kept]
    return shapes, counts
