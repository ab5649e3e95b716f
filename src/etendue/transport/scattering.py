"""Scattering with both densities: the BSDF as bidirectional techniques need it.

Everything is the function that a path tracer integrates, ``f(eye -> light) |cos_s(light)|`` as Mitsuba's ``eval`` gives
it from the eye's side, whichever side a sub-path comes from. A light sub-path therefore evaluates with the two
directions exchanged and converts the cosine by the *geometric* normal. That is Veach's correction for shading normals
[Veach 1997, eq. 5.19], exact for normal and bump maps too, it keeps every technique an estimate of one integral, and
the exchanged call returns the reverse density that the weights want anyway.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource

from . import dimensions as dim

#: Cosine below which a direction lies in the surface.
_GRAZING = 1e-6


@dataclass
class Scattered:
    """One sampled direction, one lane each."""

    direction: mi.Vector3f  #: world
    weight: mi.Color3f  #: factor on the throughput
    pdf: mi.Float  #: solid-angle density of the direction
    reverse_pdf: mi.Float  #: of the opposite walk at the same vertex
    cos: mi.Float  #: |cos| of the direction and the geometric normal
    eta: mi.Float  #: relative index of refraction along the way
    is_delta: mi.Bool
    is_null: mi.Bool  #: went straight on through a null component
    active: mi.Bool


@dataclass
class Evaluated:
    """A BSDF towards one given direction, one lane each."""

    value: mi.Color3f  #: f |cos_s(light side)|
    pdf: mi.Float  #: solid-angle density of the direction
    reverse_pdf: mi.Float  #: of the opposite walk


class Proposal(Protocol):
    """Samples directions at a vertex: from the BSDF, uniformly, or from a guide."""

    def __call__(
        self,
        bsdf: mi.BSDFPtr,
        si: mi.SurfaceInteraction3f,
        source: SampleSource,
        vertex: mi.UInt32,
        active: mi.Bool,
        directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
    ) -> tuple[Scattered, list[Evaluated]]:
        """Sample a direction with the random numbers of ``vertex``, and evaluate the BSDF in the given (local
        direction, mask) pairs."""
        ...


def is_smooth(bsdf: mi.BSDFPtr) -> mi.Bool:
    """Whether a BSDF has a component that can be connected to or merged at."""
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)


def exchanged(si: mi.SurfaceInteraction3f, wo: mi.Vector3f) -> mi.SurfaceInteraction3f:
    """A copy of ``si`` seen from the local direction ``wo``."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wo
    return other


def geometric_cos(si: mi.SurfaceInteraction3f, direction: mi.Vector3f) -> mi.Float:
    """``|cos|`` of a world direction and the geometric normal."""
    return dr.abs(dr.dot(si.n, direction))


def evaluate_camera_end(bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
    """The BSDF at a camera vertex towards the light-side local direction ``wo``."""
    return Evaluated(*dr.dispatch(bsdf, _camera_end, si, wo, active))


def evaluate_light_end(bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
    """The BSDF at a light vertex towards the eye-side local direction ``wo``; its value, times :func:`cosine_ratio`,
    is the adjoint BSDF times its cosine."""
    return Evaluated(*dr.dispatch(bsdf, _light_end, si, wo, active))


def _camera_end(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float, mi.Float]:
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo, active)
    reverse = bsdf.pdf(mi.BSDFContext(mi.TransportMode.Importance), exchanged(si, wo), si.wi, active)
    return _leaving(wo, value, pdf, reverse)


def _light_end(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float, mi.Float]:
    value, reverse = bsdf.eval_pdf(mi.BSDFContext(), exchanged(si, wo), si.wi, active)
    pdf = bsdf.pdf(mi.BSDFContext(mi.TransportMode.Importance), si, wo, active)
    return _leaving(wo, value, pdf, reverse)


def _leaving(wo: mi.Vector3f, value: mi.Color3f, *densities: mi.Float) -> tuple[Any, ...]:
    """Nothing for directions in the surface: they carry nothing, and some materials answer 0 / 0 there."""
    leaves = dr.abs(mi.Frame3f.cos_theta(wo)) > _GRAZING
    return value & leaves, *(dr.select(leaves, pdf, 0.0) for pdf in densities)


def cosine_ratio(si: mi.SurfaceInteraction3f, direction: mi.Vector3f) -> mi.Float:
    """cos_g(eye) / cos_g(light) at a light vertex, ``direction`` pointing to the eye side: what turns the value of
    :func:`evaluate_light_end`, which holds the cosine of the light side, into the adjoint BSDF times its cosine."""
    cos_light = geometric_cos(si, si.to_world(si.wi))
    return dr.select(cos_light > 0.0, geometric_cos(si, direction) / cos_light, 0.0)


def scatter_camera(
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """Sample a direction at a camera vertex, and evaluate towards the given (local direction, mask) pairs."""
    return _scatter(_sample_camera, _camera_end, bsdf, si, source, vertex, active, directions)


def scatter_light(
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """The same at a light vertex, for importance."""
    scattered, evaluated = _scatter(_sample_light, _light_end, bsdf, si, source, vertex, active, directions)
    ratio = cosine_ratio(si, scattered.direction)
    # A delta lobe has no density to divide by: its sampled weight, made adjoint by the cosines of both normals.
    wo = si.to_local(scattered.direction)
    shading = dr.select(scattered.is_delta, dr.abs(mi.Frame3f.cos_theta(si.wi) / mi.Frame3f.cos_theta(wo)), 1.0)
    scattered.weight *= ratio * shading
    return scattered, evaluated


def scatter_uniform(
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """As :func:`scatter_camera`, but knowing nothing of the BSDF: directions are uniform over the sphere of the world's
    directions, or the half of it that a surface which lets no light through reflects to.

    What is wanted of the other half is turned round, so that a place in the square of random numbers means the same
    axis wherever the surface faces. Delta components are left to the BSDF, which one number in two goes to where the
    BSDF also has others.
    """
    return _scatter(_sample_uniform, _uniform_end, bsdf, si, source, vertex, active, directions)


def _scatter(
    sample: Any,
    evaluate: Any,
    bsdf: mi.BSDFPtr,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Any,
) -> tuple[Scattered, list[Evaluated]]:
    """One call a BSDF for everything that is asked of it: a call of its own for each question costs a seventh more."""
    # An even number for the lobe costs time and gains nothing that could be measured.
    u = source.decide(vertex, dim.LOBE), mi.Point2f(*source.next_2d(vertex, dim.DIRECTION))

    def ask(self: Any, si: mi.SurfaceInteraction3f, u: Any, active: mi.Bool, directions: list[tuple[Any, Any]]) -> Any:
        return sample(self, si, u, active), [evaluate(self, si, wo, mask) for wo, mask in directions]

    sampled, evaluated = dr.dispatch(bsdf, ask, si, u, active, list(directions))
    wo, weight, pdf, reverse_pdf, eta, lobe = sampled
    is_delta, is_null = mi.has_flag(lobe, mi.BSDFFlags.Delta), mi.has_flag(lobe, mi.BSDFFlags.Null)
    direction = si.to_world(wo)
    active = active & ~(pdf <= 0.0) & ~dr.all(weight == 0.0)  # NaN goes on, to be counted
    cos = geometric_cos(si, direction)
    scattered = Scattered(direction, weight, pdf, reverse_pdf, cos, eta, is_delta, is_null, active)
    return scattered, [Evaluated(*e) for e in evaluated]


def _sample_camera(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, u: tuple[mi.Float, mi.Point2f], active: mi.Bool
) -> tuple[Any, ...]:
    bs, weight = bsdf.sample(mi.BSDFContext(), si, *u, active)
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    reverse_pdf = bsdf.pdf(context, exchanged(si, bs.wo), si.wi, active & ~is_delta)
    return bs.wo, weight, bs.pdf, reverse_pdf, bs.eta, bs.sampled_type


def _sample_light(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, u: tuple[mi.Float, mi.Point2f], active: mi.Bool
) -> tuple[Any, ...]:
    bs, weight = bsdf.sample(mi.BSDFContext(mi.TransportMode.Importance), si, *u, active)
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    value, reverse_pdf = bsdf.eval_pdf(mi.BSDFContext(), exchanged(si, bs.wo), si.wi, active & ~is_delta)
    # A sample that the BSDF itself rejects stays rejected, whatever the value in its direction.
    taken = ~dr.all(weight == 0.0)
    weight = dr.select(is_delta, weight, dr.select(taken, value * dr.rcp(bs.pdf), 0.0))
    return bs.wo, weight, bs.pdf, reverse_pdf, bs.eta, bs.sampled_type


def _sample_uniform(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, u: tuple[mi.Float, mi.Point2f], active: mi.Bool
) -> tuple[Any, ...]:
    lobe, u_direction = u
    share, pdf = _uniform_share(bsdf)
    smooth = active & (lobe < share)
    world = mi.warp.square_to_uniform_sphere(u_direction)
    wo = si.to_local(world)
    if not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission):
        wo = dr.select(mi.Frame3f.cos_theta(wo) * mi.Frame3f.cos_theta(si.wi) < 0.0, -wo, wo)
    value, pdf, reverse_pdf = _uniform_end(bsdf, si, wo, smooth)
    weight = value / dr.maximum(pdf, 1e-12)
    eta, kind = mi.Float(1.0), mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
    if share == 1.0:
        return wo, weight, pdf, reverse_pdf, eta, kind
    # A sample of the BSDF counts only where it is one of a delta component.
    rest = (lobe - share) / (1.0 - share)
    bs, delta_weight = bsdf.sample(mi.BSDFContext(), si, rest, u_direction, active & ~smooth)
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    delta_weight = dr.select(is_delta, delta_weight / (1.0 - share), 0.0)
    return (
        dr.select(smooth, wo, bs.wo),
        dr.select(smooth, weight, delta_weight),
        dr.select(smooth, pdf, bs.pdf),
        dr.select(smooth, reverse_pdf, 0.0),
        dr.select(smooth, eta, bs.eta),
        dr.select(smooth, kind, bs.sampled_type),
    )


def _uniform_end(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Color3f, mi.Float, mi.Float]:
    value = bsdf.eval(mi.BSDFContext(), si, wo, active)
    _, pdf = _uniform_share(bsdf)
    return _leaving(wo, value, mi.Float(pdf), mi.Float(pdf))


def _uniform_share(bsdf: mi.BSDFPtr) -> tuple[float, float]:
    """Share of the samples that are uniform, and their density."""
    flags = bsdf.flags()
    if not mi.has_flag(flags, mi.BSDFFlags.Smooth):
        share = 0.0
    else:
        share = 0.5 if mi.has_flag(flags, mi.BSDFFlags.Delta) else 1.0
    return share, share / (4.0 if mi.has_flag(flags, mi.BSDFFlags.Transmission) else 2.0) / dr.pi


def roulette(
    throughput: mi.Color3f, eta: mi.Float, depth: mi.UInt32, first_depth: int, u: mi.Float
) -> tuple[mi.Bool, mi.Float]:
    """Russian roulette by throughput from ``first_depth`` on: (survives, factor on the throughput).

    ``eta`` undoes the radiance scaling of refraction, so that paths inside glass are not cut short; pass 1 for light
    sub-paths, whose throughput carries none.
    """
    survival = dr.minimum(dr.max(throughput) * dr.square(eta), 0.95)
    playing = depth >= first_depth
    return ~playing | ~(u >= survival), dr.select(playing, dr.rcp(survival), 1.0)


def shadow_roulette(
    contributions: Sequence[mi.Color3f], threshold: mi.Float, u: mi.Float, active: mi.Bool
) -> tuple[mi.Bool, mi.Float]:
    """Decide before a shadow ray is cast whether its contribution is worth it: (goes on, factor on the contribution).
    Of several that share the ray the largest decides.

    A contribution, complete with its weight, below ``threshold`` goes on with probability contribution / threshold. One
    may be negative: filters have negative lobes. One that is NaN goes on, to be counted where contributions are summed
    (hence ``~(x == 0)``, here and elsewhere: no comparison holds for NaN, ``!=`` included).
    """
    size = functools.reduce(dr.maximum, (dr.max(dr.abs(contribution)) for contribution in contributions))
    survival = dr.select(size >= threshold, 1.0, size / threshold)
    return active & ~(size == 0.0) & ~(u >= survival), dr.rcp(survival)
