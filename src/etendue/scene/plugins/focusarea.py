"""Emitter ``focusarea``: an area light that is focused around its normal.

    L(x, w) = radiance(x) (n + 2) / 2 cos^n        cos: between w and the normal, n: the focus exponent

The factor keeps the radiosity, pi radiance, for every exponent; n = 0 is Mitsuba's ``area``. A focused light therefore
has the same power, and along the normal it is (n + 2) / 2 times as bright.

Parameters: ``radiance`` (1), a colour or texture: the radiance of a diffuse light with the same radiosity; ``exponent``
(0), a number of at least 0; ``sampling_weight`` as in every emitter. It is nested in a shape, as ``area`` is.

Sampling densities: points p_A as in ``area`` (the shape's own, or by the texture); directions of emitted rays
(n + 2) / (2 pi) cos^(n + 1), so that a ray carries pi radiance / p_A; directions from a given point as in ``area``.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError

from .parameters import block, check_range, make_opaque, number
from .warps import square_to_cosine_power


def make_focusarea() -> type:
    """The emitter class for the current variant."""

    class FocusArea(mi.Emitter):
        """An area light whose radiance falls off as a power of the cosine."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "focusarea"
            if "to_world" in props:
                raise OptionError("'focusarea' has no 'to_world'; transform the shape in which it is nested")
            self.radiance = props.get_emissive_texture("radiance", 1.0)
            self.exponent = number(props, "exponent", 0.0)
            self._check()
            self.m_flags = +mi.EmitterFlags.Surface
            if self.radiance.is_spatially_varying():
                self.m_flags |= +mi.EmitterFlags.SpatiallyVarying

        def _check(self) -> None:
            check_range("focusarea", "exponent", self.exponent, 0.0)
            make_opaque(self.exponent)

        def _focus(self, cos: mi.Float) -> mi.Float:
            """L / radiance; 0 behind the light."""
            lit = (0.5 * self.exponent + 1.0) * dr.power(dr.maximum(cos, 0.0), self.exponent)
            return dr.select(cos > 0.0, lit, 0.0)

        def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Spectrum:
            return self.radiance.eval(si, active) * self._focus(mi.Frame3f.cos_theta(si.wi))

        def sample_position(
            self, time: mi.Float, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.PositionSample3f, mi.Float]:
            shape = self.get_shape()
            if shape is None:
                return dr.zeros(mi.PositionSample3f), mi.Float(0.0)
            if self.radiance.is_spatially_varying():
                si, pdf = self._sample_texture(shape, sample, active)
                ps = mi.PositionSample3f(si)
                ps.pdf, ps.delta = pdf, False
            else:
                ps = shape.sample_position(time, sample, active)
            return ps, dr.select(active & (ps.pdf > 0.0), dr.rcp(ps.pdf), 0.0)

        def _sample_texture(
            self, shape: mi.Shape, sample: mi.Point2f, active: mi.Bool | bool
        ) -> tuple[mi.SurfaceInteraction3f, mi.Float]:
            """A point of the shape sampled by the brightness of the texture, and its area density."""
            uv, pdf = self.radiance.sample_position(sample, active)
            si = shape.eval_parameterization(uv, active=active & (pdf > 0.0))
            density = pdf * dr.rcp(dr.norm(dr.cross(si.dp_du, si.dp_dv)))
            return si, dr.select(active & si.is_valid() & (pdf > 0.0), density, 0.0)

        def sample_ray(
            self,
            time: mi.Float,
            sample1: mi.Float,
            sample2: mi.Point2f,
            sample3: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
            ps, weight = self.sample_position(time, sample2, active)
            si = mi.SurfaceInteraction3f(ps, dr.zeros(mi.Color0f))
            si.time = time
            si.wavelengths, spectrum = self.sample_wavelengths(si, sample1, active)
            local = square_to_cosine_power(sample3, self.exponent + 1.0)
            return si.spawn_ray(si.to_world(local)), spectrum * (weight * dr.pi)

        def sample_direction(
            self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Bool | bool = True
        ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
            shape = self.get_shape()
            if shape is None:
                return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0.0)
            if self.radiance.is_spatially_varying():
                si, area_pdf = self._sample_texture(shape, sample, active)
                ds = dr.zeros(mi.DirectionSample3f)
                ds.p, ds.n, ds.uv, ds.time = si.p, si.n, si.uv, it.time
                ds.d = si.p - it.p
                ds.dist = dr.norm(ds.d)
                ds.d /= ds.dist
                cos = dr.maximum(-dr.dot(ds.d, ds.n), 0.0)
                ds.pdf = dr.select(cos > 0.0, area_pdf * dr.square(ds.dist) / cos, 0.0)
            else:
                ds = shape.sample_direction(it, sample, active)
            ds.emitter = mi.EmitterPtr(self)
            radiance = self.eval_direction(it, ds, active)
            return ds, dr.select(active & (ds.pdf > 0.0), radiance / ds.pdf, 0.0)

        def pdf_direction(
            self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Float:
            shape = self.get_shape()
            if shape is None:
                return mi.Float(0.0)
            cos = -dr.dot(ds.d, ds.n)
            if self.radiance.is_spatially_varying():
                si = shape.eval_parameterization(ds.uv, active=active)
                active = active & si.is_valid()
                stretch = dr.norm(dr.cross(si.dp_du, si.dp_dv))
                pdf = self.radiance.pdf_position(ds.uv, active) * dr.square(ds.dist) / (stretch * cos)
            else:
                pdf = shape.pdf_direction(it, ds, active)
            return dr.select(active & (cos > 0.0), pdf, 0.0)

        def eval_direction(
            self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Bool | bool = True
        ) -> mi.Spectrum:
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            return self.radiance.eval(si, active) * self._focus(-dr.dot(ds.d, ds.n))

        def sample_wavelengths(
            self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Bool | bool = True
        ) -> tuple[mi.Color0f, mi.Spectrum]:
            return dr.zeros(mi.Color0f), self.radiance.eval(si, active)

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return self.get_shape().bbox()

        def traverse(self, callback: mi.TraversalCallback) -> None:
            super().traverse(callback)
            callback.put("radiance", self.radiance, mi.ParamFlags.Differentiable)
            callback.put("exponent", self.exponent, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            self._check()
            super().parameters_changed(keys)

        def to_string(self) -> str:
            return block("focusarea", radiance=self.radiance, exponent=self.exponent)

    return FocusArea
