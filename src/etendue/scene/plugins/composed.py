"""A material defined by a function composed with :mod:`etendue.integration`, for any scene."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from etendue.core import OptionError, use_variant
from etendue.integration import Integrand

from ..both import pdf_of_both, value_of_both
from ..packet import require_rgb

#: Parameters of a reflectance: texture coordinates, and two directions.
PARAMETERS = 8


def composed_bsdf(f: Integrand) -> mi.BSDF:
    """A Mitsuba material, for ``"bsdf"`` of a scene dictionary, whose BRDF is the function ``f`` [Leeson 2001,
    sec. 5.2].

    Parameters
    ----------
    f: the BRDF, a function of (u, v), the direction towards the light (x, y, z) and the direction towards the eye; unit
        vectors in the frame of the surface, with the normal z. Scalar, or a colour of three values; it must run on the
        device.

    One-sided; wrap it in ``twosided`` for both sides. Directions are sampled by the cosine, since a general function
    cannot be sampled, so narrow lobes are noisy. ``etendue.check`` tests whether it conserves energy and is reciprocal.
    It is evaluated inside kernels and must not contain integrals. Raises :class:`OptionError` for a function with other
    parameters or values, or one that runs on the host only.
    """
    if f.dimension != PARAMETERS or f.values not in (1, 3) or f.on == "host":
        raise OptionError(
            f"a material is a function of {PARAMETERS} parameters (u, v, light x, y, z, eye x, y, z) on the device "
            f"with 1 or 3 values, not one of {f.dimension} parameters on the {f.on} with {f.values} values"
        )
    use_variant()
    if f.values == 3:
        require_rgb("materials of functions with three values")

    class ComposedBSDF(mi.BSDF):
        """f cos, and the density of cosine sampling."""

        eval, pdf = value_of_both, pdf_of_both

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.plugin_name = "composed"
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying
            # Whether the function is isotropic is unknown: assume that it is not, so that stored vertices keep the
            # tangents.
            self.m_components = [flags | mi.BSDFFlags.Anisotropic]
            self.m_flags = self.m_components[0]

        def sample(
            self,
            ctx: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            sample1: mi.Float,
            sample2: mi.Point2f,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
            bs = mi.BSDFSample3f()
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.eta = 1.0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            bs.sampled_component = mi.UInt32(0)
            value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active)
            return bs, dr.select(bs.pdf > 0.0, value / bs.pdf, 0.0)

        def eval_pdf(
            self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
        ) -> tuple[mi.Spectrum, mi.Float]:
            cos = mi.Frame3f.cos_theta(wo)
            active = active & (mi.Frame3f.cos_theta(si.wi) > 0.0) & (cos > 0.0)
            active &= ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0)
            # In Mitsuba light comes from `wo`, since paths begin at the eye.
            found = f.parts(f.evaluate([*si.uv, *wo, *si.wi]))
            value = mi.Spectrum(*found) if f.values == 3 else mi.Spectrum(mi.Float(found[0]))
            return value * cos & active, cos * dr.inv_pi & active

        def to_string(self) -> str:
            return "composed[]"

    return ComposedBSDF(mi.Properties("composed"))
