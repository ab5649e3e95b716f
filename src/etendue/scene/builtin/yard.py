"""A yard at dusk: a sky, a low sun, and ten lamps, one of them near to what the camera sees.

A bulb hangs above the bench at the wall of a house; the other lamps stand far away around a large ground. The power of
the sky through the sphere that bounds the ground is thousands of times that of the bulb, and so is its power over that
of a lamp beside it for most of the ground, but not in the picture.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .pieces import box, camera, diffuse, rgb

#: Half the side of the ground, and distance of the far lamps, in metres.
_GROUND, _FAR = 80.0, 24.0


def yard() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    def facing(origin: list[float], target: list[float]) -> mi.ScalarTransform4f:
        return mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0.01])

    ground = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(_GROUND)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 8},
        "sensor": camera((1.8, 1.7, 4.6), (-0.2, 0.8, 0.0), 42.0, up=(0, 1, 0.01)),
        "sky": {"type": "constant", "radiance": rgb(0.02, 0.028, 0.05)},
        "sun": {"type": "directional", "direction": [-0.8, -0.22, 0.35], "irradiance": rgb(0.16, 0.09, 0.045)},
        "ground": {"type": "rectangle", "to_world": ground, "bsdf": diffuse(0.2, 0.19, 0.17)},
        "house": box((-0.5, 1.5, -1.6), (6.0, 3.0, 2.0), diffuse(0.5, 0.4, 0.32)),
        "shed": box((-3.6, 1.1, 1.2), (1.4, 2.2, 2.4), diffuse(0.25, 0.3, 0.22)),
        "bench": box((-0.7, 0.44, -0.25), (1.6, 0.06, 0.4), diffuse(0.35, 0.2, 0.1)),
        "left": box((-1.35, 0.205, -0.25), (0.08, 0.41, 0.36), diffuse(0.3, 0.3, 0.3)),
        "right": box((-0.05, 0.205, -0.25), (0.08, 0.41, 0.36), diffuse(0.3, 0.3, 0.3)),
        "pot": {
            "type": "sphere",
            "center": [0.9, 0.302, 0.2],
            "radius": 0.3,
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.1, 0.25, 0.4), "alpha": 0.1},
        },
        "bulb": {
            "type": "sphere",
            "center": [-0.4, 1.9, -0.3],
            "radius": 0.06,
            "emitter": {"type": "area", "radiance": rgb(100.0, 72.0, 36.0)},
        },
    }
    for number, turn in enumerate(np.linspace(0.3, 0.3 + 2.0 * np.pi, 9, endpoint=False).tolist()):
        x, z = _FAR * float(np.cos(turn)), _FAR * float(np.sin(turn))
        match number % 3:
            case 0:
                lamp: dict[str, Any] = {"type": "point", "position": [x, 5.0, z], "intensity": rgb(30.0, 24.0, 14.0)}
            case 1:
                target = [0.5 * x, 0.0, 0.5 * z]
                look = facing([x, 6.0, z], target)
                lamp = {"type": "spot", "to_world": look, "intensity": rgb(300.0, 280.0, 240.0), "cutoff_angle": 35.0}
            case _:
                place = mi.ScalarTransform4f().translate([x, 4.0, z]).rotate([1, 0, 0], 90).scale(0.4)
                lamp = {
                    "type": "rectangle",
                    "to_world": place,
                    "emitter": {"type": "area", "radiance": rgb(40, 36, 30)},
                }
        scene[f"lamp{number}"] = lamp
    return scene
