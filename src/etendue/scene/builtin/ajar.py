"""A room lit through a half-open door, from a lamp in the next room that faces a wall.

No surface that the camera sees is lit directly, and almost none by fewer than two bounces: a camera path must pass the
gap of the door before next event estimation can find the lamp.
"""

from __future__ import annotations

from typing import Any

from .pieces import box, diffuse, placed, rgb

#: Inner sizes: half the width, the height, and the depths of the room and of the one behind it.
_HALF, _HEIGHT, _ROOM, _BEHIND = 2.8, 2.6, 5.6, 2.4
_WALL = 0.1
#: The doorway in the wall at z = 0: range of x, height; opening angle of the door in degrees.
_DOOR_X, _DOOR_HEIGHT, _OPEN = (0.3, 1.3), 2.1, 35.0


def ajar() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    far = -_WALL - _BEHIND
    middle, depth = (_ROOM + far) / 2, _ROOM - far
    paint, floor = diffuse(0.72, 0.70, 0.66), diffuse(0.45, 0.32, 0.2)
    left, right = _DOOR_X
    wall_z = -_WALL / 2
    lamp = mi.ScalarTransform4f().translate([-_HALF + 0.5, 1.5, far + 1.0]).rotate([0, 1, 0], -90).scale(0.4)
    hinge = mi.ScalarTransform4f().translate([left, 0.0, 0.02]).rotate([0, 1, 0], -_OPEN)
    return {
        "type": "scene",
        "integrator": {"type": "guided", "max_depth": 12},
        "sensor": _sensor(),
        "floor": box((0.0, -_WALL / 2, middle), (2 * _HALF, _WALL, depth), floor),
        "ceiling": box((0.0, _HEIGHT + _WALL / 2, middle), (2 * _HALF, _WALL, depth), paint),
        "left": box((-_HALF - _WALL / 2, _HEIGHT / 2, middle), (_WALL, _HEIGHT, depth), diffuse(0.62, 0.24, 0.18)),
        "right": box((_HALF + _WALL / 2, _HEIGHT / 2, middle), (_WALL, _HEIGHT, depth), diffuse(0.25, 0.42, 0.5)),
        "front": box((0.0, _HEIGHT / 2, _ROOM + _WALL / 2), (2 * _HALF, _HEIGHT, _WALL), paint),
        "far": box((0.0, _HEIGHT / 2, far - _WALL / 2), (2 * _HALF, _HEIGHT, _WALL), paint),
        "wall-left": box(((left - _HALF) / 2, _HEIGHT / 2, wall_z), (left + _HALF, _HEIGHT, _WALL), paint),
        "wall-right": box(((right + _HALF) / 2, _HEIGHT / 2, wall_z), (_HALF - right, _HEIGHT, _WALL), paint),
        "wall-above": box(
            ((left + right) / 2, (_DOOR_HEIGHT + _HEIGHT) / 2, wall_z),
            (right - left, _HEIGHT - _DOOR_HEIGHT, _WALL),
            paint,
        ),
        "door": {
            "type": "cube",
            "to_world": hinge
            @ placed(((right - left) / 2, _DOOR_HEIGHT / 2, 0.02), (right - left, _DOOR_HEIGHT, 0.04)),
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


def _sensor() -> dict[str, Any]:
    import mitsuba as mi

    film = {"type": "hdrfilm", "width": 512, "height": 384, "pixel_format": "rgb", "rfilter": {"type": "gaussian"}}
    return {
        "type": "perspective",
        "fov": 58.0,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at([-0.1, 1.5, 5.4], [0.05, 1.05, 0.0], [0, 1, 0]),
        "sampler": {"type": "independent", "sample_count": 64},
        "film": film,
    }
