"""The lobe of Ward's model: BSDF ``ward``, isotropic and anisotropic.

    f(wi, wo) = k_d / pi + k_s exp(-tan^2 t_h (cos^2 p_h / a_u^2 + sin^2 p_h / a_v^2))
                               / (4 pi a_u a_v sqrt(cos_i cos_o))

with (t_h, p_h) the half vector in the frame of the surface and a_u, a_v the RMS slopes along its tangents [Ward 1992].
Towards grazing incidence the albedo of this lobe is unbounded. The cosines under the root are therefore clamped to at
least min(a^3 / 4, 1/20), ``a`` the larger slope: the model is exact except for directions that close to the surface
(within 0.1 degrees of it for a = 0.2, 3 for a = 0.6), stays reciprocal, and reflects less than k_s for every slope.
The bound follows from the lobe's albedo near grazing, at most 0.36 sqrt(a^3 / cos_i).

Parameters: ``diffuse_reflectance`` (0.5), ``specular_reflectance`` (0.2), colours or textures, scaled down in a channel
whose sum exceeds 1; ``alpha`` (0.1), or ``alpha_u`` and ``alpha_v``, numbers above 0; the model is meant for values up
to about 0.2. One-sided; wrap it in ``twosided`` for both sides.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import OptionError

from .parameters import check_range, make_opaque, number


class WardLobe:
    """Evaluates and samples the lobe for k_s = 1; directions are local, both above the surface where active."""

    name = "ward"

    def __init__(self, props: mi.Properties) -> None:
        if "alpha" in props and ("alpha_u" in props or "alpha_v" in props):
            raise OptionError("'ward' has either 'alpha', or 'alpha_u' and 'alpha_v'; remove one or the other")
        if ("alpha_u" in props) != ("alpha_v" in props):
            raise OptionError("'ward' needs both 'alpha_u' and 'alpha_v', or 'alpha' for both; add the missing one")
        key_u, key_v = ("alpha_u", "alpha_v") if "alpha_u" in props else ("alpha", "alpha")
        self.alpha_u, self.alpha_v = number(props, key_u, 0.1), number(props, key_v, 0.1)
        self.parameters_changed()

    @property
    def is_anisotropic(self) -> bool:
        """Whether the slopes differ."""
        return float(np.asarray(self.alpha_u)[0]) != float(np.asarray(self.alpha_v)[0])

    def parameters(self) -> dict[str, mi.Float]:
        """The parameters for ``mi.traverse``."""
        return {"alpha_u": self.alpha_u, "alpha_v": self.alpha_v}

    def parameters_changed(self) -> None:
        """Check the parameters, and make them opaque."""
        for key, value in self.parameters().items():
            check_range(self.name, key, value, 0.0, strict=True)
        make_opaque(self.alpha_u, self.alpha_v)

    def evaluate(self, wi: mi.Vector3f, wo: mi.Vector3f) -> tuple[mi.Float, mi.Float]:
        """The lobe without its cosine, and the solid-angle density of sampling ``wo``."""
        h = dr.normalize(wi + wo)
        slope_u, slope_v = h.x / (self.alpha_u * h.z), h.y / (self.alpha_v * h.z)
        gauss = dr.exp(-dr.square(slope_u) - dr.square(slope_v)) / (4.0 * dr.pi * self.alpha_u * self.alpha_v)
        larger = dr.maximum(self.alpha_u, self.alpha_v)
        least = dr.minimum(0.25 * larger * dr.square(larger), 0.05)
        value = gauss * dr.rsqrt(dr.maximum(wi.z, least) * dr.maximum(wo.z, least))
        # The density of slopes is 4 gauss; of half vectors, per solid angle, 4 gauss / h.z^3; of mirrored directions
        # the latter over 4 dot(h, wi) [Walter 2005].
        return value, gauss / (dr.dot(h, wi) * h.z * dr.square(h.z))

    def sample(self, wi: mi.Vector3f, u: mi.Point2f) -> mi.Vector3f:
        """A direction mirrored at a half vector of Gaussian slopes; it may be below the surface."""
        radius = dr.sqrt(-dr.log(1.0 - u.x))
        sin, cos = dr.sincos(dr.two_pi * u.y)
        h = dr.normalize(mi.Vector3f(self.alpha_u * radius * cos, self.alpha_v * radius * sin, 1.0))
        return mi.reflect(wi, h)
