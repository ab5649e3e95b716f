"""Four estimators of form factors on the same lines (table 4.1 of the thesis), here lines of the whole scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from etendue.core import Array
from etendue.points import Independent
from etendue.radiosity import (
    ESTIMATORS,
    Estimator,
    FormFactors,
    RayScene,
    SpherePairs,
    form_factors,
    pair_errors,
)

from .. import plotting
from ..measuring import Record
from ..options import Out, Seeds, whole_numbers
from .options import BUNDLES, OUT, Detail, ReferenceBundles, Scenes
from .references import factor_reference
from .scenes import SCENES
from .sweeping import WholeRays

#: Sums of squared errors of table 4.1, for nine-cubes.
_THESIS = {
    "F1": {50_000: 1.1796, 100_000: 0.60453, 500_000: 0.11347, 1_000_000: 0.05634},
    "F3": {50_000: 8.82378, 100_000: 4.27148, 500_000: 0.81667, 1_000_000: 0.44048},
    "F4": {50_000: 1.1224, 100_000: 0.50391, 500_000: 0.09735, 1_000_000: 0.04850},
}


def errors(scene: RayScene, exact: FormFactors, lines: int, seed: int) -> dict[Estimator, float]:
    """Sum of squared errors of every estimator on the same lines."""
    engine = WholeRays(SpherePairs(scene.patches), scene, Independent(4, seed))
    segments = engine.cast(lines)
    return {kind: pair_errors(form_factors(segments, kind), exact) for kind in ESTIMATORS}


def measure(
    scenes: Scenes = "nine-cubes,test-one",
    lines: Annotated[
        Any, typer.Option(parser=whole_numbers, help="Numbers, separated by commas.", metavar="N,...")
    ] = "50000,100000,500000,1000000",
    seeds: Seeds = 10,
    detail: Detail = 1.0,
    bundles: ReferenceBundles = BUNDLES,
    out: Out = OUT,
) -> Iterator[Record]:
    """A table of each scene."""
    for name in scenes:
        scene = RayScene(SCENES[name](detail))
        exact, noise = factor_reference(scene.patches, bundles)
        yield _scene(name, scene, exact, noise, lines, seeds, out)


def _scene(
    title: str, scene: RayScene, exact: FormFactors, noise: float, counts: Sequence[int], seeds: int, out: Path
) -> Record:
    """A row for each estimator, a column for each number of lines."""
    found = [[errors(scene, exact, count, seed) for seed in range(seeds)] for count in counts]
    means: dict[Estimator, Array] = {
        kind: np.array([np.mean([run[kind] for run in runs]) for runs in found]) for kind in ESTIMATORS
    }
    axes = "lines", "sum of squared errors of form factors"
    curves = {str(kind): list(zip(map(float, counts), map(float, mean), strict=True)) for kind, mean in means.items()}
    plotting.save(out / f"estimators-{title}.svg", curves, title, *axes, 1.0)
    record = Record(
        f"Estimators of form factors, {title}, {len(scene.patches)} patches, {seeds} seeds",
        ("", *(f"FFE, {count} lines" for count in counts), f"to F1 at {counts[-1]}", "thesis, to F1"),
    )
    for kind, mean in means.items():
        thesis = _THESIS.get(kind, {})
        ratios = [thesis[count] / _THESIS["F1"][count] for count in thesis]
        cells = f"{mean[-1] / means['F1'][-1]:.3f}", f"{min(ratios):.2f} to {max(ratios):.2f}" if ratios else ""
        record.add(kind, *(f"{value:.4f}" for value in mean), *cells)
    record.notes += [
        "sphere pairs, independent numbers; FFE is the sum of squared errors over all pairs",
        "lines of the whole scene: r_ij = r_ji, so that F4 is the mean of F1 and F2, and F3 = r_ij (1 + A_j / A_i) / "
        "(r_i + r_j); in the thesis lines are cast in parts of the scene, and r_ij differs from r_ji",
        f"noise of the reference: {noise:.2g}, {noise / min(mean[-1] for mean in means.values()):.1%} of the least",
    ]
    return record
