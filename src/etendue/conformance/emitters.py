"""Tests of an emitter: density and radiance of next event estimation, and the power of its rays."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from etendue.scene import graph, is_spectral, spread_wavelengths

from .bsdfs import judge_density
from .report import Finding, Findings
from .statistics import DensityFit, fit_density
from .surfaces import Array, host, uniform, uniform_sphere, vectors

#: Lit points, samples for each, rays for the power.
_PLACES, _DRAWS, _RAYS = 3, 16384, 65536
_QUICK = 4
#: Largest number of surfaces of the emitter along one ray.
_MOST_HITS = 64
_SIGMAS, _SHARE = 5.0, 0.01
#: Farthest place that is lit, in sizes of the emitter: beyond it, Mitsuba's cosines in single precision put the
#: directions to a sphere on a few circles. (Étendue's methods sample spheres themselves.)
_FARTHEST = 100.0


def check_emitter(
    emitter: mi.Emitter,
    scene: mi.Scene,
    component: str | None = None,
    *,
    quick: bool = False,
    seed: int = 0,
    level: float = 1e-5,
) -> list[Finding]:
    """Test a ``mi.Emitter`` of a loaded scene.

    The tests are ``range``, ``radiance`` (the weight of ``sample_direction`` is ``eval_direction`` over density),
    ``density``, ``integral`` and ``sampler`` (of ``sample_direction`` against ``pdf_direction``, as for materials) and
    ``power`` (the mean weight of ``sample_ray`` is the emitted power, the integral of the radiance).
    """
    rng = np.random.default_rng([seed, 0xE317])
    findings = Findings(component or graph.describe(emitter, "emitter"))
    with findings.trying("interface"):
        _check_next_event(findings, emitter, scene, _DRAWS // (_QUICK if quick else 1), rng, level)
    with findings.trying("power", required=False):  # lights with procedural textures do not implement sample_ray
        _check_power(findings, emitter, scene, _RAYS // (_QUICK if quick else 1), rng)
    return findings.rows


def is_surface(emitter: mi.Emitter) -> bool:
    """Whether an emitter is on a shape that rays can hit."""
    return mi.has_flag(emitter.flags(), mi.EmitterFlags.Surface) and emitter.get_shape() is not None


def _is_delta(emitter: mi.Emitter) -> bool:
    return mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta)


def _places(emitter: mi.Emitter, scene: mi.Scene, rng: np.random.Generator) -> Array:
    """Points that the emitter lights: in front of its surface, or anywhere within the scene."""
    box = scene.bbox()
    low, high = (np.asarray(v, np.float64).ravel() for v in (box.min, box.max))
    if not is_surface(emitter):
        return low + (high - low) * (0.1 + 0.8 * rng.random((_PLACES, 3)))
    place = emitter.get_shape().sample_position(0.0, uniform(rng, _PLACES, 2))
    p, n = host(place.p, _PLACES), host(place.n, _PLACES)
    direction = n + 0.7 * rng.random() * uniform_sphere(rng, _PLACES)
    around = emitter.get_shape().bbox()
    size = np.linalg.norm(np.asarray(around.max, np.float64) - np.asarray(around.min, np.float64))
    reach = min(np.linalg.norm(high - low), _FARTHEST * size)
    return p + direction * reach * rng.uniform(0.1, 0.4, (_PLACES, 1))


def _at(point: Array, lanes: int) -> mi.Interaction3f:
    it = dr.zeros(mi.Interaction3f, lanes)
    it.p, it.wavelengths = mi.Point3f(*(float(v) for v in point)), spread_wavelengths()
    return it


def _check_next_event(
    findings: Findings, emitter: mi.Emitter, scene: mi.Scene, draws: int, rng: np.random.Generator, level: float
) -> None:
    alone = mi.load_dict({"type": "scene", "shape": emitter.get_shape()}) if is_surface(emitter) else None
    wrong, differences, fits = 0, [], list[DensityFit]()
    deviation, total = 0.0, 0.0
    delta = _is_delta(emitter)
    for point in _places(emitter, scene, rng):
        it = _at(point, draws)
        ds, weight = emitter.sample_direction(it, uniform(rng, draws, 2))
        results = [ds.d, weight, ds.pdf]
        if not delta:
            results += [emitter.pdf_direction(it, ds), emitter.eval_direction(it, ds)]
        dr.eval(*results)
        direction, weight_of, pdf, *rest = (host(v, draws) for v in results)
        bad = ~np.isfinite(weight_of).all(1) | (weight_of < 0.0).any(1) | ~np.isfinite(pdf) | (pdf < 0.0)
        wrong += int(bad.sum())
        if delta or bad.any():
            continue
        evaluated, radiance = rest
        lit = evaluated > 0.0
        both = lit & (weight_of > 0.0).any(1)
        differences.append(np.abs(pdf - evaluated)[both] / np.maximum(pdf, evaluated)[both])
        deviation += float(np.abs(weight_of * pdf[:, None] - radiance)[both].sum())
        total += float(radiance[both].sum())
        if fit := fit_density(direction[lit], draws, _density(emitter, alone, point), rng):
            fits.append(fit)
    findings.judge(
        "range",
        float(wrong),
        0.0,
        "next event: all weights and densities are finite and not negative",
        f"{wrong} weights or densities of next event are NaN, infinite or negative; correct the radiance or the plugin",
    )
    if delta or wrong:
        return
    share = deviation / total if total > 0.0 else 0.0
    findings.judge(
        "radiance",
        share,
        _SHARE,
        "relative difference of next event's weight and radiance over density",
        f"the radiance of next event differs by {share:.1%} from that of eval_direction; make the weight radiance over "
        "density",
    )
    relative = np.concatenate(differences) if differences else np.zeros(0)
    judge_density(findings, fits, float(relative.mean()) if len(relative) else 0.0, level)


def _density(emitter: mi.Emitter, alone: mi.Scene | None, point: Array) -> Callable[[Array], Array]:
    """Density of the direction of next event; for an emitter on a shape, the sum over its points along the ray."""

    def density(directions: Array) -> Array:
        lanes = len(directions)
        d, it = vectors(directions), _at(point, lanes)
        if alone is None:
            ds = dr.zeros(mi.DirectionSample3f, lanes)
            ds.d = d
            ds.emitter = mi.EmitterPtr(emitter)
            return np.nan_to_num(host(emitter.pdf_direction(it, ds), lanes))
        total = np.zeros(lanes)
        ray, hit = mi.Ray3f(it.p, d), mi.Bool(True)
        for _ in range(_MOST_HITS):
            si = alone.ray_intersect(ray, hit)
            hit = hit & si.is_valid()
            dr.eval(si, hit)
            if not np.asarray(hit).any():
                break
            ds = mi.DirectionSample3f(alone, si, it)
            total += np.nan_to_num(host(emitter.pdf_direction(it, ds, hit), lanes))
            ray = si.spawn_ray(d)
        return total

    return density


def _check_power(findings: Findings, emitter: mi.Emitter, scene: mi.Scene, rays: int, rng: np.random.Generator) -> None:
    reference = _power(emitter, scene, rays, rng)
    if reference is None:
        return
    _, weight = emitter.sample_ray(0.0, uniform(rng, rays, 1), uniform(rng, rays, 2), uniform(rng, rays, 2))
    carried = host(weight, rays)
    mean, error = carried.mean(0), carried.std(0) / np.sqrt(rays)
    expected, expected_error = (_nanometres() * value for value in reference)
    difference = np.abs(mean - expected)
    tolerance = _SIGMAS * np.hypot(error, expected_error) + 2e-3 * expected
    channel = int(np.argmax(difference - tolerance))
    figure = float(difference[channel] / expected[channel]) if expected[channel] > 0.0 else float(difference[channel])
    findings.judge(
        "power",
        figure,
        float(max(tolerance[channel] / max(expected[channel], 1e-30), 0.0)),
        "relative difference of the power that its rays carry and the integral of its radiance",
        f"its rays carry {mean[channel]:.4g} W but its radiance integrates to {expected[channel]:.4g} W, so light "
        "paths and camera paths give different results; make sample_ray return radiance over density",
        failed=bool((difference > tolerance).any()),
    )


def _power(emitter: mi.Emitter, scene: mi.Scene, rays: int, rng: np.random.Generator) -> tuple[Array, Array] | None:
    """Emitted power for each channel and its standard error, from the radiance alone; under a spectral variant, that of
    a nanometre, on average, four times."""
    flags, wavelengths = emitter.flags(), spread_wavelengths()
    if is_spectral():
        wavelengths = mi.Spectrum(*(mi.MI_CIE_MIN + _nanometres() * uniform(rng, rays, 1) for _ in range(4)))
    sphere = scene.bbox().bounding_sphere()
    disc = np.pi * float(np.asarray(sphere.radius).ravel()[0]) ** 2
    if is_surface(emitter):
        if _is_delta(emitter):
            return None
        shape = emitter.get_shape()
        area = float(np.asarray(shape.surface_area()).ravel()[0])
        si = mi.SurfaceInteraction3f(shape.sample_position(0.0, uniform(rng, rays, 2)), wavelengths)
        si.wi = mi.warp.square_to_cosine_hemisphere(uniform(rng, rays, 2))
        return _moments(np.pi * area * host(emitter.eval(si), rays))
    if mi.has_flag(flags, mi.EmitterFlags.Infinite):
        if mi.has_flag(flags, mi.EmitterFlags.DeltaDirection):
            it = _at(np.asarray(sphere.center).ravel(), rays)
            it.wavelengths = wavelengths
            _, weight = emitter.sample_direction(it, mi.Point2f(0.5))
            return _moments(disc * host(weight, rays))
        si = dr.zeros(mi.SurfaceInteraction3f, rays)
        si.wi, si.wavelengths = vectors(uniform_sphere(rng, rays)), wavelengths
        return _moments(4.0 * np.pi * disc * host(emitter.eval(si), rays))
    if not mi.has_flag(flags, mi.EmitterFlags.DeltaPosition):
        return None
    ray, _ = emitter.sample_ray(0.0, mi.Float(0.5), mi.Point2f(0.5), mi.Point2f(0.5))
    origin, d = host(ray.o, 1)[0], uniform_sphere(rng, rays)
    distance = 0.1 * np.sqrt(disc)
    it = dr.zeros(mi.Interaction3f, rays)
    it.p, it.wavelengths = mi.Point3f(np.ascontiguousarray((origin + distance * d).T, np.float32)), wavelengths
    _, weight = emitter.sample_direction(it, mi.Point2f(0.5))
    return _moments(4.0 * np.pi * distance**2 * host(weight, rays))


def _nanometres() -> float:
    """Range of the wavelengths over which sampled rays carry power; 1 without wavelengths."""
    return float(mi.MI_CIE_MAX - mi.MI_CIE_MIN) if is_spectral() else 1.0


def _moments(values: Array) -> tuple[Array, Array]:
    return values.mean(0), values.std(0) / np.sqrt(len(values))
