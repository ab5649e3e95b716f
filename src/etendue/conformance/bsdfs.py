"""Tests of a material: range of values, energy conservation, reciprocity, and the density of its sampling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from etendue.scene import graph

from .report import Finding, Findings
from .statistics import DensityFit, fit_density
from .surfaces import Array, host, points_on, uniform, uniform_sphere, vectors

Mask = NDArray[np.bool_]

#: Cosines of the directions of incidence, on both sides: for all tests except ``sampler``, and for ``sampler``.
_COSINES, _SAMPLED_COSINES = (1.0, 0.9, 0.6, 0.3, 0.1, 0.01), (0.95, 0.6, 0.2)
#: Deviation of a mean that is a fault, in standard errors.
_SIGMAS = 5.0
#: Accepted relative difference of two values of the same quantity, and accepted excess of an albedo, for rounding.
_SHARE, _ALBEDO_SLACK = 0.01, 0.01
#: Least number of samples for a test.
_FEW = 64
#: RMS relative error of a density that is accepted even if it is significant, for rounding and edges of cells.
_DEVIATION = 0.05

#: Materials without absorption unless they have a colour, and the accepted loss of energy.
_CLEAR, _LOSS = ("roughdielectric",), 0.1

#: Known faults of Mitsuba's materials: (plugin, test) and the reason.
_KNOWN = {
    ("blendbsdf", "range behind"): "Mitsuba 3.9 blends invalid samples of one-sided materials; use 'twosided'",
    ("principled", "energy"): "the sum of its lobes, such as clearcoat and sheen, exceeds 1 near grazing angles",
    ("hair", "reciprocity"): "scattering depends on the point where the ray enters the fibre, at one end of the path",
    ("bumpmap", "reciprocity"): "a shading normal makes f depend on which end of the path is the light",
    ("normalmap", "reciprocity"): "a shading normal makes f depend on which end of the path is the light",
}


@dataclass(frozen=True)
class Effort:
    """Numbers of samples."""

    points: int = 6  #: points of the surface for each direction of incidence
    samples: int = 512  #: samples for each direction and point
    draws: int = 32768  #: samples for each direction in the test of the sampler


QUICK = Effort(points=2, samples=256, draws=8192)


def check_bsdf(
    bsdf: mi.BSDF,
    component: str | None = None,
    *,
    scene: mi.Scene | None = None,
    shape: mi.Shape | None = None,
    quick: bool = False,
    seed: int = 0,
    level: float = 1e-5,
) -> list[Finding]:
    """Test a ``mi.BSDF``, at points of ``shape`` in ``scene`` or, without them, of a unit square.

    The tests are ``range`` (finite, not negative), ``energy`` (albedo at most 1 for a grid of directions on both sides
    and points all over the surface), ``loss`` (of clear rough dielectrics), ``reciprocity`` (f(a, b) = f(b, a);
    refracted light scaled by eta squared), ``weight`` (the weight of a sample is value over density), ``density`` (the
    density of a sample is that of ``pdf``), ``integral`` (``pdf`` integrates to at most 1), ``sampler`` (sampled
    directions have that density; ``level`` is the probability that a correct sampler fails) and ``coverage`` (the
    density is not zero where the material reflects).
    """
    effort = QUICK if quick else Effort()
    rng = np.random.default_rng([seed, 0xB5DF])
    name = component or graph.describe(bsdf, "material")
    plugins = {graph.plugin_name(node) for node in graph.below(bsdf) if isinstance(node, mi.BSDF)}

    def known(test: str) -> str:
        return next((reason for (plugin, what), reason in _KNOWN.items() if what == test and plugin in plugins), "")

    findings = Findings(name, known)
    with findings.trying("interface"):
        grid = _directions(_COSINES, effort.points, rng)
        si = points_on(scene, shape, len(grid), rng)
        si.wi = vectors(grid)
        drawn = _draw(bsdf, si, effort.samples, rng)
        anywhere = _evaluate(bsdf, si, uniform_sphere(rng, len(grid) * effort.samples), effort.samples)
        if _check_range(findings, drawn, anywhere):
            albedo = _check_energy(findings, drawn, len(grid))
            coloured = any(key.startswith("specular") for key, _ in graph.contents(bsdf).objects)
            if graph.plugin_name(bsdf) in _CLEAR and not coloured:
                _check_loss(findings, albedo, grid)
            _check_reciprocity(findings, drawn, anywhere)
            _check_weight(findings, drawn)
            _check_coverage(findings, anywhere)
            _check_density(findings, bsdf, si, drawn, effort, rng, level)
    return findings.rows


@dataclass
class _Values:
    """Values of a material: (n,), or (n, channels) for directions and colours."""

    wi: Array
    wo: Array
    value: Array  #: ``eval``, including the cosine at ``wo``
    back: Array  #: ``eval`` with the directions exchanged
    pdf: Array  #: ``pdf``


@dataclass
class _Draws(_Values):
    """Values for directions that the material has sampled."""

    weight: Array
    sample_pdf: Array
    eta: Array
    kept: Mask  #: lanes whose weight is not zero
    drawn: Mask  #: lanes of ``kept`` with a density above zero
    smooth: Mask  #: lanes of ``drawn`` that are not of a delta component


def _directions(cosines: tuple[float, ...], points: int, rng: np.random.Generator) -> Array:
    cos = np.repeat([*cosines, *(-c for c in cosines)], points)
    phi = rng.random(len(cos)) * 2 * np.pi
    sin = np.sqrt(1.0 - cos**2)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], -1)


def _spread(si: mi.SurfaceInteraction3f, samples: int) -> mi.SurfaceInteraction3f:
    """Each interaction ``samples`` times."""
    return dr.gather(mi.SurfaceInteraction3f, si, dr.arange(mi.UInt32, dr.width(si.wi) * samples) // samples)


def _draw(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, samples: int, rng: np.random.Generator) -> _Draws:
    context, lanes = mi.BSDFContext(), dr.width(si.wi) * samples
    si = _spread(si, samples)
    drawn, weight = bsdf.sample(context, si, uniform(rng, lanes, 1), uniform(rng, lanes, 2))
    delta = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
    wo = drawn.wo
    values = _answers(bsdf, context, si, wo)
    results = (si.wi, wo, *values, weight, drawn.pdf, drawn.eta, delta)
    dr.eval(*results)
    wi, out, value, back, pdf, weight, sample_pdf, eta, is_delta = (host(v, lanes) for v in results)
    # A sample of weight zero is discarded, whatever its density.
    kept = (weight != 0.0).any(1)
    valid = kept & (sample_pdf > 0.0)
    smooth = valid & (is_delta == 0.0) & np.isfinite(out).all(1)
    return _Draws(wi, out, value, back, pdf, weight, sample_pdf, eta, kept, valid, smooth)


def _evaluate(bsdf: mi.BSDF, si: mi.SurfaceInteraction3f, wo: Array, samples: int) -> _Values:
    context, lanes = mi.BSDFContext(), len(wo)
    si, out = _spread(si, samples), vectors(wo)
    results = (si.wi, out, *_answers(bsdf, context, si, out))
    dr.eval(*results)
    return _Values(*(host(v, lanes) for v in results))


def _answers(
    bsdf: mi.BSDF, context: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f
) -> tuple[mi.Color3f, mi.Color3f, mi.Float]:
    exchanged = mi.SurfaceInteraction3f(si)
    exchanged.wi = wo
    return bsdf.eval(context, si, wo), bsdf.eval(context, exchanged, si.wi), bsdf.pdf(context, si, wo)


def _check_range(findings: Findings, drawn: _Draws, anywhere: _Values) -> bool:
    """Whether enough values are valid for the other tests."""
    wrong, behind, total = 0, 0, 0
    for values, lanes, arrays in (
        (drawn, drawn.drawn, (drawn.value, drawn.back, drawn.pdf)),
        (drawn, drawn.kept, (drawn.weight, drawn.sample_pdf)),
        (anywhere, np.ones(len(anywhere.pdf), bool), (anywhere.value, anywhere.back, anywhere.pdf)),
    ):
        for array in arrays:
            bad = (~np.isfinite(array) | (array < -1e-5)).reshape(len(array), -1).any(1) & lanes
            wrong += int(bad.sum())
            behind += int((bad & (values.wi[:, 2] < 0.0)).sum())
            total += int(lanes.sum())
    meaning = (
        f"{wrong} of {total} values, densities and weights are NaN, infinite or negative, which makes pixels invalid"
    )
    if wrong and wrong == behind and (reason := findings.known("range behind")):
        findings.warn("range", wrong / total, 0.0, f"{meaning}, all for the back side; known: {reason}")
        return True
    verdict = findings.judge(
        "range",
        wrong / total,
        0.0,
        "all values, densities and weights are finite and not negative",
        f"{meaning}; correct the parameters or the plugin",
    )
    return verdict == "pass" or wrong < 1e-3 * total


def _check_energy(findings: Findings, drawn: _Draws, groups: int) -> Array:
    """Test the albedo; returns it for each direction and point."""
    # Refraction scales radiance by eta squared, but not energy [Veach 1997, sec. 5.2].
    scale = np.where(drawn.drawn & (drawn.wo[:, 2] * drawn.wi[:, 2] < 0.0) & (drawn.eta > 0.0), drawn.eta**2, 1.0)
    reflected = np.nan_to_num(np.where(drawn.drawn[:, None], drawn.weight * scale[:, None], 0.0))
    reflected = reflected.reshape(groups, -1, reflected.shape[1])
    albedo, error = reflected.mean(1), reflected.std(1) / np.sqrt(reflected.shape[1])
    largest = float(albedo.max())
    least = float((albedo - _SIGMAS * error).max())
    worst = np.unravel_index(int(np.argmax(albedo - _SIGMAS * error)), albedo.shape)[0]
    cos = float(drawn.wi.reshape(groups, -1, 3)[worst, 0, 2])
    findings.judge(
        "energy",
        largest,
        1.0,
        "largest albedo over directions of incidence and points",
        f"it reflects up to {albedo[worst].max():.2f} times the incident light (at cosine {cos:.2f} to the normal), so "
        "pictures become too bright and paths may not end; lower its reflectances or repair the plugin",
        failed=least > 1.0 + _ALBEDO_SLACK,
    )
    return albedo


def _check_loss(findings: Findings, albedo: Array, directions: Array) -> None:
    lost = 1.0 - float(np.average(albedo.mean(1), weights=np.abs(directions[:, 2])))
    good = "share of uniform light from both sides that a clear material loses"
    if lost <= _LOSS:
        findings.judge("loss", lost, _LOSS, good, good)
        return
    meaning = (
        f"it absorbs {lost:.0%} of the light although it is clear; known: the model has no multiple scattering between "
        "microfacets, so rough glass is too dark; a smaller alpha loses less"
    )
    findings.warn("loss", lost, _LOSS, meaning)


def _check_reciprocity(findings: Findings, drawn: _Draws, anywhere: _Values) -> None:
    front, back = (_eta(drawn, side) for side in (1.0, -1.0))
    asymmetry = 0.0
    for values, lanes, share in (
        (anywhere, np.ones(len(anywhere.pdf), bool), np.ones(len(anywhere.pdf))),
        (drawn, drawn.smooth, 1.0 / np.where(drawn.smooth, drawn.sample_pdf, 1.0)),
    ):
        through = values.wi[:, 2] * values.wo[:, 2] < 0.0
        eta = np.where(through, np.where(values.wi[:, 2] > 0.0, front, back), 1.0)
        # Values contain the cosine at one end; multiplied by that at the other end they are symmetric.
        there = values.value * (np.abs(values.wi[:, 2]) * eta**2 * share)[:, None]
        again = values.back * (np.abs(values.wo[:, 2]) * share)[:, None]
        for chosen in (lanes & ~through, lanes & through):
            total = float((there + again)[chosen].sum())
            if chosen.sum() >= _FEW and total > 0.0:
                asymmetry = max(asymmetry, float(np.abs(there - again)[chosen].sum()) / total)
    findings.judge(
        "reciprocity",
        asymmetry,
        _SHARE,
        "difference of f(a, b) and f(b, a), as a share of the light",
        f"f(a, b) and f(b, a) differ by {asymmetry:.1%} of the light, so light paths and camera paths give different "
        "results, and methods that connect them disagree with path tracing; make eval symmetric, except for its cosine",
    )


def _eta(drawn: _Draws, side: float) -> float:
    """Relative index of refraction for paths that cross the surface from one side, from samples that cross it."""
    crossing = drawn.smooth & (drawn.wi[:, 2] * side > 0.0) & (drawn.wo[:, 2] * side < 0.0)
    return float(np.median(drawn.eta[crossing])) if crossing.any() else 1.0


def _check_weight(findings: Findings, drawn: _Draws) -> None:
    smooth = drawn.smooth
    if smooth.sum() < _FEW:
        return
    weight = drawn.weight[smooth]
    expected = drawn.value[smooth] / drawn.sample_pdf[smooth, None]
    total = float(np.maximum(weight, expected).sum())
    difference = float(np.abs(weight - expected).sum()) / total if total > 0.0 else 0.0
    findings.judge(
        "weight",
        difference,
        _SHARE,
        "mean relative difference of a sample's weight and value over density",
        f"the weight of a sample differs by {difference:.1%} from eval / pdf, so sampled directions and next event "
        "estimation give different results; make sample return eval / pdf",
    )


def _check_coverage(findings: Findings, anywhere: _Values) -> None:
    light = anywhere.value.sum(1)
    total = float(light.sum())
    missed = float(light[anywhere.pdf <= 0.0].sum()) / total if total > 0.0 else 0.0
    findings.judge(
        "coverage",
        missed,
        0.001,
        "share of the reflected light in directions of density zero",
        f"{missed:.1%} of the light is reflected to directions that are never sampled, so it is lost if directions are "
        "sampled only; make pdf and sample cover all directions in which eval is not zero",
    )


def _check_density(
    findings: Findings,
    bsdf: mi.BSDF,
    si: mi.SurfaceInteraction3f,
    drawn: _Draws,
    effort: Effort,
    rng: np.random.Generator,
    level: float,
) -> None:
    sampled, evaluated = drawn.sample_pdf[drawn.smooth], drawn.pdf[drawn.smooth]
    differences = np.abs(sampled - evaluated) / np.maximum(np.maximum(sampled, evaluated), 1e-12)
    difference = float(differences.mean()) if len(differences) else 0.0

    grid = _directions(_SAMPLED_COSINES, 1, rng)
    places = dr.gather(mi.SurfaceInteraction3f, si, mi.UInt32(rng.integers(0, dr.width(si.wi), len(grid)).astype("u4")))
    places.wi = vectors(grid)
    many = _draw(bsdf, places, effort.draws, rng)
    fits = []
    for number in range(len(grid)):
        lanes = slice(number * effort.draws, (number + 1) * effort.draws)
        place = dr.gather(mi.SurfaceInteraction3f, places, mi.UInt32([number]))
        if fit := fit_density(many.wo[lanes][many.smooth[lanes]], effort.draws, _density(bsdf, place), rng):
            fits.append(fit)
    judge_density(findings, fits, difference, level)


def _density(bsdf: mi.BSDF, place: mi.SurfaceInteraction3f) -> Callable[[Array], Array]:
    """The density ``pdf`` of directions in which ``eval`` is not zero; 0 for other directions, whose samples have no
    weight."""

    def density(directions: Array) -> Array:
        lanes, context, wo = len(directions), mi.BSDFContext(), vectors(directions)
        si = dr.gather(mi.SurfaceInteraction3f, place, dr.zeros(mi.UInt32, lanes))
        value, pdf = bsdf.eval(context, si, wo), bsdf.pdf(context, si, wo)
        dr.eval(value, pdf)
        return np.where(host(value, lanes).any(1), np.nan_to_num(host(pdf, lanes)), 0.0)

    return density


def judge_density(findings: Findings, fits: list[DensityFit], difference: float, level: float) -> None:
    """The tests ``density``, ``integral`` and ``sampler`` from several fits, with Bonferroni's bound over them."""
    findings.judge(
        "density",
        difference,
        _SHARE,
        "mean relative difference of a sample's density and that of the plugin's pdf function",
        f"a sample's density differs by {difference:.1%} from that of the pdf function, so weights of multiple "
        "importance sampling do not sum to one; make both equal",
    )
    if not fits:
        return
    integral = max(fits, key=lambda f: f.integral - _SIGMAS * f.integral_error)
    findings.judge(
        "integral",
        integral.integral,
        1.0 + _SHARE,
        "largest integral of the density over all directions; below 1 if some samples are rejected or of mirrors",
        f"the density integrates to {integral.integral:.2f}, so pictures become too dark or too bright; normalise it",
        failed=integral.integral - _SIGMAS * integral.integral_error > 1.0 + _SHARE,
    )
    p_value = min(1.0, len(fits) * min(f.p_value for f in fits))
    deviation = max(f.deviation for f in fits)
    findings.judge(
        "sampler",
        deviation,
        _DEVIATION,
        f"relative deviation of sampled directions from the density (chi-square, p = {p_value:.2g})",
        f"sampled directions do not have the density of pdf (chi-square, p = {p_value:.1g}; deviation "
        f"{deviation:.0%}), so pictures are biased; make pdf the density of sample",
        failed=p_value < level and deviation > _DEVIATION,
    )
