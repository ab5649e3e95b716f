"""Living room: a sofa, a table with glass on it, a shelf, a framed mirror, and lamps of a few centimetres.

The pendant lamp hangs in a brass shade over the table, and throws caustics of the glass on it; the mirror shows them.
The lamp on the shelf burns in a glass globe: all of its light is caustic. Each lamp has less than 0.1 % of the
ceiling's area.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .parts import (
    GAP,
    Model,
    Vector,
    about_x,
    about_y,
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
    picture,
    planks,
    rectangle,
    ring,
    smooth_normals,
    turned,
)

#: Inside of the room: half its width, its height, z of the wall behind the sofa and of the one behind the camera.
_HALF, _HEIGHT, _BACK, _FRONT = 2.4, 2.6, 0.0, 5.0
_PENDANT: Vector = (0.15, 1.2, 1.62)
_GLOBE: Vector = (-1.95, 1.3, 0.28)
#: Centre and height of the table's top.
_TABLE: Vector = (0.15, 0.42, 1.62)


def living_room() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 240 000 triangles."""
    model = Model(_materials())
    _sofa(model)
    _table(model)
    _shelf(model)
    _wall_mirror(model)
    _pendant(model)
    _details(model)
    x, y, z = _PENDANT
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": camera((0.75, 1.45, 4.7), (-0.08, 0.86, 0.6), 50.0),
        **_room(),
        "pendant-lamp": lamp((x, y + 0.02, z), 0.03, 1100.0, 960.0, 760.0),
        "globe-lamp": lamp(_GLOBE, 0.025, 190.0, 145.0, 90.0),
        **model.shapes(),
    }


def _materials() -> dict[str, dict[str, Any]]:
    return {
        "cloth": diffuse(0.16, 0.27, 0.32),
        "pillow": diffuse(0.70, 0.38, 0.12),
        "pale-pillow": diffuse(0.68, 0.62, 0.52),
        "dark-wood": glazed(0.16, 0.085, 0.045),
        "light-wood": diffuse(0.50, 0.36, 0.22),
        "white": diffuse(0.76, 0.74, 0.70),
        "glass": glass(),
        "amber": glass(1.5, 0.98, 0.72, 0.35),
        "sea": glass(1.5, 0.62, 0.90, 0.84),
        "brass": metal("Au", 0.12),
        "steel": metal("Cr", 0.15),
        "mirror": mirror(),
        "china": glazed(0.72, 0.70, 0.66),
        "red": glazed(0.46, 0.05, 0.04),
        "leaf": diffuse(0.09, 0.24, 0.06),
        "book-0": diffuse(0.42, 0.10, 0.08),
        "book-1": diffuse(0.10, 0.20, 0.36),
        "book-2": diffuse(0.62, 0.54, 0.38),
        "book-3": diffuse(0.10, 0.26, 0.16),
    }


def _sofa(model: Model) -> None:
    """Two seats along the back wall, with loose pillows."""
    width, depth = 2.0, 0.88
    x, z = 0.2, _BACK + 0.06 + depth / 2
    model.add("cloth", box((width, 0.24, depth), 0.03), (x, 0.24, z))
    model.add("cloth", box((width, 0.62, 0.2), 0.07, 5), (x, 0.52, z - depth / 2 + 0.11))
    for side in (-1, 1):
        model.add("cloth", box((0.2, 0.46, depth), 0.07, 5), (x + side * (width / 2 + 0.03), 0.38, z))
        seat = cushion((width / 2 - 0.09, 0.17, depth - 0.22), 0.06, 0.035)
        model.add("cloth", seat, (x + side * (width / 4 - 0.025), 0.44, z + 0.1))
        back = cushion((width / 2 - 0.1, 0.19, 0.44), 0.07, 0.05)
        model.add("cloth", back, (x + side * (width / 4 - 0.025), 0.72, z - 0.19), about_x(76))
        for end in (-1, 1):
            leg = turned([(0, 0), (0.02, 0), (0.028, 0.13), (0, 0.13)], 24)
            model.add("dark-wood", leg, (x + side * (width / 2 - 0.08), GAP, z + end * (depth / 2 - 0.08)))
    for at, turn, tilt, colour in (
        (-0.66, 24, 62, "pillow"),
        (-0.36, -8, 66, "pale-pillow"),
        (0.74, -28, 62, "pillow"),
    ):
        pillow = cushion((0.4, 0.1, 0.4), 0.045, 0.06)
        model.add(colour, pillow, (x + at, 0.74, z + 0.03), about_y(turn) @ about_x(tilt))


def _table(model: Model) -> None:
    """A round wooden table with glass on it, on a rug."""
    x, y, z = _TABLE
    top = [(0, 0), (0.5, 0), (0.52, 0.01), (0.52, 0.03), (0.5, 0.04), (0, 0.04)]
    model.add("dark-wood", turned(top, 96), (x, y - 0.04, z))
    for k in range(3):
        angle = 2 * np.pi * k / 3 + 0.5
        leg = turned([(0, 0), (0.016, 0), (0.026, y - 0.045), (0, y - 0.045)], 24)
        model.add("dark-wood", leg, (x + 0.36 * np.cos(angle), 0.013, z + 0.36 * np.sin(angle)))
    on_top = y + GAP
    outside = [
        (0, 0),
        (0.07, 0),
        (0.08, 0.015),
        (0.055, 0.06),
        (0.095, 0.14),
        (0.085, 0.22),
        (0.05, 0.27),
        (0.075, 0.31),
    ]
    inside = [(0.066, 0.31), (0.04, 0.27), (0.075, 0.22), (0.084, 0.14), (0.042, 0.07), (0, 0.055)]
    model.add("amber", turned(outside + inside, 96, 6), (x - 0.24, on_top, z - 0.1))
    model.add("glass", ball(0.075, 96, 48), (x + 0.08, on_top + 0.075, z + 0.2))
    bowl = [(0, 0), (0.05, 0), (0.055, 0.012), (0.15, 0.07), (0.165, 0.1), (0.158, 0.1), (0.14, 0.075), (0.045, 0.024)]
    model.add("sea", turned([*bowl, (0, 0.022)], 96, 6), (x + 0.24, on_top, z - 0.12))
    _wine_glass(model, (x - 0.2, on_top, z + 0.22))
    _wine_glass(model, (x - 0.06, on_top, z + 0.34))
    model.add("book-1", box((0.24, 0.028, 0.17), 0.003), (x + 0.3, on_top + 0.014, z + 0.2), about_y(-20))


def _wine_glass(model: Model, at: Vector) -> None:
    outside = [
        (0, 0),
        (0.034, 0),
        (0.034, 0.003),
        (0.006, 0.01),
        (0.0045, 0.08),
        (0.03, 0.1),
        (0.04, 0.14),
        (0.031, 0.2),
    ]
    inside = [(0.0295, 0.2), (0.038, 0.14), (0.028, 0.103), (0, 0.092)]
    model.add("glass", turned(outside + inside, 72, 6), at)


def _shelf(model: Model) -> None:
    """Boards with books, bowls and the lamp in its globe, in the corner."""
    x, depth = -1.9, 0.34
    z = _BACK + 0.01 + depth / 2
    for y in (0.06, 0.56, 1.06, 1.9):
        model.add("light-wood", box((0.86, 0.028, depth), 0.004), (x, y, z))
    for side in (-1, 1):
        model.add("light-wood", box((0.028, 1.95, depth), 0.004), (x + side * 0.445, 0.975 + GAP, z))
    rng = np.random.default_rng(5)
    for y, first, last in ((0.574, -0.41, 0.12), (0.074, -0.3, 0.4), (1.914, -0.38, 0.0)):
        edge = first
        while edge < last:
            thick, tall = rng.uniform(0.02, 0.045), rng.uniform(0.2, 0.31)
            book = box((thick, tall, rng.uniform(0.16, 0.24)), 0.003)
            model.add(f"book-{rng.integers(0, 4)}", book, (x + edge + thick / 2, y + GAP + tall / 2, z - 0.02))
            edge += thick + 0.002
    vase = [
        (0, 0),
        (0.06, 0),
        (0.1, 0.1),
        (0.085, 0.2),
        (0.035, 0.26),
        (0.045, 0.3),
        (0.035, 0.3),
        (0.025, 0.26),
        (0, 0.1),
    ]
    model.add("china", turned(vase, 64), (x + 0.27, 0.574 + GAP, z))
    _globe(model)


def _globe(model: Model) -> None:
    """The clear globe around the shelf's lamp, with a steel foot."""
    x, _, z = _GLOBE
    model.add("glass", ball(0.115, 96, 48), _GLOBE)
    points, faces, normals = ball(0.107, 96, 48)
    model.add("glass", (points, faces[:, ::-1], -normals), _GLOBE)
    foot = [(0, 0), (0.075, 0), (0.075, 0.012), (0.03, 0.03), (0.03, 0.1), (0.055, 0.118), (0, 0.118)]
    model.add("steel", turned(foot, 64), (x, 1.074 + GAP, z))


def _wall_mirror(model: Model) -> None:
    """A framed mirror over the sofa, leaning forward a little so that it shows the table."""
    width, height = 1.3, 0.78
    turn = about_x(18.0)
    centre = np.array([0.3, 1.74, _BACK + 0.16])

    def place(offset: Vector) -> Vector:
        moved = centre + turn @ np.array(offset)
        return float(moved[0]), float(moved[1]), float(moved[2])

    model.add("mirror", box((width, height, 0.008)), place((0.0, 0.0, 0.0)), turn)
    for side in (-1, 1):
        upright, beam = box((0.06, height + 0.12, 0.04), 0.012), box((width, 0.06, 0.04), 0.012)
        model.add("brass", upright, place((side * (width / 2 + 0.03), 0.0, 0.005)), turn)
        model.add("brass", beam, place((0.0, side * (height / 2 + 0.03), 0.005)), turn)


def _pendant(model: Model) -> None:
    """A brass shade, open below and a little above, where its lamp lights the ceiling."""
    x, y, z = _PENDANT
    outside = [(0.2, -0.07), (0.19, 0.0), (0.13, 0.09), (0.07, 0.13), (0.06, 0.145)]
    inside = [(0.055, 0.14), (0.066, 0.123), (0.125, 0.085), (0.184, -0.002), (0.195, -0.07)]
    model.add("brass", ring(outside + inside, 96, 5), (x, y + 0.02, z))
    model.add("steel", turned([(0, 0), (0.012, 0), (0.012, 0.1), (0, 0.1)], 24), (x, y + 0.0525, z))
    cord = turned([(0, 0), (0.004, 0), (0.004, _HEIGHT - y - 0.16), (0, _HEIGHT - y - 0.16)], 16)
    model.add("steel", cord, (x, y + 0.153, z))


def _details(model: Model) -> None:
    """A rug, a plant in a pot, skirting boards, pictures on the side walls."""
    model.add("pale-pillow", box((2.3, 0.012, 1.6), 0.004), (0.15, 0.0065, 1.75))
    pot = [(0, 0), (0.13, 0), (0.18, 0.3), (0.19, 0.32), (0.17, 0.32), (0.15, 0.26), (0, 0.26)]
    model.add("china", turned(pot, 64), (1.85, GAP, 0.5))
    rng = np.random.default_rng(8)
    for k in range(26):
        _leaf(model, (1.85, 0.25, 0.5), 137.5 * k, rng.uniform(8.0, 52.0), rng.uniform(0.55, 0.95))
    for side in (-1, 1):
        model.add(
            "white", box((0.015, 0.09, _FRONT - _BACK), 0.003), (side * (_HALF - 0.0085), 0.046, (_FRONT + _BACK) / 2)
        )
    model.add("white", box((2 * _HALF - 0.04, 0.09, 0.015), 0.003), (0.0, 0.046, _BACK + 0.0085))


def _leaf(model: Model, at: Vector, turn: float, lean: float, length: float) -> None:
    """A blade that rises and bends over, a thin lens in section."""
    points, faces, _ = box((1.0, 1.0, 1.0), 0.05, 2, 10)
    t = points[:, 1] + 0.5
    width = 0.052 * np.sin(np.pi * np.clip(t, 0.03, 0.99)) ** 0.7 * (1.0 - 0.5 * t)
    angle = np.radians(lean) * (0.35 + 1.2 * t)
    out = length * t * np.sin(angle)
    bent = np.stack([points[:, 0] * 2 * width, length * t * np.cos(angle), out + 0.003 * points[:, 2]], -1)
    model.add("leaf", (bent, faces, smooth_normals(bent, faces)), at, about_y(turn))


def _room() -> dict[str, Any]:
    width, depth = 2 * _HALF, _FRONT - _BACK
    wall, side, ceiling = diffuse(0.60, 0.55, 0.47), diffuse(0.38, 0.44, 0.40), diffuse(0.78, 0.77, 0.74)
    boards = planks(np.random.default_rng(4), 16, tone=(0.52, 0.36, 0.22))
    wood = {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": picture(boards, (1.5, 2.0))}}
    return {
        "floor": rectangle((-_HALF, 0.0, _FRONT), (width, 0.0, 0.0), (0.0, 0.0, -depth), wood),
        "back": rectangle((-_HALF, 0.0, _BACK), (width, 0.0, 0.0), (0.0, _HEIGHT, 0.0), wall),
        "front": rectangle((_HALF, 0.0, _FRONT), (-width, 0.0, 0.0), (0.0, _HEIGHT, 0.0), wall),
        "left": rectangle((-_HALF, 0.0, _FRONT), (0.0, 0.0, -depth), (0.0, _HEIGHT, 0.0), side),
        "right": rectangle((_HALF, 0.0, _BACK), (0.0, 0.0, depth), (0.0, _HEIGHT, 0.0), side),
        "ceiling": rectangle((-_HALF, _HEIGHT, _BACK), (width, 0.0, 0.0), (0.0, 0.0, depth), ceiling),
    }
