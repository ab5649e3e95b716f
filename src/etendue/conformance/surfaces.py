"""Points of a surface at which materials are evaluated, and conversions to the host."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import spread_wavelengths

Array = NDArray[np.float64]


def host(value: mi.Float | mi.Color3f | mi.Vector3f, lanes: int) -> Array:
    """A Dr.Jit array as doubles on the host: (lanes,), or (lanes, channels) for colours and vectors."""
    array = np.asarray(value, np.float64)
    if array.ndim > 1:
        return np.broadcast_to(array, (array.shape[0], lanes)).T
    return np.broadcast_to(array, (lanes,))


def vectors(values: Array) -> mi.Vector3f:
    """Vectors on the device from an array (n, 3)."""
    return mi.Vector3f(np.ascontiguousarray(values.T, np.float32))


def uniform(rng: np.random.Generator, lanes: int, width: int) -> mi.Float | mi.Point2f:
    """Uniform random numbers on the device: ``Float`` for width 1, ``Point2f`` for width 2."""
    numbers = rng.random((width, lanes), np.float32)
    return mi.Float(numbers[0]) if width == 1 else mi.Point2f(numbers)


def uniform_sphere(rng: np.random.Generator, count: int) -> Array:
    """Directions uniform over the sphere, (count, 3)."""
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def points_on(
    scene: mi.Scene | None, shape: mi.Shape | None, count: int, rng: np.random.Generator
) -> mi.SurfaceInteraction3f:
    """``count`` interactions on a shape, from rays that start close to it, with all fields that textures need.

    Without scene and shape, or if rays cannot hit the shape (inside a shape group), interactions on the unit square.
    """
    if shape is not None:
        try:
            found = _hits(scene, shape, 4 * count, rng)
        except (RuntimeError, NotImplementedError):  # shapes that cannot be sampled, such as an 'sdfgrid'
            found = None
        if found is not None:
            width = dr.width(found)
            chosen = dr.gather(mi.SurfaceInteraction3f, found, dr.arange(mi.UInt32, count) % width)
            dr.eval(chosen)
            return chosen
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.t, si.wavelengths = mi.Float(1.0), spread_wavelengths()
    si.uv = uniform(rng, count, 2)
    si.p = mi.Point3f(si.uv.x, si.uv.y, 0.0)
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    return si


def _hits(scene: mi.Scene, shape: mi.Shape, count: int, rng: np.random.Generator) -> mi.SurfaceInteraction3f | None:
    place = shape.sample_position(0.0, uniform(rng, count, 2))
    extent = float(np.max(np.asarray(scene.bbox().extents()).ravel()))
    near = 1e-4 * extent
    ray = mi.Ray3f(place.p + near * place.n, -mi.Vector3f(place.n), 0.0, spread_wavelengths())
    si = scene.ray_intersect(ray)
    dr.eval(si)  # so that kernels that use these points do not cast the rays again
    seen = np.broadcast_to(np.asarray(si.is_valid() & (si.shape == mi.ShapePtr(shape)) & (si.t < 2 * near)), count)
    if not seen.any():
        return None
    return dr.gather(mi.SurfaceInteraction3f, si, mi.UInt32(np.flatnonzero(seen).astype(np.uint32)))
