"""The scenes: those of the adaptive integrators, an office with a glossy floor, and glass in a box."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue import scene

from ..adaptive.scenes import cornell, cornell_specular, ring
from ..vcm_thesis.scenes import parts


def glossy_office() -> dict[str, Any]:
    """A room with a glossy floor under two desks, lit by lamps that shine at the ceiling, and by the ceiling."""
    wall, desk = parts.diffuse(0.7, 0.7, 0.66), parts.diffuse(0.45, 0.3, 0.2)
    black = parts.diffuse(0.0, 0.0, 0.0)
    floor = {"type": "phong", "diffuse_reflectance": 0.15, "specular_reflectance": 0.7, "exponent": 300.0}
    half, high, deep = 3.0, 2.8, 4.0
    width, up, depth = (2 * half, 0.0, 0.0), (0.0, high, 0.0), (0.0, 0.0, 2 * deep)
    back = (0.0, 0.0, -2 * deep)
    room: dict[str, Any] = {
        "type": "scene",
        "sensor": parts.camera((0.0, 1.7, 3.6), (0.0, 0.8, 0.0), 60.0),
        "floor": parts.rectangle((-half, 0.0, deep), width, back, floor),
        "ceiling": parts.rectangle((-half, high, -deep), width, depth, wall),
        "back": parts.rectangle((-half, 0.0, -deep), width, up, wall),
        "front": parts.rectangle((half, 0.0, deep), (-2 * half, 0.0, 0.0), up, wall),
        "left": parts.rectangle((-half, 0.0, deep), back, up, wall),
        "right": parts.rectangle((half, 0.0, -deep), depth, up, wall),
    }
    for number, (x, z) in enumerate(((-1.5, -1.0), (1.4, 0.8))):
        room[f"desk-{number}"] = parts.rectangle((x - 0.8, 0.74, z + 0.4), (1.6, 0.0, 0.0), (0.0, 0.0, -0.8), desk)
        room[f"under-{number}"] = parts.rectangle((x - 0.8, 0.73, z - 0.4), (1.6, 0.0, 0.0), (0.0, 0.0, 0.8), desk)
        lamp = {"emitter": {"type": "area", "radiance": parts.rgb(60.0, 56.0, 50.0)}}
        corner = (x - 0.15, 1.9, z + 0.15)
        room[f"lamp-{number}"] = parts.rectangle(corner, (0.3, 0.0, 0.0), (0.0, 0.0, -0.3), black, **lamp)
        shade = (x - 0.16, 1.89, z - 0.16)
        room[f"shade-{number}"] = parts.rectangle(shade, (0.32, 0.0, 0.0), (0.0, 0.0, 0.32), black)
    return room


#: Every scene by the name that the commands take.
SCENES: dict[str, Callable[[], Any]] = {
    "cornell": cornell,
    "cornell-specular": cornell_specular,
    "ring": ring,
    "glossy-office": glossy_office,
    "cornell-glass": lambda: scene.bundled_scene("cornell-glass").build(),
    "ajar": lambda: scene.bundled_scene("ajar").build(),
}
#: Scenes whose materials the thesis did not sample.
WITHOUT_BSDF = ("cornell-specular",)
#: Cells along the sides of a primitive: the thesis has maps of 50 x 50 in the Cornell box.
CELLS = {"cornell": 32, "cornell-specular": 32, "ring": 50, "glossy-office": 40, "cornell-glass": 32, "ajar": 16}


def open_scene(name: str) -> scene.Problem:
    """A scene, loaded."""
    return scene.load(SCENES[name](), size=(64, 48))
