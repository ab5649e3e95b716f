"""What surrounds the camera: the surfaces that short paths meet, and how much of the sky these surfaces see."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.core import Array, SampleSource
from etendue.scene import corners_of

from . import dimensions as dim

#: Shares of the surfaces left out at either end of each axis of their box, and least number of them.
_TAIL, _LEAST = 0.01, 64


@dataclass(frozen=True)
class Surroundings:
    """``sky``: share of the hemispheres over the surfaces that camera rays hit which no other surface hides; 1 if the
    rays hit nothing. ``lower``, ``upper``: corners of a box around nearly all of these surfaces and those that they
    see."""

    sky: float
    lower: Array
    upper: Array


def surroundings(scene: mi.Scene, ray: mi.Ray3f, source: SampleSource) -> Surroundings:
    """The surroundings by camera rays and one ray, of uniform direction, from the surface that each hits."""
    first = scene.ray_intersect(ray)
    hit = first.is_valid()
    up = mi.warp.square_to_uniform_hemisphere(mi.Point2f(*source.next_2d(1, dim.DIRECTION)))
    towards = dr.mulsign(mi.Frame3f(first.n).to_world(up), dr.dot(first.n, -ray.d))
    second = scene.ray_intersect(first.spawn_ray(towards), hit)
    again = hit & second.is_valid()
    dr.eval(first.p, second.p, hit, again)
    held = [np.array(p, np.float64).T[np.array(mask)] for p, mask in ((first.p, hit), (second.p, again))]
    seen, (lower, upper) = len(held[0]), corners_of(scene)
    if seen >= _LEAST:
        lower, upper = np.quantile(np.concatenate(held), (_TAIL, 1.0 - _TAIL), axis=0)
    return Surroundings(1.0 - len(held[1]) / seen if seen else 1.0, lower, upper)
