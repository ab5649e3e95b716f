"""Sampling of directions by a power of the cosine around the z axis, shared by the Phong lobe and the focused light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def square_to_cosine_power(u: mi.Point2f, exponent: mi.Float) -> mi.Vector3f:
    """Direction of density (exponent + 1) / (2 pi) cos^exponent over the upper hemisphere, ``u`` in [0, 1)^2.

    A uniform point of the unit disc, lifted: cos^(exponent + 1) and 1 - r^2 are uniform. Exponent 1 gives Mitsuba's
    ``square_to_cosine_hemisphere``.
    """
    disk = mi.warp.square_to_uniform_disk_concentric(u)
    r2 = dr.squared_norm(disk)
    cos = dr.exp(dr.log(dr.maximum(1.0 - r2, 1e-7)) / (exponent + 1.0))
    scale = dr.safe_sqrt(1.0 - dr.square(cos)) * dr.rsqrt(dr.maximum(r2, 1e-20))
    return mi.Vector3f(disk.x * scale, disk.y * scale, cos)


def square_to_cosine_power_pdf(cos: mi.Float, exponent: mi.Float) -> mi.Float:
    """The solid-angle density of :func:`square_to_cosine_power` at the cosine ``cos``; 0 below the horizon."""
    return dr.select(cos > 0.0, (exponent + 1.0) * (0.5 * dr.inv_pi) * dr.power(dr.maximum(cos, 0.0), exponent), 0.0)
