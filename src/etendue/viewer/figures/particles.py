"""Particles of a file as points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.film import LUMINANCE
from etendue.particles import ParticleFile, Particles
from etendue.scene import Problem

#: Most points that are drawn; if there are more, every k-th is drawn, with k times its power.
MOST_POINTS = 300_000


def points(problem: Problem, file: Path) -> dict[str, NDArray[Any]]:
    """Position (n, 3), power (n, 3) in watts, its luminance (n,) and edges from the light (n,) of a file's particles.

    Raises the errors of :class:`etendue.particles.ParticleFile`, also for particles of another scene."""
    opened = ParticleFile(file)
    opened.require_scene(problem)
    step = max(1, -(-len(opened) // MOST_POINTS))
    kept = Particles.joined([part[::step] for part in opened.parts()])
    power = kept.power * np.float32(len(opened) / max(len(kept), 1))
    return {
        "points": problem.space.from_scene(kept.position).astype(np.float32),
        "power": power,
        "value": (power @ np.asarray(LUMINANCE, np.float32)).astype(np.float32),
        "number": np.minimum(kept.bounce, 255).astype(np.uint8),
    }
