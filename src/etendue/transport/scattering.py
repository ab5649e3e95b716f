"""BSDF sampling and evaluation with the densities of both directions, as bidirectional techniques need them.

All techniques evaluate the same function, the integrand of path tracing: ``f(eye -> light) |cos_s(light)|``, which
Mitsuba's ``eval`` returns for a camera sub-path. A light sub-path evaluates the BSDF with the two directions exchanged
and converts the cosine by the *geometric* normal, which is Veach's correction for shading normals [Veach 1997,
eq. 5.19]. It is exact for normal and bump maps, too. The exchanged call also returns the reverse density, which the
MIS weights need.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import drjit as dr
import mitsuba as mi

from etendue.core import SampleSource
from etendue.scene import Material, is_phase

from . import dimensions as dim

#: Cosine up to which a direction counts as tangential.
_GRAZING = 1e-6


@dataclass
class Scattered:
    """One sampled direction, one lane each."""

    direction: mi.Vector3f  #: world
    weight: mi.Spectrum  #: factor on the throughput
    pdf: mi.Float  #: solid-angle density of the direction
    reverse_pdf: mi.Float  #: solid-angle density of sampling the incoming direction from the sampled one
    cos: mi.Float  #: |cos| of the direction and the geometric normal
    eta: mi.Float  #: relative index of refraction
    is_delta: mi.Bool
    is_null: mi.Bool  #: the null component was sampled: the path crosses the surface
    active: mi.Bool
    by_guide: mi.Bool | None = None  #: whether a guide has sampled it; None without one


@dataclass
class Evaluated:
    """A BSDF evaluated for one given direction, one lane each."""

    value: mi.Spectrum  #: f |cos_s(light side)|
    pdf: mi.Float  #: solid-angle density of the direction
    reverse_pdf: mi.Float  #: solid-angle density of sampling the incoming direction from the given one
    plain_pdf: mi.Float | None = None  #: the density by the BSDF alone, where ``pdf`` is that of a guide, too


#: A sampled local direction: (wo, weight, pdf, reverse_pdf, eta, flags of the sampled component).
_Sampled: TypeAlias = "tuple[mi.Vector3f, mi.Spectrum, mi.Float, mi.Float, mi.Float, mi.UInt32]"
_Sample: TypeAlias = "Callable[[mi.BSDF, mi.SurfaceInteraction3f, tuple[mi.Float, mi.Point2f], mi.Bool], _Sampled]"
_Evaluate: TypeAlias = (
    "Callable[[mi.BSDF, mi.SurfaceInteraction3f, mi.Vector3f, mi.Bool], tuple[mi.Spectrum, mi.Float, mi.Float]]"
)


class Proposal(Protocol):
    """Samples directions at a vertex: from the BSDF, uniformly, or from a guide."""

    def __call__(
        self,
        bsdf: Material,
        si: mi.SurfaceInteraction3f,
        source: SampleSource,
        vertex: mi.UInt32,
        active: mi.Bool,
        directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
    ) -> tuple[Scattered, list[Evaluated]]:
        """Sample a direction with the random numbers of ``vertex``, and evaluate the BSDF in the given (local
        direction, mask) pairs."""
        ...


def is_smooth(bsdf: Material) -> mi.Bool:
    """Whether a BSDF has a component without delta functions, so that vertices can be connected or merged."""
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)


def exchanged(si: mi.SurfaceInteraction3f, wo: mi.Vector3f) -> mi.SurfaceInteraction3f:
    """A copy of ``si`` with the local direction ``wo`` as ``wi``."""
    other = mi.SurfaceInteraction3f(si)
    other.wi = wo
    return other


def geometric_cos(si: mi.SurfaceInteraction3f, direction: mi.Vector3f, in_medium: mi.Bool | None = None) -> mi.Float:
    """``|cos|`` of a world direction and the geometric normal; 1 ``in_medium``."""
    cos = dr.abs(dr.dot(si.n, direction))
    return cos if in_medium is None else dr.select(in_medium, 1.0, cos)


def evaluate_camera_end(bsdf: Material, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
    """The BSDF at a camera vertex for the local direction ``wo`` of the light side."""
    return Evaluated(*bsdf.call(_camera_end, si, wo, active=active))


def evaluate_light_end(bsdf: Material, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool) -> Evaluated:
    """The BSDF at a light vertex for the local direction ``wo`` of the eye side; the value times :func:`cosine_ratio`
    is the adjoint BSDF times its cosine."""
    # The camera end with the directions exchanged: a kernel then holds one function for both ends.
    value, reverse, pdf = bsdf.call(_camera_end, exchanged(si, wo), si.wi, active=active)
    return Evaluated(value, pdf, reverse)


# Functions that are dispatched get the BSDF as an object, not as a pointer.


def _camera_end(
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo, active)
    reverse = bsdf.pdf(mi.BSDFContext(mi.TransportMode.Importance), exchanged(si, wo), si.wi, active)
    return _not_tangential(bsdf, si.wi, wo, value, pdf, reverse)


def _light_end(
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    value, reverse, pdf = _camera_end(bsdf, exchanged(si, wo), si.wi, active)
    return value, pdf, reverse


def _not_tangential(
    bsdf: mi.BSDF, wi: mi.Vector3f, wo: mi.Vector3f, value: mi.Spectrum, pdf: mi.Float, reverse_pdf: mi.Float
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    """The same values, 0 if one of the directions is tangential to a surface, for which some materials return NaN."""
    if is_phase(bsdf):
        return value, pdf, reverse_pdf
    valid = dr.minimum(*(dr.abs(mi.Frame3f.cos_theta(w)) for w in (wi, wo))) > _GRAZING
    return value & valid, dr.select(valid, pdf, 0.0), dr.select(valid, reverse_pdf, 0.0)


def cosine_ratio(si: mi.SurfaceInteraction3f, direction: mi.Vector3f, in_medium: mi.Bool | None = None) -> mi.Float:
    """cos_g(eye) / cos_g(light) at a light vertex; ``direction`` points to the eye side. The value of
    :func:`evaluate_light_end` holds the cosine of the light side; times this ratio, it is the adjoint BSDF times its
    cosine. 1 ``in_medium``."""
    cos_light = geometric_cos(si, si.to_world(si.wi), in_medium)
    return dr.select(cos_light > 0.0, geometric_cos(si, direction, in_medium) / cos_light, 0.0)


def scatter_camera(
    bsdf: Material,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """Sample a direction at a camera vertex, and evaluate the BSDF for the given (local direction, mask) pairs."""
    return _scatter(_sample_camera, _camera_end, bsdf, si, source, vertex, active, directions)


def scatter_light(
    bsdf: Material,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """As :func:`scatter_camera` at a light vertex; weights are those of the adjoint BSDF."""
    scattered, evaluated = _scatter(_sample_light, _light_end, bsdf, si, source, vertex, active, directions)
    _make_adjoint(scattered, si, bsdf.in_medium)
    return scattered, evaluated


def _make_adjoint(scattered: Scattered, si: mi.SurfaceInteraction3f, in_medium: mi.Bool | None) -> None:
    """Bring the weight at a light vertex, which has the cosine of the light side, to the adjoint BSDF."""
    ratio = cosine_ratio(si, scattered.direction, in_medium)
    # A delta lobe cannot be evaluated: its sampled weight is made adjoint by the cosines of both normals.
    wo = si.to_local(scattered.direction)
    shading = dr.select(scattered.is_delta, dr.abs(mi.Frame3f.cos_theta(si.wi) / mi.Frame3f.cos_theta(wo)), 1.0)
    scattered.weight *= ratio * shading


def scatter_uniform(
    bsdf: Material,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """As :func:`scatter_camera`, with directions that are uniform over the sphere, or over a hemisphere for BSDFs
    without transmission.

    Random numbers are mapped to world directions. A direction on the wrong side of a surface without transmission is
    negated, so that the same numbers give the same axis at all surfaces. Delta components are sampled by the BSDF, with
    probability 1/2 where the BSDF also has others.
    """
    return _scatter(_sample_uniform, _uniform_end, bsdf, si, source, vertex, active, directions)


def scatter_light_uniform(
    bsdf: Material,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]] = (),
) -> tuple[Scattered, list[Evaluated]]:
    """As :func:`scatter_uniform` at a light vertex; weights are those of the adjoint BSDF."""
    sample = functools.partial(_sample_uniform, light=True)
    evaluate = functools.partial(_uniform_end, light=True)
    scattered, evaluated = _scatter(sample, evaluate, bsdf, si, source, vertex, active, directions)
    _make_adjoint(scattered, si, bsdf.in_medium)
    return scattered, evaluated


def _scatter(
    sample: _Sample,
    evaluate: _Evaluate,
    bsdf: Material,
    si: mi.SurfaceInteraction3f,
    source: SampleSource,
    vertex: mi.UInt32,
    active: mi.Bool,
    directions: Sequence[tuple[mi.Vector3f, mi.Bool]],
) -> tuple[Scattered, list[Evaluated]]:
    """Sample and evaluate in one call of the BSDF, which takes less time than separate ones."""
    # The lobe is not stratified: that would cost time and has no measurable effect on the error.
    u = source.decide(vertex, dim.LOBE), mi.Point2f(*source.next_2d(vertex, dim.DIRECTION))

    def call(
        bsdf: mi.BSDF,
        si: mi.SurfaceInteraction3f,
        u: tuple[mi.Float, mi.Point2f],
        active: mi.Bool,
        directions: list[tuple[mi.Vector3f, mi.Bool]],
        everywhere: mi.Bool,
    ) -> tuple[_Sampled, list[tuple[mi.Spectrum, mi.Float, mi.Float]]]:
        return sample(bsdf, si, u, active), [evaluate(bsdf, si, wo, mask) for wo, mask in directions]

    sampled, evaluated = bsdf.call(call, si, u, active, list(directions))
    wo, weight, pdf, reverse_pdf, eta, lobe = sampled
    is_delta, is_null = mi.has_flag(lobe, mi.BSDFFlags.Delta), mi.has_flag(lobe, mi.BSDFFlags.Null)
    direction = si.to_world(wo)
    active = active & ~(pdf <= 0.0) & ~dr.all(weight == 0.0)  # lanes with NaN stay active, so that they are counted
    cos = geometric_cos(si, direction, bsdf.in_medium)
    scattered = Scattered(direction, weight, pdf, reverse_pdf, cos, eta, is_delta, is_null, active)
    return scattered, [Evaluated(*e) for e in evaluated]


def _sample_camera(
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, u: tuple[mi.Float, mi.Point2f], active: mi.Bool
) -> _Sampled:
    bs, weight = bsdf.sample(mi.BSDFContext(), si, *u, active)
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    reverse_pdf = bsdf.pdf(context, exchanged(si, bs.wo), si.wi, active & ~is_delta)
    return bs.wo, weight, bs.pdf, reverse_pdf, bs.eta, bs.sampled_type


def _sample_light(
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, u: tuple[mi.Float, mi.Point2f], active: mi.Bool
) -> _Sampled:
    bs, weight = bsdf.sample(mi.BSDFContext(mi.TransportMode.Importance), si, *u, active)
    is_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
    value, reverse_pdf = bsdf.eval_pdf(mi.BSDFContext(), exchanged(si, bs.wo), si.wi, active & ~is_delta)
    # A sample of weight 0 is one that the BSDF has rejected, whatever the value in its direction.
    accepted = ~dr.all(weight == 0.0)
    weight = dr.select(is_delta, weight, dr.select(accepted, value * dr.rcp(bs.pdf), 0.0))
    return bs.wo, weight, bs.pdf, reverse_pdf, bs.eta, bs.sampled_type


def _sample_uniform(
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, u: tuple[mi.Float, mi.Point2f], active: mi.Bool, light: bool = False
) -> _Sampled:
    """``light``: at a light vertex."""
    lobe, u_direction = u
    share, pdf = _uniform_share(bsdf)
    smooth = active & (lobe < share)
    world = mi.warp.square_to_uniform_sphere(u_direction)
    wo = si.to_local(world)
    if not mi.has_flag(bsdf.flags(), mi.BSDFFlags.Transmission):
        wo = dr.select(mi.Frame3f.cos_theta(wo) * mi.Frame3f.cos_theta(si.wi) < 0.0, -wo, wo)
    value, pdf, reverse_pdf = _uniform_end(bsdf, si, wo, smooth, light)
    weight = value / dr.maximum(pdf, 1e-12)
    eta, kind = mi.Float(1.0), mi.UInt32(+mi.BSDFFlags.DiffuseReflection)
    if share == 1.0:
        return wo, weight, pdf, reverse_pdf, eta, kind
    # Samples of the BSDF contribute only where they come from a delta component.
    rest = (lobe - share) / (1.0 - share)
    context = mi.BSDFContext(mi.TransportMode.Importance if light else mi.TransportMode.Radiance)
    bs, delta_weight = bsdf.sample(context, si, rest, u_direction, active & ~smooth)
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
    bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool, light: bool = False
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    """``light``: at a light vertex."""
    if light:
        value = bsdf.eval(mi.BSDFContext(), exchanged(si, wo), si.wi, active)
    else:
        value = bsdf.eval(mi.BSDFContext(), si, wo, active)
    _, pdf = _uniform_share(bsdf)
    return _not_tangential(bsdf, si.wi, wo, value, mi.Float(pdf), mi.Float(pdf))


def _uniform_share(bsdf: mi.BSDF) -> tuple[float, float]:
    """(probability of a uniform direction, solid-angle density of the uniform directions)."""
    flags = bsdf.flags()
    if not mi.has_flag(flags, mi.BSDFFlags.Smooth):
        share = 0.0
    else:
        share = 0.5 if mi.has_flag(flags, mi.BSDFFlags.Delta) else 1.0
    return share, share / (4.0 if mi.has_flag(flags, mi.BSDFFlags.Transmission) else 2.0) / dr.pi


def roulette(
    throughput: mi.Spectrum, eta: mi.Float, depth: mi.UInt32, first_depth: int, u: mi.Float, scale: float = 1.0
) -> tuple[mi.Bool, mi.Float]:
    """Russian roulette by ``scale`` times the throughput from ``first_depth`` on: (survives, factor on the throughput).

    ``eta``: product of the relative indices of refraction, which compensates the scaling of radiance by refraction;
    1 for light sub-paths, whose throughput is not scaled.
    """
    survival = dr.minimum(dr.max(throughput) * dr.square(eta) * scale, 0.95)
    playing = depth >= first_depth
    return ~playing | ~(u >= survival), dr.select(playing, dr.rcp(survival), 1.0)


def shadow_roulette(
    contributions: Sequence[mi.Spectrum], threshold: mi.Float, u: mi.Float, active: mi.Bool
) -> tuple[mi.Bool, mi.Float]:
    """Russian roulette before a shadow ray: (whether the ray is cast, factor on the contributions).

    The largest of the weighted ``contributions`` that share the ray decides: below ``threshold``, the ray is cast with
    probability contribution / threshold. Contributions may be negative, as filters have negative lobes. The ray is cast
    for a contribution of NaN, which is counted where contributions are summed. Hence ``~(x == 0)`` here and elsewhere:
    in Dr.Jit all comparisons with NaN are false, ``!=`` included.
    """
    size = functools.reduce(dr.maximum, (dr.max(dr.abs(contribution)) for contribution in contributions))
    survival = dr.select(size >= threshold, 1.0, size / threshold)
    return active & ~(size == 0.0) & ~(u >= survival), dr.rcp(survival)
