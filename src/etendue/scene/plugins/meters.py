"""Sensor ``meters``: a pixel for each meter. Made by :func:`etendue.scene.with_meters`."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .parameters import block


def make_meters() -> type:
    """The sensor class for the current variant."""

    class Meters(mi.Sensor):
        """``origins``, ``directions``: tensors (1, n, 3), of a film of n x 1 pixels. ``irradiance``: whether the camera
        paths begin on the white ``surface`` at each origin, towards which the ray points; otherwise they begin with the
        ray."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "meters"
            self._rays = [mi.Float(props[key].array) for key in ("origins", "directions")]
            self.m_needs_sample_3 = False
            self._count = len(self._rays[0]) // 3
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
            meter = dr.minimum(mi.UInt32(sample2.x * self._count), self._count - 1)
            o, d = (dr.gather(mi.Vector3f, values, meter) for values in self._rays)
            weight = weight * dr.pi if self.surface is not None else weight
            return mi.Ray3f(mi.Point3f(o), d, dr.inf, time, wavelengths), weight

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

        def traverse(self, callback: mi.TraversalCallback) -> None:
            super().traverse(callback)
            for key, values in zip(("origins", "directions"), self._rays, strict=True):
                callback.put(key, values, mi.ParamFlags.NonDifferentiable)

        def to_string(self) -> str:
            return block("meters", number=self._count, irradiance=self.surface is not None, film=self.film())

    return Meters
