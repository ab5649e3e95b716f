"""Scenes of dispersion: a prism in a sheet of sunlight, cut stones under small lamps. They need a spectral variant."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..meshes import Faces, MeshDescription, Points, brilliant
from .pieces import camera, lamp, matt, rectangle, rgb

#: Side and height of the prism; its glass; angle of incidence at which light crosses it parallel to its base.
_SIDE, _HEIGHT, _GLASS, _INCIDENCE = 1.0, 0.7, "n-sf11", math.radians(63.2)
#: The sheet of light: width of its slit, height, length before the prism, and by how much it falls on this length.
_SLIT, _SHEET, _AWAY, _FALL = 0.02, 0.5, 1.9, 0.22
#: Distance of the screen from the prism.
_SCREEN = 2.1


def _prism() -> tuple[Points, Faces]:
    """A prism that stands on the floor, on a base of three equal sides, one edge at the back."""
    third = _SIDE * math.sqrt(3.0) / 6.0
    corners = np.array([[0.0, -2.0 * third], [-0.5 * _SIDE, third], [0.5 * _SIDE, third]])
    low, high = (np.insert(corners, 1, y, axis=1) for y in (0.002, _HEIGHT))
    sides = [face for i in range(3) for j in [(i + 1) % 3] for face in ([i, j, j + 3], [i, j + 3, i + 3])]
    return np.concatenate([low, high]), np.array([*sides, [0, 2, 1], [3, 4, 5]])


def prism() -> dict[str, Any]:
    """A sheet of white light in a dark room: a prism fans it out over the floor and a screen. 512x384."""
    import mitsuba as mi

    way = math.radians(30.0) - _INCIDENCE  # of the light before the prism, from the x axis to z
    along, across = np.array([math.cos(way), 0.0, math.sin(way)]), np.array([-math.sin(way), 0.0, math.cos(way)])
    met = np.array([-0.25 * _SIDE, 0.0, -_SIDE * math.sqrt(3.0) / 12.0])
    slit = met - _AWAY * along + np.array([0.0, 0.5 * _SHEET + 0.02, 0.0])
    ahead = along - np.array([0.0, _FALL / _AWAY, 0.0])
    ahead /= np.linalg.norm(ahead)
    sheet = np.eye(4)
    sheet[:3, 0], sheet[:3, 1] = 0.5 * _SLIT * across, 0.5 * _SHEET * np.cross(ahead, across)
    sheet[:3, 2], sheet[:3, 3] = ahead, slit + np.array([0.0, 0.5 * _FALL, 0.0])
    out = np.array([along[0], 0.0, -along[2]])
    side = np.array([-out[2], 0.0, out[0]])
    foot = np.array([0.25 * _SIDE, 0.0, met[2]]) + _SCREEN * out
    points, faces = _prism()
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 12},
        "sensor": camera((-0.75, 1.75, 3.5), (0.95, 0.12, 0.35), 50.0, (512, 384)),
        "floor": rectangle((-4.0, 0.0, 4.0), (9.0, 0, 0), (0, 0, -8.0), matt(0.5, 0.5, 0.5)),
        "screen": rectangle(foot - 0.9 * side, 1.8 * side, (0, 0.7, 0), matt(0.8, 0.8, 0.8)),
        "prism": MeshDescription("prism", points, faces, {"type": "dispersive", "int_ior": _GLASS}),
        "light": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(sheet),
            "bsdf": matt(0.0, 0.0, 0.0),
            "emitter": {"type": "directionalarea", "radiance": {"type": "d65", "scale": 400.0}},
        },
        "dusk": {"type": "constant", "radiance": rgb(0.2, 0.21, 0.23)},
    }


def diamond() -> dict[str, Any]:
    """A diamond and two stones of glass and sapphire on dark slate, under seven small lamps. 512x384."""
    stone, facets = brilliant(0.5, 0.24, 0.36, 8)
    stones = {
        "diamond": ("diamond", 1.0, (0.0, 0.0, 0.1)),
        "sapphire": ("sapphire", 0.62, (-1.0, 0.0, -0.45)),
        "flint": ("n-sf11", 0.62, (0.95, 0.0, -0.5)),
    }
    lamps = {
        f"lamp-{n}": lamp((2.2 * math.cos(t), 2.6 + 0.3 * (n % 2), 0.3 + 1.6 * math.sin(t)), 0.12, 90.0, 86.0, 80.0)
        for n, t in enumerate(np.linspace(0.3, 2.0 * math.pi, 7, endpoint=False))
    }
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 24},
        "sensor": camera((0.0, 1.75, 3.1), (0.0, 0.22, -0.05), 36.0, (512, 384)),
        "slate": rectangle((-6.0, 0.0, 6.0), (12.0, 0, 0), (0, 0, -12.0), matt(0.14, 0.14, 0.15)),
        **{
            name: MeshDescription(
                name, scale * stone + np.array(place) + np.array([0.0, 0.003, 0.0]), facets, _gem(material)
            )
            for name, (material, scale, place) in stones.items()
        },
        **lamps,
        "room": {"type": "constant", "radiance": rgb(0.05, 0.055, 0.065)},
    }


def _gem(material: str) -> dict[str, Any]:
    return {"type": "dispersive", "int_ior": material}
