"""Spherical lights as seen from a point: directions uniform over the cone that the sphere fills.

Half of a sphere's area is out of sight of any point, and most of the rest is seen at a flat angle; a direction uniform
in the cone always meets the light [Shirley 1996]. From within the sphere, points are drawn as on any other area light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.scene import Light

#: Square of radius over distance above which a point counts as one inside.
_INSIDE = 1.0 - 1e-4


@dataclass
class Cone:
    """The cone of directions from a point in which a spherical light lies, one lane each."""

    axis: Any  #: unit vector towards the centre
    sin2: Any  #: squared sine of its half angle
    extent: Any  #: 1 - cosine of its half angle
    applies: Any  #: the light is a sphere, and the point outside of it

    @property
    def density(self) -> Any:
        """Per solid angle, of a direction uniform in the cone."""
        return dr.rcp(dr.two_pi * dr.select(self.applies, self.extent, 1.0))


def cone_of(light: Light, origin: Any) -> Cone:
    """The cone in which a light is seen from ``origin``."""
    centre, radius = light.sphere.xyz, light.sphere.w
    offset = mi.Vector3f(centre) - mi.Vector3f(origin)
    distance_squared = dr.squared_norm(offset)
    sin2 = dr.square(radius) / distance_squared
    applies = (radius > 0.0) & (sin2 < _INSIDE)
    sin2 = dr.select(applies, sin2, 0.5)
    # 1 - cos without the difference of two numbers that are nearly one.
    extent = sin2 / (1.0 + dr.sqrt(1.0 - sin2))
    return Cone(offset * dr.rsqrt(distance_squared), sin2, extent, applies)


def point_in(cone: Cone, light: Light, u: Any) -> tuple[Any, Any]:
    """The point of the light that a direction uniform in the cone meets first: (position, outward normal)."""
    disc = mi.warp.square_to_uniform_disk_concentric(u)
    less = dr.squared_norm(disc) * cone.extent  # 1 - cos of the angle to the axis
    sin2, cos = less * (2.0 - less), 1.0 - less
    # The sine of the angle at the light between direction and normal, by the law of sines.
    sin2_light = dr.minimum(sin2 / cone.sin2, 1.0)
    sin_light, cos_light = dr.sqrt(sin2_light), dr.sqrt(1.0 - sin2_light)
    sin = dr.sqrt(sin2)
    sin_centre, cos_centre = sin_light * cos - cos_light * sin, cos_light * cos + sin_light * sin
    across = sin_centre * dr.rsqrt(dr.maximum(dr.squared_norm(disc), 1e-20))
    frame = mi.Frame3f(cone.axis)
    normal = frame.to_world(mi.Vector3f(disc.x * across, disc.y * across, -cos_centre))
    return mi.Point3f(light.sphere.xyz) + normal * light.sphere.w, normal


def seen_density(light: Light, lit: Any, direction: Any, distance: Any, otherwise: Any) -> Any:
    """Density by area, picking included, with which next event from ``lit`` draws the point of a light that lies
    ``distance`` away along ``direction``; ``otherwise`` where that does not depend on ``lit``."""
    cone = cone_of(light, lit)
    outward = dr.normalize(mi.Vector3f(lit) + direction * distance - mi.Vector3f(light.sphere.xyz))
    cos = dr.maximum(dr.abs(dr.dot(outward, direction)), 1e-8)
    return dr.select(cone.applies, light.pick * cone.density * cos / dr.square(distance), otherwise)
