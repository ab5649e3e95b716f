"""What camera rays meet first: albedo, shading normal, depth and emission, recorded by the walk that traces the rays;
the shape in the middle of each pixel."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import Problem, graph

from .bidirectional.photons import packed_normal, unpacked_normal
from .vertex import WalkVertex

#: Packets of four floats of a camera ray: albedo and depth; emission and the packed shading normal.
_PACKETS = 2


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

    def record(self, vertex: WalkVertex, emitted: mi.Color3f, active: mi.Bool) -> None:
        """Record the ends of first edges and the emission there, inside the walk."""

        def put(
            ray: mi.UInt32,
            si: mi.SurfaceInteraction3f,
            bsdf: mi.BSDFPtr,
            emitted: mi.Color3f,
            hit: mi.Bool,
            active: mi.Bool,
        ) -> mi.Bool:
            n = si.sh_frame.n
            albedo = dr.select(hit, bsdf.eval_diffuse_reflectance(si, hit), 0.0)
            # A packed normal is always finite; a depth of NaN tells of one that is not.
            depth = dr.select(hit, dr.select(dr.all(dr.isfinite(n)), si.t, dr.nan), 0.0)
            first = mi.Vector4f(albedo.x, albedo.y, albedo.z, depth)
            second = mi.Vector4f(emitted.x, emitted.y, emitted.z, packed_normal(n))
            for number, packet in enumerate((first, second)):
                dr.scatter(self._packets, packet, ray * _PACKETS + number, active)
            return active

        # A branch, because only one of the edges of a path is the first.
        arguments = self._ray, vertex.si, vertex.bsdf, emitted, active & vertex.valid, active
        dr.if_stmt(arguments, active, put, lambda *_: _[-1], label="first hit")

    def found(self) -> tuple[dict[str, Any], int]:
        """(layers by name, one lane a ray, depth in units of the render space; number of values that were not finite
        and are 0)."""
        ray = dr.arange(mi.UInt32, self._rays)
        first, second = (dr.gather(mi.Vector4f, self._packets, ray * _PACKETS + number) for number in range(_PACKETS))
        emitted = mi.Color3f(second.x, second.y, second.z)
        finite, shines = dr.all(dr.isfinite(first)), dr.all(dr.isfinite(emitted))
        layers = {
            "albedo": dr.select(finite, mi.Color3f(first.x, first.y, first.z), 0.0),
            "normal": dr.select(first.w > 0.0, unpacked_normal(second.w), 0.0),
            "depth": dr.select(finite, first.w, 0.0),
            "emitted": dr.select(shines, emitted, 0.0),
        }
        bad = [dr.select(good, mi.UInt32(0), 1) for good in (finite, shines)]
        dr.eval(layers, bad)
        return layers, sum(int(dr.sum(flags)[0]) for flags in bad)


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
