"""``eval`` and ``pdf`` of BSDFs in Python that compute both together: Mitsuba's classes allow no second base."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import mitsuba as mi


def value_of_both(
    bsdf: Any, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
) -> mi.Spectrum:
    """The value of ``eval_pdf``: the BSDF times the cosine."""
    return bsdf.eval_pdf(ctx, si, wo, active)[0]


def pdf_of_both(
    bsdf: Any, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool | bool = True
) -> mi.Float:
    """The density of ``eval_pdf``: that of ``wo``."""
    return bsdf.eval_pdf(ctx, si, wo, active)[1]
