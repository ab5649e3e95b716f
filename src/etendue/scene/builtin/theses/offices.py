"""Offices lit by lamps that shine at the ceiling: all matt, or with a glossy floor. Most light is indirect."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..pieces import diffuse, palette, rectangle, walls
from ..solids import GAP, Model, about, ball, box, cushion, tube, turned
from .furniture import books, plant, view

_HALF, _HEIGHT, _DEEP = 3.0, 2.8, 4.0
#: Middles of the desks.
_DESKS = ((-1.55, -1.9), (1.45, -1.9), (-1.55, 0.55), (1.45, 0.55))
_MATERIALS = palette(
    diffuse,
    "wood .48 .34 .22, white .74 .73 .70, grey .34 .35 .37, black .04 .04 .045, steel .50 .51 .53, screen .07 .09 .13, "
    "cloth .10 .22 .34, china .70 .66 .58, leaf .09 .26 .06, "
    "book-0 .46 .10 .07, book-1 .10 .20 .40, book-2 .64 .54 .34, book-3 .12 .30 .18",
)


def diffuse_office() -> dict[str, Any]:
    """All is matt: the scene as a Mitsuba dictionary."""
    return _office(diffuse(0.28, 0.29, 0.33))


def glossy_office() -> dict[str, Any]:
    """The same with a floor by Phong."""
    return _office({"type": "phong", "diffuse_reflectance": 0.15, "specular_reflectance": 0.7, "exponent": 300.0})


def _office(floor: dict[str, Any]) -> dict[str, Any]:
    model = Model(_MATERIALS)
    rng = np.random.default_rng(12)
    lamps = {}
    for number, (x, z) in enumerate(_DESKS):
        model.put(_desk(rng), (x, 0.0, z))
        model.put(_chair(), (x + rng.uniform(-0.15, 0.15), 0.0, z + 0.62), about(1, 180 + rng.uniform(-40, 40)))
        if number in (0, 3):
            lamps[f"lamp-{number}"] = _trough(model, x, z)
    _along_the_walls(model, rng)
    other = {"floor": floor, "left": diffuse(0.36, 0.48, 0.44), "ceiling": diffuse(0.82, 0.82, 0.80)}
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((0.35, 1.75, 3.7), (-0.1, 0.85, -1.2), 62.0),
        **walls((-_HALF, _HALF), (0.0, _HEIGHT), (-_DEEP, _DEEP), diffuse(0.70, 0.69, 0.64), **other),
        **lamps,
        **model.shapes(),
    }


def _desk(rng: np.random.Generator) -> Model:
    """A desk with drawers, a screen, keys, papers; who sits at it looks along -z."""
    model = Model(_MATERIALS)
    model.add("wood", box((1.6, 0.03, 0.8), 0.008), (0, 0.725, 0))
    model.add("white", box((0.42, 0.62, 0.7), 0.006), (0.55, 0.37, 0))
    for k in range(3):
        model.add("white", box((0.39, 0.185, 0.02), 0.007), (0.55, 0.17 + 0.2 * k, 0.355))
        model.add("steel", box((0.14, 0.014, 0.02), 0.005), (0.55, 0.21 + 0.2 * k, 0.372))
    for z in (-0.34, 0.34):
        model.add("steel", tube([[-0.74, GAP, z], [-0.74, 0.35, z], [-0.74, 0.709, z]], 0.022))
    model.add("steel", tube([[-0.74, 0.06, -0.33], [-0.74, 0.06, 0], [-0.74, 0.06, 0.33]], 0.014))
    y = 0.74 + GAP
    model.add("black", turned("0,0 12,0 12,.8 3,1.6 2,4 2,16 0,16"), (-0.1, y, -0.2))
    model.add("black", box((0.56, 0.36, 0.03), 0.01), (-0.1, y + 0.3, -0.17), about(0, -6))
    model.add("screen", box((0.52, 0.32, 0.006), 0.002), (-0.1, y + 0.302, -0.152), about(0, -6))
    model.add("grey", box((0.42, 0.016, 0.14), 0.005), (-0.1, y + 0.009, 0.16), about(0, 3))
    for row in range(4):
        for k in range(12):
            model.add(
                "white", box((0.026, 0.01, 0.024), 0.003, 1), (-0.275 + 0.032 * k, y + 0.019, 0.112 + 0.032 * row)
            )
    model.add("grey", cushion((0.06, 0.028, 0.1), 0.012, 0.006, 6), (0.2, y + 0.015, 0.17))
    for level in range(4):
        sheet = box((0.21, 0.008, 0.297), 0.001, 1)
        model.add("white", sheet, (0.52, y + 0.004 + 0.009 * level, 0.05), about(1, rng.uniform(-14, 14)))
    model.add("book-0", turned("0,0 3.4,0 4,1 4,9 3.7,9 3.6,1.2 0,.8"), (-0.6, y, 0.1))
    books(model, rng, (-0.62, y, -0.27), -0.14, 0.14)
    return model


def _chair() -> Model:
    """A swivel chair, whose back is at low z."""
    model = Model(_MATERIALS)
    for k in range(5):
        c, s = np.cos(2 * np.pi * k / 5), np.sin(2 * np.pi * k / 5)
        model.add(
            "black", tube([[0.02 * c, 0.1, 0.02 * s], [0.16 * c, 0.085, 0.16 * s], [0.3 * c, 0.07, 0.3 * s]], 0.02)
        )
        model.add("black", ball(0.03, 24, 12), (0.29 * c, 0.0305, 0.29 * s))
    model.add("steel", turned("0,7 3.5,7 3.5,20 2.2,22 2.2,42 0,42", 32))
    model.add("cloth", cushion((0.48, 0.09, 0.46), 0.04, 0.015), (0, 0.465, 0.02))
    spine = [[0, 0.42, -0.15], [0, 0.43, -0.25], [0, 0.52, -0.285], [0, 0.8, -0.29]]
    model.add("black", tube(spine, 0.022))
    model.add("cloth", cushion((0.44, 0.08, 0.48), 0.038, 0.015), (0, 0.8, -0.235), about(0, 82))
    for side in (-1, 1):
        arm = [[0.2 * side, 0.44, 0], [0.28 * side, 0.44, 0], [0.285 * side, 0.5, 0], [0.285 * side, 0.64, 0]]
        model.add("black", tube(arm, 0.015))
        model.add("black", cushion((0.06, 0.03, 0.26), 0.013, 0.003, 3), (0.285 * side, 0.65, 0.02))
    return model


def _trough(model: Model, x: float, z: float) -> dict[str, Any]:
    """A lamp that hangs from the ceiling in a tray and shines upwards; the light."""
    y = 2.05
    model.add("white", box((1.3, 0.012, 0.2), 0.004), (x, y, z))
    for end in (-1, 1):
        model.add("white", box((1.3, 0.07, 0.012), 0.004), (x, y + 0.028, z + 0.1 * end))
        model.add("white", box((0.012, 0.07, 0.2), 0.004), (x + 0.65 * end, y + 0.028, z))
        model.add("steel", tube([[x + 0.6 * end, h, z] for h in (y, 2.4, _HEIGHT - GAP)], 0.003, 8))
    edges = ((1.2, 0.0, 0.0), (0.0, 0.0, -0.14))
    return rectangle((x - 0.6, y + 0.012, z + 0.07), *edges, diffuse(0.0, 0.0, 0.0), 58.0, 53.0, 46.0)


def _along_the_walls(model: Model, rng: np.random.Generator) -> None:
    """Shelves with books, a cupboard, a plant, a board, a clock, a blind in front of the window."""
    for x in (-1.9, -0.9):
        z = 0.17 - _DEEP
        for y in (0.03, 0.42, 0.81, 1.2, 1.59, 1.98):
            model.add("wood", box((0.96, 0.025, 0.32), 0.004), (x, y, z))
            if 0 < y < 1.9:
                books(model, rng, (x, y + 0.0125, z), -0.44, rng.uniform(0.0, 0.4))
        for side in (-1, 1):
            model.add("wood", box((0.025, 2.0, 0.32), 0.004), (x + 0.49 * side, 1.0 + GAP, z))
    model.add("white", box((1.5, 0.9, 0.03), 0.008), (1.2, 1.55, 0.017 - _DEEP))
    model.add("steel", box((1.56, 0.96, 0.02), 0.006), (1.2, 1.55, 0.011 - _DEEP))
    model.add("steel", box((0.7, 0.02, 0.07), 0.006), (1.2, 1.09, 0.06 - _DEEP))
    for k in range(5):
        model.add(
            "white" if k % 2 else "book-2", box((0.16, 0.2, 0.004), 0.001, 1), (0.75 + 0.21 * k, 1.6, 0.036 - _DEEP)
        )
    plant(model, 2.6, -3.55, 1.2)
    for k in range(34):
        model.add("white", box((0.03, 0.004, 2.6), 0.0015, 1), (_HALF - 0.05, 0.95 + 0.04 * k, -0.6), about(2, 52))
    model.add("grey", box((0.06, 0.04, 2.7), 0.008), (_HALF - 0.04, 2.33, -0.6))
    model.add("white", box((0.2, 0.04, 2.8), 0.01), (_HALF - 0.1, 0.88, -0.6))
    model.add("white", box((0.5, 1.1, 1.0), 0.01), (0.26 - _HALF, 0.556, -0.4))
    for side in (-1, 1):
        model.add("white", box((0.02, 1.04, 0.48), 0.006), (0.515 - _HALF, 0.556, -0.4 + 0.245 * side))
        model.add("steel", box((0.02, 0.12, 0.014), 0.005), (0.535 - _HALF, 0.7, -0.4 + 0.05 * side))
    books(model, rng, (0.2 - _HALF, 1.106, -0.55), -0.1, 0.12)
