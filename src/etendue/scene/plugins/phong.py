"""The lobe of the modified Phong model: BSDF ``phong``.

    f(wi, wo) = k_d / pi + k_s (n + 2) / (2 pi) max(0, cos a)^n        a: angle of wo and the mirror direction of wi

[LafortuneWillems 1994]. It is reciprocal, since ``cos a`` is, and conserves energy for k_d + k_s <= 1: the lobe
reflects k_s at normal incidence and less elsewhere, where part of it is below the surface.

Parameters: ``diffuse_reflectance`` (0.5), ``specular_reflectance`` (0.2), colours or textures, scaled down in a channel
whose sum exceeds 1; ``exponent`` (30), a number of at least 0. One-sided; wrap it in ``twosided`` for both sides.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .parameters import check_range, make_opaque, number
from .warps import square_to_cosine_power, square_to_cosine_power_pdf


class PhongLobe:
    """Evaluates and samples the lobe for k_s = 1; directions are local, both above the surface where active."""

    name = "phong"

    def __init__(self, props: mi.Properties) -> None:
        self.exponent = number(props, "exponent", 30.0)
        self.parameters_changed()

    @property
    def is_anisotropic(self) -> bool:
        """False."""
        return False

    def parameters(self) -> dict[str, mi.Float]:
        """The parameters for ``mi.traverse``."""
        return {"exponent": self.exponent}

    def parameters_changed(self) -> None:
        """Check the parameters, and make them opaque."""
        check_range(self.name, "exponent", self.exponent, 0.0)
        make_opaque(self.exponent)

    def evaluate(self, wi: mi.Vector3f, wo: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        """The lobe without its cosine, and the solid-angle density of sampling ``wo``: powers of one cosine."""
        pdf = square_to_cosine_power_pdf(dr.dot(mi.reflect(wi), wo), self.exponent)
        return pdf * ((self.exponent + 2.0) / (self.exponent + 1.0)), pdf

    def sample(self, wi: mi.Vector3f, u: mi.Point2f) -> mi.Vector3f:
        """A direction around the mirror direction; it may be below the surface."""
        return mi.Frame3f(mi.reflect(wi)).to_world(square_to_cosine_power(u, self.exponent))
