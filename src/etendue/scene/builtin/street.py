"""A street at night among 1,024 lamps, most of which are hidden by houses.

Blocks of four houses stand in rows, each row shifted by half a block, so that a street ends at a house after one block.
Sixteen lanterns hang on the walls of a block; they are one mesh and one light. The camera stands in the middle and sees
light of a few blocks only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..meshes import MeshDescription, cuboids
from .pieces import box, camera, diffuse, rgb

Array = NDArray[np.float64]

#: Blocks a side, side of a block with and without its street, and height of the lanterns, in metres.
_BLOCKS, _PITCH, _SIDE, _LANTERN = 8, 24.0, 17.0, 3.1
#: Lanterns on a side of a block, distance from the wall, half the width and the height of their glass.
_PER_SIDE, _BRACKET, _HALF_GLASS, _GLASS = 4, 0.34, 0.13, 0.36
_WALLS = ((0.42, 0.30, 0.22), (0.50, 0.46, 0.38), (0.36, 0.38, 0.42), (0.48, 0.27, 0.20))
_COLOURS = ((300.0, 168.0, 62.0), (260.0, 205.0, 130.0), (170.0, 195.0, 235.0))
_SEED = 7


def street() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary, 512x384."""
    import mitsuba as mi

    random = np.random.default_rng(_SEED)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 10},
        "sensor": camera((0.4, 1.65, 17.0), (-0.1, 1.75, 0.0), 62.0),
        "road": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(0.75 * _BLOCKS * _PITCH),
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.06, 0.06, 0.065), "alpha": 0.12},
        },
    }
    centres = _centres()
    corners = centres[:, None, :] + 0.25 * _SIDE * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    heights = random.uniform(7.0, 13.0, corners.shape[:2])
    wall = random.integers(len(_WALLS), size=heights.shape)
    for number, colour in enumerate(_WALLS):
        at, high = corners[wall == number], heights[wall == number]
        lower = np.stack([at[:, 0] - _SIDE / 4, np.zeros(len(at)), at[:, 1] - _SIDE / 4], -1)
        upper = np.stack([at[:, 0] + _SIDE / 4, high, at[:, 1] + _SIDE / 4], -1)
        scene[f"houses{number}"] = MeshDescription(f"houses{number}", *cuboids(lower, upper), diffuse(*colour))
    pavement = np.stack([centres[:, 0], np.zeros(len(centres)), centres[:, 1]], -1)
    half = np.array([_SIDE / 2 + 1.1, 0.12, _SIDE / 2 + 1.1])
    scene["pavements"] = MeshDescription(
        "pavements", *cuboids(pavement - half, pavement + half), {"type": "twosided", "bsdf": diffuse(0.3, 0.29, 0.27)}
    )
    scene |= _facades(centres)
    for number, centre in enumerate(centres):
        light = rgb(*_COLOURS[random.integers(len(_COLOURS))])
        lantern = MeshDescription(f"lanterns{number}", *_lanterns(centre), diffuse(0.1, 0.1, 0.1), emitter=light)
        scene[f"lanterns{number}"] = lantern
    return scene | _things()


def _centres() -> Array:
    """Centres (x, z) of the blocks; the street in the middle of two rows is at x = 0."""
    i, j = np.meshgrid(np.arange(_BLOCKS), np.arange(_BLOCKS), indexing="ij")
    x = (i - 0.5 * (_BLOCKS - 1)) * _PITCH + np.where(j % 2 == 0, 0.0, 0.5 * _PITCH)
    return np.stack([x.ravel(), (j.ravel() - 0.5 * (_BLOCKS - 1)) * _PITCH], -1)


def _around(distance: float, count: int) -> tuple[Array, Array]:
    """Evenly spaced points along the sides of a block at a distance from its walls, and the outward directions, both
    (4 count, 2)."""
    along = (np.arange(count) + 0.5) / count - 0.5
    points, outward = [], []
    for turn in range(4):
        cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[turn]
        u, v = along * _SIDE, np.full(count, _SIDE / 2 + distance)
        points.append(np.stack([cos * u - sin * v, sin * u + cos * v], -1))
        outward.append(np.broadcast_to([-sin, cos], (count, 2)).astype(np.float64))
    return np.concatenate(points), np.concatenate(outward)


def _lanterns(centre: Array) -> tuple[Array, NDArray[np.int64]]:
    """The glowing glass of a block's lanterns: four-sided pyramids, tip down."""
    at, _ = _around(_BRACKET, _PER_SIDE)
    at = at + centre
    corners = _HALF_GLASS * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    points: list[Any] = []
    faces: list[Any] = []
    for x, z in at:
        first = 5 * len(points)
        ring = [(x + dx, _LANTERN, z + dz) for dx, dz in corners]
        points.append([*ring, (x, _LANTERN - _GLASS, z)])
        faces += [(first + k, first + (k + 1) % 4, first + 4) for k in range(4)]
    return np.array(points).reshape(-1, 3), np.array(faces)


def _facades(centres: Array) -> dict[str, Any]:
    """Windows, and the lids and brackets of the lanterns."""
    panes: list[tuple[Array, Array]] = []
    at, outward = _around(0.0, 8)
    for low in (1.1, 4.2):
        for (x, z), (dx, dz) in zip(at, outward, strict=True):
            middle = np.array([x, low + 0.7, z])
            half = np.array([0.5 * abs(dz) + 0.02 * abs(dx), 0.7, 0.5 * abs(dx) + 0.02 * abs(dz)])
            panes.append((middle - half, middle + half))
    at, outward = _around(_BRACKET, _PER_SIDE)
    iron: list[tuple[Array, Array]] = []
    for (x, z), (dx, dz) in zip(at, outward, strict=True):
        lid, half = np.array([x, _LANTERN + 0.05, z]), np.array([_HALF_GLASS + 0.05, 0.03, _HALF_GLASS + 0.05])
        iron.append((lid - half, lid + half))
        arm = np.array([x - 0.5 * dx * _BRACKET, _LANTERN + 0.11, z - 0.5 * dz * _BRACKET])
        half = np.array([0.5 * _BRACKET * abs(dx) + 0.025, 0.025, 0.5 * _BRACKET * abs(dz) + 0.025])
        iron.append((arm - half, arm + half))
    offsets = np.stack([centres[:, 0], np.zeros(len(centres)), centres[:, 1]], -1)
    result = {}
    glass = {"type": "plastic", "diffuse_reflectance": rgb(0.02, 0.025, 0.03)}
    for name, parts, bsdf in (("windows", panes, glass), ("iron", iron, diffuse(0.05, 0.05, 0.05))):
        lower, upper = (np.array([part[k] for part in parts]) for k in (0, 1))
        lower, upper = ((offsets[:, None] + corner).reshape(-1, 3) for corner in (lower, upper))
        result[name] = MeshDescription(name, *cuboids(lower, upper), bsdf)
    return result


def _things() -> dict[str, Any]:
    """The objects in the street that the camera sees."""
    body = np.array([[[-2.3, 0.3, 7.4], [-0.7, 0.85, 11.4]], [[-2.2, 0.85, 8.2], [-0.8, 1.4, 10.5]]])
    wheels: dict[str, Any] = {
        f"wheel{k}": {
            "type": "cylinder",
            "p0": [x - 0.1, 0.31, z],
            "p1": [x + 0.1, 0.31, z],
            "radius": 0.3,
            "bsdf": {"type": "twosided", "bsdf": diffuse(0.03, 0.03, 0.03)},
        }
        for k, (x, z) in enumerate(((-2.2, 8.3), (-0.8, 8.3), (-2.2, 10.6), (-0.8, 10.6)))
    }
    lacquer = {"type": "roughplastic", "diffuse_reflectance": rgb(0.35, 0.03, 0.03), "alpha": 0.06}
    ball = {"type": "roughconductor", "material": "Cu", "alpha": 0.08}
    return wheels | {
        "car": MeshDescription("car", *cuboids(body[:, 0], body[:, 1]), lacquer),
        "plinth": box((1.7, 0.5, 8.0), (0.8, 1.0, 0.8), diffuse(0.4, 0.4, 0.38)),
        "ball": {"type": "sphere", "center": [1.7, 1.451, 8.0], "radius": 0.45, "bsdf": ball},
    }
