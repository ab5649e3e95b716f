"""The noise that a run reports is the noise that runs have: of methods whose passes depend on each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support import scenes
from support.running import go, prepared

from etendue.core import RELATIVE_EPSILON
from etendue.scene import load

SEEDS, PASSES = 30, 16
METHODS: dict[str, dict[str, Any]] = {
    "guided": {"samples_per_pass": 64, "cell_samples": 500},
    "vegas": {"samples_per_pass": 16},
    "stratified": {"samples_per_pass": 128, "update": 4},
    "sppm": {"samples_per_pass": 4, "radius": 0.05},
    "bpm": {"samples_per_pass": 4, "radius": 0.05},
    "vcm": {"samples_per_pass": 4},
    "pssmlt": {"samples_per_pass": 32, "bootstrap": 1 << 12},
    "mmlt": {"samples_per_pass": 32, "bootstrap": 1 << 12},
    "film_metropolis": {"samples_per_pass": 32, "bootstrap": 1 << 12},
}


def assert_reported(runs: list[Any], what: str) -> None:
    """Within a quarter, the mean over the picture of variance / (mean² + 0.01): estimated by each run, and between
    runs."""
    pictures = np.stack([run.mean() for run in runs])
    scale = np.square(pictures.mean(0)) + RELATIVE_EPSILON
    reported = np.mean([run.variance_of_mean() / scale for run in runs])
    measured = np.mean(pictures.var(0, ddof=1) / scale)
    assert reported == pytest.approx(measured, rel=0.25), what


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_noise_over_seeds(method):
    problem = load("ajar", size=(12, 9)) if method == "guided" else scenes.room("mixed", "rough", size=(8, 6))
    seeds = range(1, SEEDS + 1)
    runs = [go(prepared(problem, method, seed, **METHODS[method]), PASSES, seed).measurement for seed in seeds]
    assert_reported(runs, method)


@pytest.mark.slow
def test_noise_of_the_points_that_ppm_looks_at():
    """Runs that look at the same points, by other photons: what the points miss is no noise, as it stays for ever."""
    problem, settings = scenes.room("mixed", "rough", size=(8, 6)), {"samples_per_pass": 4, "radius": 0.05}
    firsts = range(0, 1000 * SEEDS, 1000)
    assert_reported([go(prepared(problem, "ppm", **settings), PASSES, first=i).measurement for i in firsts], "ppm")


@pytest.mark.slow
def test_a_budget_in_error_ends_at_the_error_over_seeds():
    """What such a budget looks at, of runs of one length, in pixels that no single path makes."""
    problem = scenes.room("sphere", "rough", size=(8, 6))
    settings = METHODS["guided"] | {"sampler": "owen"}
    seeds = range(1, SEEDS + 1)
    runs = [go(prepared(problem, "guided", seed, **settings), PASSES, seed).measurement for seed in seeds]
    pictures = np.stack([run.mean() for run in runs])
    measured = np.mean(pictures.var(0, ddof=1) / (np.square(pictures.mean(0)) + RELATIVE_EPSILON))
    assert np.mean([run.relative_error() for run in runs]) == pytest.approx(measured, rel=0.25)
