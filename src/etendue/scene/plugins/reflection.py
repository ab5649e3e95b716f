"""A BSDF with a diffuse component and a lobe, shared by ``phong`` and ``ward``."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..both import pdf_of_both, value_of_both
from .parameters import block
from .phong import PhongLobe
from .ward import WardLobe


def make_phong() -> type:
    """The BSDF class ``phong`` for the current variant."""
    return _with_lobe(PhongLobe)


def make_ward() -> type:
    """The BSDF class ``ward`` for the current variant."""
    return _with_lobe(WardLobe)


def _with_lobe(lobe_type: type[PhongLobe] | type[WardLobe]) -> type:
    """The BSDF class of a lobe."""

    class DiffuseAndLobe(mi.BSDF):
        """f = k_d / pi + k_s lobe; a component is selected by its share of the reflectance and sampled."""

        eval, pdf = value_of_both, pdf_of_both

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = lobe_type.name
            self.diffuse = props.get_texture("diffuse_reflectance", 0.5)
            self.specular = props.get_texture("specular_reflectance", 0.2)
            self.lobe = lobe_type(props)
            self._set_components()

        def _set_components(self) -> None:
            front = mi.BSDFFlags.FrontSide
            diffuse, glossy = mi.BSDFFlags.DiffuseReflection | front, mi.BSDFFlags.GlossyReflection | front
            if self.diffuse.is_spatially_varying():
                diffuse |= mi.BSDFFlags.SpatiallyVarying
            if self.specular.is_spatially_varying():
                glossy |= mi.BSDFFlags.SpatiallyVarying
            if self.lobe.is_anisotropic:
                glossy |= mi.BSDFFlags.Anisotropic
            self.m_components = [diffuse, glossy]
            self.m_flags = diffuse | glossy

        def _reflectances(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> tuple[mi.Spectrum, mi.Spectrum]:
            """k_d and k_s, their sum at most 1 in every channel."""
            diffuse, specular = self.diffuse.eval(si, active), self.specular.eval(si, active)
            scale = dr.rcp(dr.maximum(diffuse + specular, 1.0))
            return diffuse * scale, specular * scale

        def _lobe_share(self, ctx: mi.BSDFContext, diffuse: mi.Spectrum, specular: mi.Spectrum) -> mi.Float:
            """Probability of sampling the lobe."""
            if not ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 0):
                return mi.Float(1.0)
            if not ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 1):
                return mi.Float(0.0)
            whole = dr.sum(diffuse + specular)
            return dr.select(whole > 0.0, dr.sum(specular) / whole, 0.0)

        def _evaluate(
            self,
            ctx: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            wo: mi.Vector3f,
            reflectances: tuple[mi.Spectrum, mi.Spectrum],
            active: mi.Bool | bool,
        ) -> tuple[mi.Spectrum, mi.Float]:
            """f cos and the density of sampling ``wo``; zero below the surface."""
            diffuse, specular = reflectances
            value, pdf = mi.Spectrum(0.0), mi.Float(0.0)
            cos = mi.Frame3f.cos_theta(wo)
            active = active & (mi.Frame3f.cos_theta(si.wi) > 0.0) & (cos > 0.0)
            share = self._lobe_share(ctx, diffuse, specular)
            if ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 0):
                value += diffuse * dr.inv_pi
                pdf += (1.0 - share) * (cos * dr.inv_pi)
            if ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 1):
                lobe, lobe_pdf = self.lobe.evaluate(si.wi, wo)
                value += specular * lobe
                pdf += share * lobe_pdf
            return value * cos & active, pdf & active

        def sample(
            self,
            ctx: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            sample1: mi.Float,
            sample2: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            reflectances = self._reflectances(si, active)
            share = self._lobe_share(ctx, *reflectances)
            of_lobe = sample1 < share
            bs = mi.BSDFSample3f()
            bs.wo = dr.select(of_lobe, self.lobe.sample(si.wi, sample2), mi.warp.square_to_cosine_hemisphere(sample2))
            bs.eta = 1.0
            glossy, diffuse = mi.UInt32(+mi.BSDFFlags.GlossyReflection), mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
            bs.sampled_type = dr.select(of_lobe, glossy, diffuse)
            bs.sampled_component = dr.select(of_lobe, mi.UInt32(1), mi.UInt32(0))
            value, bs.pdf = self._evaluate(ctx, si, bs.wo, reflectances, active)
            return bs, dr.select(bs.pdf > 0.0, value / bs.pdf, 0.0)

        def eval_pdf(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> tuple[mi.Spectrum, mi.Float]:
            return self._evaluate(ctx, si, wo, self._reflectances(si, active), active)

        def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool = True) -> mi.Spectrum:
            return self._reflectances(si, active)[0]

        def traverse(self, callback: mi.TraversalCallback) -> None:
            flags = mi.ParamFlags.Differentiable
            callback.put("diffuse_reflectance", self.diffuse, flags)
            callback.put("specular_reflectance", self.specular, flags)
            for name, value in self.lobe.parameters().items():
                callback.put(name, value, flags)

        def parameters_changed(self, keys: list[str]) -> None:
            self.lobe.parameters_changed()
            self._set_components()

        def to_string(self) -> str:
            rows = {"diffuse_reflectance": self.diffuse, "specular_reflectance": self.specular}
            return block(lobe_type.name, **rows, **self.lobe.parameters())

    DiffuseAndLobe.__name__ = DiffuseAndLobe.__qualname__ = f"{lobe_type.name.capitalize()}BSDF"
    return DiffuseAndLobe
