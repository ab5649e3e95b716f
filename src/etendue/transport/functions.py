"""A scene as functions of rays, from which the rendering equation is composed.

For rays r, and random numbers u in the unit cube, the rendering equation [Kajiya 1986; Leeson 2001, sec. 5.2]

    L(r) = L_e(r) + int w(r, u) L(s(r, u)) du

is written as

    radiance = f.emitted + integral(f.weight * radiance.compose(f.scatter), over=[6, 7, 8])

applied once for each scattering that is to be computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, OptionError
from etendue.integration import Box, Integrand, Integrator, integral
from etendue.scene import Material, bsdfs, corners_of, emitters, refuse_media, require_rgb, warn_of_offsets

from .scattering import is_smooth

T = TypeVar("T")


class TransportFunctions:
    """Functions on the device that describe light transport in a Mitsuba scene, along camera paths.

    A *ray* is six parameters, the coordinates of its origin and of its direction (a unit vector). Colours have three
    values. An intersection is computed once for functions that are evaluated at the same rays.

    Attributes
    ----------
    camera: film position (u, v) in the unit square -> the ray through it, from the centre of the lens.
    emitted: ray -> radiance emitted by the surface that it hits, or by the environment, towards its origin.
    scatter: ray, and three random numbers for component and direction -> the next ray, from the point that the first
        one hits, sampled from the BSDF.
    weight: the same parameters -> BSDF times cosine over the density of ``scatter``. Zero where the ray hits nothing;
        the next ray then hits nothing either.
    direct: ray, and two random numbers for a point on the emitters -> radiance from that point reflected towards the
        ray's origin, over the density of the point. Zero for materials without a smooth component.
    hit: ray -> coordinates of the point that it hits and of the normal there, on the ray's side; the ray's origin and
        zeros where it hits nothing.
    distance: ray -> distance to the point that it hits; infinite where it hits nothing.
    albedo: ray -> diffuse reflectance of the material that it hits.

    Raises :class:`OptionError` if the scene has no sensor of that number.
    """

    def __init__(self, scene: mi.Scene, sensor: int = 0) -> None:
        sensors = scene.sensors()
        if not 0 <= sensor < len(sensors):
            raise OptionError(
                f"the scene has {len(sensors)} sensors, number {sensor} is not one of them (they count from 0)"
            )
        self.scene, self._sensor = scene, sensors[sensor]
        refuse_media(scene, "functions of transport", self._sensor)
        require_rgb("functions of transport")
        self._emitters, self._bsdfs = emitters(scene), bsdfs(scene)
        warn_of_offsets(scene, self._sensor, "the scene")
        lower, upper = corners_of(scene)
        if not np.isfinite([lower, upper]).all() or not (upper >= lower).all():
            lower, upper = np.zeros(3), np.zeros(3)
        eye = np.array(self._sensor.world_transform().translation(), dtype=float).ravel()[:3]
        lower, upper = np.minimum(lower, eye), np.maximum(upper, eye)
        margin = max(float((upper - lower).max()), 1.0)
        #: Origin of rays that hit nothing.
        self._outside = [float(v) for v in upper + margin]
        ends = [(float(a) - 2 * margin, float(b) + 2 * margin) for a, b in zip(lower, upper, strict=True)]
        unit = (0.0, 1.0)
        ray = [*ends, *[(-1.0, 1.0)] * 3]
        #: The domain of rays.
        self.rays = Box.of(ray)
        bounded = (0.0, math.inf)
        self.camera = Integrand(self._camera, [unit] * 2, on="device", values=6)
        self.emitted = Integrand(self._emitted, ray, bounded, "device", values=3)
        self.scatter = Integrand(lambda x: self._bounce(x)[0], [*ray, *[unit] * 3], on="device", values=6)
        self.weight = Integrand(lambda x: self._bounce(x)[1], [*ray, *[unit] * 3], bounded, "device", values=3)
        self.direct = Integrand(self._direct, [*ray, *[unit] * 2], bounded, "device", values=3)
        self.hit = Integrand(self._hit, ray, on="device", values=6)
        self.distance = Integrand(lambda x: self._interaction(x).t, ray, bounded, "device")
        self.albedo = Integrand(self._albedo, ray, (0.0, 1.0), "device", values=3)
        self._last: dict[str, tuple[list[mi.Float], Any]] = {}

    def picture(
        self,
        radiance: Integrand,
        size: tuple[int, int],
        samples: int = 16,
        integrator: Integrator | None = None,
        seed: int = 0,
    ) -> Array:
        """Picture of ``radiance``, a function of rays: (height, width, 3), or (height, width, 1) if it is scalar.

        ``size``: (width, height). Each pixel is the mean over its square, an integral by ``integrator`` (see
        :func:`etendue.integration.integral`) with ``samples`` rays; all pixels are computed in one launch.
        """
        return film_picture(radiance.compose(self.camera), size, samples, integrator, seed)

    # In functions of rays, x[0..5] are the coordinates of the ray -----------------------------------------------------

    def _camera(self, x: Sequence[mi.Float]) -> list[mi.Float]:
        film = mi.Point2f(x[0], x[1])
        ray, _ = self._sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
        return [*ray.o, *ray.d]

    def _interaction(self, x: Sequence[mi.Float]) -> mi.SurfaceInteraction3f:
        ray = mi.Ray3f(mi.Point3f(*x[:3]), mi.Vector3f(*x[3:6]))

        def intersect() -> mi.PreliminaryIntersection3f:
            hit = self.scene.ray_intersect_preliminary(ray)
            dr.eval(hit)  # so that the kernels that use it do not cast the ray again
            return hit

        return self._cached("hit", list(x[:6]), intersect).compute_surface_interaction(ray)

    def _material(self, si: mi.SurfaceInteraction3f) -> Material:
        return Material(si.bsdf(), self._bsdfs)

    def _emitted(self, x: Sequence[mi.Float]) -> mi.Spectrum:
        si = self._interaction(x)
        if not self._emitters:
            return mi.Spectrum(0.0)
        emitter = dr.reinterpret_array(mi.UInt32, si.emitter(self.scene))
        return self._emitters.call(emitter, mi.Emitter.eval, si, active=emitter != 0)

    def _bounce(self, x: Sequence[mi.Float]) -> tuple[list[mi.Float], mi.Spectrum]:
        """(next ray, weight)."""

        def sample() -> tuple[list[mi.Float], mi.Spectrum]:
            si = self._interaction(x)
            valid = si.is_valid()
            arguments = mi.BSDFContext(), si, x[6], mi.Point2f(x[7], x[8])
            bs, weight = self._material(si).call(mi.BSDF.sample, *arguments, active=valid)
            scattered = valid & (bs.pdf > 0.0) & dr.any(weight != 0.0)
            ray = si.spawn_ray(si.to_world(bs.wo))
            origin = dr.select(scattered, ray.o, mi.Point3f(*self._outside))
            direction = dr.select(scattered, ray.d, mi.Vector3f(0.0, 0.0, 1.0))
            weight = dr.select(scattered, weight, 0.0)
            dr.eval(origin, direction, weight)  # in one kernel, not in one for each number that is read
            return [*origin, *direction], weight

        return self._cached("bounce", list(x[:9]), sample)

    def _direct(self, x: Sequence[mi.Float]) -> mi.Spectrum:
        si = self._interaction(x)
        if not self._emitters:
            return mi.Spectrum(0.0)
        material = self._material(si)
        active = si.is_valid() & is_smooth(material)
        number, weight, u = self.scene.sample_emitter(x[6], active)
        emitter = dr.gather(mi.UInt32, dr.reinterpret_array(mi.UInt32, self.scene.emitters_dr()), number, active)
        place = mi.Point2f(u, x[7])
        ds, radiance = self._emitters.call(emitter, mi.Emitter.sample_direction, si, place, active=active)
        active &= ds.pdf != 0.0
        active &= ~self.scene.ray_test(si.spawn_ray_to(ds.p), active)
        value = material.call(mi.BSDF.eval, mi.BSDFContext(), si, si.to_local(ds.d), active=active)
        return dr.select(active, value * radiance * weight, 0.0)

    def _hit(self, x: Sequence[mi.Float]) -> list[mi.Float]:
        si = self._interaction(x)
        normal = dr.select(dr.dot(si.n, mi.Vector3f(*x[3:6])) > 0.0, -si.n, si.n)
        valid = si.is_valid()
        return [*dr.select(valid, si.p, mi.Point3f(*x[:3])), *dr.select(valid, normal, 0.0)]

    def _albedo(self, x: Sequence[mi.Float]) -> mi.Spectrum:
        si = self._interaction(x)
        return self._material(si).call(mi.BSDF.eval_diffuse_reflectance, si, active=si.is_valid())

    def _cached(self, name: str, x: list[mi.Float], compute: Callable[[], T]) -> T:
        """``compute()``, or its last result if that was computed for the same arrays. The arrays of the last call are
        kept, so that their indices are not used again."""
        last = self._last.get(name)
        if last is not None and [v.index for v in last[0]] == [v.index for v in x]:
            return cast(T, last[1])
        result = compute()
        self._last[name] = (x, result)
        return result


def film_picture(
    seen: Integrand, size: tuple[int, int], samples: int = 16, integrator: Integrator | None = None, seed: int = 0
) -> Array:
    """Means over pixels of ``seen``, a function of the film position (u, v) in the unit square: (height, width,
    values).

    Arguments as of :meth:`TransportFunctions.picture`. Pixels are squares (box filter); the first one is at (0, 0).
    """
    width, height = size
    if width < 1 or height < 1:
        raise OptionError(f"a picture needs at least one pixel a side, not {width}x{height}")
    # Parameters: corner of a pixel and offset in the pixel, over which the mean is taken.
    domain = [(0.0, 1.0), (0.0, 1.0), (0.0, 1.0 / width), (0.0, 1.0 / height)]
    in_pixel = Integrand(lambda x: [x[0] + x[2], x[1] + x[3]], domain, on="either", values=2)
    pixel = integral(seen.compose(in_pixel), [2, 3], integrator, samples, seed) * float(width * height)
    index = dr.arange(mi.UInt32, width * height)
    corner = [mi.Float(index % width) * (1.0 / width), mi.Float(index // width) * (1.0 / height)]
    values = pixel.parts(pixel.evaluate(corner))
    return np.stack([np.array(v, dtype=np.float64).reshape(height, width) for v in values], axis=-1)
