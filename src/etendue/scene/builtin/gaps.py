"""A room lit through two narrow gaps, by a lamp in the second chamber behind it that faces away from the gap.

Light must pass the gap between the second chamber and the first, and the gap between the first chamber and the room,
which are not opposite each other. Few paths of the camera or of the lamp pass one gap, and hardly any pass both.
"""

from __future__ import annotations

from typing import Any

from .pieces import camera, diffuse, pierced, rgb, shell

#: Inner sizes: half the width, the height, the depths of the room and of the two chambers behind it.
_HALF, _HEIGHT, _ROOM, _CHAMBER = 1.6, 2.2, 3.2, 1.4
_WALL = 0.08
#: The gaps: (range of x, range of y) in the wall of the room and in the wall behind it.
_GAPS = (((-1.1, -0.8), (0.65, 1.35)), ((0.7, 1.0), (0.8, 1.5)))


def gaps() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    fronts = (-_WALL / 2, -1.5 * _WALL - _CHAMBER)  # middles of the walls with gaps
    far = -2.0 * (_WALL + _CHAMBER)
    paint, floor = diffuse(0.75, 0.72, 0.68), diffuse(0.5, 0.42, 0.32)
    left, right = diffuse(0.68, 0.34, 0.26), diffuse(0.34, 0.5, 0.62)
    lamp = mi.ScalarTransform4f().translate([-_HALF + 0.35, 1.2, far + 0.7]).rotate([0, 1, 0], -90).scale(0.25)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "mmlt", "max_depth": 16},
        "sensor": camera((0.15, 1.2, 3.05), (0.0, 0.95, 0.0), 60.0),
        **shell(_HALF, _HEIGHT, (far, _ROOM), _WALL, paint, floor=floor, left=left, right=right),
        "lamp": {
            "type": "disk",
            "to_world": lamp,
            "bsdf": diffuse(0.2, 0.2, 0.2),
            "emitter": {"type": "area", "radiance": rgb(4.0e6, 3.5e6, 2.9e6)},
        },
        "ball": {
            "type": "sphere",
            "center": [-0.45, 0.351, 1.1],
            "radius": 0.35,
            "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.25},
        },
        "block": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0.6, 0.4, 0.8]).rotate([0, 1, 0], 28).scale([0.3, 0.4, 0.3]),
            "bsdf": diffuse(0.6, 0.58, 0.5),
        },
    }
    for number, (z, gap) in enumerate(zip(fronts, _GAPS, strict=True)):
        scene |= pierced(f"wall{number}", _HALF, _HEIGHT, z, _WALL, *gap, paint)
    return scene
