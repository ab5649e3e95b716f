"""Mirror balls: polished balls and rings on a wooden floor, lit by a small bare lamp and by one in a glass globe.

The balls and the rings throw caustics on the floor and the walls, and every ball shows those of the others.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..pieces import Vector, glass, lamp, matt, metal, mirror, planks, textured, walls
from ..solids import GAP, Model, ball, inside_out, outline, ring, turned
from .furniture import view

_WIDTH, _HEIGHT, _FRONT, _BACK = 5.2, 2.9, 4.4, -2.0
_BULB: Vector = (0.15, 1.8, 0.2)
_MATERIALS = ("silver", "gold", "copper")
#: Centres (x, z), radius and material of the balls in front; the others are strewn between them.
_CHOSEN = (
    ((-0.72, -0.25), 0.45, "silver"),
    ((0.62, 0.2), 0.34, "silver"),
    ((1.05, -1.0), 0.5, "silver"),
    ((-0.2, 0.95), 0.17, "gold"),
    ((-1.2, 0.7), 0.24, "silver"),
    ((1.3, 0.75), 0.16, "copper"),
)
#: Centres and radii of the rings, and of the lamp in its globe, which the strewn balls keep away from.
_RINGS = (((0.35, 1.1), 0.2), ((-0.75, 1.3), 0.13))
_GLOBE = (-0.05, -1.05)


def mirror_balls() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 250 000 triangles."""
    metals = {"gold": metal("Au"), "copper": metal("Cu"), "iron": metal("Cr", 0.25)}
    model = Model({"silver": mirror(0.93, 0.93, 0.92), "glass": glass(), **metals})
    for (x, z), radius, material in _strewn():
        model.add(material, ball(radius, 104, 52), (x, radius + GAP, z))
    for (x, z), radius in _RINGS:
        band = [(radius, 0.0), (1.1 * radius, 0.0), (1.1 * radius, 0.4 * radius), (radius, 0.4 * radius)]
        model.add("gold", ring([(r, GAP + y) for r, y in _subdivided(band)], 144), (x, 0.0, z))
    _lamps(model)
    half, boards = _WIDTH / 2, textured(planks(3, 14, tone=(0.46, 0.33, 0.22)), (2.0, 2.0))
    sides = {"left": matt(0.20, 0.34, 0.36), "right": matt(0.48, 0.22, 0.14), "ceiling": matt(0.75, 0.74, 0.72)}
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((0.0, 1.75, 3.35), (0.02, 0.3, 0.0), 47.0),
        **walls((-half, half), (0.0, _HEIGHT), (_BACK, _FRONT), matt(0.62, 0.58, 0.52), floor=boards, **sides),
        "bulb": lamp(_BULB, 0.03, 1500.0, 1280.0, 950.0),
        "globe": lamp((_GLOBE[0], 0.36, _GLOBE[1]), 0.025, 300.0, 205.0, 110.0),
        **model.shapes(),
    }


def _strewn() -> list[tuple[tuple[float, float], float, str]]:
    """The chosen balls, and small ones thrown until they touch no other."""
    rng = np.random.default_rng(11)
    balls = list(_CHOSEN)
    while len(balls) < 19:
        x, z, radius = rng.uniform(-2.0, 2.0), rng.uniform(-1.6, 1.5), rng.uniform(0.07, 0.2)
        taken = [(p, q, r) for (p, q), r, _ in balls] + [(p, q, 1.2 * r) for (p, q), r in _RINGS] + [(*_GLOBE, 0.3)]
        if all(np.hypot(x - p, z - q) > radius + r + 0.02 for p, q, r in taken):
            balls.append(((x, z), radius, _MATERIALS[rng.integers(0, 3)] if radius < 0.14 else "silver"))
    return balls


def _subdivided(polygon: list[tuple[float, float]], times: int = 3) -> list[tuple[float, float]]:
    """More corners on each edge, so that smoothing rounds no more than the ends of it."""
    shares = np.arange(times) / times
    ends = zip(polygon, [*polygon[1:], polygon[0]], strict=True)
    return [(a + (c - a) * t, b + (d - b) * t) for (a, b), (c, d) in ends for t in shares]


def _lamps(model: Model) -> None:
    """A glass globe on the floor around the small lamp, on a foot; a fitting and a cord for the bare one."""
    x, z = _GLOBE
    thick = outline("0,0 10,0 22,10 24,22 20,36 8,44 0,44")
    inside = [(r * 0.93, 0.22 + (y - 0.22) * 0.93) for r, y in thick]
    model.add("glass", turned(thick, 64), (x, 0.14, z))
    model.add("glass", inside_out(turned(inside, 64)), (x, 0.14, z))
    model.add("iron", turned("0,0 16,0 17,2 5,5 5,12 0,13", 64), (x, GAP, z))
    fitting = turned("0,0 3.5,0 4.5,6 3,10 .8,12 .8,105 0,105", 48)
    model.add("iron", fitting, (_BULB[0], _BULB[1] + 0.035, _BULB[2]))
    model.add("iron", ring("5,0 16,0 16,2 5,2", 64), (_BULB[0], _HEIGHT - 0.025, _BULB[2]))
