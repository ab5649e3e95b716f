"""Particle tracing against closed forms: fluxes in a closed box, and what becomes a particle."""

from __future__ import annotations

from functools import cache
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from support.particles import POWER, box
from support.scenes import diffuse, rgb

import etendue
from etendue.core import SceneError
from etendue.methods import ParticleTracing
from etendue.particles import Particles
from etendue.scene import Problem, load

PATHS, PASSES = 4096, 16


@cache
def problem(albedo: tuple[float, float, float] = (0.5, 0.5, 0.5)) -> Problem:
    return load(box(albedo))


def traced(source: Problem, passes: int = PASSES, seed: int = 1, **settings: Any) -> list[Particles]:
    """The particles of each pass, each with the power of the lamp of its own paths."""
    given = {"samples_per_pass": PATHS, "sampler": "independent"} | settings
    tracing = ParticleTracing(ParticleTracing.Settings.from_mapping(given))  # type: ignore[arg-type]
    tracing.prepare(source, seed)
    return [tracing.particles(tracing.step(k, seed, {}).measurement) for k in range(passes)]


def z_scores(passes: list[Particles], expected: np.ndarray) -> np.ndarray:
    """Deviations of the mean flux over the passes from ``expected``, in measured standard errors of at most 1 %."""
    flux = np.array([p.power.sum(0, dtype=float) for p in passes])
    error = flux.std(0, ddof=1) / np.sqrt(len(flux)) + 1e-5 * expected  # the second for single precision
    assert (error < 0.01 * expected).all()
    return (flux.mean(0) - expected) / error


def test_flux_in_a_closed_box():
    """Light is reflected again and again: the incident flux is power / (1 - albedo), on each wall a sixth."""
    passes = traced(problem())
    expected = POWER / (1 - 0.5)
    assert np.abs(z_scores(passes, expected)).max() < 4
    for wall in range(6):
        on_wall = [p[p.shape == wall] for p in passes]
        assert np.abs(z_scores(on_wall, expected / 6)).max() < 4


def test_direct_light_has_the_power_of_the_lamp():
    (particles,) = traced(problem(), passes=1, max_bounces=1)
    assert len(particles) == PATHS and (particles.bounce == 1).all()
    np.testing.assert_allclose(particles.power.sum(0, dtype=float), POWER, rtol=1e-5)
    p = particles.position
    np.testing.assert_allclose(np.abs(p).max(1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(particles.direction, p / np.linalg.norm(p, axis=1)[:, None], atol=1e-5)


def test_uv_and_frames_give_the_position():
    source = problem()
    tracing = ParticleTracing()
    tracing.prepare(source, 0)
    particles = traced(source, passes=1)[0]
    surfaces = tracing.surfaces
    frame = surfaces.frames[surfaces.first[particles.shape] + particles.primitive]
    u, v = particles.uv.T[:, :, None]
    np.testing.assert_allclose(frame[:, :3] + u * frame[:, 3:6] + v * frame[:, 6:], particles.position, atol=1e-5)
    np.testing.assert_allclose(surfaces.areas, 4.0, rtol=1e-6)
    assert sorted(surfaces.names) == ["back", "ceiling", "floor", "front", "left", "right"]


def test_first_hits_are_those_of_direct_light():
    first = traced(problem(), passes=1, keep="first")[0]
    assert len(first) == PATHS
    assert (first.bounce == 1).all()


def test_hits_after_n_bounces_lose_the_first():
    everything, later = traced(problem(), passes=1)[0], traced(problem(), passes=1, after=2)[0]
    chosen = everything[everything.bounce > 2]
    assert later.bounce.min() == 3
    np.testing.assert_array_equal(later.rows, chosen.rows)


def test_all_light_is_absorbed():
    """Each path ends on a wall, and what arrives is absorbed: by grey walls in equal parts, by coloured ones on
    average."""
    (grey,) = traced(problem(), passes=1, keep="absorbed")
    assert len(grey) == PATHS
    np.testing.assert_allclose(grey.power, np.tile(POWER / PATHS, (PATHS, 1)), rtol=1e-5)
    coloured = traced(problem((0.7, 0.5, 0.2)), keep="absorbed")
    assert np.abs(z_scores(coloured, POWER)).max() < 4


def test_mirrors_have_no_particles_unless_asked():
    mirror = {"type": "conductor", "material": "none"}
    half = {"type": "rectangle", "bsdf": mirror, "to_world": mi.ScalarTransform4f().translate([0, 0, -0.9]).scale(0.9)}
    source = load(box(mirror=half))
    names = ParticleTracing()
    names.prepare(source, 0)
    number = names.surfaces.names.index("mirror")
    assert not (traced(source, passes=1)[0].shape == number).any()
    shown = traced(source, passes=1, specular=True)[0]
    assert (shown.shape == number).sum() > PATHS / 20
    # The mirror turns light back: its particles are followed by others of the same power.
    first = traced(source, passes=1, keep="first")[0]
    np.testing.assert_allclose(first.power.sum(0, dtype=float), POWER, rtol=1e-4)
    assert set(first.bounce) == {1, 2}


def test_a_small_scene_has_its_own_units():
    """Render space enlarges a box of 2 mm; positions and power are those of the scene nevertheless."""
    light = {"type": "sphere", "radius": 2e-4, "emitter": {"type": "area", "radiance": rgb(3.0, 2.0, 1.0)}}
    scene = box(half=1e-3, lamp=light | {"bsdf": diffuse(0.0, 0.0, 0.0)})
    source = load(scene)
    assert not source.space.is_own
    (particles,) = traced(source, passes=1, max_bounces=1)
    np.testing.assert_allclose(np.abs(particles.position).max(), 1e-3, rtol=1e-4)
    power = np.pi * 4 * np.pi * 2e-4**2 * np.array([3.0, 2.0, 1.0])
    np.testing.assert_allclose(particles.power.sum(0, dtype=float), power, rtol=1e-3)


def test_the_same_seed_gives_the_same_particles_in_the_same_order():
    one, two = (etendue.trace_particles(problem().scene, paths=5000, seed=3).particles for _ in range(2))
    np.testing.assert_array_equal(one.rows, two.rows)
    assert (np.diff(one.path.astype(np.int64)) >= 0).all()
    other = etendue.trace_particles(problem().scene, paths=5000, seed=4).particles
    assert not np.array_equal(one.position[:100], other.position[:100])


def test_a_budget_in_particles():
    result = etendue.trace_particles(problem().scene, particles=20_000)
    assert len(result.particles) == pytest.approx(20_000, rel=0.05)
    assert result.counters["particles"] == len(result.particles)


def test_a_scene_in_which_no_light_arrives():
    black = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -50])}
    scene = {
        "type": "scene",
        "sensor": box()["sensor"],
        "lamp": {"type": "spot", "intensity": 1.0, "cutoff_angle": 5.0},
        "wall": black,
    }
    with pytest.raises(SceneError, match=r"none of \d+ light paths .* left a particle"):
        etendue.trace_particles(load(scene).scene)


def masked() -> Problem:
    """A half opaque sheet around the lamp: half of the light crosses it, at each crossing."""
    sheet = {"type": "mask", "opacity": 0.5, "bsdf": {"type": "twosided", "bsdf": diffuse(0.5, 0.5, 0.5)}}
    return load(box(sheet={"type": "sphere", "radius": 0.5, "bsdf": sheet}))


def test_hits_before_and_behind_null_surfaces_are_in_order():
    """They have the same bounce; the sheet is hit first."""
    source = masked()
    one, two = (traced(source, passes=1)[0] for _ in range(2))
    np.testing.assert_array_equal(one.rows, two.rows)
    sheet = one.shape == one.shape[0]
    assert np.allclose(np.linalg.norm(one.position[sheet], axis=1), 0.5, atol=1e-4)
    same = (np.diff(one.path.astype(np.int64)) == 0) & (np.diff(one.bounce.astype(np.int64)) == 0)
    assert same.sum() > PATHS / 4
    direct = same & (one.bounce[:-1] == 1)
    assert sheet[:-1][direct].all() and not sheet[1:][direct].any()


def test_a_path_has_one_first_particle_behind_null_surfaces_too():
    first = traced(masked(), passes=1, keep="first")[0]
    assert len(first) == PATHS == len(np.unique(first.path))
    np.testing.assert_allclose(first.power.sum(0, dtype=float), POWER, rtol=1e-4)


def test_light_absorbed_at_the_last_edge_is_a_share_of_what_arrives():
    """Of the sheet, half opaque and of albedo one half, a quarter."""
    passes = traced(masked(), keep="absorbed", max_bounces=1)
    assert np.abs(z_scores(passes, POWER / 4)).max() < 4


def test_a_pass_that_does_not_fit_at_first_leaves_the_passes_as_they_are():
    tracing = ParticleTracing(ParticleTracing.Settings(sampler="independent"))
    tracing.prepare(problem(), 1)
    paths, expected = tracing.samples_per_iteration, tracing.step(1, 1, {}).measurement
    tracing._room *= 0.5
    again = tracing.step(1, 1, {}).measurement
    assert tracing.samples_per_iteration == paths == again.counters["paths"]
    assert again.counters["particles"] == expected.counters["particles"]
