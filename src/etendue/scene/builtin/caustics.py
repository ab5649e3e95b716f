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

Vector = tuple[float, float, float]

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
        "sensor": _sensor(),
        **_room(),
        **_pool(),
        **_lamp(),
        **_still_life(),
    }


def _sensor() -> dict[str, Any]:
    import mitsuba as mi

    return {
        "type": "perspective",
        "fov": 43.0,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at([-0.3, 3.2, 6.9], [-0.08, 0.5, 0.35], [0, 1, 0]),
        "sampler": {"type": "independent", "sample_count": 64},
        "film": {
            "type": "hdrfilm",
            "width": 640,
            "height": 480,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "gaussian"},
        },
    }


def _rgb(*value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(value)}


def _diffuse(*value: float) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": _rgb(*value)}}


def _rectangle(corner: Vector, along: Vector, across: Vector, bsdf: dict[str, Any]) -> dict[str, Any]:
    """The parallelogram of two edges from a corner; its normal is the direction of ``along`` x ``across``."""
    import mitsuba as mi

    u, v = np.array(along) / 2, np.array(across) / 2
    normal = np.cross(u, v)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = u, v
    matrix[:3, 2] = normal / np.linalg.norm(normal)
    matrix[:3, 3] = np.array(corner) + u + v
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf}


def _room() -> dict[str, Any]:
    (x0, x1), (y0, y1), (z0, z1) = _ROOM
    width, height, depth = x1 - x0, y1 - y0, z1 - z0
    wall, side, ceiling = _diffuse(0.09, 0.20, 0.26), _diffuse(0.34, 0.20, 0.15), _diffuse(0.45, 0.43, 0.40)
    floor = _diffuse(0.62, 0.57, 0.50)
    (p0, p1), (q0, q1) = _POOL_X, _POOL_Z
    return {
        "back": _rectangle((x0, y0, z0), (width, 0, 0), (0, height, 0), wall),
        "front": _rectangle((x1, y0, z1), (-width, 0, 0), (0, height, 0), ceiling),
        "left": _rectangle((x0, y0, z1), (0, 0, -depth), (0, height, 0), side),
        "right": _rectangle((x1, y0, z0), (0, 0, depth), (0, height, 0), side),
        "ceiling": _rectangle((x0, y1, z0), (width, 0, 0), (0, 0, depth), ceiling),
        # The floor surrounds the pool.
        "floor-back": _rectangle((x0, y0, q0), (width, 0, 0), (0, 0, z0 - q0), floor),
        "floor-front": _rectangle((x0, y0, z1), (width, 0, 0), (0, 0, q1 - z1), floor),
        "floor-left": _rectangle((x0, y0, q1), (p0 - x0, 0, 0), (0, 0, q0 - q1), floor),
        "floor-right": _rectangle((p1, y0, q1), (x1 - p1, 0, 0), (0, 0, q0 - q1), floor),
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
                "color0": _rgb(0.20, 0.55, 0.60),
                "color1": _rgb(0.60, 0.78, 0.76),
                "to_uv": mi.ScalarTransform4f().scale([4, 4, 1]),
            },
        },
    }
    rim = _diffuse(0.40, 0.60, 0.62)
    # The water ends inside the walls of the basin, which close its volume.
    sheet = height_field(_ripples, (p0 - 0.01, p1 + 0.01), (q0 - 0.01, q1 + 0.01), (110, 100))
    water = {"type": "dielectric", "int_ior": "water", "ext_ior": "air"}
    return {
        "pool-bottom": _rectangle((p0, bottom, q1), (width, 0, 0), (0, 0, -length), tiles),
        "pool-back": _rectangle((p0, bottom, q0), (width, 0, 0), (0, _POOL_DEPTH, 0), rim),
        "pool-front": _rectangle((p1, bottom, q1), (-width, 0, 0), (0, _POOL_DEPTH, 0), rim),
        "pool-left": _rectangle((p0, bottom, q1), (0, 0, -length), (0, _POOL_DEPTH, 0), rim),
        "pool-right": _rectangle((p1, bottom, q0), (0, 0, length), (0, _POOL_DEPTH, 0), rim),
        "water": MeshDescription("water", *sheet[:2], water, sheet[2]),
    }


def _lamp() -> dict[str, Any]:
    """A small glowing ball in a hollow glass ball, hanging from a cord."""

    x, y, z = _LAMP
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    hollow = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}
    brass = {"type": "roughconductor", "material": "Cu", "distribution": "ggx", "alpha": 0.2}
    top = y + _BULB_RADIUS
    cap = np.array([[0.0, 0.0], [0.09, 0.0], [0.12, 0.05], [0.1, 0.16], [0.04, 0.22], [0.0, 0.22]])
    points, faces, normals = lathe(smooth(cap, 6, closed=False), 48, closed=False)
    points = points + np.array([x, top + _GAP, z])
    return {
        "lamp": {
            "type": "sphere",
            "center": [x, y, z],
            "radius": _LAMP_RADIUS,
            "bsdf": {"type": "diffuse", "reflectance": _rgb(0.0, 0.0, 0.0)},
            "emitter": {"type": "area", "radiance": _rgb(6400.0, 4800.0, 3100.0)},
        },
        "bulb": {"type": "sphere", "center": [x, y, z], "radius": _BULB_RADIUS, "bsdf": glass},
        "bulb-inside": {"type": "sphere", "center": [x, y, z], "radius": _BULB_RADIUS - _BULB_WALL, "bsdf": hollow},
        "socket": MeshDescription("socket", points, faces, brass, normals),
        "cord": {
            "type": "cylinder",
            "p0": [x, top + 0.2, z],
            "p1": [x, _ROOM[1][1], z],
            "radius": 0.012,
            "bsdf": _diffuse(0.05, 0.05, 0.05),
        },
    }


def _still_life() -> dict[str, Any]:
    return {
        "ball": {
            "type": "sphere",
            "center": [0.25, 0.62 + _GAP, 0.55],
            "radius": 0.62,
            "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
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
    amber = {
        "type": "dielectric",
        "int_ior": 1.5,
        "ext_ior": 1.0,
        "specular_transmittance": _rgb(0.98, 0.80, 0.48),
    }
    return MeshDescription("vase", points, faces, amber, normals)


def _stone() -> MeshDescription:
    points, faces = brilliant(0.42, 0.3, 0.36, 9)
    points = points + np.array([0.6, _GAP, 2.45])
    sapphire = {
        "type": "dielectric",
        "int_ior": 1.77,
        "ext_ior": 1.0,
        "specular_transmittance": _rgb(0.62, 0.84, 0.97),
    }
    return MeshDescription("stone", points, faces, sapphire)
