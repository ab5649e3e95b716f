"""Sensor ``meters``: a pixel for each meter. Made by :func:`etendue.scene.with_meters`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .parameters import block


def make_meters() -> type:
    """The sensor class for the current variant."""

    class Meters(mi.Sensor):
        """``origins``, ``directions``: tensors (1, n, 3), of a film of n x 1 pixels; without them, all meters are on
        the attribute ``shape``, uniform by area, and their rays point against its normals. ``irradiance``: whether
        camera paths begin on the white ``surface`` at each origin, towards which the ray points; otherwise they begin
        with the ray. ``turned``: of irradiance, the surface has any direction around the ray (``cylindrical``), or any
        direction at all (``spherical``)."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "meters"
            self._rays = [mi.Float(props[key].array) for key in ("origins", "directions") if key in props]
            self.shape: mi.Shape | None = None
            self._turned = str(props.get("turned", ""))
            self.m_needs_sample_3 = not self._rays or bool(self._turned)
            self._count = len(self._rays[0]) // 3 if self._rays else 0
            white = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 1.0}}
            self.surface = mi.load_dict(white) if props["irradiance"] else None

        def sample_ray(
            self,
            time: mi.Float,
            sample1: mi.Float,
            sample2: mi.Point2f,
            sample3: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
            wavelengths, weight = self.sample_wavelengths(dr.zeros(mi.SurfaceInteraction3f), sample1, active)
            weight = weight * dr.pi if self.surface is not None else weight
            if self.shape is not None:
                place = self.shape.sample_position(time, sample3, active)
                return mi.Ray3f(place.p, -mi.Vector3f(place.n), dr.inf, time, wavelengths), weight
            meter = dr.minimum(mi.UInt32(sample2.x * self._count), self._count - 1)
            o, d = (dr.gather(mi.Vector3f, values, meter) for values in self._rays)
            if self._turned == "spherical":
                d = mi.warp.square_to_uniform_sphere(sample3)
            elif self._turned:
                sine, cosine = dr.sincos(dr.two_pi * sample3.x)
                d = mi.Frame3f(d).to_world(mi.Vector3f(cosine, sine, 0.0))
            return mi.Ray3f(mi.Point3f(o), d, dr.inf, time, wavelengths), weight

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback: mi.TraversalCallback) -> None:
            super().traverse(callback)
            for key, values in zip(("origins", "directions"), self._rays, strict=False):
                callback.put(key, values, mi.ParamFlags.NonDifferentiable)

        def to_string(self) -> str:
            irradiance = self.surface is not None
            return block("meters", number=self._count, irradiance=irradiance, turned=self._turned, film=self.film())

    return Meters
