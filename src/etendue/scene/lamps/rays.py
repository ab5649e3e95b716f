"""Rays sampled by an emitter itself."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ..graph import contents, plugin_name
from ..packet import is_spectral


def own_ray(
    emitter: mi.Emitter, u: mi.Point2f, v: mi.Point2f, wavelengths: mi.Spectrum, active: mi.Bool | bool = True
) -> tuple[mi.Ray3f, mi.Spectrum]:
    """A ray that an emitter samples by two pairs of random numbers, and its weight: radiance times cosine over density.

    A spot light is evaluated in a direction of its cone instead, because Mitsuba samples its rays only if its texture
    is uniform or a bitmap. Under spectral variants all emitters are evaluated at the given ``wavelengths``, because
    Mitsuba samples others for each emitter.
    """
    if plugin_name(emitter) == "spot":
        values = dict(contents(emitter).values)
        to_world, cosine = values["to_world"], dr.cos(dr.deg2rad(values["cutoff_angle"]))
        d = dr.normalize(to_world @ mi.warp.square_to_uniform_cone(u, cosine))
        ray = mi.Ray3f(to_world @ mi.Point3f(0.0), d, 0.0, wavelengths)
        ahead = dr.zeros(mi.Interaction3f, dr.width(u))
        ahead.p, ahead.wavelengths = ray.o + ray.d, wavelengths
        ds, intensity = emitter.sample_direction(ahead, v, active)
        return ray, intensity * (dr.square(ds.dist) * dr.two_pi * (1.0 - cosine))
    ray, weight = emitter.sample_ray(0.0, 0.5, u, v, active)
    if is_spectral():
        ray.wavelengths = wavelengths
        weight = _at_wavelengths(emitter, weight, u, v, wavelengths, active)
    return ray, weight


def _at_wavelengths(
    emitter: mi.Emitter, weight: mi.Spectrum, u: mi.Point2f, v: mi.Point2f, wavelengths: mi.Spectrum, active: mi.Bool
) -> mi.Spectrum:
    """The weight of a ray that an emitter of one point or direction has sampled, at wavelengths other than its own."""
    found = contents(emitter)
    textures, scale = dict(found.objects), dict(found.values).get("scale", 1.0)  # of a projector
    (name,) = textures.keys() & {"intensity", "irradiance", "radiance", "color"}
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
    if name == "irradiance":
        si.uv, _ = textures[name].sample_position(v, active)
    elif name == "radiance":
        si = mi.SurfaceInteraction3f(emitter.get_shape().sample_position(0.0, u, active), wavelengths)
    _, own = emitter.sample_wavelengths(si, 0.5, active)
    si.wavelengths = wavelengths
    total = dr.sum(own)
    return textures[name].eval(si, active) * (scale * dr.select(total > 0.0, dr.sum(weight) / total, 0.0))
