"""What camera rays meet first: albedo, shading normal, depth and emission, recorded by the walk that traces the rays;
the shape in the middle of each pixel."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import Problem, graph

from .vertex import WalkVertex

#: Packets of four floats of a camera ray: albedo and depth, shading normal, emission.
_PACKETS = 3


class FirstHits:
    """Albedo, shading normal, depth and emission of the first surfaces that ``rays`` camera rays meet, 0 where they
    meet none; the emission is that of the environment there."""

    def __init__(self, rays: int) -> None:
        self._rays = rays
        self._packets = dr.zeros(mi.Float, 4 * _PACKETS * rays)
        self._ray: mi.UInt32 | None = None
        #: Pass whose places on the film the rays have.
        self.iteration = 0

    @property
    def recorded(self) -> bool:
        """Whether a walk has recorded something."""
        return self._ray is not None

    def of(self, ray: mi.UInt32, iteration: int) -> FirstHits:
        """The recorder for a walk whose lanes are the camera rays ``ray``."""
        self._ray, self.iteration = ray, iteration
        return self

    def record(self, vertex: WalkVertex, active: mi.Bool) -> None:
        """Record the surfaces at the ends of first edges, inside the walk."""
        active, si = active & vertex.valid, vertex.si
        albedo = vertex.bsdf.eval_diffuse_reflectance(si, active)
        self._put(0, mi.Vector4f(albedo.x, albedo.y, albedo.z, si.t), active)
        n = si.sh_frame.n
        self._put(1, mi.Vector4f(n.x, n.y, n.z, 0.0), active)

    def record_emission(self, radiance: mi.Color3f, active: mi.Bool) -> None:
        """Record the emission seen on first edges, inside the walk."""
        self._put(2, mi.Vector4f(radiance.x, radiance.y, radiance.z, 0.0), active)

    def _put(self, packet: int, value: mi.Vector4f, active: mi.Bool) -> None:
        assert self._ray is not None
        dr.scatter(self._packets, value, self._ray * _PACKETS + packet, active)

    def layers(self, image: Callable[[mi.Vector4f], NDArray[np.float32]]) -> tuple[dict[str, NDArray[np.float32]], int]:
        """(pictures by name, depth in units of the render space; number of values that were not finite and count as 0).
        ``image`` makes pictures (height, width, channels) of vectors, one lane a ray."""
        ray = dr.arange(mi.UInt32, self._rays)
        packets = [dr.gather(mi.Vector4f, self._packets, ray * _PACKETS + number) for number in range(_PACKETS)]
        good = [dr.all(dr.isfinite(packet)) for packet in packets]
        packets = [dr.select(finite, packet, 0.0) for finite, packet in zip(good, packets, strict=True)]
        dr.eval(packets, good)
        bad = sum(self._rays - int(np.count_nonzero(finite)) for finite in good)
        surface, normal, emitted = map(image, packets)
        found = {"albedo": surface[..., :3], "normal": normal[..., :3], "depth": surface[..., 3:]}
        return found | {"emitted": emitted[..., :3]}, bad


def shapes_seen(problem: Problem) -> tuple[NDArray[np.float32], list[str]]:
    """(numbers from 1 of the shapes that the rays through the middle of the pixels meet, 0 for none, as (height, width,
    1); names of the shapes, ids of the scene, or type and number). An instance is one shape."""
    (width, height), shapes = problem.size, list(problem.scene.shapes())
    pixel = dr.arange(mi.UInt32, width * height)
    y = pixel // width
    place = mi.Point2f((mi.Float(pixel - y * width) + 0.5) / width, (mi.Float(y) + 0.5) / height)
    ray, _ = problem.sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    hit = problem.scene.ray_intersect_preliminary(ray)
    instance, shape = (dr.reinterpret_array(mi.UInt32, pointer) for pointer in (hit.instance, hit.shape))
    seen = np.array(dr.select(hit.is_valid(), dr.select(instance != 0, instance, shape), 0))
    pointers = [int(np.ravel(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(one)))[0]) for one in shapes]
    numbers = np.zeros(max([0, int(seen.max()), *pointers]) + 1, np.float32)
    numbers[pointers] = np.arange(1, len(shapes) + 1)
    numbers[0] = 0.0
    names = [graph.name(one) or f"{graph.plugin_name(one)} {number}" for number, one in enumerate(shapes, 1)]
    return numbers[seen].reshape(height, width, 1), names
