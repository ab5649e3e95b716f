"""Solutions of the radiosity system: by every solver, by multipath, and in closed form."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from support.patches import cube, room
from support.tables import thinned

from etendue.points import Halton, Independent, OwenSobol
from etendue.radiosity import (
    SOLVERS,
    ABuffer,
    ChainedRays,
    Patches,
    RadiosityError,
    RayScene,
    SpherePairs,
    breadth_first,
    depth_first,
    first_shot,
    form_factors,
    multipath,
    multipath_bundles,
    scene_patches,
    solve,
)
from etendue.scene import load


def lit_room(n, channels=3):
    """A room whose middle of the ceiling shines, with other colours everywhere."""
    geometry = room(n)
    colours = 0.1 + 0.7 * np.random.default_rng(3).uniform(size=(len(geometry), channels))
    lamp = np.linalg.norm(geometry.centres - [0.5, 0.5, 1], axis=1) < 0.36
    emission = lamp[:, None] * np.arange(1.0, channels + 1)
    return geometry.with_properties(reflectance=colours, emission=emission)


def opened(patches, missing=5):
    """Without the first faces: light comes in and goes out."""
    kept = np.arange(missing, len(patches))
    return Patches(
        *(patches.vertices, patches.faces[kept]),
        reflectance=patches.reflectance[kept],
        emission=patches.emission[kept],
        sky=[0.5, 0.2, 0.1],
    )


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("is_open", [False, True])
def test_solvers_agree_with_the_direct_solution(solver, is_open):
    patches = opened(lit_room(3)) if is_open else lit_room(3)
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 1000).cast(300))
    exact = solve(patches, factors, "direct", tolerance=1e-10)
    found = solve(patches, factors, solver, tolerance=1e-10)
    np.testing.assert_allclose(found.radiosity, exact.radiosity, rtol=1e-7)
    np.testing.assert_allclose(found.irradiance, exact.irradiance, rtol=1e-7)
    np.testing.assert_allclose(found.radiosity, patches.emission + patches.reflectance * found.irradiance, rtol=1e-7)
    assert exact.imbalance < 5e-3


@pytest.mark.parametrize("solver", ["jacobi", "conjugate-gradient"])
def test_segments_give_the_solution_of_their_matrix(solver):
    patches = lit_room(3)
    segments = ABuffer(patches, OwenSobol(4, seed=1), 1000).cast(300)
    exact = solve(patches, form_factors(segments), "direct")
    found = solve(patches, segments, solver, tolerance=1e-10)
    np.testing.assert_allclose(found.radiosity, exact.radiosity, rtol=1e-7)
    assert found.residuals == tuple(sorted(found.residuals, reverse=True)) or solver != "jacobi"


def test_energy_is_balanced_where_factors_are_reciprocal_and_closed():
    patches = lit_room(2)
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 1000).cast(200), "reciprocal").repaired()
    assert solve(patches, factors, "conjugate-gradient", tolerance=1e-12).imbalance < 1e-9


def test_light_that_is_shot_and_light_that_is_gathered():
    """The system of powers: the same solution where factors are reciprocal, all power found where rows sum to 1."""
    patches = lit_room(2)
    segments = ABuffer(patches, OwenSobol(4, seed=1), 500).cast(100)
    factors = form_factors(segments, "reciprocal")
    gathered, shot = (solve(patches, f, "gauss-seidel", tolerance=1e-12) for f in (factors, factors.transposed()))
    np.testing.assert_allclose(gathered.radiosity, shot.radiosity, rtol=1e-9)
    assert solve(patches, form_factors(segments).transposed(), tolerance=1e-12).imbalance < 1e-10


def test_a_furnace():
    """Where all emit and reflect alike, the radiosity is E / (1 - rho) whatever the form factors."""
    patches = room(2, reflectance=0.8, emission=2.0)
    segments = ABuffer(patches, OwenSobol(4, seed=1), 500).cast(64)
    for solver, iterations in (("jacobi", 80), ("conjugate-gradient", 3)):
        solution = solve(patches, segments, solver)
        np.testing.assert_allclose(solution.radiosity, 10, rtol=1e-5)
        assert len(solution.residuals) <= iterations


@pytest.mark.slow
def test_multipath_comes_to_the_direct_solution():
    """Line by line and by bundles, with and without a first shot: the mean of repetitions, by their scatter."""
    patches = lit_room(2)
    scene = RayScene(patches)
    exact = solve(patches, form_factors(ABuffer(patches, OwenSobol(4, seed=1)).cast(2048), "F4")).radiosity
    forms = {"line by line": [], "after a shot": [], "bundles": [], "bundles after a shot": []}
    lines, bundles, count = 1 << 14, 128, 6
    for seed in range(count):
        rays = ChainedRays(SpherePairs(patches), scene, Independent(4, seed=seed))
        parallel = ABuffer(patches, Independent(4, seed=seed), 200)
        shot = first_shot(scene, Independent(4, seed=100 + seed).block(1 << 14))
        for kind, start in (("line by line", None), ("after a shot", shot)):
            result = multipath(rays, lines, shot=start)
            forms[kind].append(result.radiosity)
            out = result.absorbed + result.to_sky + result.unshot.sum(axis=0)
            np.testing.assert_allclose(result.sent, out, rtol=1e-9)
        for kind, start in (("bundles", None), ("bundles after a shot", shot)):
            result = multipath_bundles(parallel, bundles, shot=start)
            forms[kind].append(result.radiosity)
            out = result.absorbed + result.to_sky + result.unshot.sum(axis=0)
            np.testing.assert_allclose(result.sent, out, rtol=1e-9)
            np.testing.assert_allclose(out, (patches.areas[:, None] * patches.emission).sum(axis=0), rtol=1e-6)
    for kind, radiosities in forms.items():
        mean, spread = np.mean(radiosities, axis=0), np.std(radiosities, axis=0, ddof=1) / np.sqrt(count)
        total = (patches.areas[:, None] * mean).sum() / (patches.areas[:, None] * exact).sum()
        # Of single lines, power that is on its way in the end is missing. Of bundles, none is.
        single = "bundles" not in kind
        assert total == pytest.approx(1, abs=0.03 if single else 0.003), kind
        deviation = (mean - exact) / (spread + (0.005 if single else 0.001) * exact)
        assert np.sqrt((deviation**2).mean()) < 2, kind


@pytest.mark.parametrize("form", thinned(["hit", "patch", "breadth"], ["breadth"]))
def test_particles_come_to_the_direct_solution(form):
    patches = lit_room(2)
    scene = RayScene(patches)
    exact = solve(patches, form_factors(ABuffer(patches, OwenSobol(4, seed=1)).cast(2048), "F4")).radiosity
    results = [
        breadth_first(scene, 1 << 14, Independent(4, seed=seed), tolerance=1e-4)
        if form == "breadth"
        else depth_first(scene, 1 << 14, Independent(4, seed=seed), seed=seed, leave=form)
        for seed in range(10)
    ]
    emitted = (patches.areas[:, None] * patches.emission).sum(axis=0)
    for result in results:
        gone = result.absorbed + result.to_sky + result.unshot
        np.testing.assert_allclose(gone, emitted, rtol=1e-9 if form == "breadth" else 0.05)
        assert result.rays > 1 << 14 and result.to_sky.sum() < 1e-3 * emitted.sum()
    radiosities = np.array([result.radiosity for result in results])
    mean, spread = radiosities.mean(axis=0), radiosities.std(axis=0, ddof=1) / np.sqrt(10)
    # Particles that leave from where they are do not know that the radiosity of a patch is taken as one.
    deviation = (mean - exact) / (spread + (0.05 if form == "hit" else 0.003) * exact)
    assert np.sqrt((deviation**2).mean()) < 1.7


@pytest.mark.slow
def test_point_sequences_have_less_than_two_thirds_of_the_error_of_independent_lines():
    """Mean squared error of multipath after a first shot, at equal lines; in [Castro 2002, sec. 3.3] about a half.

    Weyl's points are left out: with so few lines they have a third here, with more 0.5 to 0.7, and in other rooms more
    than independent ones."""
    patches = lit_room(2, channels=1)
    scene, lines = RayScene(patches), 1 << 12
    exact = solve(patches, form_factors(ABuffer(patches, OwenSobol(4, seed=1)).cast(1024), "F4")).radiosity

    def error(points, seed):
        shot = first_shot(scene, points.randomised(100 + seed).block(lines))
        engine = ChainedRays(SpherePairs(patches), scene, points.randomised(seed))
        return (patches.areas[:, None] * (multipath(engine, lines, shot=shot).radiosity - exact) ** 2).sum()

    independent = np.mean([error(Independent(4), seed) for seed in range(8)])
    for sequence in (Halton(4), OwenSobol(4)):
        assert np.mean([error(sequence, seed) for seed in range(8)]) < 0.65 * independent, sequence


def test_multipath_under_a_sky():
    patches = opened(lit_room(2), missing=2)
    engine = ABuffer(patches, OwenSobol(4, seed=5), 2000)
    exact = solve(patches, engine.cast(1024)).radiosity
    result = multipath_bundles(engine, 256)
    np.testing.assert_allclose(
        (patches.areas[:, None] * result.radiosity).sum(axis=0), (patches.areas[:, None] * exact).sum(axis=0), rtol=5e-3
    )
    assert result.unshot.sum() < 1e-6 * result.sent.sum()
    np.testing.assert_allclose(result.sent, result.absorbed + result.to_sky + result.unshot.sum(axis=0), rtol=1e-9)


@pytest.mark.slow
def test_the_light_of_path_tracing():
    """Mean radiosity of the walls of the Cornell box, against paths that start there."""
    scene = load("cornell-box", check=False).scene
    patches = scene_patches(scene, max_area=0.02)
    solution = solve(patches, ABuffer(patches, OwenSobol(4, seed=1)).cast(512), "conjugate-gradient")
    integrator = mi.load_dict({"type": "path", "max_depth": 40, "rr_depth": 40})
    walls = [shape for shape in scene.shapes() if shape.id() in ("floor", "ceiling", "back", "green-wall", "red-wall")]
    assert len(walls) == 5
    for wall in walls:
        lanes = 1 << 15
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(3, lanes)
        point = wall.sample_position(0.0, sampler.next_2d())
        ray = mi.RayDifferential3f(mi.Ray3f(point.p + 1e-3 * point.n, -point.n))
        found = np.pi * np.array(integrator.sample(scene, sampler, ray)[0]).reshape(3, -1)
        centre, normal = np.array(point.p).mean(axis=1), np.array(point.n).mean(axis=1)
        on_wall = (np.abs((patches.centres - centre) @ normal) < 1e-4) & (patches.normals @ normal > 0.999)
        areas = patches.areas[on_wall]
        mean = (areas[:, None] * solution.radiosity[on_wall]).sum(axis=0) / areas.sum()
        error = found.std(axis=1) / np.sqrt(lanes)
        # Light leaks through patches that a box stands on, in part.
        assert (np.abs(mean - found.mean(axis=1)) < 4 * error + 0.01 * mean).all(), wall.id()


def test_conjugate_gradients_take_the_estimators_that_their_message_names():
    patches = lit_room(2, channels=1)
    segments = ABuffer(patches, OwenSobol(4, seed=1), 1000).cast(50)
    with pytest.raises(RadiosityError) as error:
        solve(patches, form_factors(segments, "F2"), "conjugate-gradient")
    for name in ("F3", "F4", "reciprocal", "pooled"):
        assert f"'{name}'" in str(error.value)
        assert solve(patches, form_factors(segments, name), "conjugate-gradient").residual <= 1e-6


def test_what_cannot_be_solved():
    patches = cube(1, reflectance=0.5, emission=1.0)
    segments = ABuffer(patches, lines=50).cast(32)
    factors = form_factors(segments)
    dark = patches.with_properties(emission=0.0)
    for call, words in (
        (lambda: solve(dark, segments), "no patch emits"),
        (lambda: multipath(ABuffer(dark), 1), "no patch emits"),
        (lambda: first_shot(RayScene(dark), np.full((4, 4), 0.5)), "no patch emits"),
        (lambda: breadth_first(RayScene(dark), 8), "no patch emits"),
        (lambda: depth_first(RayScene(patches), 8, leave="edge"), "'hit' or the 'patch'"),
        (lambda: solve(patches, segments, "direct"), "needs form factors"),
        (lambda: solve(patches, segments, "guess"), "there is no solver"),
        (lambda: solve(patches, form_factors(segments, "F2"), "conjugate-gradient"), "reciprocal form factors"),
        (lambda: solve(patches, segments, tolerance=1e-9, max_iterations=2), "after 2 iterations"),
        (lambda: solve(patches, segments, max_iterations=0), "at least one iteration, not 0"),
        (lambda: solve(cube(2, emission=1.0), factors), "there are 24 patches, but the transport is that of 6"),
    ):
        with pytest.raises(RadiosityError) as error:
            call()
        assert words in str(error.value) and "\n" not in str(error.value)
