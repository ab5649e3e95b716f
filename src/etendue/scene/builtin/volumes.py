"""Scenes of participating media: a spot light through fog and a glass ball, sunlight in water, smoke over a bulb."""

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
#: Centre and radius of the bulb of ``smoke``; ranges of x, y and z of the smoke, and its points per unit of length.
_BULB, _GLASS = (0.0, 0.55, 0.0), 0.3
_PLUME, _FINENESS = ((-0.8, 0.8), (0.9, 2.75), (-0.8, 0.8)), 40


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


def _plume() -> Points:
    """Density of smoke that rises and widens, (z, y, x, 1): a cone of a noise whose spectrum falls with the frequency,
    around a centre that sways."""
    x, y, z = (np.linspace(low, high, round(_FINENESS * (high - low))) for low, high in _PLUME)
    z, y, x = np.meshgrid(z, (y - y[0]) / (y[-1] - y[0]), x, indexing="ij")
    frequencies = np.meshgrid(*(_FINENESS * np.fft.fftfreq(n) for n in x.shape), indexing="ij")
    across = np.sqrt(frequencies[0] ** 2 + 0.3 * frequencies[1] ** 2 + frequencies[2] ** 2)
    white = np.fft.fftn(np.random.default_rng(3).standard_normal(x.shape))
    noise = np.real(np.fft.ifftn(white / (1.0 + across) ** 2.0))
    noise /= noise.std()
    sway = 0.16 * y * np.sin(5.0 * y + 0.6), 0.14 * y * np.sin(4.0 * y + 2.2)
    radius = np.hypot(x - sway[0], z - sway[1]) / (0.07 + 0.33 * y)
    density = np.exp(-(radius**2)) * (0.6 + 0.6 * noise) - 0.1
    # Nothing at the faces of the grid, so that they are not seen.
    inside = np.minimum(1.0, 12.0 * np.minimum(y, 1.0 - y)) * (np.maximum(np.abs(x), np.abs(z)) < 0.78)
    return (np.clip(density, 0.0, 1.5) * inside)[..., None]


def smoke() -> dict[str, Any]:
    """Smoke above a bulb of clear glass, the only lamp: its light reaches the smoke and the walls through the glass.
    512x384."""
    import mitsuba as mi

    low, high = np.array(_PLUME).T
    place = mi.ScalarTransform4f().translate(list(low)).scale(list(high - low))
    box = mi.ScalarTransform4f().translate(list(0.5 * (low + high))).scale(list(0.5 * (high - low)))
    sides = walls((-1.9, 1.9), (0.0, 3.0), (-1.6, 3.6), matt(0.17, 0.15, 0.13), back=matt(0.07, 0.09, 0.13))
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 24},
        "plume": {
            "type": "heterogeneous",
            "sigma_t": {"type": "gridvolume", "grid": mi.VolumeGrid(_plume().astype(np.float32)), "to_world": place},
            "scale": 14.0,
            "albedo": rgb(0.93, 0.93, 0.95),
            "phase": {"type": "hg", "g": 0.4},
        },
        "sensor": camera((0.0, 1.35, 3.3), (0.0, 1.32, 0.0), 48.0, (512, 384)),
        **sides,
        "table": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0, 0.09, 0]).scale([0.8, 0.09, 0.5]),
            "bsdf": matt(0.42, 0.27, 0.17),
        },
        "socket": {
            "type": "cylinder",
            "p0": [0, 0.18, 0],
            "p1": [0, 0.28, 0],
            "radius": 0.13,
            "bsdf": {"type": "twosided", "bsdf": matt(0.25, 0.25, 0.25)},
        },
        "filament": {
            "type": "sphere",
            "center": list(_BULB),
            "radius": 0.035,
            "bsdf": matt(0.0, 0.0, 0.0),
            "emitter": {"type": "area", "radiance": rgb(2200.0, 1650.0, 1000.0)},
        },
        "glass": {"type": "sphere", "center": list(_BULB), "radius": _GLASS, "bsdf": glass()},
        "hollow": {
            "type": "sphere",
            "center": list(_BULB),
            "radius": 0.93 * _GLASS,
            "bsdf": glass(1.0, outside=1.5),
        },
        "boundary": {
            "type": "cube",
            "to_world": box,
            "bsdf": {"type": "null"},
            "interior": {"type": "ref", "id": "plume"},
        },
    }
