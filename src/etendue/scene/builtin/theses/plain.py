"""Small scenes of the theses: a Cornell box that throws a caustic, a ring, a glass of water, a matt room."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...meshes import lathe, smooth
from ..pieces import diffuse, glass, matt, metal, palette, planks, rectangle, textured, walls
from ..solids import GAP, Model, about, ball, box, cushion, outline, ring, tube
from .furniture import view


def cornell_specular() -> dict[str, Any]:
    """The Cornell box with a tall box by Phong, which throws the lamp back to the ceiling."""
    import mitsuba as mi

    scene: dict[str, Any] = mi.cornell_box()
    phong = {"type": "phong", "diffuse_reflectance": 0.05, "specular_reflectance": 0.85, "exponent": 50.0}
    scene["large-box"]["bsdf"] = phong
    return scene


def silver_ring() -> dict[str, Any]:
    """A silver ring on the floor of a room with a lamp on a wall: inside it, a caustic with a cusp."""
    model = Model({"silver": metal("Ag", 0.05)})
    model.add("silver", ring("50,0 53,0 53,30 50,30", 128), (0.0, 0.001, 0.0))
    side, grey, lamp = (-1.5, 1.5), matt(0.56, 0.58, 0.62), (160.0, 148.0, 128.0)
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((-0.25, 1.45, 1.4), (0.0, 0.06, -0.05), 52.0),
        **walls(side, (0.0, 2.0), side, grey, floor=matt(0.70, 0.58, 0.44), back=matt(0.30, 0.42, 0.50)),
        "lamp": rectangle((1.49, 1.0, -0.1), (0.0, 0.0, 0.2), (0.0, 0.2, 0.0), grey, *lamp),
        **model.shapes(),
    }


def glass_of_water() -> dict[str, Any]:
    """A glass of water with a straw in a cubic room; a small lamp on a wall throws its caustics on the floor and on the
    wall opposite."""
    wet = glass(1.5, outside=1.333)
    model = Model({"glass": glass(), "wet": wet, "water": glass(1.333), "straw": matt(0.62, 0.07, 0.05)})
    outside, inside = "0,0 3.2,0 3.6,.4 4.4,13 4.4,13.6", "4.15,13.6 4.12,13 3.4,1.3 3.2,1 0,.9"
    profile = smooth(np.array(outline(f"{outside} {inside}")), 12, closed=False)
    rim = int(np.argmax(profile[:, 1]))
    level = rim + int(np.argmin(np.abs(profile[rim:, 1] - 0.095)))
    model.add("glass", lathe(profile[: level + 1], 128, closed=False), (0.0, GAP, 0.0))
    model.add("wet", lathe(profile[level:], 128, closed=False), (0.0, GAP, 0.0))
    surface = np.outer(np.linspace(1.0, 0.0, 12), [profile[level, 0], 0.0])
    model.add("water", lathe(surface, 128, closed=False), (0.0, GAP + profile[level, 1], 0.0))
    model.add("straw", tube([[-0.022, 0.013, 0.01], [0.006, 0.09, -0.004], [0.034, 0.172, -0.018]], 0.003))
    paint, half = matt(0.66, 0.64, 0.60), 0.4
    wood = textured(planks(6, 8, tone=(0.70, 0.62, 0.52)))
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((0.17, 0.3, 0.38), (0.07, 0.055, 0.0), 46.0),
        **walls((-half, half), (0.0, 2 * half), (-half, half), paint, floor=wood, back=matt(0.28, 0.40, 0.46)),
        "lamp": rectangle(
            (0.001 - half, 0.24, 0.025),
            (0.0, 0.0, -0.05),
            (0.0, 0.05, 0.0),
            diffuse(0.0, 0.0, 0.0),
            260.0,
            225.0,
            175.0,
        ),
        **model.shapes(),
    }


def diffuse_room() -> dict[str, Any]:
    """Blocks and balls under a broad lamp. Nothing throws a caustic."""
    model = Model(palette(matt, "chalk .72 .70 .66, clay .55 .24 .14, slate .16 .24 .32, moss .22 .36 .16"))
    model.add("chalk", box((0.5, 1.0, 0.5), 0.02), (-0.55, 0.5 + GAP, 0.15), about(1, 25))
    model.add("clay", box((0.55, 0.55, 0.55), 0.02), (0.55, 0.275 + GAP, 0.55), about(1, -18))
    model.add("chalk", ball(0.26, 128, 64), (0.55, 0.55 + 0.26 + 2 * GAP, 0.55))
    model.add("moss", ball(0.2), (-0.2, 0.2 + GAP, 1.05))
    model.add("slate", cushion((0.7, 0.12, 0.5), 0.05, 0.03), (0.1, 0.095, -0.45))
    wall, left, right = matt(0.70, 0.68, 0.64), matt(0.56, 0.20, 0.14), matt(0.16, 0.38, 0.40)
    black = diffuse(0.0, 0.0, 0.0)
    return {
        "type": "scene",
        "integrator": {"type": "path"},
        "sensor": view((0.0, 1.15, 3.75), (0.0, 0.75, 0.0), 48.0),
        **walls((-1.4, 1.4), (0.0, 2.1), (-1.0, 4.0), wall, left=left, right=right),
        "lamp": rectangle((-0.45, 2.098, 0.0), (0.9, 0.0, 0.0), (0.0, 0.0, 0.9), black, 9.0, 8.2, 7.0),
        **model.shapes(),
    }
