"""The scenes of the experiments, built by code: two Cornell boxes, a ring on a floor, a sitting room."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue import scene

from ..vcm_thesis.scenes import living_room, parts


def cornell() -> dict[str, Any]:
    """The Cornell box, all matt."""
    return scene.bundled_scene("cornell-box").build()


def cornell_specular() -> dict[str, Any]:
    """The same with a tall box by Phong, which throws the lamp back to the ceiling."""
    box = cornell()
    phong = {"type": "phong", "diffuse_reflectance": 0.05, "specular_reflectance": 0.85, "exponent": 50.0}
    box["large-box"]["bsdf"] = phong
    return box


def ring() -> dict[str, Any]:
    """A silver ring on the floor of a room with a lamp on a wall: inside it, a caustic with a cusp. Lengths: metres."""
    model = parts.Model({"silver": parts.metal("Ag", 0.1)})
    model.add("silver", parts.ring([(0.5, 0.0), (0.53, 0.0), (0.53, 0.3), (0.5, 0.3)], 128), (0.0, 0.001, 0.0))
    wall, floor = parts.diffuse(0.6, 0.6, 0.6), parts.diffuse(0.7, 0.66, 0.6)
    lamp = {"emitter": {"type": "area", "radiance": parts.rgb(40.0, 37.0, 32.0)}}
    half, high = 1.5, 2.0
    width, up, depth = (2 * half, 0.0, 0.0), (0.0, high, 0.0), (0.0, 0.0, 2 * half)
    back = (0.0, 0.0, -2 * half)
    return {
        "type": "scene",
        "sensor": parts.camera((0.0, 1.75, 1.3), (0.0, 0.0, 0.0), 48.0),
        "floor": parts.rectangle((-half, 0.0, half), width, back, floor),
        "ceiling": parts.rectangle((-half, high, -half), width, depth, wall),
        "back": parts.rectangle((-half, 0.0, -half), width, up, wall),
        "front": parts.rectangle((half, 0.0, half), (-2 * half, 0.0, 0.0), up, wall),
        "left": parts.rectangle((-half, 0.0, half), back, up, wall),
        "right": parts.rectangle((half, 0.0, -half), depth, up, wall),
        "lamp": parts.rectangle((half - 0.01, 0.9, -0.2), (0.0, 0.0, 0.4), (0.0, 0.4, 0.0), wall, **lamp),
        **model.shapes(),
    }


def sitting_room() -> dict[str, Any]:
    """The furniture of the living room, by the light of two windows in place of its lamps."""
    room = living_room()
    for lamp in ("pendant-lamp", "globe-lamp"):
        del room[lamp]
    black = {"type": "diffuse", "reflectance": parts.rgb(0.0, 0.0, 0.0)}
    sky = {"emitter": {"type": "area", "radiance": parts.rgb(7.0, 7.6, 8.4)}}
    for name, z in (("window-far", 0.9), ("window-near", 2.6)):
        room[name] = parts.rectangle((2.39, 0.95, z), (0.0, 0.0, 1.1), (0.0, 1.25, 0.0), black, **sky)
    return room


#: Every scene by the name that the commands take. A builder returns a fresh Mitsuba dictionary; a variant must be set.
SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cornell": cornell,
    "cornell-specular": cornell_specular,
    "ring": ring,
    "sitting-room": sitting_room,
}
#: The thesis's sizes of pictures, as far as it states them.
SIZES = {"cornell": (100, 100), "cornell-specular": (100, 100), "ring": (100, 75), "sitting-room": (128, 91)}


def open_scene(name: str, size: tuple[int, int]) -> scene.Problem:
    """A scene of the experiments, loaded at a size."""
    return scene.load(SCENES[name](), size=size)
