"""A classroom lit by sky and sun through three windows, one of them behind blinds.

Almost all light enters through the windows: of the rays that the sky sends to the scene, one in several hundred.
"""

from __future__ import annotations

from itertools import product
from typing import Any

from .pieces import box, camera, diffuse, glass, rgb, shell, sky

#: Half the width, height and depth of the room; thickness of the walls.
_HALF, _HEIGHT, _DEPTH, _WALL = 3.2, 3.0, 4.0, 0.2
#: The windows: middles along z, width, sill and top.
_WINDOWS, _WIDTH, _SILL, _TOP = (-2.5, 0.0, 2.5), 1.5, 0.95, 2.5
_FRAME = 0.07
#: The blinds: slats of a window, their angle in degrees, and what is open below them in each window.
_SLATS, _TILT, _RAISED = 16, 62.0, (0.0, 0.25, 0.0)
#: Places of the desks, (x, z).
_DESKS = [(x, z) for z in (-2.4, -0.9, 0.6) for x in (-1.7, 0.0, 1.7)]


def shutters() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    paint, frame = diffuse(0.78, 0.76, 0.70), diffuse(0.6, 0.6, 0.58)
    wood, steel = diffuse(0.52, 0.36, 0.2), {"type": "roughconductor", "alpha": 0.25}
    sides = shell(_HALF, _HEIGHT, (-_DEPTH, _DEPTH), _WALL, paint, floor=diffuse(0.42, 0.33, 0.25))
    del sides["left"]
    sides["ceiling"] = box(
        (-_WALL, _HEIGHT + _WALL, 0.0), (2 * _HALF + 4 * _WALL, 2 * _WALL, 2 * _DEPTH + _WALL), paint
    )
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 12},
        "sensor": camera((2.3, 1.55, 3.7), (-0.9, 1.05, -1.2), 70.0),
        "sky": sky((-0.8, 0.55, 0.25), (13000.0, 11500.0, 9500.0), height=256, width=0.00025),
        "ground": {
            "type": "disk",
            "to_world": mi.ScalarTransform4f().translate([0, -_WALL - 0.01, 0]).rotate([1, 0, 0], -90).scale(25.0),
            "bsdf": diffuse(0.2, 0.25, 0.12),
        },
        **sides,
    }
    x, z = -_HALF - _WALL / 2, -_DEPTH
    for number, middle in enumerate(_WINDOWS):
        low, high = middle - _WIDTH / 2, middle + _WIDTH / 2
        scene[f"pier{number}"] = box((x, _HEIGHT / 2, (z + low) / 2), (_WALL, _HEIGHT, low - z), paint)
        scene[f"sill{number}"] = box((x, _SILL / 2, middle), (_WALL, _SILL, _WIDTH), paint)
        scene[f"lintel{number}"] = box((x, (_TOP + _HEIGHT) / 2, middle), (_WALL, _HEIGHT - _TOP, _WIDTH), paint)
        scene[f"post{number}"] = box((x, (_SILL + _TOP) / 2, middle), (_FRAME, _TOP - _SILL, _FRAME), frame)
        scene[f"bar{number}"] = box((x, _SILL + 0.62 * (_TOP - _SILL), middle), (_FRAME, _FRAME, _WIDTH), frame)
        scene[f"pane{number}"] = box((x + 0.05, (_SILL + _TOP) / 2, middle), (0.006, _TOP - _SILL, _WIDTH), glass())
        z = high
    scene["pier3"] = box((x, _HEIGHT / 2, (z + _DEPTH) / 2), (_WALL, _HEIGHT, _DEPTH - z), paint)
    for number, (window, slat) in enumerate(product(range(3), range(_SLATS))):
        if (slat + 0.5) / _SLATS < _RAISED[window]:
            continue
        y = _SILL + (slat + 0.5) / _SLATS * (_TOP - _SILL)
        tilted = mi.ScalarTransform4f().translate([-_HALF + 0.06, y, _WINDOWS[window]]).rotate([0, 0, 1], _TILT)
        scene[f"slat{number}"] = {
            "type": "cube",
            "to_world": tilted.scale([0.05, 0.003, _WIDTH / 2]),
            "bsdf": diffuse(0.7, 0.68, 0.6),
        }
    for number, (x, z) in enumerate(_DESKS):
        scene[f"desk{number}"] = box((x, 0.73, z), (1.2, 0.04, 0.6), wood)
        for side in (-0.5, 0.5):
            scene[f"leg{number}{'lr'[side > 0]}"] = box((x + side, 0.355, z), (0.05, 0.71, 0.5), steel)
    scene["board"] = box((0.0, 1.6, -_DEPTH + 0.03), (3.2, 1.2, 0.05), diffuse(0.05, 0.14, 0.09))
    scene["globe"] = {
        "type": "sphere",
        "center": [1.75, 0.93, 0.6],
        "radius": 0.17,
        "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.1, 0.25, 0.5), "alpha": 0.1},
    }
    return scene
