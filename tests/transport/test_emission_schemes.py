"""Schemes of emission: none changes what arrives, each changes how it scatters."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats
from support import scenes
from support.light_paths import independent
from support.particles import box
from support.tables import thinned

from etendue.core import IndependentSource
from etendue.methods.particles import ParticleSettings, ParticleTracing
from etendue.scene import LightTable, Problem, load
from etendue.transport import (
    EMISSION,
    BlindEmission,
    CameraSampler,
    CellEmission,
    EmittedRay,
    ImportancePilot,
    StratifiedSource,
    UniformLights,
    Visibility,
    emit,
)

LEVEL = 1e-5
PATHS, LONGEST, BATCHES = 1 << 16, 3, 64


def pilot(problem: Problem, seed: int = 1, rays: int = 1 << 16) -> CellEmission:
    walk = ImportancePilot(
        visibility=Visibility(problem.scene),
        lights=LightTable(problem.scene),
        max_edges=dr.opaque(mi.UInt32, 64),
        rr_depth=5,
        camera=CameraSampler(problem),
    )
    return walk.learn(rays, seed)


def flux(problem: Problem, seed: int, **how: Any) -> np.ndarray:
    """(BATCHES, cells): luminance that arrives on quarters of shapes, of parts of the paths."""
    shape, colour, position = independent(problem, PATHS, seed, LONGEST, **how)
    value = colour @ np.array([0.212671, 0.715160, 0.072169]) * BATCHES
    cell = 4 * shape + (position[..., 0] > 0) + 2 * (position[..., 2] > 0)
    found = np.zeros((BATCHES, 4 * len(problem.scene.shapes())))
    np.add.at(found, (np.broadcast_to(np.arange(PATHS) % BATCHES, cell.shape), cell), value)
    return found


@pytest.mark.parametrize("emitter", thinned(["mixed", "focused", "textured", "envmap", "two"], ["mixed", "envmap"]))
def test_every_scheme_brings_the_same_flux(emitter):
    problem = scenes.room(emitter, ())
    expected = flux(problem, 1)
    learned = pilot(problem)
    for scheme in (UniformLights(), BlindEmission(), learned):
        found = flux(problem, 2, emission=scheme)
        variance = (expected.var(0, ddof=1) + found.var(0, ddof=1)) / BATCHES
        lit = (expected > 0).sum(0) > BATCHES // 2
        z = (expected.mean(0) - found.mean(0))[lit] / np.sqrt(variance[lit])
        assert lit.sum() >= 6
        assert stats.chi2.sf((z**2).sum(), lit.sum()) > LEVEL, (scheme, np.round(z, 1))


def test_cells_of_a_density_are_drawn_as_often_as_it_says():
    """Chi-square of the cells of rays against the probabilities, of a density that is uneven on purpose."""
    problem = scenes.room("two", ())
    lights = LightTable(problem.scene)
    resolution = pilot(problem, rays=1 << 10).resolution
    probability = np.random.default_rng(1).random(2 * resolution.cells) + 0.05
    probability /= probability.sum()
    scheme = CellEmission(lights, resolution, probability)
    lane = dr.arange(mi.UInt32, 1 << 18)
    drawn: dict[str, Any] = {}

    def keep(lights: LightTable, source: Any, active: mi.Bool) -> Any:
        drawn["row"] = lights.pick(source.next_1d(0, 0)).row
        drawn["point"], drawn["direction"] = mi.Point2f(*source.next_2d(0, 1)), mi.Point2f(*source.next_2d(0, 3))
        return emit(lights, source, active)

    from etendue.transport.schemes import numbers

    original, numbers.emit = numbers.emit, keep
    try:
        scheme(lights, IndependentSource(lane, 1, "test", 0), dr.full(mi.Bool, True, len(lane)))
    finally:
        numbers.emit = original
    cell = np.array(resolution.cell(drawn["row"], drawn["point"], drawn["direction"]))
    count = np.bincount(cell, minlength=len(probability))
    assert stats.chisquare(count, probability * len(lane)).pvalue > LEVEL


def test_importance_saves_variance_where_most_light_goes_elsewhere():
    """A lamp lights a table that the camera sees, a brighter one the room behind it: 32 seeds of emission by importance
    and by power alone, where the dim lamp has no least share."""
    grey = scenes.diffuse(0.5, 0.5, 0.5)
    dark = {"type": "rectangle", "to_world": scenes.transform().translate([0, 1, -1]).scale(3), "bsdf": grey}
    problem = load(
        {
            "type": "scene",
            "sensor": scenes.camera(),
            "floor": scenes.plate((0, 0, 0), 0.9, True),
            "lamp": scenes.lamp((0, 1.5, 0), 0.2, 4.0),
            "wall": dark,
            "hall": scenes.plate((0, 0, -4), 2.0, True),
            "bright": scenes.lamp((0, 1.5, -4), 0.5, 20.0),
        }
    )
    floor = [shape.id() for shape in problem.scene.shapes()].index("floor")
    means, errors = [], []

    def by_power(lights: LightTable, *numbers: Any) -> EmittedRay:
        return emit(lights.picked_by(lights.powers, lights.powers), *numbers)

    for emission in (by_power, pilot(problem)):
        sums = []
        for seed in range(32):
            shape, colour, _ = independent(problem, 1 << 12, seed, LONGEST, emission=emission)
            sums.append(colour[shape == floor].sum())
        means.append(np.mean(sums))
        errors.append(np.std(sums, ddof=1) / np.sqrt(32))
    assert abs(means[0] - means[1]) < 4.5 * np.hypot(*errors)
    assert errors[1] ** 2 < 0.3 * errors[0] ** 2


def test_strata_hold_one_path_each():
    paths = 778
    index = dr.arange(mi.UInt32, paths)
    source = StratifiedSource(IndependentSource(index, 1, "test", 0), index, paths)
    numbers = [source.next_1d(0, 0), *source.next_2d(0, 1), *source.next_2d(0, 3), *source.next_2d(mi.UInt32(1), 1)]
    values = np.stack([np.array(x) for x in numbers])
    assert values.min() >= 0 and values.max() < 1
    # 778 paths: 3 segments of the first four dimensions and 2 of the others, 648 strata; the other paths are free.
    counts = (3, 3, 3, 3, 2, 2, 2)
    segments = np.floor(values * np.array(counts)[:, None]).astype(int)
    code = np.ravel_multi_index(segments[:, :648], counts)
    np.testing.assert_array_equal(np.bincount(code, minlength=648), 1)
    assert len(np.unique(np.ravel_multi_index(segments[:, 648:], counts))) < paths - 648


def test_strata_save_variance_of_direct_light():
    problem = scenes.room("rectangle", ())
    lanes = dr.arange(mi.UInt32, 1 << 12)
    sums: dict[str, list[np.ndarray]] = {"plain": [], "even": []}
    for seed in range(16):
        base = IndependentSource(lanes, seed, "test", 0)
        for name, source in (("plain", base), ("even", StratifiedSource(base, lanes, len(lanes), EMISSION[1:]))):
            shape, colour, position = independent(problem, len(lanes), seed, 2, source=source)
            cell = 4 * shape + (position[..., 0] > 0) + 2 * (position[..., 2] > 0)
            sums[name].append(np.bincount(cell.ravel(), colour.sum(-1).ravel(), minlength=12))
    plain, even = (np.array(sums[name]) for name in ("plain", "even"))
    error = np.sqrt((plain.var(0, ddof=1) + even.var(0, ddof=1)) / 16) + 1e-6
    assert (np.abs(plain.mean(0) - even.mean(0)) < 4.5 * error).all()
    assert even.var(0, ddof=1).sum() < 0.7 * plain.var(0, ddof=1).sum()


@pytest.mark.parametrize(("emission", "sampler"), [("importance", "strata"), ("blind", "strata"), ("uniform", "owen")])
def test_particles_of_every_scheme_have_the_same_flux(emission, sampler):
    problem = scenes.room("two", ())

    def power(**settings: Any) -> np.ndarray:
        method = ParticleTracing(ParticleSettings(samples_per_pass=1 << 14, **settings))
        method.prepare(problem, 1)
        found = []
        for iteration in range(8):
            particles = method.particles(method.step(iteration, 1, {}).measurement)
            found.append([particles.power[particles.shape == s].sum() for s in range(3)])
        return np.array(found)

    a, b = power(sampler="independent"), power(emission=emission, sampler=sampler)
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 8) + 1e-6
    assert (np.abs(a.mean(0) - b.mean(0)) < 5.0 * error).all()


def test_a_cell_of_hardly_any_probability_is_reached():
    """Rounding to random numbers of 23 bits leaves each cell a step."""
    problem = scenes.room("two", ())
    learned = pilot(problem)
    wanted = np.full(len(learned.probability), 1e-12)
    wanted[0] = 1.0
    scheme = CellEmission(LightTable(problem.scene), learned.resolution, wanted)
    steps = np.diff(np.array(scheme._sums, np.float64), prepend=0.0) * 2**23
    assert steps[-1] == 1.0 == steps[1:].min() and steps.sum() == 2**23


def test_black_lights_start_no_paths():
    problem = load(box(dark={"type": "point", "position": [0.5, 0.5, 0.5], "intensity": scenes.rgb(0.0, 0.0, 0.0)}))
    lights, count = LightTable(problem.scene), 1 << 12
    source = IndependentSource(dr.arange(mi.UInt32, count), 1, "black", 0)
    for scheme in (UniformLights(), BlindEmission()):
        emitted = scheme(lights, source, dr.full(mi.Bool, True, count))
        lit = dr.any(emitted.throughput > 0.0) & dr.all(dr.isfinite(emitted.throughput))
        assert dr.all(~emitted.active | lit) and dr.any(emitted.active)
