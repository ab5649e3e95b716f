"""The light of small emitters, sent by rays, and the solution of the rest."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import BOXES, box, cube, discs, joined, parallel_squares, perpendicular_squares, room, square

import etendue.radiosity.solvers.shot
from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    SOLVERS,
    ABuffer,
    Patches,
    RadiosityError,
    RayScene,
    first_shot,
    form_factors,
    multipath_bundles,
    shot_at_patches,
    small_emitters,
    solve,
)
from etendue.radiosity.solvers.shot import Shot


def lamp_in_a_room(walls=2, missing=0, **properties):
    """A small lamp that shines down, the last patch, in a room with a box; without the first faces it is open."""
    lamp = square((0.47, 0.48, 0.97), (0, 0.05, 0), (0.05, 0, 0))
    vertices, faces = joined(box((0, 0, 0), (1, 1, 1), walls, inward=True), box(*BOXES[0]), lamp)
    faces = faces[missing:]
    emission = np.zeros((len(faces), 2))
    emission[-1] = 100, 30
    reflectance = np.random.default_rng(1).uniform(0.2, 0.8, (len(faces), 2))
    return Patches(vertices, faces, **{"reflectance": reflectance, "emission": emission, **properties})


@pytest.mark.parametrize("aimed", [False, True])
def test_the_solution_is_unbiased_and_has_a_fraction_of_the_error(aimed):
    """Mean over seeds against a converged solution, by the scatter of the seeds, which the errors tell."""
    patches = lamp_in_a_room()
    scene = RayScene(patches)
    many = ABuffer(patches, OwenSobol(4, seed=99), 4000).cast(1024)
    exact = solve(patches, many, "conjugate-gradient", shot=first_shot(scene, OwenSobol(4).block(1 << 19))).irradiance
    found, errors, without = [], [], []
    for seed in range(10):
        segments = ABuffer(patches, Independent(4, seed=seed), 500).cast(256)
        points = Independent(4, seed=50 + seed)
        shot = shot_at_patches(scene, 1 << 14, points) if aimed else first_shot(scene, points.block(1 << 14))
        solution = solve(patches, segments, "conjugate-gradient", shot=shot)
        found.append(solution.irradiance)
        errors.append(solution.irradiance_error(segments))
        without.append(solve(patches, segments, "conjugate-gradient").irradiance)
    weight = patches.areas[:, None] / exact.mean() ** 2
    scatter = np.std(found, axis=0, ddof=1)
    deviation = (np.mean(found, axis=0) - exact) / (scatter / np.sqrt(10) + 2e-3 * exact)
    assert np.sqrt((deviation**2).mean()) < 1.6
    assert np.sqrt((np.square(errors) * weight).sum() / 10) == pytest.approx(
        np.sqrt((scatter**2 * weight).sum()), rel=0.5
    )
    squares = [(np.square(np.array(x) - exact) * weight).sum() for x in (found, without)]
    assert squares[0] < (0.03 if aimed else 0.1) * squares[1]


def test_the_error_of_a_point_sequence_is_the_scatter_over_seeds():
    """Mean squares over the surface, both known to a tenth by 30 seeds."""
    patches = lamp_in_a_room()
    scene = RayScene(patches)
    shots = [shot_at_patches(scene, 1, OwenSobol(4, seed=seed)) for seed in range(30)]
    areas = patches.areas[:, None]
    scatter = (areas * np.var([shot.irradiance for shot in shots], axis=0, ddof=1)).sum()
    stated = (areas * np.mean([np.square(shot.error) for shot in shots], axis=0)).sum()
    assert np.sqrt(stated / scatter) == pytest.approx(1, rel=0.25)


@pytest.mark.parametrize(("pair", "near"), [(parallel_squares, 0.3), (perpendicular_squares, 0.3), (discs, 0.0)])
def test_aimed_rays_find_form_factors_in_closed_form(pair, near, monkeypatch):
    """Far from a lamp, beside it, and by the cosine law alone; in open scenes the rest goes to the sky."""
    monkeypatch.setattr(etendue.radiosity.solvers.shot, "_NEAR", near)
    (vertices, faces), exact = pair()
    ids = np.repeat([0, 1], len(faces) // 2)
    patches = Patches(vertices, faces, ids=ids, emission=[1.0, 0.0])
    shots = [shot_at_patches(RayScene(patches), 1 << 15, Independent(4, seed=seed)) for seed in range(8)]
    found = [shot.irradiance[1, 0] * patches.areas[1] / patches.areas[0] for shot in shots]
    assert np.mean(found) == pytest.approx(exact, abs=4 * np.std(found, ddof=1) / np.sqrt(8) + 1e-5)
    assert np.std(found) < 0.01
    for shot in shots:
        assert shot.to_sky[0] + shot.irradiance[1, 0] * patches.areas[1] == pytest.approx(patches.areas[0])


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("missing", [0, 3])
def test_solvers_agree_after_a_shot(solver, missing):
    patches = lamp_in_a_room(missing=missing, sky=[0.5, 0.2] if missing else 0.0)
    shot = shot_at_patches(RayScene(patches), 1 << 12)
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 500).cast(128))
    exact = solve(patches, factors, "direct", shot=shot, tolerance=1e-10)
    found = solve(patches, factors, solver, shot=shot, tolerance=1e-10)
    np.testing.assert_allclose(found.radiosity, exact.radiosity, rtol=1e-7)
    np.testing.assert_allclose(found.radiosity, patches.emission + patches.reflectance * found.irradiance, rtol=1e-7)
    assert exact.imbalance < 0.01 and (missing > 0) == bool(shot.to_sky.any())


@pytest.mark.parametrize("aimed", [False, True])
def test_no_power_is_lost(aimed):
    """Where factors are reciprocal and closed, but to the back of the lamp; the shot loses nothing anyway."""
    patches = lamp_in_a_room()
    scene = RayScene(patches)
    shot = shot_at_patches(scene, 1 << 12) if aimed else first_shot(scene, OwenSobol(4, seed=2).block(1 << 12))
    sent = (patches.areas[:, None] * patches.emission).sum(axis=0)
    arrived = (patches.areas[:, None] * shot.irradiance).sum(axis=0)
    np.testing.assert_allclose(arrived + shot.to_sky + shot.lost, sent, rtol=1e-12)
    np.testing.assert_allclose(shot.absorbed + shot.reflected.sum(axis=0) + shot.to_sky, sent, rtol=1e-12)
    factors = form_factors(ABuffer(patches, OwenSobol(4, seed=1), 4000).cast(256), "reciprocal").repaired()
    solution = solve(patches, factors, "conjugate-gradient", shot=shot, tolerance=1e-12)
    by_lines = patches.areas[:, None] * (solution.radiosity - shot.emission)
    on_backs = (factors.dark[:, None] * by_lines).sum() + shot.lost.sum()
    assert solution.imbalance == pytest.approx(on_backs / sent.sum(), abs=1e-9)


def test_black_patches_keep_what_was_shot():
    patches = lamp_in_a_room(reflectance=0.0)
    shot = first_shot(RayScene(patches), OwenSobol(4, seed=2).block(1 << 10))
    segments = ABuffer(patches, lines=200).cast(32)
    for solver in ("jacobi", "conjugate-gradient"):
        solution = solve(patches, segments, solver, shot=shot)
        np.testing.assert_allclose(solution.irradiance, shot.irradiance)
        np.testing.assert_allclose(solution.radiosity, patches.emission)


def test_some_emitters_are_shot_and_the_others_left_to_the_lines():
    """By the solver and by multipath: no power is lost, and both come to the same."""
    patches = lamp_in_a_room()
    patches = patches.with_properties(emission=patches.emission + 0.1)
    emitters = small_emitters(patches, 1 / 16)
    assert np.flatnonzero(emitters).tolist() == [len(patches) - 1]
    shot = first_shot(RayScene(patches), OwenSobol(4, seed=2).block(1 << 16), emitters)
    engine = ABuffer(patches, OwenSobol(4, seed=1), 1000)
    solution = solve(patches, engine.cast(1024), shot=shot)
    assert solution.imbalance < 2e-3
    result = multipath_bundles(engine, 256, shot=shot)
    out = result.absorbed + result.to_sky + result.unshot.sum(axis=0)
    np.testing.assert_allclose(result.sent, out, rtol=1e-9)
    powers = [(patches.areas[:, None] * x.radiosity).sum(axis=0) for x in (solution, result)]
    np.testing.assert_allclose(*powers, rtol=0.01)


def test_which_emitters_are_small():
    lamp = lamp_in_a_room()
    only = np.arange(len(lamp)) == len(lamp) - 1
    assert np.array_equal(small_emitters(lamp, 1 / 16), only)
    assert not small_emitters(lamp, 1e-4).any()  # so few rays are no help
    assert not small_emitters(room(2, emission=1.0), 1 / 16).any()
    # All nearly alike: the brightest alone are no great part of it.
    assert not small_emitters(room(2, emission=np.linspace(1, 1.1, len(room(2)))), 1 / 16).any()
    assert not small_emitters(cube(1), 1 / 16).any()


def test_so_many_rays_give_the_same_whenever_they_are_cast(monkeypatch):
    patches = lamp_in_a_room()
    scene, emitters = RayScene(patches), small_emitters(patches, 1 / 16)
    shot = Shot(scene, OwenSobol(4, seed=3), emitters)
    rays = 9 * shot.cast(1).rays // 4
    at_once, blocks = shot.cast(rays), shot.blocks(rays)
    assert blocks == 9
    monkeypatch.setattr(etendue.radiosity.solvers.shot, "BATCH", 1 << 16)  # in parts
    again = Shot(scene, OwenSobol(4, seed=3), emitters).cast(rays)
    assert at_once.rays == again.rays >= rays
    np.testing.assert_array_equal(at_once.irradiance, again.irradiance)
    np.testing.assert_array_equal(at_once.error, again.error)
    # Blocks of several calls, in any order, add up.
    parts = shot.result(shot.light(7, blocks - 7) + shot.light(0, 7))
    assert parts.rays == at_once.rays
    np.testing.assert_allclose(parts.irradiance, at_once.irradiance, rtol=1e-12)
    np.testing.assert_allclose(parts.error, at_once.error, rtol=1e-9)


def test_shots_that_do_not_fit():
    patches = lamp_in_a_room()
    shot = first_shot(RayScene(patches), OwenSobol(4).block(64))
    segments = ABuffer(patches, lines=200).cast(16)
    with pytest.raises(RadiosityError, match="more light than the patches emit"):
        solve(patches.with_properties(emission=0.5 * patches.emission), segments, shot=shot)
    other = lamp_in_a_room(walls=1)
    with pytest.raises(RadiosityError, match="of other patches"):
        solve(other, ABuffer(other, lines=200).cast(16), shot=shot)
    with pytest.raises(RadiosityError, match="no first shot"):
        first_shot(RayScene(patches), OwenSobol(4).block(64), np.arange(len(patches)) == 0)
