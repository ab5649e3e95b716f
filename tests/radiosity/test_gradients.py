"""Gradients of radiosity solutions: closed forms, finite differences of solutions, the scatter over seeds."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import BOXES, box, cube, joined, room
from support.tables import thinned

from etendue.core import sparse
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    FormFactors,
    Patches,
    RadiosityError,
    RayScene,
    first_shot,
    form_factors,
    gradient,
    gradient_error,
    point_views,
    solve,
    thermal,
    with_local_rays,
)

TIGHT = {"tolerance": 1e-13, "max_iterations": 3000}


def lit(is_open=False, n=2, channels=2):
    """A room with boxes, its properties at random; open, it has lost its first walls to a sky."""
    patches = room(n)
    kept = np.arange(3 * is_open, len(patches.faces))
    rng = np.random.default_rng(4)
    shape = len(kept), channels
    light = {"reflectance": rng.uniform(0.2, 0.8, shape), "emission": rng.uniform(0.0, 2.0, shape)}
    return Patches(patches.vertices, patches.faces[kept], **light, sky=[0.5, 0.2][:channels] if is_open else 0.0)


def transports(patches):
    """Segments, segments with local rays, form factors with weights and without."""
    segments = ABuffer(patches, OwenSobol(4, seed=1), 400).cast(64)
    return {
        "segments": segments,
        "mixed": with_local_rays(segments, points=OwenSobol(4, seed=2)),
        "pooled": form_factors(segments, "pooled"),
        "F2": form_factors(segments, "F2"),
    }


def solved(patches, transport, shot=None):
    by = "conjugate-gradient" if transport.exchange_weights is not None else "direct"
    return solve(patches, transport, by, shot=shot, **TIGHT)


def slope(loss, step):
    """Central difference of a function of one number, at 0."""
    return (loss(step) - loss(-step)) / (2 * step)


@pytest.mark.parametrize("kind", ["segments", "mixed", "pooled", "F2"])
@pytest.mark.parametrize("is_open", [False, True])
def test_derivatives_along_random_directions_are_finite_differences(is_open, kind):
    """Of a loss that is quadratic in B, and linear in H, with both signs."""
    patches = lit(is_open)
    transport = transports(patches)[kind]
    rng = np.random.default_rng(8)
    on_b, on_h = rng.normal(size=(2, *patches.emission.shape)) * patches.areas[:, None]

    def loss(changed):
        found = solved(changed, transport)
        return float((on_b * found.radiosity**2).sum() + (on_h * found.irradiance).sum())

    solution = solved(patches, transport)
    found = gradient(solution, transport, 2 * on_b * solution.radiosity, dirradiance=on_h)
    for name in ("emission", "reflectance", "sky"):
        value = getattr(patches, name)
        along = rng.uniform(0.1, 1, value.shape) * value

        def changed(t, name=name, value=value, along=along):
            return loss(patches.with_properties(**{name: value + t * along}))

        by_difference = slope(changed, 1e-4)
        assert (getattr(found, name) * along).sum() == pytest.approx(by_difference, rel=1e-6, abs=1e-9)
    assert bool(found.sky.any()) == is_open


def test_a_linear_loss_is_its_gradient_by_emission_times_the_emission():
    patches = lit()
    segments = transports(patches)["segments"]
    g = np.random.default_rng(2).normal(size=patches.emission.shape)
    solution = solved(patches, segments)
    found = gradient(solution, segments, g)
    assert (found.emission * patches.emission).sum() == pytest.approx((g * solution.radiosity).sum(), rel=1e-9)


def sphere_factors(patches):
    """Those of an integrating sphere with such areas: every patch sees the same, F_ij = A_j / A."""
    n, shares = len(patches), patches.areas / patches.areas.sum()
    matrix = sparse().csr_array(np.tile(shares, (n, 1)))
    return FormFactors(matrix, 0 * matrix, np.zeros(n), patches.areas, np.full(n, 1.0))


@pytest.mark.parametrize("is_open", [False, True])
def test_heat(is_open):
    """Net heat of some patches, by emissivities and temperatures of all, with an adiabatic one."""
    geometry = lit(is_open, channels=1)
    rng = np.random.default_rng(1)
    t, epsilon = rng.uniform(280, 420, len(geometry)), rng.uniform(0.2, 0.9, len(geometry))
    segments = transports(geometry)["segments"]
    weights = (geometry.areas * (rng.random(len(geometry)) < 0.3))[:, None]
    heat = {"surroundings": 290.0 if is_open else 0.0}

    def loss(temperatures, emissivities):
        found = solved(thermal(geometry, temperatures, emissivities, **heat), segments)
        return float((weights * (found.radiosity - found.irradiance)).sum())

    solution = solved(thermal(geometry, t, epsilon, **heat), segments)
    found = gradient(solution, segments, weights, dirradiance=-weights, temperatures=t)
    along = rng.normal(size=len(t))
    by_difference = slope(lambda s: loss(t + s * along, epsilon), 0.01)
    assert (found.temperature * along).sum() == pytest.approx(by_difference, rel=1e-6)
    by_difference = slope(lambda s: loss(t, epsilon + s * along), 1e-4)
    assert (found.emissivity * along).sum() == pytest.approx(by_difference, rel=1e-6)


def test_an_adiabatic_wall_has_no_derivative_by_temperature():
    geometry = cube(2)
    factors = sphere_factors(geometry)
    epsilon = np.where(np.arange(24) == 5, 0.0, 0.5)
    solution = solved(thermal(geometry, 300, epsilon), factors)
    found = gradient(solution, factors, geometry.areas, temperatures=300)
    assert found.temperature[5] == 0 and (np.delete(found.temperature, 5) > 0).all()


def test_integrating_sphere():
    """H = A_i E_i / (A (1 - rho)) from a lamp of area A_i: the formula of every luminous flux sphere."""
    patches = cube(2, reflectance=0.8, emission=np.arange(24.0))
    factors = sphere_factors(patches)
    meter = np.arange(24) == 7
    found = gradient(solved(patches, factors), factors, dirradiance=1.0 * meter)
    shares = patches.areas / patches.areas.sum()
    level = (shares * patches.emission[:, 0]).sum() / 0.2
    np.testing.assert_allclose(found.emission[:, 0], shares / 0.2, rtol=1e-8)
    np.testing.assert_allclose(found.irradiance[:, 0], meter + 0.8 * shares / 0.2, rtol=1e-8)
    np.testing.assert_allclose(found.reflectance[:, 0], shares / 0.2 * level, rtol=1e-8)


def test_power_in_a_closed_room_of_one_reflectance():
    """All light arrives 1 / (1 - rho) times: dL/dE_i = A_i / (1 - rho) for L the power that arrives."""
    patches = room(2, reflectance=0.6, emission=1.0)
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 2000).cast(256), "reciprocal").repaired()
    found = gradient(solved(patches, factors), factors, dirradiance=patches.areas)
    np.testing.assert_allclose(found.emission[:, 0], patches.areas / 0.4, rtol=1e-7)
    np.testing.assert_allclose(found.importance, 1 / 0.4, rtol=1e-7)
    np.testing.assert_allclose(found.reflectance[:, 0], patches.areas / 0.4**2, rtol=1e-7)


def test_patches_without_lines_keep_their_own_derivative():
    """The system of these lines gives them no light; that is also what their emission and irradiance change."""
    patches = lit()
    one = ABuffer(patches, OwenSobol(4, seed=1), 4).cast(1)
    assert len(one.unseen)
    g, h = np.random.default_rng(5).normal(size=(2, *patches.emission.shape))
    found = gradient(solved(patches, one), one, g, dirradiance=h)
    np.testing.assert_array_equal(found.emission[one.unseen], g[one.unseen])
    assert not found.reflectance[one.unseen].any()


def test_a_loss_that_is_met_has_gradient_zero():
    patches = lit()
    segments = transports(patches)["segments"]
    found = gradient(solved(patches, segments), segments, np.zeros(patches.emission.shape))
    assert not (found.emission.any() or found.reflectance.any() or found.importance.any())


def test_after_a_first_shot():
    """By light along lines with the shot kept, by reflectance, and by the brightness of the shot."""
    patches = lit(True)
    emitters = np.arange(len(patches)) % 5 == 0
    shot = first_shot(RayScene(patches), OwenSobol(4).block(1 << 12), emitters)
    segments = transports(patches)["segments"]
    g, h = np.random.default_rng(3).normal(size=(2, *patches.emission.shape))

    def loss(changed, sent=shot):
        found = solved(changed, segments, sent)
        return float((g * found.radiosity).sum() + (h * found.irradiance).sum())

    found = gradient(solved(patches, segments, shot), segments, g, dirradiance=h)
    along = np.random.default_rng(6).random(patches.emission.shape)
    by_emission = loss(patches.with_properties(emission=patches.emission + along)) - loss(patches)
    assert (found.emission * along).sum() == pytest.approx(by_emission, rel=1e-8)
    by_reflectance = slope(lambda t: loss(patches.with_properties(patches.reflectance + t * along)), 1e-4)
    assert (found.reflectance * along).sum() == pytest.approx(by_reflectance, rel=1e-6)
    brighter = patches.with_properties(emission=patches.emission + shot.emission)
    twice = first_shot(RayScene(brighter), OwenSobol(4).block(1 << 12), emitters)
    assert found.along(shot).sum() == pytest.approx(loss(brighter, twice) - loss(patches), rel=1e-6)


@pytest.mark.parametrize("shot_rays", thinned([0, 512], [512]))
def test_errors_are_the_scatter_over_seeds(shot_rays):
    """Of gradients of a fixed loss, in quadratic mean over the patches: by 24 seeds both are known to some per cent.
    With a shot nearly all light is that of its few rays."""
    patches = lit(True, channels=1)
    rng = np.random.default_rng(3)
    t, epsilon = rng.uniform(280, 420, len(patches)), rng.uniform(0.2, 0.8, len(patches))
    hottest = np.argmax(t)
    t[hottest] = 2000 if shot_rays else t[hottest]
    patches = thermal(patches, t, epsilon, surroundings=300)
    h = patches.areas * (patches.centres[:, 2] < 0.3)
    emitters = np.arange(len(patches)) == hottest
    found, stated = [], []
    for seed in range(24):
        segments = ABuffer(patches, Independent(4, seed=seed), 200).cast(64, batches=8)
        shot = None
        if shot_rays:
            shot = first_shot(RayScene(patches), Independent(4, seed=100 + seed).block(shot_rays), emitters)
        solution = solve(patches, segments, "conjugate-gradient", shot=shot, tolerance=1e-8)
        found.append(gradient(solution, segments, dirradiance=h, temperatures=t))
        stated.append(gradient_error(solution, segments, dirradiance=h, temperatures=t))
    for name in ("emission", "reflectance", "irradiance", "sky", "emissivity", "temperature"):
        scatter = np.var([getattr(x, name) for x in found], axis=0, ddof=1).mean()
        squares = np.mean([np.square(getattr(x, name)) for x in stated])
        assert np.sqrt(squares / scatter) == pytest.approx(1, rel=0.35 if name == "sky" else 0.2), name
    assert np.mean([x.importance for x in stated]) > 0


def test_all_batches_but_one():
    patches = lit()
    lines = ABuffer(patches, OwenSobol(4, seed=1), 400).cast(32, batches=4)
    for segments in (lines, with_local_rays(lines, points=OwenSobol(4, seed=2))):
        rest = segments.without(1)
        assert rest.batch_count == 3 and len(rest) + len(segments.batch(1)) == len(segments)
        values = patches.emission
        sums = (lines.sums(values) for lines in (segments, rest, segments.batch(1)))
        for whole, part, one in zip(*sums, strict=True):
            np.testing.assert_allclose(part + one, whole, rtol=1e-12)
        np.testing.assert_allclose(rest.expected, 0.75 * segments.expected)


LAMPS = np.array([[0.5, 0.5, 0.8], [0.3, 0.55, 0.9]])


def lobes(views, exponent=2.0):
    """Intensities of cosine lobes downwards: (exponent + 1) / (2 pi) cos^exponent, of power 1."""
    down = np.maximum(-views.directions[..., 2], 0) ** exponent * (exponent + 1) / (2 * np.pi)
    return np.broadcast_to(down, views.seen.shape)


def test_direct_light_of_lamps_at_points():
    """I cos / d^2, a mean over each patch of an empty room; no power is lost."""
    patches = cube(4, reflectance=0.5)
    scene = RayScene(patches)
    floor = np.flatnonzero(patches.normals[:, 2] > 0.5)
    middles = (np.arange(50) + 0.5) / 200 - 0.125
    offsets = np.stack([*np.meshgrid(middles, middles), np.zeros((50, 50))], axis=-1).reshape(-1, 3)
    ways = patches.centres[floor, None] + offsets - LAMPS[0]
    square = (ways**2).sum(axis=2)
    exact = (3 / (2 * np.pi) * (-ways[..., 2] / np.sqrt(square)) ** 3 / square).mean(axis=1)
    off, stated = [], []
    for seed in range(16):
        views = point_views(scene, LAMPS[:1], (60, 120), seed=seed)
        shot = views.shot(lobes(views))
        assert views.solid_angles.sum() == pytest.approx(4 * np.pi)
        assert shot.sent == pytest.approx(1, rel=5e-3) and not shot.lost.any()
        off.append(shot.irradiance[floor, 0] - exact)
        stated.append(shot.error[floor, 0])
    scatter = np.sqrt(np.mean(np.square(off)))
    assert scatter < 0.05 * exact.mean()
    assert np.abs(np.mean(off, axis=0)).max() < 4.5 * np.std(off, axis=0).max() / 4  # unbiased
    assert 0.9 * scatter < np.sqrt(np.mean(np.square(stated))) < 3 * scatter


def test_the_adjoint_map_is_the_derivative_by_each_intensity():
    """Against solutions with other lamps: dimmed, coloured and turned; in a furnished room, for losses on B and H."""
    patches = lit(True)
    segments = transports(patches)["segments"]
    views = point_views(RayScene(patches), LAMPS, (24, 48))
    g, h = np.random.default_rng(7).normal(size=(2, *patches.emission.shape)) * patches.areas[:, None]

    def solution(intensity):
        return solved(patches, segments, views.shot(intensity))

    def loss(intensity):
        found = solution(intensity)
        return float((g * found.radiosity).sum() + (h * found.irradiance).sum())

    before = lobes(views)
    found = gradient(solution(before), segments, g, dirradiance=h)
    by_cell = views.adjoint_map(found) * views.solid_angles[..., None]
    before = before[..., None] * np.ones(2)
    turned = np.roll(before, 12, axis=1)
    for after in (0.5 * before, before**2, before * [1.5, 0.2], before * np.reshape([1, 3], (2, 1, 1, 1)), turned):
        assert (by_cell * (after - before)).sum() == pytest.approx(loss(after) - loss(before), rel=1e-8)


def test_the_power_of_lamps_is_balanced():
    patches = room(2, reflectance=0.5)
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 2000).cast(256), "reciprocal").repaired()
    views = point_views(RayScene(patches), LAMPS)
    solution = solved(patches, factors, views.shot(lobes(views)))
    np.testing.assert_allclose(solution.power["emitted"], 2, rtol=1e-3)
    assert solution.imbalance < 1e-6


def test_what_is_refused_in_one_line():
    patches = lit()
    known = transports(patches)
    segments = known["segments"]
    solution = solved(patches, segments)
    g = np.ones(patches.emission.shape)
    wrong = g.copy()
    wrong[3] = np.nan
    other = ABuffer(patches, Independent(4, seed=5), 40).cast(16)
    early = solve(patches, segments, max_iterations=1, ambient="fuzzy")
    scene = RayScene(patches)
    views = point_views(scene, LAMPS, (8, 16))
    cubes = point_views(RayScene(cube(2)), LAMPS[:1], (2, 2))
    found = gradient(solution, segments, g)

    class Bare:
        outside, dark, exchange_weights, gather = segments.sky, segments.dark, None, segments.gather

    # A closed box of mirrors, without light, in the room: its loss has no finite derivative.
    apart = Patches(*joined(box((0, 0, 0), (3, 3, 3), inward=True), box((1, 1, 1), (2, 2, 2), inward=True)))
    dark = np.arange(12) >= 6
    apart = apart.with_properties(np.where(dark, 1.0, 0.5), np.where(dark, 0.0, 1.0))
    lines = ABuffer(apart, lines=400).cast(64)
    calls = {
        "needs the derivative": lambda: gradient(solution, segments),
        "a row for each patch": lambda: gradient(solution, segments, g[:, 0]),
        "patch 3": lambda: gradient(solution, segments, wrong),
        "array of numbers": lambda: gradient(solution, segments, "radiosity"),
        "transport is not that": lambda: gradient(solution, other, g),
        "without an ambient term": lambda: gradient(early, segments, g),
        "transport is that of 24": lambda: gradient(solution, sphere_factors(cube(2)), g),
        "no exchange weights": lambda: gradient(solution, Bare(), g),
        "in one channel": lambda: gradient(solution, segments, g, temperatures=300),
        "batches of lines": lambda: gradient_error(solution, known["pooled"], g),
        "at least two batches": lambda: gradient_error(solution, segments.batch(0), g),
        "point 1 ": lambda: point_views(scene, [[0.5, 0.5, 0.5], np.mean(BOXES[0], axis=0)]),
        "finite numbers": lambda: point_views(scene, [[np.nan, 0, 0]]),
        "2 rows": lambda: point_views(scene, LAMPS, (1, 4)),
        "each point and cell": lambda: views.shot(np.ones((8, 16))),
        "not negative": lambda: views.shot(-lobes(views)),
        "gradient is that of": lambda: cubes.adjoint_map(found),
        "shot is that of other": lambda: found.along(cubes.shot(np.ones(cubes.seen.shape))),
        "adjoint of this loss has no solution": lambda: gradient(solved(apart, lines), lines, 1.0 * dark),
    }
    for message, call in calls.items():
        with pytest.raises(RadiosityError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)
    grey = thermal(lit(channels=1), 300, 0.5)
    with pytest.raises(RadiosityError, match="do not emit as grey"):
        gradient(solved(grey, segments), segments, grey.areas, temperatures=310)
