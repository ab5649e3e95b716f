"""A flat whose lamp hangs two rooms away from the camera: light passes two doorways that are not opposite each other.

The living room (z > 0) opens to a hall, and the hall to a bedroom with the only lamp. The camera sees the doorway of
the hall, and hardly anything that the lamp lights directly.
"""

from __future__ import annotations

from typing import Any

from .pieces import box, camera, diffuse, pierced, rgb, shell

#: Half the width and the height of the rooms; depths of living room, hall and bedroom; thickness of the walls.
_HALF, _HEIGHT, _LIVING, _HALL, _BEDROOM, _WALL = 2.7, 2.5, 4.6, 2.2, 3.6, 0.12
#: Doorways in the walls behind the living room and behind the hall: range of x; and their height.
_DOORS, _DOOR_HEIGHT = ((0.2, 1.6), (-1.7, -0.3)), 2.15


def flat() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    fronts = (-_WALL / 2, -1.5 * _WALL - _HALL)  # middles of the walls with doorways
    far = -2.0 * _WALL - _HALL - _BEDROOM
    paint, wood = diffuse(0.84, 0.81, 0.76), diffuse(0.5, 0.35, 0.22)
    other = {"floor": wood, "ceiling": diffuse(0.86, 0.86, 0.84)}
    other |= {"left": diffuse(0.42, 0.6, 0.58), "right": diffuse(0.75, 0.55, 0.34)}
    lamp = (0.4, 1.9, far + 0.55 * _BEDROOM)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 14},
        "sensor": camera((-1.9, 1.5, 4.3), (0.5, 1.0, 0.0), 62.0),
        **shell(_HALF, _HEIGHT, (far, _LIVING), _WALL, paint, **other),
        "bulb": {
            "type": "sphere",
            "center": list(lamp),
            "radius": 0.1,
            "bsdf": diffuse(0.5, 0.5, 0.5),
            "emitter": {"type": "area", "radiance": rgb(24000.0, 20000.0, 15500.0)},
        },
        "bed": box((1.5, 0.25, far + 1.1), (1.6, 0.5, 2.0), diffuse(0.55, 0.52, 0.6)),
        "sofa": box((-1.35, 0.22, 0.55), (1.8, 0.44, 0.8), diffuse(0.5, 0.2, 0.16)),
        "back": box((-1.35, 0.6, 0.12), (1.8, 0.5, 0.2), diffuse(0.5, 0.2, 0.16)),
        "table": {
            "type": "cylinder",
            "p0": [0.3, 0.002, 2.0],
            "p1": [0.3, 0.4, 2.0],
            "radius": 0.42,
            "bsdf": {"type": "twosided", "bsdf": wood},
        },
        "top": {
            "type": "disk",
            "to_world": mi.ScalarTransform4f().translate([0.3, 0.4, 2.0]).rotate([1, 0, 0], -90).scale(0.42),
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.4, 0.26, 0.16), "alpha": 0.1},
        },
        "bowl": {"type": "sphere", "center": [0.3, 0.582, 2.0], "radius": 0.18, "bsdf": {"type": "dielectric"}},
        "vase": {
            "type": "sphere",
            "center": [2.1, 0.402, 0.6],
            "radius": 0.4,
            "bsdf": {"type": "roughconductor", "material": "Cu", "alpha": 0.15},
        },
        "mirror": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([-1.3, 1.55, 0.005]).scale([0.6, 0.4, 1.0]),
            "bsdf": {"type": "conductor", "material": "Ag"},
        },
    }
    for number, (z, door) in enumerate(zip(fronts, _DOORS, strict=True)):
        scene |= pierced(f"wall{number}", _HALF, _HEIGHT, z, _WALL, door, (0.0, _DOOR_HEIGHT), paint)
    return scene
