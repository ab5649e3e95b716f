"""A plain diffuse scene: a room with blocks and balls, all matt, under a broad lamp. Nothing throws a caustic."""

from __future__ import annotations

from typing import Any

from .parts import GAP, Model, about_y, ball, box, camera, cushion, diffuse, rectangle, rgb


def diffuse_room() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 25 000 triangles."""
    model = Model(
        {
            "chalk": diffuse(0.72, 0.70, 0.66),
            "clay": diffuse(0.55, 0.24, 0.14),
            "slate": diffuse(0.16, 0.24, 0.32),
            "moss": diffuse(0.22, 0.36, 0.16),
        }
    )
    model.add("chalk", box((0.5, 1.0, 0.5), 0.02), (-0.55, 0.5 + GAP, 0.15), about_y(25))
    model.add("clay", box((0.55, 0.55, 0.55), 0.02), (0.55, 0.275 + GAP, 0.55), about_y(-18))
    model.add("chalk", ball(0.26, 128, 64), (0.55, 0.55 + 0.26 + 2 * GAP, 0.55))
    model.add("moss", ball(0.2, 96, 48), (-0.2, 0.2 + GAP, 1.05))
    model.add("slate", cushion((0.7, 0.12, 0.5), 0.05, 0.03), (0.1, 0.095, -0.45))
    wall, left, right = diffuse(0.70, 0.68, 0.64), diffuse(0.56, 0.20, 0.14), diffuse(0.16, 0.38, 0.40)
    black = {"type": "diffuse", "reflectance": rgb(0.0, 0.0, 0.0)}
    light = {"emitter": {"type": "area", "radiance": rgb(9.0, 8.2, 7.0)}}
    return {
        "type": "scene",
        "integrator": {"type": "path"},
        "sensor": camera((0.0, 1.15, 3.75), (0.0, 0.75, 0.0), 48.0),
        "floor": rectangle((-1.4, 0.0, 4.0), (2.8, 0.0, 0.0), (0.0, 0.0, -5.0), wall),
        "ceiling": rectangle((-1.4, 2.1, -1.0), (2.8, 0.0, 0.0), (0.0, 0.0, 5.0), wall),
        "back": rectangle((-1.4, 0.0, -1.0), (2.8, 0.0, 0.0), (0.0, 2.1, 0.0), wall),
        "front": rectangle((1.4, 0.0, 4.0), (-2.8, 0.0, 0.0), (0.0, 2.1, 0.0), wall),
        "left": rectangle((-1.4, 0.0, 4.0), (0.0, 0.0, -5.0), (0.0, 2.1, 0.0), left),
        "right": rectangle((1.4, 0.0, -1.0), (0.0, 0.0, 5.0), (0.0, 2.1, 0.0), right),
        "lamp": rectangle((-0.45, 2.098, 0.0), (0.9, 0.0, 0.0), (0.0, 0.0, 0.9), black, **light),
        **model.shapes(),
    }
