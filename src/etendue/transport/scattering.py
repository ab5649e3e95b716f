"""Scattering with both densities: the BSDF as bidirectional techniques need it.

Everything is the function that a path tracer integrates, ``f(eye -> light) |cos_s(light)|`` as Mitsuba's ``eval`` gives
it from the eye's side, whichever side a sub-path comes from. A light sub-path therefore evaluates with the two
directions exchanged and converts the cosine by the *geometric* normal. That is Veach's correction for shading normals
[Veach 1997, eq. 5.19], exact for normal and bump maps too, it keeps every technique an estimate of one integral, and
the exchanged call returns the reverse density that the weights want anyway.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from etendue.core.samples import SampleSource

from . import dimensions as dim


@dataclass
class Scattered:
    """One sampled direction, one lane each."""

    direction: Any  #: world
    weight: Any  #: factor on the throughput
    pdf: Any  #: solid-angle density of the direction
    reverse_pdf: Any  #: of the opposite walk at the same vertex
    cos: Any  #: |cos| of the direction and the geometric normal
    eta: Any  #: relative index of refraction along the way
    is_delta: Any
    active: Any


def is_smooth(bsdf: Any) -> Any:
    """Whether a BSDF has a component that can be connected to or merged at."""
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)


def exchanged(si: Any, wo: Any) -> Any:
    """A copy of ``si`` seen from the local direction ``wo``."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wo
    return other


def geometric_cos(si: Any, direction: Any) -> Any:
    """``|cos|`` of a world direction and the geometric normal."""
    return dr.abs(dr.dot(si.n, direction))


def evaluate_from_eye(bsdf: Any, si: Any, wo: Any, active: Any) -> tuple[Any, Any, Any]:
    """(f |cos_s|, pdf, reverse pdf) at a camera vertex towards the light-side local direction ``wo``."""
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo, active)
    reverse = bsdf.pdf(mi.BSDFContext(mi.TransportMode.Importance), exchanged(si, wo), si.wi, active)
    return value, pdf, reverse


def evaluate_from_light(bsdf: Any, si: Any, wo: Any, direction: Any, active: Any) -> tuple[Any, Any]:
    """(f |cos_g|, reverse pdf) at a light vertex towards the eye-side direction ``wo`` (local), ``direction`` (world)."""
    value, reverse = bsdf.eval_pdf(mi.BSDFContext(), exchanged(si, wo), si.wi, active)
    return value * _cosine_ratio(si, direction), reverse


def _cosine_ratio(si: Any, direction: Any) -> Any:
    """cos_g(eye) / cos_g(light): the exchanged value carries the cosine of the light side."""
    cos_light = geometric_cos(si, si.to_world(si.wi))
    return dr.select(cos_light > 0.0, geometric_cos(si, direction) / cos_light, 0.0)


def scatter_camera(bsdf: Any, si: Any, source: SampleSource, vertex: Any, active: Any, reverse: bool = True) -> Scattered:
    """Sample a direction at a camera vertex. ``reverse``: whether the reverse density is wanted."""
    bs, weight = bsdf.sample(
        mi.BSDFContext(), si, source.next_1d(vertex, dim.LOBE), mi.Point2f(*source.next_2d(vertex, dim.DIRECTION)), active
    )
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    reverse_pdf: Any = 0.0
    if reverse:
        context = mi.BSDFContext(mi.TransportMode.Importance)
        reverse_pdf = bsdf.pdf(context, exchanged(si, bs.wo), si.wi, active & ~is_delta)
    direction = si.to_world(bs.wo)
    return Scattered(
        direction, weight, bs.pdf, reverse_pdf, geometric_cos(si, direction), bs.eta, is_delta,
        active & (bs.pdf > 0.0) & dr.any(weight != 0.0),
    )  # fmt: skip


def scatter_light(bsdf: Any, si: Any, source: SampleSource, vertex: Any, active: Any) -> Scattered:
    """Sample a direction at a light vertex; importance transport."""
    bs, weight = bsdf.sample(
        mi.BSDFContext(mi.TransportMode.Importance),
        si,
        source.next_1d(vertex, dim.LOBE),
        mi.Point2f(*source.next_2d(vertex, dim.DIRECTION)),
        active,
    )
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    value, reverse_pdf = bsdf.eval_pdf(mi.BSDFContext(), exchanged(si, bs.wo), si.wi, active & ~is_delta)
    direction = si.to_world(bs.wo)
    ratio = _cosine_ratio(si, direction)
    # A delta lobe has no density to divide by: its sampled weight, made adjoint by the cosines of both normals.
    shading = dr.abs(mi.Frame3f.cos_theta(si.wi) / mi.Frame3f.cos_theta(bs.wo))
    weight = dr.select(is_delta, weight * shading * ratio, value * (ratio * dr.rcp(bs.pdf)))
    return Scattered(
        direction, weight, bs.pdf, reverse_pdf, geometric_cos(si, direction), bs.eta, is_delta,
        active & (bs.pdf > 0.0) & dr.any(weight != 0.0),
    )  # fmt: skip


def roulette(throughput: Any, eta: Any, depth: Any, first_depth: int, u: Any) -> tuple[Any, Any]:
    """Russian roulette by throughput from ``first_depth`` on: (survives, factor on the throughput).

    ``eta`` undoes the radiance scaling of refraction, so that paths inside glass are not cut short; pass 1 for light
    sub-paths, whose throughput carries none.
    """
    survival = dr.minimum(dr.max(throughput) * dr.square(eta), 0.95)
    playing = depth >= first_depth
    return ~playing | (u < survival), dr.select(playing, dr.rcp(survival), 1.0)
