"""The demonstration scene: glass, gold and water on a stone floor, lit by one small lamp inside a glass bulb.

Every light path leaves the lamp through the bulb, so next event estimation never reaches the lamp and a path tracer
finds it only by rare hits. All of its light is caustics: of the bulb, the ball, the vase, the stone and the ring on the
floor, and of the ripples on the bottom of the pool, which the camera sees through the water again (specular, diffuse,
specular).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..meshes import MeshDescription, Points, brilliant, height_field, lathe, smooth
from .pieces import Vector, camera, glass, lamp, matt, rectangle, rgb, walls

#: Inside of the room: ranges of x, y and z.
_ROOM = ((-4.2, 4.2), (0.0, 4.4), (-3.0, 7.6))
#: The pool in the floor: ranges of x and z; depth; water level.
_POOL_X, _POOL_Z, _POOL_DEPTH, _WATER = (-2.2, -0.45), (0.75, 2.55), 0.4, -0.06
_LAMP: Vector = (0.85, 1.95, -1.35)
_LAMP_RADIUS, _BULB_RADIUS, _BULB_WALL = 0.045, 0.3, 0.02
#: Gap under objects that stand on the floor, so that no two faces coincide.
_GAP = 0.002


def caustics() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 640x480; about 60 000 triangles."""
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 16},
        "sensor": camera((-0.3, 3.2, 6.9), (-0.08, 0.5, 0.35), 43.0, (640, 480)),
        **_room(),
        **_pool(),
        **_lamp(),
        **_still_life(),
    }


def _room() -> dict[str, Any]:
    (x0, x1), (y0, _), (z0, z1) = _ROOM
    width = x1 - x0
    side, ceiling = matt(0.34, 0.20, 0.15), matt(0.45, 0.43, 0.40)
    floor = matt(0.62, 0.57, 0.50)
    (p0, p1), (q0, q1) = _POOL_X, _POOL_Z
    return {
        **walls(*_ROOM, side, back=matt(0.09, 0.20, 0.26), front=ceiling, ceiling=ceiling, floor=None),
        # The floor surrounds the pool.
        "floor-back": rectangle((x0, y0, q0), (width, 0, 0), (0, 0, z0 - q0), floor),
        "floor-front": rectangle((x0, y0, z1), (width, 0, 0), (0, 0, q1 - z1), floor),
        "floor-left": rectangle((x0, y0, q1), (p0 - x0, 0, 0), (0, 0, q0 - q1), floor),
        "floor-right": rectangle((p1, y0, q1), (x1 - p1, 0, 0), (0, 0, q0 - q1), floor),
    }


def _ripples(x: Points, z: Points) -> Points:
    """Water level: rings from where two drops fell, fading outwards."""
    level = np.full_like(x, _WATER)
    for cx, cz, wave, amplitude in ((-0.95, 1.35, 0.32, 0.014), (-1.8, 2.1, 0.25, 0.009)):
        r = np.sqrt((x - cx) ** 2 + (z - cz) ** 2 + 1e-4)
        level += amplitude * np.cos(2 * np.pi * r / wave) * np.exp(-0.7 * r)
    return level


def _pool() -> dict[str, Any]:
    (p0, p1), (q0, q1), bottom = _POOL_X, _POOL_Z, -_POOL_DEPTH
    width, length = p1 - p0, q1 - q0
    import mitsuba as mi

    tiles = {
        "type": "twosided",
        "bsdf": {
            "type": "diffuse",
            "reflectance": {
                "type": "checkerboard",
                "color0": rgb(0.20, 0.55, 0.60),
                "color1": rgb(0.60, 0.78, 0.76),
                "to_uv": mi.ScalarTransform4f().scale([4, 4, 1]),
            },
        },
    }
    rim = matt(0.40, 0.60, 0.62)
    # The water ends inside the walls of the basin, which close its volume.
    sheet = height_field(_ripples, (p0 - 0.01, p1 + 0.01), (q0 - 0.01, q1 + 0.01), (110, 100))
    water = {"type": "dielectric", "int_ior": "water", "ext_ior": "air"}
    return {
        "pool-bottom": rectangle((p0, bottom, q1), (width, 0, 0), (0, 0, -length), tiles),
        "pool-back": rectangle((p0, bottom, q0), (width, 0, 0), (0, _POOL_DEPTH, 0), rim),
        "pool-front": rectangle((p1, bottom, q1), (-width, 0, 0), (0, _POOL_DEPTH, 0), rim),
        "pool-left": rectangle((p0, bottom, q1), (0, 0, -length), (0, _POOL_DEPTH, 0), rim),
        "pool-right": rectangle((p1, bottom, q0), (0, 0, length), (0, _POOL_DEPTH, 0), rim),
        "water": MeshDescription("water", *sheet[:2], water, sheet[2]),
    }


def _lamp() -> dict[str, Any]:
    """A small glowing ball in a hollow glass ball, hanging from a cord."""

    x, y, z = _LAMP
    hollow = glass(1.0, outside=1.5)
    brass = {"type": "roughconductor", "material": "Cu", "distribution": "ggx", "alpha": 0.2}
    top = y + _BULB_RADIUS
    cap = np.array([[0.0, 0.0], [0.09, 0.0], [0.12, 0.05], [0.1, 0.16], [0.04, 0.22], [0.0, 0.22]])
    points, faces, normals = lathe(smooth(cap, 6, closed=False), 48, closed=False)
    points = points + np.array([x, top + _GAP, z])
    return {
        "lamp": lamp(_LAMP, _LAMP_RADIUS, 6400.0, 4800.0, 3100.0),
        "bulb": {"type": "sphere", "center": [x, y, z], "radius": _BULB_RADIUS, "bsdf": glass()},
        "bulb-inside": {"type": "sphere", "center": [x, y, z], "radius": _BULB_RADIUS - _BULB_WALL, "bsdf": hollow},
        "socket": MeshDescription("socket", points, faces, brass, normals),
        "cord": {
            "type": "cylinder",
            "p0": [x, top + 0.2, z],
            "p1": [x, _ROOM[1][1], z],
            "radius": 0.012,
            "bsdf": matt(0.05, 0.05, 0.05),
        },
    }


def _still_life() -> dict[str, Any]:
    return {
        "ball": {
            "type": "sphere",
            "center": [0.25, 0.62 + _GAP, 0.55],
            "radius": 0.62,
            "bsdf": glass(),
        },
        "ring": _ring(),
        "vase": _vase(),
        "stone": _stone(),
        "copper-ball": {
            "type": "sphere",
            "center": [2.35, 0.4 + _GAP, -0.75],
            "radius": 0.4,
            "bsdf": {"type": "roughconductor", "material": "Cu", "distribution": "ggx", "alpha": 0.12},
        },
    }


def _ring() -> MeshDescription:
    """A gold band on the floor, whose inside reflects a cardioid caustic."""
    band = np.array([[0.74, 0.0], [0.82, 0.0], [0.82, 0.26], [0.74, 0.26]])
    band = np.concatenate(
        [np.linspace(a, b, 4, endpoint=False) for a, b in zip(band, np.roll(band, -1, 0), strict=True)]
    )
    points, faces, normals = lathe(smooth(band, 3, closed=True), 192, closed=True)
    points = points + np.array([1.6, _GAP, 1.1])
    return MeshDescription("ring", points, faces, {"type": "conductor", "material": "Au"}, normals)


def _vase() -> MeshDescription:
    """A thick-walled vase of amber glass: one closed surface, outside up and inside down."""
    outside = [(0, 0), (0.34, 0), (0.36, 0.08), (0.2, 0.3), (0.46, 0.8), (0.42, 1.2), (0.2, 1.5), (0.34, 1.78)]
    inside = [(0.28, 1.78), (0.13, 1.5), (0.34, 1.2), (0.38, 0.8), (0.16, 0.4), (0, 0.36)]
    profile = smooth(np.array(outside + inside, dtype=np.float64), 8, closed=False)
    points, faces, normals = lathe(profile, 128, closed=False)
    points = points + np.array([-1.45, _GAP, -0.75])
    return MeshDescription("vase", points, faces, glass(1.5, 0.98, 0.80, 0.48), normals)


def _stone() -> MeshDescription:
    points, faces = brilliant(0.42, 0.3, 0.36, 9)
    points = points + np.array([0.6, _GAP, 2.45])
    return MeshDescription("stone", points, faces, glass(1.77, 0.62, 0.84, 0.97))
