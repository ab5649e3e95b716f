"""Bathroom: tiles, a wash basin with a chrome tap, a mirror, a glass shelf, and the sun through the window.

The sun is a focused light outside the window, the sky a frosted pane in the ceiling, and a small lamp burns in a glass
tube over the mirror. Mirror, chrome, glass and the water in the basin throw the sun on the tiles around them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...meshes import lathe
from ..pieces import Array, Vector, diffuse, glass, glazed, lamp, matt, metal, mirror, palette, rectangle, rgb, walls
from ..solids import GAP, Model, about, ball, box, cushion, inside_out, smooth_normals, stretched, tube, turned
from .furniture import view

#: Inside of the room: half its width, its height, z of the wall with the basin and of the one behind the camera.
_HALF, _HEIGHT, _BACK, _FRONT = 1.5, 2.5, 0.0, 3.4
#: The window in the left wall: z and y from and to, and the thickness of the wall.
_WINDOW_Z, _WINDOW_Y, _WALL = (0.75, 1.75), (1.0, 2.15), 0.14
#: Middle of the basin's rim.
_BASIN: Vector = (0.12, 0.86, 0.36)
_TILE, _GROUT = 0.15, 0.004


def bathroom() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 260 000 triangles."""
    model = Model(
        {
            **palette(
                glazed, "tile .62 .66 .66, tile-blue .10 .24 .32, floor-light .60 .58 .54, floor-dark .10 .11 .12"
            ),
            **palette(glazed, "china .80 .80 .78, soap .72 .60 .30"),
            **palette(matt, "paint .78 .77 .74, wood .44 .29 .17, pale-wood .52 .37 .23, towel .66 .22 .14"),
            **palette(glass, "glass 1.5, water 1.33, green 1.5 .45 .85 .62, amber 1.5 .97 .68 .30"),
            "chrome": metal("Cr"),
            "mirror": mirror(),
        }
    )
    for part in (_tiles, _basin, _tap, _over_the_basin, _shelf, _window, _details):
        part(model)
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((0.62, 1.5, 2.75), (-0.02, 1.12, 0.0), 52.0),
        **_room(),
        **_lights(),
        **model.shapes(),
    }


def _tiles(model: Model) -> None:
    """Tiles with round edges on the wall of the basin and on the right one, up to a blue row; on the floor, in two
    colours. None lies quite even."""
    rng = np.random.default_rng(7)
    tile = box((_TILE - _GROUT, _TILE - _GROUT, 0.012), 0.0025, 1)

    def lay(material: str, at: Vector, turn: Array) -> None:
        tilt = about(0, rng.normal(0.0, 0.12)) @ about(1, rng.normal(0.0, 0.12))
        model.add(material, tile, at, turn @ tilt)

    across, along = round(2 * _HALF / _TILE), round((_FRONT - _BACK) / _TILE)
    for row in range(10):
        y, material = (row + 0.5) * _TILE, "tile-blue" if row == 8 else "tile"
        for k in range(across):
            lay(material, (-_HALF + (k + 0.5) * _TILE, y, _BACK), np.eye(3))
        for k in range(along):
            lay(material, (_HALF, y, _BACK + (k + 0.5) * _TILE), about(1, -90))
    for i in range(across):
        for k in range(along):
            at = (-_HALF + (i + 0.5) * _TILE, 0.0, _BACK + (k + 0.5) * _TILE)
            lay("floor-dark" if (i + k) % 2 else "floor-light", at, about(0, -90))


def _basin(model: Model) -> None:
    """A round basin on a wooden board with legs, with water in it that ends inside the china."""
    x, y, z = _BASIN
    china = "0,-14 10,-14 17,-10 22,0 23.2,.6 22.8,1.2 21.4,.6 16,-8.5 10,-11.8 2.5,-12.2 0,-12.2"
    model.add("china", turned(china, 128, 8), _BASIN)
    model.add("wood", box((1.25, 0.04, 0.5), 0.006), (x + 0.02, y - 0.162, z - 0.06))
    for side in (-1, 1):
        for depth in (-0.24, 0.12):
            model.add("chrome", turned("0,0 1.4,0 1.4,69 0,69", 24), (x + 0.56 * side, 0.0065, z + depth))
    model.add("wood", box((1.2, 0.02, 0.44), 0.004), (x + 0.02, 0.24, z - 0.06))
    for k, (at, colour) in enumerate(((-0.4, "towel"), (-0.05, "paint"), (0.36, "towel"))):
        for level in range(3 - k % 2):
            folded = cushion((0.3, 0.055, 0.3), 0.024, 0.008, 6)
            model.add(colour, folded, (x + at, 0.25 + GAP + 0.0365 + 0.062 * level, z - 0.05))
    model.add("water", _ripples(), _BASIN)


def _ripples() -> tuple[Array, Any, Array]:
    """A round sheet of water, with rings where a drop fell."""
    points, faces, _ = lathe(np.stack([np.linspace(0.183, 0, 61), np.zeros(61)], -1), 120, closed=False)
    d = np.hypot(points[:, 0] - 0.03, points[:, 2] + 0.05)
    points[:, 1] = -0.045 + 0.0022 * np.cos(2 * np.pi * d / 0.04) * np.exp(-6.0 * d)
    return points, faces, smooth_normals(points, faces)


def _tap(model: Model) -> None:
    """A chrome tap behind the basin: a pipe that bends over, and a lever."""
    x, y, z = _BASIN[0], _BASIN[1] - 0.14 + GAP, _BASIN[2] - 0.255
    model.add("chrome", turned("0,0 3,0 3,1 2,1.6 2,10 0,10"), (x, y, z))
    angle = np.linspace(0.0, 1.15 * np.pi, 40)
    bend = np.stack([np.zeros(40), 0.3 + 0.075 * np.sin(angle), 0.075 * (1 - np.cos(angle))], -1)
    rise = np.stack([np.zeros(8), np.linspace(0.08, 0.29, 8), np.zeros(8)], -1)
    model.add("chrome", tube(np.concatenate([rise, bend]), 0.0125, 28), (x, y, z))
    model.add("chrome", tube([[0, 0.06, 0], [0.04, 0.065, 0], [0.09, 0.085, 0.01]], 0.006, 16), (x, y, z))
    model.add("chrome", ball(0.009, 24, 12), (x + 0.09, y + 0.085, z + 0.01))


def _over_the_basin(model: Model) -> None:
    """The mirror with a chrome rim, and the lamp's glass tube over it."""
    x, y, z = _BASIN[0], 1.52, _BACK + 0.17
    model.add("mirror", box((0.9, 0.72, 0.008), 0.003, 2), (x, y, _BACK + 0.03))
    across = about(2, 90)
    glass_tube = turned("0,-17 3,-17 3.4,-16 3.4,16 3,17 0,17", 64, 8)
    model.add("glass", glass_tube, (x, 1.99, z), across)
    model.add("glass", stretched(inside_out(glass_tube), 0.9, 0.97, 0.9), (x, 1.99, z), across)
    for side in (-1, 1):
        model.add("chrome", box((0.014, 0.75, 0.03), 0.004), (x + 0.458 * side, y, _BACK + 0.03))
        model.add("chrome", box((0.93, 0.014, 0.03), 0.004), (x, y + 0.368 * side, _BACK + 0.03))
        model.add("chrome", turned("0,0 4,0 4,3 0,3"), (x + side * 0.186 + 0.015, 1.99, z), across)
        model.add("chrome", box((0.02, 0.02, 0.15), 0.003), (x + 0.186 * side, 1.99, _BACK + 0.08))


def _shelf(model: Model) -> None:
    """A glass shelf under the mirror with bottles and a tumbler."""
    x, y, z = _BASIN[0], 1.1, _BACK + 0.09
    model.add("green", box((0.95, 0.01, 0.13), 0.003), (x, y, z))
    for side in (-1, 1):
        model.add("chrome", ball(0.012, 32, 16), (x + 0.4 * side, y - 0.018, z - 0.05))
    y += 0.005 + GAP
    bottle = turned("0,0 3,0 3.4,1 3.4,10 1.2,12.5 1.2,15 .9,15 .9,12.5 3,10 3,1.4 0,1", 72, 5)
    model.add("amber", bottle, (x - 0.36, y, z))
    model.add("green", stretched(bottle, 0.85, 0.8, 0.85), (x - 0.27, y, z + 0.01))
    model.add("glass", turned("0,0 3,0 3.3,.6 3.7,9 3.4,9 3,1.2 0,1.1", 72), (x + 0.34, y, z))
    model.add("glass", ball(0.032, 72, 36), (x + 0.22, y + 0.032, z + 0.01))
    for lean, colour in ((-9.0, "towel"), (11.0, "soap")):
        handle = tube([[0, 0.0, 0], [0, 0.08, 0], [0, 0.165, 0]], 0.0035, 12)
        model.add(colour, handle, (x + 0.34, y + 0.013, z), about(2, lean))
    dish = cushion((0.09, 0.03, 0.06), 0.012, 0.004, 6)
    model.add("soap", dish, (_BASIN[0] + 0.38, _BASIN[1] - 0.142 + 0.019 + GAP, _BASIN[2]), about(1, 25))


def _window(model: Model) -> None:
    """Frame and bars of the window, a sill with a vase and a ball."""
    (z0, z1), (y0, y1) = _WINDOW_Z, _WINDOW_Y
    x, y, z = -_HALF - _WALL / 2, (y0 + y1) / 2, (z0 + z1) / 2
    for edge in (z0 + 0.025, z, z1 - 0.025):
        model.add("paint", box((0.05, y1 - y0 - 2 * GAP, 0.05), 0.006), (x, y, edge))
    for edge in (y0 + 0.025 + GAP, y, y1 - 0.025 - GAP):
        model.add("paint", box((0.045, 0.05, z1 - z0 - 2 * GAP), 0.006), (x, edge, z))
    model.add("paint", box((0.2, 0.03, z1 - z0 + 0.1), 0.006), (-_HALF + 0.03, y0 - 0.016, z))
    vase = turned("0,0 3.5,0 5,6 2,14 3,18 2.6,18 1.5,14 4,6 0,1.5", 72)
    model.add("green", vase, (-_HALF + 0.06, y0 + GAP, z0 + 0.3))
    model.add("glass", ball(0.06), (-_HALF + 0.06, y0 + 0.06 + GAP, z1 - 0.33))


def _details(model: Model) -> None:
    """A towel on a rail at the right wall; opposite the mirror a door and shelves, which it shows."""
    model.add("wood", box((0.82, 2.0, 0.05), 0.006), (-0.55, 1.0, _FRONT - 0.026))
    for y in (0.62, 1.5):
        model.add("pale-wood", box((0.56, 0.68, 0.02), 0.008), (-0.55, y, _FRONT - 0.056))
    model.add("chrome", ball(0.03, 48, 24), (-0.24, 1.02, _FRONT - 0.09))
    jar = turned("0,0 6,0 7,2 7,14 4.5,17 5,21 0,21", 48, 4)
    for y in (1.25, 1.65, 2.05):
        model.add("wood", box((0.8, 0.025, 0.24), 0.004), (0.7, y, _FRONT - 0.121))
        for k in range(4):
            colour = ("china", "towel", "tile-blue", "soap")[(k + round(10 * y)) % 4]
            model.add(colour, jar, (0.43 + 0.18 * k, y + 0.0125 + GAP, _FRONT - 0.12))
    x = _HALF - 0.07
    model.add("chrome", tube([[x, 1.15, 0.5], [x, 1.15, 0.8], [x, 1.15, 1.1]], 0.01))
    for z in (0.52, 1.08):
        model.add("chrome", box((0.08, 0.02, 0.02), 0.004), (_HALF - 0.045, 1.15, z))
    for side, length in ((-1, 0.5), (1, 0.42)):
        hanging = cushion((0.012, length, 0.42), 0.005, 0.0, 4)
        model.add("towel", hanging, (x + 0.018 * side, 1.158 - length / 2, 0.8))
    model.add("towel", box((0.05, 0.012, 0.42), 0.005), (x, 1.167, 0.8))


def _room() -> dict[str, Any]:
    """The left wall goes around the window, whose reveal is as deep as the wall; its glass lets shadow rays pass."""
    paint, grout = matt(0.66, 0.70, 0.70), matt(0.42, 0.41, 0.39)
    (z0, z1), (y0, y1), left, tiled = _WINDOW_Z, _WINDOW_Y, -_HALF, 10 * _TILE
    width, deep = 2 * _HALF, (0.0, 0.0, z0 - z1)
    high, far = (0.0, _HEIGHT, 0.0), {"floor": grout, "ceiling": matt(0.78, 0.78, 0.76), "left": None, "back": None}
    return {
        **walls((left, _HALF), (0.0, _HEIGHT), (_BACK, _FRONT), paint, **far),
        "back-tiled": rectangle((left, 0.0, _BACK), (width, 0.0, 0.0), (0.0, tiled, 0.0), grout),
        "back": rectangle((left, tiled, _BACK), (width, 0.0, 0.0), (0.0, _HEIGHT - tiled, 0.0), paint),
        "left-near": rectangle((left, 0.0, _FRONT), (0.0, 0.0, z1 - _FRONT), high, paint),
        "left-far": rectangle((left, 0.0, z0), (0.0, 0.0, _BACK - z0), high, paint),
        "left-low": rectangle((left, 0.0, z1), deep, (0.0, y0, 0.0), paint),
        "left-high": rectangle((left, y1, z1), deep, (0.0, _HEIGHT - y1, 0.0), paint),
        "reveal-low": rectangle((left - _WALL, y0, z1), (_WALL, 0.0, 0.0), deep, paint),
        "reveal-high": rectangle((left - _WALL, y1, z0), (_WALL, 0.0, 0.0), (0.0, 0.0, z1 - z0), paint),
        "reveal-far": rectangle((left - _WALL, y0, z0), (_WALL, 0.0, 0.0), (0.0, y1 - y0, 0.0), paint),
        "reveal-near": rectangle((left, y0, z1), (-_WALL, 0.0, 0.0), (0.0, y1 - y0, 0.0), paint),
        "pane": rectangle(
            (left - _WALL / 2, y0, z1), deep, (0.0, y1 - y0, 0.0), {"type": "thindielectric", "int_ior": 1.5}
        ),
    }


def _lights() -> dict[str, Any]:
    """The sun, focused to a beam of some degrees; the sky in a frosted pane of the ceiling; the lamp in its tube."""
    import mitsuba as mi

    black = diffuse(0.0, 0.0, 0.0)
    (z0, z1), (y0, y1) = _WINDOW_Z, _WINDOW_Y
    window = np.array([-_HALF - _WALL / 2, (y0 + y1) / 2, (z0 + z1) / 2])
    towards = np.array([1.0, -0.34, -0.58])
    origin = window - 2.2 * towards / np.linalg.norm(towards)
    sun = mi.ScalarTransform4f().look_at(origin.tolist(), window.tolist(), [0, 1, 0]).scale([0.62, 0.62, 1.0])
    beam = {"type": "focusarea", "radiance": rgb(5.0, 4.1, 3.0), "exponent": 4000.0}
    return {
        "sun": {"type": "rectangle", "to_world": sun, "bsdf": black, "emitter": beam},
        "sky": rectangle((-0.3, _HEIGHT - 0.005, 1.2), (0.8, 0.0, 0.0), (0.0, 0.0, 0.8), black, 4.6, 5.3, 6.1),
        "tube-lamp": lamp((_BASIN[0], 1.99, _BACK + 0.17), 0.016, 300.0, 250.0, 180.0),
    }
