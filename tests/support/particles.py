"""A closed box with a light inside, in which particles have known sums."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from etendue.particles import LAYOUT, Particles, Rows

from .scenes import Dict, camera, diffuse, rgb

#: Power of the lamp, red, green and blue.
POWER = np.array([30.0, 20.0, 10.0])


def box(albedo: tuple[float, float, float] = (0.5, 0.5, 0.5), half: float = 1.0, **more: Any) -> Dict:
    """A cube of six rectangles around the origin that face inwards, with a point light in its middle."""
    turns = {
        "left": ([0, 1, 0], 90),
        "right": ([0, 1, 0], -90),
        "floor": ([1, 0, 0], -90),
        "ceiling": ([1, 0, 0], 90),
        "back": ([0, 1, 0], 0),
        "front": ([0, 1, 0], 180),
    }
    scene: Dict = {
        "type": "scene",
        "sensor": camera(origin=(0.0, 0.0, 0.9 * half), target=(0.0, 0.0, 0.0)),
        "lamp": {"type": "point", "intensity": rgb(*(POWER / (4 * np.pi)))},
    }
    for name, (axis, angle) in turns.items():
        place = mi.ScalarTransform4f().rotate(axis, angle).translate([0, 0, -half]).scale(half)
        scene[name] = {"type": "rectangle", "to_world": place, "bsdf": diffuse(*albedo)}
    return scene | more


def rows_at_random(count: int, shapes: np.ndarray, primitives: np.ndarray, seed: int = 0) -> Rows:
    """Particles of random fields on given shapes and primitives."""
    rng = np.random.default_rng(seed)
    fields = {name: rng.random((count, *row)).astype("f4") for name, (_, row) in LAYOUT.items()}
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    fields["direction"] = direction.astype("f4")
    fields["shape"], fields["primitive"] = shapes, primitives
    fields["path"] = np.arange(count) * 7
    fields["bounce"] = rng.geometric(0.4, count)
    return Particles(**fields).rows


def sorted_rows(rows: Rows) -> Rows:
    """The same rows in an order that depends on their values only."""
    return rows[np.lexsort(rows.T)]
