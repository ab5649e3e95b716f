"""A scene as functions of rays, from which the rendering equation is composed as it stands.

    L(r) = L_e(r) + int w(r, u) L(s(r, u)) du

is, over rays r and the unit cube of u [Kajiya 1986; Leeson 2001, sec. 5.2]:

    radiance = f.emitted + integral(f.weight * radiance.compose(f.scatter), over=[6, 7, 8])

put into itself as many times as light shall be followed.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, OptionError
from etendue.integration import Box, Integrand, Integrator, integral
from etendue.scene import warn_of_offsets

from .scattering import is_smooth


class TransportFunctions:
    """The functions that light transport in a Mitsuba scene is put together from, on the device.

    A *ray* is six parameters, the coordinates of its origin and of its direction (a unit vector). Colours have three
    values. What a ray meets is computed once for functions that are asked at the same rays.

    Attributes
    ----------
    camera: film position (u, v) in the unit square -> the ray through it, from the middle of the lens.
    emitted: ray -> radiance that comes against it from the emitter it meets.
    scatter: ray, and three numbers for lobe and direction -> the ray that goes on where the first one ends, drawn by
        the material.
    weight: the same parameters -> BSDF times cosine over the density of ``scatter``. Zero where nothing is met; the
        next ray then leads out of the scene.
    direct: ray, and two numbers for a point on the emitters -> radiance from there that is reflected against the ray,
        over the density of the point. Materials without a smooth part reflect none of it.
    hit: ray -> coordinates of the point where it ends and of the normal there, on the ray's side. Origin and zero
        where nothing is met.
    distance: ray -> its length; infinite where nothing is met.
    albedo: ray -> diffuse reflectance of the material that it meets.

    Light is followed from the eye. Raises :class:`OptionError` for a sensor that the scene does not have.
    """

    def __init__(self, scene: Any, sensor: int = 0) -> None:
        sensors = scene.sensors()
        if not 0 <= sensor < len(sensors):
            raise OptionError(f"the scene has {len(sensors)} sensors, number {sensor} is not among them")
        self.scene, self._sensor = scene, sensors[sensor]
        warn_of_offsets(scene, self._sensor, "the scene")
        lower, upper = np.array(scene.bbox().min).ravel(), np.array(scene.bbox().max).ravel()
        if not np.isfinite([lower, upper]).all() or not (upper >= lower).all():
            lower, upper = np.zeros(3), np.zeros(3)
        eye = np.array(self._sensor.world_transform().translation(), dtype=float).ravel()[:3]
        lower, upper = np.minimum(lower, eye), np.maximum(upper, eye)
        margin = max(float((upper - lower).max()), 1.0)
        #: Where a ray that is to meet nothing begins, on its way out.
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
        self._last: dict[str, tuple[list[Any], Any]] = {}

    def picture(
        self,
        radiance: Integrand,
        size: tuple[int, int],
        samples: int = 16,
        integrator: Integrator | None = None,
        seed: int = 0,
    ) -> Array:
        """What the camera sees of ``radiance``, a function of rays: (height, width, 3), or 1 if that is real.

        ``size``: (width, height). Each pixel is the mean over its square, an integral by ``integrator`` (see
        :func:`etendue.integration.integral`) with ``samples`` rays; all pixels are computed at once.
        """
        return film_picture(radiance.compose(self.camera), size, samples, integrator, seed)

    # Each function takes coordinates, x[0..5] being the ray ---------------------------------------------------------

    def _camera(self, x: Any) -> list[Any]:
        film = mi.Point2f(x[0], x[1])
        ray, _ = self._sensor.sample_ray(0.0, 0.5, film, mi.Point2f(0.5))
        return [*ray.o, *ray.d]

    def _interaction(self, x: Any) -> Any:
        ray = mi.Ray3f(mi.Point3f(*x[:3]), mi.Vector3f(*x[3:6]))

        def intersect() -> Any:
            met = self.scene.ray_intersect_preliminary(ray)
            dr.eval(met)  # a ray is cast once, whatever kernels ask for what it met
            return met

        return self._remembered("hit", list(x[:6]), intersect).compute_surface_interaction(ray)

    def _emitted(self, x: Any) -> Any:
        si = self._interaction(x)
        return si.emitter(self.scene).eval(si)

    def _bounce(self, x: Any) -> tuple[list[Any], Any]:
        """The ray that goes on, and the weight."""

        def sample() -> tuple[list[Any], Any]:
            si = self._interaction(x)
            met = si.is_valid()
            bs, weight = si.bsdf().sample(mi.BSDFContext(), si, x[6], mi.Point2f(x[7], x[8]), met)
            goes_on = met & (bs.pdf > 0.0) & dr.any(weight != 0.0)
            ray = si.spawn_ray(si.to_world(bs.wo))
            origin = dr.select(goes_on, ray.o, mi.Point3f(*self._outside))
            direction = dr.select(goes_on, ray.d, mi.Vector3f(0.0, 0.0, 1.0))
            weight = dr.select(goes_on, weight, 0.0)
            dr.eval(origin, direction, weight)  # by one kernel, not by one for each number that is read
            return [*origin, *direction], weight

        return self._remembered("bounce", list(x[:9]), sample)

    def _direct(self, x: Any) -> Any:
        si = self._interaction(x)
        met = si.is_valid() & is_smooth(si.bsdf())
        towards, radiance = self.scene.sample_emitter_direction(si, mi.Point2f(x[6], x[7]), True, met)
        met &= towards.pdf != 0.0
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(towards.d), met)
        return dr.select(met, value * radiance, 0.0)

    def _hit(self, x: Any) -> list[Any]:
        si = self._interaction(x)
        normal = dr.select(dr.dot(si.n, mi.Vector3f(*x[3:6])) > 0.0, -si.n, si.n)
        met = si.is_valid()
        return [*dr.select(met, si.p, mi.Point3f(*x[:3])), *dr.select(met, normal, 0.0)]

    def _albedo(self, x: Any) -> Any:
        si = self._interaction(x)
        return si.bsdf().eval_diffuse_reflectance(si, si.is_valid())

    def _remembered(self, name: str, x: list[Any], compute: Any) -> Any:
        """``compute()``, or what it gave last time if that was for the very same arrays, which are kept until then."""
        known = self._last.get(name)
        if known is not None and [v.index for v in known[0]] == [v.index for v in x]:
            return known[1]
        result = compute()
        self._last[name] = (x, result)
        return result


def film_picture(
    seen: Integrand, size: tuple[int, int], samples: int = 16, integrator: Integrator | None = None, seed: int = 0
) -> Array:
    """Means of ``seen``, a function of the film (u, v) in the unit square, over pixels: (height, width, values).

    As :meth:`TransportFunctions.picture`; pixels are squares (a box filter), the first is that at (0, 0).
    """
    width, height = size
    if width < 1 or height < 1:
        raise OptionError(f"a picture has at least one pixel, not {width}x{height}")
    # Corner of a pixel, and place in it: the mean over the latter is a function of the former.
    domain = [(0.0, 1.0), (0.0, 1.0), (0.0, 1.0 / width), (0.0, 1.0 / height)]
    in_pixel = Integrand(lambda x: [x[0] + x[2], x[1] + x[3]], domain, on="either", values=2)
    pixel = integral(seen.compose(in_pixel), [2, 3], integrator, samples, seed) * float(width * height)
    index = dr.arange(mi.UInt32, width * height)
    corner = [mi.Float(index % width) * (1.0 / width), mi.Float(index // width) * (1.0 / height)]
    values = pixel.parts(pixel.evaluate(corner))
    return np.stack([np.array(v, dtype=np.float64).reshape(height, width) for v in values], axis=-1)
