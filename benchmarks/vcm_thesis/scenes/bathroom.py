"""Bathroom: tiles, a wash basin with a chrome tap, a mirror, a glass shelf, and the sun through the window.

The sun is a focused light outside the window, the sky a frosted pane in the ceiling, and a small lamp burns in a glass
tube over the mirror. Mirror, chrome, glass and the water in the basin throw the sun on the tiles around them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .parts import (
    GAP,
    Array,
    Model,
    Vector,
    about_x,
    about_y,
    about_z,
    ball,
    box,
    camera,
    cushion,
    diffuse,
    glass,
    glazed,
    lamp,
    metal,
    mirror,
    rectangle,
    rgb,
    smooth_normals,
    tube,
    turned,
)

#: Inside of the room: half its width, its height, z of the wall with the basin and of the one behind the camera.
_HALF, _HEIGHT, _BACK, _FRONT = 1.5, 2.5, 0.0, 3.4
#: The window in the left wall: z and y from and to, and the thickness of the wall.
_WINDOW_Z, _WINDOW_Y, _WALL = (0.75, 1.75), (1.0, 2.15), 0.14
#: Middle of the basin's rim.
_BASIN: Vector = (0.12, 0.86, 0.36)
_TILE, _GROUT = 0.15, 0.004


def bathroom() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 260 000 triangles."""
    model = Model(_materials())
    _tiles(model)
    _basin(model)
    _tap(model)
    _over_the_basin(model)
    _shelf(model)
    _window(model)
    _details(model)
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": camera((0.62, 1.5, 2.75), (-0.02, 1.12, 0.0), 52.0),
        **_room(),
        **_lights(),
        **model.shapes(),
    }


def _materials() -> dict[str, dict[str, Any]]:
    return {
        "tile": glazed(0.62, 0.66, 0.66),
        "tile-blue": glazed(0.10, 0.24, 0.32),
        "floor-light": glazed(0.60, 0.58, 0.54),
        "floor-dark": glazed(0.10, 0.11, 0.12),
        "grout": diffuse(0.42, 0.41, 0.39),
        "china": glazed(0.80, 0.80, 0.78),
        "chrome": metal("Cr"),
        "mirror": mirror(),
        "glass": glass(),
        "water": glass(1.33),
        "green": glass(1.5, 0.45, 0.85, 0.62),
        "amber": glass(1.5, 0.97, 0.68, 0.30),
        "paint": diffuse(0.78, 0.77, 0.74),
        "wood": diffuse(0.44, 0.29, 0.17),
        "pale-wood": diffuse(0.52, 0.37, 0.23),
        "towel": diffuse(0.66, 0.22, 0.14),
        "soap": glazed(0.72, 0.60, 0.30),
    }


def _tiles(model: Model) -> None:
    """Tiles with round edges on the wall of the basin and on the right one, up to a blue row; on the floor, in two
    colours. None lies quite even."""
    rng = np.random.default_rng(7)
    tile = box((_TILE - _GROUT, _TILE - _GROUT, 0.012), 0.0025, 1)

    def lay(row: int, at: Vector, turn: Array, material: str = "") -> None:
        tilt = about_x(rng.normal(0.0, 0.12)) @ about_y(rng.normal(0.0, 0.12))
        model.add(material or ("tile-blue" if row == 8 else "tile"), tile, at, turn @ tilt)

    across, along = round(2 * _HALF / _TILE), round((_FRONT - _BACK) / _TILE)
    for row in range(10):
        y = (row + 0.5) * _TILE
        for k in range(across):
            lay(row, (-_HALF + (k + 0.5) * _TILE, y, _BACK), np.eye(3))
        for k in range(along):
            lay(row, (_HALF, y, _BACK + (k + 0.5) * _TILE), about_y(-90))
    for i in range(across):
        for k in range(along):
            dark = "floor-dark" if (i + k) % 2 else "floor-light"
            lay(0, (-_HALF + (i + 0.5) * _TILE, 0.0, _BACK + (k + 0.5) * _TILE), about_x(-90), dark)


def _basin(model: Model) -> None:
    """A round basin on a wooden board with legs, with water in it."""
    x, y, z = _BASIN
    outside = [(0, -0.14), (0.1, -0.14), (0.17, -0.1), (0.22, 0), (0.232, 0.006), (0.228, 0.012)]
    inside = [(0.214, 0.006), (0.16, -0.085), (0.1, -0.118), (0.025, -0.122), (0, -0.122)]
    model.add("china", turned(outside + inside, 128, 8), _BASIN)
    model.add("wood", box((1.25, 0.04, 0.5), 0.006), (x + 0.02, y - 0.162, z - 0.06))
    for side in (-1, 1):
        for depth in (-0.24, 0.12):
            model.add(
                "chrome",
                turned([(0, 0), (0.014, 0), (0.014, 0.69), (0, 0.69)], 24),
                (x + 0.56 * side, 0.0065, z + depth),
            )
    model.add("wood", box((1.2, 0.02, 0.44), 0.004), (x + 0.02, 0.24, z - 0.06))
    for k, (at, colour) in enumerate(((-0.4, "towel"), (-0.05, "paint"), (0.36, "towel"))):
        for level in range(3 - k % 2):
            folded = cushion((0.3, 0.055, 0.3), 0.024, 0.008, 6)
            model.add(colour, folded, (x + at, 0.25 + GAP + 0.0365 + 0.062 * level, z - 0.05))
    _water(model)


def _water(model: Model) -> None:
    """Ripples that end inside the china."""
    x, y, z = _BASIN
    rings, segments, edge = 60, 120, 0.183
    r, phi = np.meshgrid(np.linspace(0, 1, rings + 1), 2 * np.pi * np.arange(segments) / segments, indexing="ij")
    r = edge * r
    px, pz = r * np.cos(phi), r * np.sin(phi)
    d = np.hypot(px - 0.03, pz + 0.05)
    level = -0.045 + 0.0022 * np.cos(2 * np.pi * d / 0.04) * np.exp(-6.0 * d)
    points = np.stack([px, level, pz], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings), np.arange(segments), indexing="ij")
    a, b = i * segments + j, i * segments + (j + 1) % segments
    c, e = a + segments, b + segments
    faces = np.concatenate([np.stack([a, e, c], -1).reshape(-1, 3), np.stack([a, b, e], -1)[1:].reshape(-1, 3)])
    model.add("water", (points, faces, smooth_normals(points, faces)), (x, y, z))


def _tap(model: Model) -> None:
    """A chrome tap behind the basin: a pipe that bends over, and a lever."""
    x, y, z = _BASIN
    base = (x, y - 0.14 + GAP, z - 0.255)
    model.add("chrome", turned([(0, 0), (0.03, 0), (0.03, 0.01), (0.02, 0.016), (0.02, 0.1), (0, 0.1)], 48), base)
    angle = np.linspace(0.0, 1.15 * np.pi, 40)
    bend = np.stack([np.zeros(40), 0.3 + 0.075 * np.sin(angle), 0.075 * (1 - np.cos(angle))], -1)
    rise = np.stack([np.zeros(8), np.linspace(0.08, 0.29, 8), np.zeros(8)], -1)
    model.add("chrome", tube(np.concatenate([rise, bend]), 0.0125, 28), base)
    lever = tube(np.array([[0.0, 0.06, 0.0], [0.04, 0.065, 0.0], [0.09, 0.085, 0.01]]), 0.006, 16)
    model.add("chrome", lever, base)
    model.add("chrome", ball(0.009, 24, 12), (base[0] + 0.09, base[1] + 0.085, base[2] + 0.01))


def _over_the_basin(model: Model) -> None:
    """The mirror with a chrome rim, and the lamp's glass tube over it."""
    x, y = _BASIN[0], 1.52
    model.add("mirror", box((0.9, 0.72, 0.008), 0.003, 2), (x, y, _BACK + 0.03))
    for side in (-1, 1):
        model.add("chrome", box((0.014, 0.75, 0.03), 0.004), (x + 0.458 * side, y, _BACK + 0.03))
        model.add("chrome", box((0.93, 0.014, 0.03), 0.004), (x, y + 0.368 * side, _BACK + 0.03))
    across = about_z(90)
    middle: Vector = (x, 1.99, _BACK + 0.17)
    outside = [(0, -0.17), (0.03, -0.17), (0.034, -0.16), (0.034, 0.16), (0.03, 0.17), (0, 0.17)]
    inside = [(0.9 * r, 0.97 * h) for r, h in outside]
    model.add("glass", turned(outside, 64, 8), middle, across)
    points, faces, normals = turned(inside, 64, 8)
    model.add("glass", (points, faces[:, ::-1], -normals), middle, across)
    for side in (-1, 1):
        cap = turned([(0, 0), (0.04, 0), (0.04, 0.03), (0, 0.03)], 48)
        model.add("chrome", cap, (x + side * 0.186 + 0.015, 1.99, _BACK + 0.17), across)
        model.add("chrome", box((0.02, 0.02, 0.15), 0.003), (x + 0.186 * side, 1.99, _BACK + 0.08))


def _shelf(model: Model) -> None:
    """A glass shelf under the mirror with bottles and a tumbler."""
    x, y, z = _BASIN[0], 1.1, _BACK + 0.09
    model.add("green", box((0.95, 0.01, 0.13), 0.003), (x, y, z))
    for side in (-1, 1):
        model.add("chrome", ball(0.012, 32, 16), (x + 0.4 * side, y - 0.018, z - 0.05))
    on = y + 0.005 + GAP
    bottle = [(0, 0), (0.03, 0), (0.034, 0.01), (0.034, 0.1), (0.012, 0.125), (0.012, 0.15), (0.009, 0.15)]
    hollow = [(0.009, 0.125), (0.03, 0.1), (0.03, 0.014), (0, 0.01)]
    model.add("amber", turned(bottle + hollow, 72, 5), (x - 0.36, on, z))
    model.add("green", turned([(r * 0.85, h * 0.8) for r, h in bottle + hollow], 72, 5), (x - 0.27, on, z + 0.01))
    tumbler = [(0, 0), (0.03, 0), (0.033, 0.006), (0.037, 0.09), (0.034, 0.09), (0.03, 0.012), (0, 0.011)]
    model.add("glass", turned(tumbler, 72, 6), (x + 0.34, on, z))
    model.add("glass", ball(0.032, 72, 36), (x + 0.22, on + 0.032, z + 0.01))
    for lean, colour in ((-9.0, "towel"), (11.0, "soap")):
        handle = tube(np.array([[0, 0.0, 0], [0, 0.08, 0], [0, 0.165, 0]]), 0.0035, 12)
        model.add(colour, handle, (x + 0.34, on + 0.013, z), about_z(lean))
    dish = cushion((0.09, 0.03, 0.06), 0.012, 0.004, 6)
    model.add("soap", dish, (_BASIN[0] + 0.38, _BASIN[1] - 0.142 + 0.019 + GAP, _BASIN[2]), about_y(25))


def _window(model: Model) -> None:
    """Frame and bars of the window; its glass is thin and lets shadow rays pass."""
    (z0, z1), (y0, y1) = _WINDOW_Z, _WINDOW_Y
    x, y, z = -_HALF - _WALL / 2, (y0 + y1) / 2, (z0 + z1) / 2
    for edge in (z0 + 0.025, z, z1 - 0.025):
        model.add("paint", box((0.05, y1 - y0 - 2 * GAP, 0.05), 0.006), (x, y, edge))
    for edge in (y0 + 0.025 + GAP, y, y1 - 0.025 - GAP):
        model.add("paint", box((0.045, 0.05, z1 - z0 - 2 * GAP), 0.006), (x, edge, z))
    model.add("paint", box((0.2, 0.03, z1 - z0 + 0.1), 0.006), (-_HALF + 0.03, y0 - 0.016, z))
    vase = [
        (0, 0),
        (0.035, 0),
        (0.05, 0.06),
        (0.02, 0.14),
        (0.03, 0.18),
        (0.026, 0.18),
        (0.015, 0.14),
        (0.04, 0.06),
        (0, 0.015),
    ]
    model.add("green", turned(vase, 72, 6), (-_HALF + 0.06, y0 + GAP, z0 + 0.3))
    model.add("glass", ball(0.06, 96, 48), (-_HALF + 0.06, y0 + 0.06 + GAP, z1 - 0.33))


def _details(model: Model) -> None:
    """A towel on a rail at the right wall; opposite the mirror a door and shelves, which it shows."""
    model.add("wood", box((0.82, 2.0, 0.05), 0.006), (-0.55, 1.0, _FRONT - 0.026))
    for y in (0.62, 1.5):
        model.add("pale-wood", box((0.56, 0.68, 0.02), 0.008), (-0.55, y, _FRONT - 0.056))
    model.add("chrome", ball(0.03, 48, 24), (-0.24, 1.02, _FRONT - 0.09))
    for y in (1.25, 1.65, 2.05):
        model.add("wood", box((0.8, 0.025, 0.24), 0.004), (0.7, y, _FRONT - 0.121))
        for k in range(4):
            jar = [(0, 0), (0.06, 0), (0.07, 0.02), (0.07, 0.14), (0.045, 0.17), (0.05, 0.21), (0, 0.21)]
            colour = ("china", "towel", "tile-blue", "soap")[(k + round(10 * y)) % 4]
            model.add(colour, turned(jar, 48, 4), (0.43 + 0.18 * k, y + 0.0125 + GAP, _FRONT - 0.12))
    rail = tube(np.array([[_HALF - 0.07, 1.15, 0.5], [_HALF - 0.07, 1.15, 0.8], [_HALF - 0.07, 1.15, 1.1]]), 0.01, 20)
    model.add("chrome", rail)
    for z in (0.52, 1.08):
        model.add("chrome", box((0.08, 0.02, 0.02), 0.004), (_HALF - 0.045, 1.15, z))
    for side, length in ((-1, 0.5), (1, 0.42)):
        model.add(
            "towel",
            cushion((0.012, length, 0.42), 0.005, 0.0, 4),
            (_HALF - 0.07 + 0.018 * side, 1.158 - length / 2, 0.8),
        )
    model.add("towel", box((0.05, 0.012, 0.42), 0.005), (_HALF - 0.07, 1.167, 0.8))


def _room() -> dict[str, Any]:
    width, depth = 2 * _HALF, _FRONT - _BACK
    paint, grout = diffuse(0.66, 0.70, 0.70), diffuse(0.42, 0.41, 0.39)
    (z0, z1), (y0, y1) = _WINDOW_Z, _WINDOW_Y
    left = -_HALF
    pane = {"type": "thindielectric", "int_ior": 1.5}
    return {
        "floor": rectangle((-_HALF, 0.0, _FRONT), (width, 0.0, 0.0), (0.0, 0.0, -depth), grout),
        "back-tiled": rectangle((-_HALF, 0.0, _BACK), (width, 0.0, 0.0), (0.0, 10 * _TILE, 0.0), grout),
        "back": rectangle((-_HALF, 10 * _TILE, _BACK), (width, 0.0, 0.0), (0.0, _HEIGHT - 10 * _TILE, 0.0), paint),
        "front": rectangle((_HALF, 0.0, _FRONT), (-width, 0.0, 0.0), (0.0, _HEIGHT, 0.0), paint),
        "right": rectangle((_HALF, 0.0, _BACK), (0.0, 0.0, depth), (0.0, _HEIGHT, 0.0), paint),
        "ceiling": rectangle((-_HALF, _HEIGHT, _BACK), (width, 0.0, 0.0), (0.0, 0.0, depth), diffuse(0.78, 0.78, 0.76)),
        # The left wall goes around the window, whose reveal is as deep as the wall.
        "left-near": rectangle((left, 0.0, _FRONT), (0.0, 0.0, z1 - _FRONT), (0.0, _HEIGHT, 0.0), paint),
        "left-far": rectangle((left, 0.0, z0), (0.0, 0.0, _BACK - z0), (0.0, _HEIGHT, 0.0), paint),
        "left-low": rectangle((left, 0.0, z1), (0.0, 0.0, z0 - z1), (0.0, y0, 0.0), paint),
        "left-high": rectangle((left, y1, z1), (0.0, 0.0, z0 - z1), (0.0, _HEIGHT - y1, 0.0), paint),
        "reveal-low": rectangle((left - _WALL, y0, z1), (_WALL, 0.0, 0.0), (0.0, 0.0, z0 - z1), paint),
        "reveal-high": rectangle((left - _WALL, y1, z0), (_WALL, 0.0, 0.0), (0.0, 0.0, z1 - z0), paint),
        "reveal-far": rectangle((left - _WALL, y0, z0), (_WALL, 0.0, 0.0), (0.0, y1 - y0, 0.0), paint),
        "reveal-near": rectangle((left, y0, z1), (-_WALL, 0.0, 0.0), (0.0, y1 - y0, 0.0), paint),
        "pane": rectangle((left - _WALL / 2, y0, z1), (0.0, 0.0, z0 - z1), (0.0, y1 - y0, 0.0), pane),
    }


def _lights() -> dict[str, Any]:
    """The sun, focused to a beam of some degrees; the sky in a frosted pane of the ceiling; the lamp in its tube."""
    import mitsuba as mi

    black = {"type": "diffuse", "reflectance": rgb(0.0, 0.0, 0.0)}
    (z0, z1), (y0, y1) = _WINDOW_Z, _WINDOW_Y
    window = np.array([-_HALF - _WALL / 2, (y0 + y1) / 2, (z0 + z1) / 2])
    towards = np.array([1.0, -0.34, -0.58])
    origin = window - 2.2 * towards / np.linalg.norm(towards)
    sun = mi.ScalarTransform4f().look_at(origin.tolist(), window.tolist(), [0, 1, 0]).scale([0.62, 0.62, 1.0])
    sky = {"emitter": {"type": "area", "radiance": rgb(4.6, 5.3, 6.1)}}
    return {
        "sun": {
            "type": "rectangle",
            "to_world": sun,
            "bsdf": black,
            "emitter": {"type": "focusarea", "radiance": rgb(5.0, 4.1, 3.0), "exponent": 4000.0},
        },
        "sky": rectangle((-0.3, _HEIGHT - 0.005, 1.2), (0.8, 0.0, 0.0), (0.0, 0.0, 0.8), black, **sky),
        "tube-lamp": lamp((_BASIN[0], 1.99, _BACK + 0.17), 0.016, 300.0, 250.0, 180.0),
    }
