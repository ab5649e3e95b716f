"""Guides of emission with given densities."""

from __future__ import annotations

from typing import Any

import numpy as np

from etendue.scene import LightTable
from etendue.transport import EmissionGuide


def taught(problem: Any, seed: int = 1) -> EmissionGuide:
    """A guide of uneven densities, in all lights and directions."""
    random, guide = np.random.default_rng(seed), EmissionGuide(LightTable(problem.scene))
    trees = guide.trees
    for share in (0.3, 0.05):
        trees = trees.with_mass(random.random(trees.places) ** 4 * (trees.level.repeat(4) + 1.0))
        trees = trees.refined(np.arange(guide.count), share)
    uneven = random.random((2, guide.count)) + 0.2
    direct, emitted = uneven / uneven.sum(axis=1, keepdims=True)
    share = 0.3 + 0.5 * random.random(guide.count)
    share[~guide.lights.has_directions] = 0.0
    visible = random.random(guide.count) + 0.1
    guide.restore(
        {"direct": direct, "emitted": emitted, "visible": visible, "share": share, "crowding": 1.0, **trees.to_arrays()}
    )
    return guide
