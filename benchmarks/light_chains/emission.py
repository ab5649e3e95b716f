"""The variance of flux by the way in which emission is sampled."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.methods import ParticleTracing
from etendue.scene import Problem

from ..measuring import Record
from .against import Scenes
from .fluxes import Cells
from .scenes import open_scene

Runs = Annotated[int, typer.Option(min=3, help="Runs of each, between which the variance is taken.")]
Paths = Annotated[int, typer.Option(min=256, help="Light paths of a run.")]
#: By label: settings of particle tracing.
SCHEMES: dict[str, dict[str, Any]] = {
    "by power, random": {"sampler": "independent"},
    "by power, strata": {"sampler": "strata"},
    "by power, Owen points": {"sampler": "owen"},
    "uniform lights, random": {"emission": "uniform", "sampler": "independent"},
    "blind, random": {"emission": "blind", "sampler": "independent"},
    "blind, strata": {"emission": "blind", "sampler": "strata"},
    "importance, random": {"emission": "importance", "sampler": "independent"},
    "importance, Owen points": {"emission": "importance", "sampler": "owen"},
}


def measure(
    scenes: Scenes = "cornell,ring,glossy-office,ajar", runs: Runs = 12, paths: Paths = 1 << 16
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _scene(name, runs, paths)


def _scene(name: str, runs: int, paths: int) -> Record:
    problem = open_scene(name)
    everywhere, fine = Cells(problem, 4), Cells(problem, 16)
    seen = _seen(problem, fine)
    record = Record(
        f"Variance of flux by emission, {name}, {paths} light paths",
        ("", "all cells", "fine cells", "cells that the camera sees", "largest particle"),
    )
    plain: list[float] = []
    for label, settings in SCHEMES.items():
        coarse, small, largest = [], [], 0.0
        for seed in range(1, runs + 1):
            method = ParticleTracing(ParticleTracing.Settings.from_mapping({"samples_per_pass": paths, **settings}))
            method.prepare(problem, seed)
            particles = method.particles(method.step(0, seed, {}).measurement)
            coarse.append(everywhere.luminance(particles))
            small.append(fine.luminance(particles))
            largest = max(largest, float(particles.power.max()))
        figures = [_variance(coarse), _variance(small), _variance([row[seen] for row in small])]
        plain = plain or [*figures, largest]
        ratios = (a / b for a, b in zip([*figures, largest], plain, strict=True))
        record.add(label, *(f"{ratio:.3f}" for ratio in ratios))
    record.notes += [
        f"variance between {runs} runs, summed over {everywhere.count} and {fine.count} cells, relative to that of the "
        f"first row, ± {100 * _spread(runs, int(seen.sum())):.0f} % or less",
        "strata: of light, point, direction and first bounce",
        "importance: by a pilot of 65536 light paths, whose time is not counted",
    ]
    return record


def _variance(rows: list[Array]) -> float:
    return float(np.var(np.array(rows), axis=0, ddof=1).sum())


def _spread(runs: int, cells: int) -> float:
    """Relative standard error of a ratio of sums of variances, if a tenth of the cells have most of the flux."""
    return float(np.sqrt(2.0 * 2.0 / ((runs - 1) * max(1, cells // 10))))


def _seen(problem: Problem, cells: Cells) -> np.ndarray:
    """Cells that camera rays hit."""
    import drjit as dr
    import mitsuba as mi

    from etendue.core import IndependentSource
    from etendue.particles import Particles, SurfaceTable
    from etendue.transport import CameraSampler

    count = 1 << 16
    lane = dr.arange(mi.UInt32, count)
    camera = CameraSampler(problem)
    ray, _, _ = camera.primary(lane % camera.pixels, IndependentSource(lane, 1, "seen", 0))
    hit = problem.scene.ray_intersect_preliminary(ray)
    si = hit.compute_surface_interaction(ray)
    table = SurfaceTable(problem)
    pointer = np.array(dr.reinterpret_array(mi.UInt32, hit.shape))
    barycentric = table.is_mesh_pointer[pointer][:, None]
    uv = np.where(barycentric, np.array(hit.prim_uv).T, np.array(si.uv).T)
    valid = np.array(hit.is_valid())
    zeros = np.zeros((int(valid.sum()), 3))
    shape, primitive = table.number_of_pointer[pointer[valid]], np.array(hit.prim_index)[valid]
    number = np.zeros(len(zeros))
    particles = Particles(zeros, zeros, zeros + 1.0, shape, primitive, uv[valid], number, number)  # type: ignore[arg-type]
    return np.asarray(cells.luminance(particles) > 0.0)
