"""A room lit through two narrow gaps, by a lamp in the second chamber behind it that faces away from the gap.

Light must pass the gap between the second chamber and the first, and the gap between the first chamber and the room,
which are not opposite each other. Few paths of the camera or of the lamp pass one gap, and hardly any pass both.
"""

from __future__ import annotations

from typing import Any

from .pieces import box, diffuse, rgb

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
    middle, depth = (_ROOM + far) / 2, _ROOM - far
    paint = diffuse(0.75, 0.72, 0.68)
    lamp = mi.ScalarTransform4f().translate([-_HALF + 0.35, 1.2, far + 0.7]).rotate([0, 1, 0], -90).scale(0.25)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "mmlt", "max_depth": 16},
        "sensor": _sensor(),
        "floor": box((0.0, -_WALL / 2, middle), (2 * _HALF, _WALL, depth), diffuse(0.5, 0.42, 0.32)),
        "ceiling": box((0.0, _HEIGHT + _WALL / 2, middle), (2 * _HALF, _WALL, depth), paint),
        "left": box((-_HALF - _WALL / 2, _HEIGHT / 2, middle), (_WALL, _HEIGHT, depth), diffuse(0.68, 0.34, 0.26)),
        "right": box((_HALF + _WALL / 2, _HEIGHT / 2, middle), (_WALL, _HEIGHT, depth), diffuse(0.34, 0.5, 0.62)),
        "front": box((0.0, _HEIGHT / 2, _ROOM + _WALL / 2), (2 * _HALF, _HEIGHT, _WALL), paint),
        "far": box((0.0, _HEIGHT / 2, far - _WALL / 2), (2 * _HALF, _HEIGHT, _WALL), paint),
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
    for number, (z, ((left, right), (low, high))) in enumerate(zip(fronts, _GAPS, strict=True)):
        parts = {
            "left": ((-_HALF, left), (0.0, _HEIGHT)),
            "right": ((right, _HALF), (0.0, _HEIGHT)),
            "below": ((left, right), (0.0, low)),
            "above": ((left, right), (high, _HEIGHT)),
        }
        for name, ((x0, x1), (y0, y1)) in parts.items():
            scene[f"wall{number}-{name}"] = box(((x0 + x1) / 2, (y0 + y1) / 2, z), (x1 - x0, y1 - y0, _WALL), paint)
    return scene


def _sensor() -> dict[str, Any]:
    import mitsuba as mi

    film = {"type": "hdrfilm", "width": 512, "height": 384, "pixel_format": "rgb", "rfilter": {"type": "gaussian"}}
    return {
        "type": "perspective",
        "fov": 60.0,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at([0.15, 1.2, 3.05], [0.0, 0.95, 0.0], [0, 1, 0]),
        "sampler": {"type": "independent", "sample_count": 64},
        "film": film,
    }
