"""A room lit through a half-open door, from a lamp in the next room that faces a wall.

No surface that the camera sees is lit directly, and almost none by fewer than two bounces: a camera path must pass the
gap of the door before next event estimation can find the lamp.
"""

from __future__ import annotations

from typing import Any

from .pieces import box, camera, diffuse, pierced, placed, rgb, shell

#: Inner sizes: half the width, the height, and the depths of the room and of the one behind it.
_HALF, _HEIGHT, _ROOM, _BEHIND = 2.8, 2.6, 5.6, 2.4
_WALL = 0.1
#: The doorway in the wall at z = 0: range of x, height; opening angle of the door in degrees.
_DOOR_X, _DOOR_HEIGHT, _OPEN = (0.3, 1.3), 2.1, 35.0


def ajar() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    far = -_WALL - _BEHIND
    paint, floor = diffuse(0.72, 0.70, 0.66), diffuse(0.45, 0.32, 0.2)
    left, right = diffuse(0.62, 0.24, 0.18), diffuse(0.25, 0.42, 0.5)
    leaf = _DOOR_X[1] - _DOOR_X[0]
    lamp = mi.ScalarTransform4f().translate([-_HALF + 0.5, 1.5, far + 1.0]).rotate([0, 1, 0], -90).scale(0.4)
    hinge = mi.ScalarTransform4f().translate([_DOOR_X[0], 0.0, 0.02]).rotate([0, 1, 0], -_OPEN)
    return {
        "type": "scene",
        "integrator": {"type": "guided", "max_depth": 12},
        "sensor": camera((-0.1, 1.5, 5.4), (0.05, 1.05, 0.0), 58.0),
        **shell(_HALF, _HEIGHT, (far, _ROOM), _WALL, paint, floor=floor, left=left, right=right),
        **pierced("wall", _HALF, _HEIGHT, -_WALL / 2, _WALL, _DOOR_X, (0.0, _DOOR_HEIGHT), paint),
        "door": {
            "type": "cube",
            "to_world": hinge @ placed((leaf / 2, _DOOR_HEIGHT / 2, 0.02), (leaf, _DOOR_HEIGHT, 0.04)),
            "bsdf": diffuse(0.5, 0.42, 0.3),
        },
        "lamp": {
            "type": "disk",
            "to_world": lamp,
            "bsdf": diffuse(0.2, 0.2, 0.2),
            "emitter": {"type": "area", "radiance": rgb(14000.0, 12500.0, 10500.0)},
        },
        "table": box((-0.9, 0.72, 2.0), (1.5, 0.06, 0.9), diffuse(0.5, 0.45, 0.4)),
        "foot": box((-0.9, 0.345, 2.0), (0.5, 0.69, 0.4), diffuse(0.3, 0.2, 0.12)),
        "ball": {
            "type": "sphere",
            "center": [-1.2, 0.971, 2.0],
            "radius": 0.22,
            "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.2},
        },
        "tin": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([-0.55, 0.941, 2.05]).rotate([0, 1, 0], 35).scale(0.19),
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.12, 0.3, 0.5), "alpha": 0.15},
        },
        "stool": {
            "type": "sphere",
            "center": [2.0, 0.352, 1.7],
            "radius": 0.35,
            "bsdf": diffuse(0.55, 0.5, 0.2),
        },
    }
