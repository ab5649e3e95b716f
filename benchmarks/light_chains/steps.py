"""The size of steps of Metropolis particles (E5; figure 6.23 of the thesis)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from etendue.core import Replica
from etendue.methods import MetropolisParticles

from ..measuring import Record
from ..options import Seeds
from .against import Millions, ReferenceMillions, Scenes
from .fluxes import Cells, Tally, reference, rms
from .scenes import CELLS, open_scene

SIZES = (0.005, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_PASSES = 4


def measure(
    scenes: Scenes = "cornell-glass",
    millions: Millions = 2.0,
    reference_millions: ReferenceMillions = 40.0,
    seeds: Seeds = 3,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        yield _scene(name, millions, reference_millions, seeds)


def _scene(name: str, millions: float, reference_millions: float, seeds: int) -> Record:
    problem = open_scene(name)
    cells = Cells(problem, CELLS[name])
    expected = reference(problem, cells, 1e6 * reference_millions, specular=True)
    record = Record(
        f"Steps of Metropolis particles, {name}, {millions:g} million steps",
        (
            "step size, anew",
            "RMS",
            "accepted",
            "rays a step",
            "autocorrelation time of edges",
            "of places",
            "split R-hat",
        ),
    )
    chains = {
        "chains": 1024,
        "steps": max(8, round(1e6 * millions / _PASSES / 1024)),
        "max_bounces": 32,
        "specular": True,
    }
    for anew in (0.0, 0.1):
        for size in SIZES:
            settings = {"step_size": size, "anew": anew, **chains}
            errors = [
                rms(Tally(MetropolisParticles, problem, cells, seed, **settings).run(_PASSES), expected)
                for seed in range(1, seeds + 1)
            ]
            method = MetropolisParticles(MetropolisParticles.Settings.from_mapping(settings))
            method.prepare(problem, 1)
            replica = Replica(method, 1)
            total = replica.step(0)
            for number in range(1, _PASSES):
                total += replica.step(number)
            facts = method.develop(total, replica.state).metadata
            times = facts["autocorrelation_time"]
            spread = np.std(errors, ddof=1) / np.sqrt(seeds) if seeds > 1 else float("nan")
            record.add(
                f"{size:g}, {anew:g}",
                f"{np.mean(errors):.4f} ± {spread:.4f}",
                f"{facts['acceptance']:.2f}",
                f"{facts['rays_per_step']:.2f}",
                f"{times['edges']:.0f}",
                f"{max(times[axis] for axis in 'xyz'):.0f}",
                f"{facts['r_hat']:.2f}",
            )
    record.notes += [
        f"1024 chains, {seeds} seeds; RMS of the flux of {cells.count} cells relative to its mean; autocorrelation "
        "times in steps",
        "anew: probability with which a step that moves the end of a path draws the last edge anew",
    ]
    return record
