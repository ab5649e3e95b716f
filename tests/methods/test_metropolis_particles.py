"""Metropolis particle tracing against independent light paths, closed forms and its own rules."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.light_paths import independent

from etendue.core import CheckpointError, Measurement, Replica, SceneError
from etendue.integration import autocorrelation_time
from etendue.methods.metropolis.particles import MetropolisParticles, MetropolisParticlesSettings
from etendue.methods.particles import ParticleSettings, ParticleTracing
from etendue.scene import Problem, load

#: A run that agrees is called different with this probability.
LEVEL = 1e-5
LONGEST = 12


def made(problem: Problem, seed: int = 1, **settings: Any) -> MetropolisParticles:
    common = {"chains": 1024, "steps": 64, "max_bounces": LONGEST, "bootstrap": 1 << 15, "specular": True}
    method = MetropolisParticles(MetropolisParticlesSettings(**common | settings))
    method.prepare(problem, seed)
    return method


def run(method: MetropolisParticles, passes: int, seed: int = 1) -> Measurement:
    replica = Replica(method, seed)
    measurement = replica.step(0)
    for iteration in range(1, passes):
        measurement += replica.step(iteration)
    return measurement


def cells(shape: np.ndarray, position: np.ndarray, bounce: np.ndarray) -> np.ndarray:
    """A number for each shape, quarter of the plane and group of bounces."""
    quarter = (position[..., 0] > 0).astype(int) + 2 * (position[..., 2] > 0)
    return (shape * 4 + quarter) * 4 + np.minimum(bounce, 4) - 1


def test_steps_cast_at_most_one_ray_and_count_every_state():
    method = made(scenes.room("rectangle", scenes.FEW))
    measurement = run(method, 2)
    steps = method.settings.chains * method.settings.steps * 2
    repeats = method.repeats(measurement)
    assert repeats.sum() == steps == measurement.counters["paths"]
    # Two of three kinds of step cast a ray, unless their numbers leave the cube.
    assert 0.5 * steps < measurement.counters["step_rays"] < 0.67 * steps
    assert 0.2 * steps < measurement.counters["accepted"] < 0.9 * steps
    particles = method.particles(measurement)
    np.testing.assert_allclose(np.linalg.norm(particles.direction, axis=1), 1.0, rtol=1e-5)
    luminance = particles.power @ [0.212671, 0.715160, 0.072169] / repeats
    for part in np.split(luminance, [len(measurement.records["particles"][0, 0])]):
        np.testing.assert_allclose(part, part[0], rtol=1e-4)


def test_a_closed_box_receives_its_power_over_the_absorbed_share():
    """Each bounce has the flux of the one before times the albedo: chains alone must find the shares."""
    albedo, radiance = 0.6, 2.0
    problem = scenes.furnace("box", radiance, albedo)
    method = made(problem, scale="counted", max_bounces=24, chains=2048, steps=128)
    measurement = run(method, 4)
    flux, error = method.flux(measurement)
    power = 24.0 * np.pi * radiance
    assert error / flux < 0.01
    assert flux == pytest.approx(power / (1 - albedo), abs=4 * error)
    arrived = method.particles(measurement).power.sum(0, dtype=np.float64)
    np.testing.assert_allclose(arrived, power / (1 - albedo), atol=4 * error)
    flux, error = (traced := made(problem, max_bounces=24)).flux(run(traced, 4))
    assert flux == pytest.approx(power / (1 - albedo), rel=max(4 * error / flux, 1e-3))


@pytest.mark.parametrize(
    ("emitter", "group"),
    [pytest.param(*row, marks=pytest.mark.slow) for row in (("mixed", scenes.FEW), ("textured", "specular"))],
)
def test_places_and_lengths_as_of_independent_paths(emitter, group):
    """Chi-square over shapes, quarters of them and bounces, with the variance between chains and between paths."""
    problem = scenes.room(emitter, group)
    bounces: list[np.ndarray] = []
    shape, flux, position = independent(problem, 1 << 17, 7, LONGEST, bounces=bounces)
    value = flux @ np.array([0.212671, 0.715160, 0.072169])
    cell = cells(shape, position, np.array(bounces))
    count, batches = int(cell.max()) + 1, 64
    batch = np.arange(value.shape[1]) % batches
    expected = np.zeros((batches, count))
    np.add.at(expected, (np.broadcast_to(batch, cell.shape), cell), value * batches)

    method = made(problem)
    particles = method.particles(measurement := run(method, 6))
    luminance = particles.power @ [0.212671, 0.715160, 0.072169]
    own = cells(particles.shape.astype(int), particles.position, particles.bounce.astype(int))
    measured = np.zeros((batches, count))
    np.add.at(measured, (particles.path % batches, own), luminance * batches)

    flux, scale_error = method.flux(measurement)
    total = measured.mean(0).sum()
    spread = expected.sum(1).std(ddof=1) / np.sqrt(batches)
    assert abs(total - expected.mean(0).sum()) < stats.norm.isf(LEVEL) * np.hypot(spread, scale_error)
    # The common factor apart, whose error cells share.
    a, b = measured / total, expected / expected.mean(0).sum()
    variance = (a.var(0, ddof=1) + b.var(0, ddof=1)) / batches
    known = b.mean(0) > 2e-4
    assert known.sum() > 20
    scores = (a.mean(0) - b.mean(0))[known] / np.sqrt(variance[known])
    assert stats.chi2.sf((scores**2).sum(), known.sum()) > LEVEL, np.round(scores, 1)


@pytest.mark.slow
def test_colours_are_those_of_independent_paths():
    problem = scenes.room("two", ())
    _, flux, _ = independent(problem, 1 << 17, 3, LONGEST)
    batches = flux.sum(0).reshape(64, -1, 3).sum(1) * 64
    method = made(problem)
    particles = method.particles(run(method, 6))
    own = np.zeros((64, 3))
    np.add.at(own, particles.path % 64, particles.power * 64)
    ratio = own / own.sum(1, keepdims=True), batches / batches.sum(1, keepdims=True)
    error = np.sqrt(sum(r.var(0, ddof=1) / 64 for r in ratio))
    np.testing.assert_array_less(np.abs(ratio[0].mean(0) - ratio[1].mean(0)), 4.5 * error + 1e-5)


def test_a_resumed_chain_goes_on_with_the_same_particles():
    problem = scenes.room("rectangle", scenes.FEW)
    whole = run(made(problem), 3)
    method = made(problem)
    first = method.step(0, 1, method.start())
    saved = {name: np.array(values) for name, values in first.state.items()}
    other = made(problem)
    second = other.step(1, 1, saved)
    third = other.step(2, 1, second.state)
    rows = np.concatenate([*first.measurement.records["particles"], *second.measurement.records["particles"]])
    rows = np.concatenate([rows, *third.measurement.records["particles"]])
    np.testing.assert_array_equal(rows, np.concatenate(list(whole.records["particles"])))
    with pytest.raises(CheckpointError, match="do not fit"):
        other.enter({"length": saved["length"][:5], "first": saved["first"], "later": saved["later"]})


def test_light_that_arrives_nowhere_is_an_error():
    light = {"type": "rectangle", "emitter": {"type": "area", "radiance": 1.0}}
    problem = load({"type": "scene", "sensor": scenes.camera(), "light": light})
    with pytest.raises(SceneError, match="none of 32768 light paths"):
        made(problem)


@pytest.mark.slow
def test_autocorrelation_time_grows_with_the_inverse_square_of_the_step():
    """Of the hits of single edges in a uniform sphere, where the target is constant and steps are a random walk."""
    problem = scenes.furnace("sphere", 1.0, 0.5)
    sizes, times = np.array([0.06, 0.03, 0.015]), []
    for size in sizes:
        method = made(problem, chains=64, steps=1 << 16, step_size=size, anew=0.0, max_bounces=1)
        traces = method.traces(run(method, 2))
        times.append(np.mean([autocorrelation_time(traces[:, :, i]) for i in (2, 3)]))
    slope = np.polyfit(np.log(sizes), np.log(times), 1)[0]
    assert slope == pytest.approx(-2.0, abs=0.2), times


@pytest.mark.slow
def test_particles_are_described_as_those_of_particle_tracing():
    """Shape, primitive and parameters of a place, on triangles, rectangles and a sphere."""
    problem = scenes.room("mesh", scenes.FEW)
    tracing = ParticleTracing(ParticleSettings(samples_per_pass=1 << 12, specular=True))
    tracing.prepare(problem, 1)
    other = tracing.particles(tracing.step(0, 1, {}).measurement)
    own = (method := made(problem)).particles(run(method, 1))
    for shape in np.unique(other.shape):
        sides = []
        for particles in (own, other):
            chosen = particles[particles.shape == shape]
            sides.append(np.unique(chosen.primitive))
            first = chosen[chosen.primitive == sides[-1][0]]
            columns = np.concatenate([first.uv, np.ones((len(first), 1))], axis=1)
            sides.append(np.linalg.lstsq(columns, first.position, rcond=None)[0])
        np.testing.assert_array_equal(sides[0], sides[2])
        if not problem.scene.shapes()[shape].is_mesh():
            continue  # positions on a sphere are no linear function of the parameters
        np.testing.assert_allclose(sides[1], sides[3], atol=1e-3)


@pytest.mark.slow
def test_a_null_surface_is_no_bounce():
    """Light that has crossed a screen arrives at the floor by its first bounce, as of particle tracing."""
    screen = {"type": "rectangle", "to_world": scenes.transform().rotate([1, 0, 0], -90).scale(2.0)}
    screen["to_world"] = scenes.transform().translate([0, 1, 0]) @ screen["to_world"]
    problem = load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "floor": scenes.plate((0.0, 0.0, 0.0), 2.0, True),
            "lamp": scenes.lamp((0.0, 2.0, 0.0), 0.3, 5.0),
            "screen": screen | {"bsdf": {"type": "null"}},
        }
    )
    measurement = run(method := made(problem, specular=False, max_bounces=2), 2)
    particles = method.particles(measurement)
    floor = method.surfaces.names.index("floor")
    assert set(particles.shape) == {floor} and set(particles.bounce) == {1}
    assert measurement.counters["lost_steps"] == 0.0


@pytest.mark.slow
def test_groups_have_surfaces_of_their_own():
    """A mirror in a group has no particles, and a ball in it the parameters of a ball."""
    t = scenes.transform()
    problem = load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "lamp": scenes.lamp((0.0, 3.0, 0.0), 0.5, 5.0),
            "group": {
                "type": "shapegroup",
                "mirror": {
                    "type": "rectangle",
                    "to_world": t.translate([1, 0, 0]).rotate([1, 0, 0], -90).scale(0.5),
                    "bsdf": {"type": "conductor"},
                },
                "ball": {"type": "sphere", "center": [-1, 0, 0], "radius": 0.4, "bsdf": scenes.diffuse(0.5, 0.5, 0.5)},
            },
            "thing": {"type": "instance", "to_world": t.translate([0, 1, 0]), "group": {"type": "ref", "id": "group"}},
        }
    )
    particles = (method := made(problem, specular=False)).particles(run(method, 1))
    thing = particles[particles.shape == method.surfaces.names.index("thing")]
    assert len(thing) > 100 and (thing.position[:, 0] < 0.0).all()
    offset = (thing.position - [-1.0, 1.0, 0.0]) / 0.4
    np.testing.assert_allclose(np.arccos(np.clip(offset[:, 2], -1, 1)) / np.pi, thing.uv[:, 1], atol=2e-3)
    # The primitives of a group are numbered as where independent particles are stored.
    traced = ParticleTracing(ParticleTracing.Settings(samples_per_pass=1 << 12))
    traced.prepare(problem, 1)
    stored = traced.particles(traced.step(0, 1, {}).measurement)
    assert set(thing.primitive) == set(stored.primitive[stored.shape == method.surfaces.names.index("thing")]) != {0}


@pytest.mark.slow
def test_a_path_that_is_lost_leaves_no_particle():
    """Found again at the start of a pass, some paths miss what they have hit; here many, as their numbers change."""
    problem = load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "floor": scenes.plate((0.0, 0.0, 0.0), 2.0, True),
            "lamp": scenes.lamp((0.0, 2.0, 0.0), 0.3, 5.0),
        }
    )
    method = made(problem)
    first = method.step(0, 1, method.start())
    state = dict(first.state) | {"first": np.random.default_rng(1).random(5 * method.settings.chains, np.float32)}
    measurement = method.step(1, 1, state).measurement
    assert np.isfinite(method.particles(measurement).power).all()
    lost = measurement.counters["lost_steps"]
    assert 0.0 < lost < 0.2 * method.settings.chains * method.settings.steps
    assert method.repeats(measurement).sum() + lost == measurement.counters["paths"]
