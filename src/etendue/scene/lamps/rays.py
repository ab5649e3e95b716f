"""Rays sampled by an emitter itself."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..graph import contents, plugin_name


def own_ray(
    emitter: mi.Emitter, u: mi.Point2f, v: mi.Point2f, active: mi.Bool | bool = True
) -> tuple[mi.Ray3f, mi.Color3f]:
    """A ray that an emitter samples by two pairs of random numbers, and its weight: radiance times cosine over density.

    A spot light is evaluated in a direction of its cone instead, because Mitsuba samples its rays only if its texture
    is uniform or a bitmap.
    """
    if plugin_name(emitter) != "spot":
        return emitter.sample_ray(0.0, 0.5, u, v, active)
    values = dict(contents(emitter).values)
    to_world, cosine = values["to_world"], dr.cos(dr.deg2rad(values["cutoff_angle"]))
    ray = mi.Ray3f(to_world @ mi.Point3f(0.0), dr.normalize(to_world @ mi.warp.square_to_uniform_cone(u, cosine)))
    ahead = dr.zeros(mi.Interaction3f, dr.width(u))
    ahead.p = ray.o + ray.d
    ds, intensity = emitter.sample_direction(ahead, v, active)
    return ray, intensity * (dr.square(ds.dist) * dr.two_pi * (1.0 - cosine))
