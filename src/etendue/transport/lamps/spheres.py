"""Sampling of spherical lights by solid angle: directions uniform in the cone that the sphere subtends at a point.

At least half of a sphere's area is invisible from a point outside, and much of the rest is seen at a grazing angle. A
direction uniform in the cone always hits the sphere [Shirley 1996]. For points inside the sphere, the light is sampled
by area, as other area lights are.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from etendue.scene import Light

#: (radius / distance from the centre)^2 from which on a point counts as inside the sphere.
_INSIDE = 1.0 - 1e-4


@dataclass
class Cone:
    """The cone of directions that a spherical light subtends at a point, one lane each."""

    axis: mi.Vector3f  #: unit vector towards the centre
    sin2: mi.Float  #: squared sine of the half angle
    extent: mi.Float  #: 1 - cosine of the half angle
    applies: mi.Bool  #: whether the light is a sphere and the point outside it

    @property
    def density(self) -> mi.Float:
        """Solid-angle density of a direction uniform in the cone."""
        return dr.rcp(dr.two_pi * dr.select(self.applies, self.extent, 1.0))


def _sphere(light: Light) -> mi.Vector4f:
    assert light.sphere is not None, "the scene has no spherical light"
    return light.sphere


def cone_of(light: Light, origin: mi.Point3f) -> Cone:
    """The cone that a light subtends at ``origin``."""
    sphere = _sphere(light)
    centre, radius = sphere.xyz, sphere.w
    offset = mi.Vector3f(centre) - mi.Vector3f(origin)
    distance_squared = dr.squared_norm(offset)
    sin2 = dr.square(radius) / distance_squared
    applies = (radius > 0.0) & (sin2 < _INSIDE)
    sin2 = dr.select(applies, sin2, 0.5)
    # 1 - cos without cancellation.
    extent = sin2 / (1.0 + dr.sqrt(1.0 - sin2))
    return Cone(offset * dr.rsqrt(distance_squared), sin2, extent, applies)


def point_in(cone: Cone, light: Light, u: mi.Point2f) -> tuple[mi.Point3f, mi.Vector3f]:
    """The point where a direction uniform in the cone hits the light first: (position, outward normal)."""
    disc = mi.warp.square_to_uniform_disk_concentric(u)
    one_minus_cos = dr.squared_norm(disc) * cone.extent  # of the angle between direction and axis
    sin2, cos = one_minus_cos * (2.0 - one_minus_cos), 1.0 - one_minus_cos
    # Angle between direction and normal at the light: law of sines.
    sin2_light = dr.minimum(sin2 / cone.sin2, 1.0)
    sin_light, cos_light = dr.sqrt(sin2_light), dr.sqrt(1.0 - sin2_light)
    sin = dr.sqrt(sin2)
    sin_centre, cos_centre = sin_light * cos - cos_light * sin, cos_light * cos + sin_light * sin
    across = sin_centre * dr.rsqrt(dr.maximum(dr.squared_norm(disc), 1e-20))
    frame = mi.Frame3f(cone.axis)
    normal = frame.to_world(mi.Vector3f(disc.x * across, disc.y * across, -cos_centre))
    sphere = _sphere(light)
    return mi.Point3f(sphere.xyz) + normal * sphere.w, normal


def seen_density(
    light: Light, lit: mi.Point3f, direction: mi.Vector3f, distance: mi.Float, otherwise: mi.Float
) -> mi.Float:
    """Area density, light selection included, with which next event at the point ``lit`` samples the point of a light
    at ``distance`` along ``direction``; ``otherwise`` where the light is not sampled by solid angle."""
    cone = cone_of(light, lit)
    outward = dr.normalize(mi.Vector3f(lit) + direction * distance - mi.Vector3f(_sphere(light).xyz))
    cos = dr.maximum(dr.abs(dr.dot(outward, direction)), 1e-8)
    return dr.select(cone.applies, light.pick * cone.density * cos / dr.square(distance), otherwise)
