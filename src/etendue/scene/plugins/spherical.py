"""Sensor ``spherical``: all directions around a point, as a latitude-longitude picture.

Film coordinates (u, v) in [0, 1]^2 of the whole film, u to the right, v downwards, are the directions

    d = (sin phi sin theta, cos theta, -cos phi sin theta),    phi = 2 pi u, theta = pi v

in the sensor's own frame: y is up, and the middle of the picture is the direction +z, as for other Mitsuba cameras. The
mapping is that of ``envmap``, so that a picture can be used as an environment map. A direction uniform in one of the
W x H pixels has the density W H / (2 pi^2 sin theta) per solid angle.

Parameters: ``to_world`` (without scale); ``near_clip`` (0.01) and ``far_clip`` (10000), distances from the point; film,
sampler and shutter as in every sensor. A crop window shows its part of the sphere.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import OptionError

from .parameters import block, check_range, make_opaque, number


def make_spherical() -> type:
    """The sensor class for the current variant."""

    class Spherical(mi.Sensor):
        """A camera for all directions."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "spherical"
            self.near_clip = number(props, "near_clip", 1e-2)
            self.far_clip = number(props, "far_clip", 1e4)
            self.m_needs_sample_3 = False
            self._check()

        def _check(self) -> None:
            check_range("spherical", "near_clip", self.near_clip, 0.0, strict=True)
            check_range("spherical", "far_clip", self.far_clip, float(np.asarray(self.near_clip)[0]), strict=True)
            if np.asarray(self.world_transform().has_scale()).any():
                raise OptionError("'to_world' of 'spherical' must not contain a scale; remove it")
            make_opaque(self.near_clip, self.far_clip)
            film = self.film()
            #: Whole film, crop window and its offset, in pixels.
            self._size, self._window, self._offset = (
                mi.ScalarVector2f(v) for v in (film.size(), film.crop_size(), film.crop_offset())
            )

        def sample_ray(
            self,
            time: mi.Float,
            sample1: mi.Float,
            sample2: mi.Point2f,
            sample3: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            place = (self._offset + sample2 * self._window) / self._size
            sin_phi, cos_phi = dr.sincos(dr.two_pi * place.x)
            sin_theta, cos_theta = dr.sincos(dr.pi * place.y)
            local = mi.Vector3f(sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta)
            to_world = self.world_transform()
            d = to_world @ local
            origin = mi.Point3f(to_world.translation()) + d * self.near_clip
            return mi.Ray3f(origin, d, self.far_clip - self.near_clip, time, wavelengths), weight

        def sample_direction(
            self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
            """The film position of ``it`` in pixels of the crop window (``uv``), and the importance over the squared
            distance, for a film of unit size."""
            to_world = self.world_transform()
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p = mi.Point3f(to_world.translation())
            offset = it.p - ds.p
            ds.dist = dr.norm(offset)
            ds.n = offset / ds.dist
            ds.d = -ds.n
            local = to_world.inverse() @ mi.Vector3f(ds.n)
            sin_theta = dr.sqrt(dr.square(local.x) + dr.square(local.z))
            u = dr.atan2(local.x, -local.z) * dr.inv_two_pi
            v = dr.atan2(sin_theta, local.y) * dr.inv_pi
            ds.uv = mi.Point2f(u - dr.floor(u), v) * self._size - self._offset
            ds.time = it.time
            active = active & (ds.dist >= self.near_clip) & (ds.dist <= self.far_clip)
            active &= dr.all((ds.uv >= 0.0) & (ds.uv <= self._window))
            ds.pdf = dr.select(active, mi.Float(1.0), 0.0)
            ratio = dr.prod(self._size) / dr.prod(self._window)
            density = ratio / (2.0 * dr.square(dr.pi) * dr.maximum(sin_theta, 1e-7))
            return ds, mi.Spectrum(dr.select(active, density / dr.square(ds.dist), 0.0))

        def bbox(self) -> mi.ScalarBoundingBox3f:
            at = mi.ScalarPoint3f(np.asarray(self.world_transform().translation()).ravel().tolist())
            return mi.ScalarBoundingBox3f(at, at)

        def traverse(self, callback: mi.TraversalCallback) -> None:
            fixed = mi.ParamFlags.NonDifferentiable
            callback.put("near_clip", self.near_clip, fixed)
            callback.put("far_clip", self.far_clip, fixed)
            super().traverse(callback)
            callback.put("to_world", self.m_to_world, fixed)

        def parameters_changed(self, keys: list[str]) -> None:
            super().parameters_changed(keys)
            self._check()

        def to_string(self) -> str:
            return block(
                "spherical",
                near_clip=self.near_clip,
                far_clip=self.far_clip,
                film=self.film(),
                sampler=self.sampler(),
                to_world=self.world_transform(),
            )

    return Spherical
