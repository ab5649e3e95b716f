"""What the thesis on global lines lets expect of form factors and multipath [Castro 2002], as far as no other file has
it."""

from __future__ import annotations

import numpy as np
import pytest
from support.patches import room

from etendue.points import Independent, OwenSobol
from etendue.radiosity import (
    ABuffer,
    ChainedRays,
    RayScene,
    SpherePairs,
    first_shot,
    form_factors,
    multipath,
    solve,
)


@pytest.mark.parametrize("estimator", ["F1", "F2", "F3", "F4", "reciprocal"])
def test_with_more_lines_factors_become_reciprocal_and_closed(estimator):
    """What one normalisation does not make exact falls to zero: a tenth from 64 times the lines."""
    patches = room(2)
    faults = []
    for bundles in (64, 4096):
        factors = form_factors(ABuffer(patches, OwenSobol(4, seed=7), 500).cast(bundles), estimator)
        closure = np.sqrt(np.mean((factors.row_sums() - 1) ** 2))
        faults.append((closure, factors.reciprocity_error()))
    for few, many in zip(*faults, strict=True):
        assert many < max(0.2 * few, 1e-12)
    assert faults[1][0] < 0.01


def test_estimators_of_lines_of_the_whole_scene():
    """A line from i to j is one from j to i: what F3 and F4 then are."""
    patches = room(2)
    segments = ChainedRays(SpherePairs(patches), RayScene(patches), Independent(4, seed=2)).cast(1 << 13)
    f1, f2, f3, f4 = (np.asarray(form_factors(segments, kind).matrix.todense()) for kind in ("F1", "F2", "F3", "F4"))
    lines, areas = segments.counted.astype(float), patches.areas
    counts = f1 * lines[:, None]
    np.testing.assert_allclose(counts, counts.T, atol=1e-9)
    np.testing.assert_allclose(f4, (f1 + f2) / 2, atol=1e-12)
    np.testing.assert_allclose(f3, counts * (1 + areas / areas[:, None]) / (lines[:, None] + lines), atol=1e-12)


def lit(patches):
    """A tenth of the room's surface shines."""
    lamp = np.linalg.norm(patches.centres - [0.5, 0.5, 1], axis=1) < 0.36
    return patches.with_properties(reflectance=0.6, emission=lamp.astype(float))


@pytest.mark.slow
def test_a_first_shot_pays():
    """At equal lines: half of them from the lamp and half through the scene, against all through the scene. Measured:
    0.4 of the mean squared error; the means agree."""
    patches = lit(room(2))
    scene, lines, seeds = RayScene(patches), 1 << 13, 10
    exact = solve(patches, form_factors(ABuffer(patches, OwenSobol(4, seed=1)).cast(1024), "F4")).radiosity
    without, after = [], []
    for seed in range(seeds):
        engine = ChainedRays(SpherePairs(patches), scene, Independent(4, seed=seed))
        shot = first_shot(scene, Independent(4, seed=100 + seed).block(lines // 2))
        without.append(multipath(engine, lines).radiosity)
        after.append(multipath(engine, lines // 2, shot=shot).radiosity)
    weights = patches.areas[:, None] / patches.areas.sum()
    error = [np.array([(weights * (run - exact) ** 2).sum() for run in runs]) for runs in (without, after)]
    assert error[1].mean() < 0.7 * error[0].mean()
    totals = [np.array([(weights * run).sum() for run in runs]) for runs in (without, after)]
    spread = np.sqrt(sum(total.var(ddof=1) / seeds for total in totals))
    # The light that is on its way in the end is missing: less than 1 %.
    assert abs(totals[0].mean() - totals[1].mean()) < 4 * spread + 0.01 * totals[1].mean()
