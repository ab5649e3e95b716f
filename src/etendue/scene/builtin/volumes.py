"""Scenes of participating media: a spot light through fog and a glass ball, and sunlight in water."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..meshes import Faces, MeshDescription, Points, brilliant, height_field
from .pieces import camera, glass, matt, rectangle, rgb, walls

#: Inside of the room of ``fog``: ranges of x, y and z; and its spot light, and what it is aimed at.
_ROOM = ((-2.2, 2.2), (0.0, 2.8), (-2.2, 3.4))
_SPOT, _BALL, _RADIUS = (-1.55, 2.55, -0.5), (0.1, 1.15, -0.2), 0.36
#: The tank of ``aquarium``: half its width, its depth from front to back, and the level of the water.
_WIDTH, _DEPTH, _LEVEL = 1.6, 1.8, 1.7


def fog() -> dict[str, Any]:
    """A spot light in a foggy room: a glass ball focuses its beam, in the air and on the floor. 512x384."""
    import mitsuba as mi

    medium: dict[str, Any] = {"type": "ref", "id": "fog"}
    sides = walls(
        *_ROOM,
        matt(0.36, 0.24, 0.17),
        back=matt(0.22, 0.27, 0.33),
        front=matt(0.3, 0.3, 0.3),
        ceiling=matt(0.4, 0.4, 0.4),
    )
    plinth = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([1.15, 0.3, 0.2]).scale([0.3, 0.3, 0.3])}
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 24},
        "fog": {"type": "homogeneous", "sigma_t": 0.3, "albedo": 0.96, "phase": {"type": "hg", "g": 0.3}},
        "sensor": camera((0.0, 1.3, 3.3), (0.05, 1.2, -0.4), 58.0, (512, 384)) | {"medium": medium},
        **{name: wall | {"exterior": medium} for name, wall in sides.items()},
        "spot": {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at(list(_SPOT), list(_BALL), [0, 1, 0]),
            "intensity": rgb(240.0, 215.0, 180.0),
            "cutoff_angle": 11.0,
            "beam_width": 9.0,
        },
        "ball": {"type": "sphere", "center": list(_BALL), "radius": _RADIUS, "bsdf": glass(), "exterior": medium},
        "plinth": plinth | {"bsdf": matt(0.6, 0.57, 0.5), "exterior": medium},
        "moon": {
            "type": "sphere",
            "center": [-1.05, 0.32, 0.1],
            "radius": 0.3,
            "bsdf": matt(0.55, 0.5, 0.46),
            "exterior": medium,
        },
    }


def _waves(x: Points, z: Points) -> Points:
    """Water level: three trains of waves."""
    level = np.full_like(x, _LEVEL)
    for kx, kz, phase, height in ((7.0, 3.0, 0.3, 0.012), (-4.0, 9.0, 1.7, 0.009), (12.0, -8.0, 4.0, 0.004)):
        level += height * np.sin(kx * x + kz * z + phase)
    return level


def _body() -> tuple[Points, Faces, Points]:
    """Surface and front of the water, which meet along a wave."""
    (cells, rows), front = (160, 100), 0.5 * _DEPTH
    points, faces, normals = height_field(_waves, (-_WIDTH, _WIDTH), (-front, front), (cells, rows))
    crest = points[points[:, 2] == front]
    foot = crest * np.array([1.0, 0.0, 1.0])
    n = np.arange(cells) + len(points)
    up = n + len(foot)
    pane = np.concatenate([np.stack([n, n + 1, up + 1], -1), np.stack([n, up + 1, up], -1)])
    facing = np.tile([0.0, 0.0, 1.0], (2 * len(foot), 1))
    return np.concatenate([points, foot, crest]), np.concatenate([faces, pane]), np.concatenate([normals, facing])


def aquarium() -> dict[str, Any]:
    """A tank of green water under the sun, seen through its front: the waves focus sunlight into beams. 512x384."""
    water: dict[str, Any] = {"type": "ref", "id": "water"}
    surface = {"type": "dielectric", "int_ior": "water", "ext_ior": "air"}
    width, front, back, level = _WIDTH, 0.5 * _DEPTH, -0.5 * _DEPTH, _LEVEL
    points, faces, normals = _body()
    sand, wall = matt(0.62, 0.55, 0.40), matt(0.20, 0.30, 0.32)
    up = (0, level + 0.1, 0)
    stone, facets = brilliant(0.34, 0.28, 0.3, 7)
    bubbles = {
        f"bubble-{n}": {
            "type": "sphere",
            "center": [x, y, z],
            "radius": radius,
            "bsdf": {"type": "dielectric", "int_ior": "air", "ext_ior": "water"},
            "exterior": water,
        }
        for n, (x, y, z, radius) in enumerate(
            ((0.75, 0.35, 0.2, 0.05), (0.82, 0.62, 0.15, 0.07), (0.72, 0.95, 0.25, 0.06), (0.8, 1.3, 0.18, 0.09))
        )
    }
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 24},
        "water": {
            "type": "homogeneous",
            "sigma_t": rgb(0.9, 0.5, 0.55),
            "scale": 0.5,
            "albedo": rgb(0.4, 0.9, 0.85),
            "phase": {"type": "hg", "g": 0.5},
        },
        "sensor": camera((0.0, 1.05, 4.4), (0.0, 0.9, 0.0), 36.0, (512, 384)),
        "sun": {"type": "directional", "direction": [0.35, -1.0, 0.1], "irradiance": rgb(20.0, 18.5, 15.0)},
        "sky": {"type": "constant", "radiance": rgb(0.25, 0.32, 0.42)},
        "bottom": rectangle((-width, 0, front), (2 * width, 0, 0), (0, 0, -_DEPTH), sand),
        "back": rectangle((-width, 0, back), (2 * width, 0, 0), up, wall),
        "left": rectangle((-width, 0, front), (0, 0, -_DEPTH), up, wall),
        "right": rectangle((width, 0, back), (0, 0, _DEPTH), up, wall),
        "surface": MeshDescription("surface", points, faces, surface, normals, interior="water"),
        "ball": {"type": "sphere", "center": [-0.55, 0.42, 0.1], "radius": 0.4, "bsdf": matt(0.75, 0.30, 0.16)},
        "stone": MeshDescription("stone", stone + np.array([0.15, 0.01, 0.35]), facets, matt(0.5, 0.5, 0.46)),
        **bubbles,
    }
