"""Living room and sitting room.

The living room: a sofa, a table with glass on it, a shelf, a framed mirror, and lamps of a few centimetres.

The pendant lamp hangs in a brass shade over the table, and throws caustics of the glass on it; the mirror shows them.
The lamp on the shelf burns in a glass globe: all of its light is caustic. Each lamp has less than 0.1 % of the
ceiling's area. The sitting room is lit by two windows.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from ...meshes import grid, smooth
from ..pieces import Array, Vector, diffuse, lamp, matt, planks, rectangle, textured, walls
from ..solids import GAP, Model, about, ball, box, cushion, inside_out, ring, smooth_normals, stretched, tube, turned
from .furniture import books, framed, furniture, painting, pillow, plant, seat, skirting, view, wine_glass

#: Inside of the room: half its width, its height, z of the wall behind the sofa and of the one behind the camera.
_HALF, _HEIGHT, _BACK, _FRONT = 2.4, 2.6, 0.0, 5.0
_PENDANT: Vector = (0.15, 1.2, 1.62)
_GLOBE: Vector = (-1.95, 1.3, 0.28)
#: Centre and height of the table's top.
_TABLE: Vector = (0.15, 0.42, 1.62)


def living_room() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 240 000 triangles."""
    model = furniture()
    model.put(seat(), (0.2, 0.0, _BACK + 0.5))
    for x, turn, tilt, colour in ((-0.46, 24, 62, "pillow"), (-0.16, -8, 66, "pale-pillow"), (0.94, -28, 62, "pillow")):
        pillow(model, colour, (x, 0.74, _BACK + 0.53), turn, tilt)
    _table(model)
    _shelf(model)
    framed(model, "mirror", (1.3, 0.78), (0.3, 1.74, _BACK + 0.16), about(0, 18.0), "brass")
    _pendant(model)
    model.add("pale-pillow", box((2.3, 0.012, 1.6), 0.004), (0.15, 0.0065, 1.75))
    plant(model, 1.85, 0.5)
    skirting(model, (-_HALF, _HALF), (_BACK, _FRONT))
    x, y, z = _PENDANT
    side, wall = matt(0.38, 0.44, 0.40), matt(0.60, 0.55, 0.47)
    other = {"left": side, "right": side, "ceiling": matt(0.78, 0.77, 0.74)}
    wood = textured(planks(4, 16, tone=(0.52, 0.36, 0.22)), (1.5, 2.0), "plastic")
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((0.75, 1.45, 4.7), (-0.08, 0.86, 0.6), 50.0),
        **walls((-_HALF, _HALF), (0.0, _HEIGHT), (_BACK, _FRONT), wall, floor=wood, **other),
        "pendant-lamp": lamp((x, y + 0.02, z), 0.03, 1100.0, 960.0, 760.0),
        "globe-lamp": lamp(_GLOBE, 0.025, 190.0, 145.0, 90.0),
        **model.shapes(),
    }


def _table(model: Model) -> None:
    """A round wooden table with glass on it."""
    x, y, z = _TABLE
    model.add("dark-wood", turned("0,0 50,0 52,1 52,3 50,4 0,4", 96), (x, y - 0.04, z))
    for k in range(3):
        angle = 2 * np.pi * k / 3 + 0.5
        leg = turned("0,0 1.6,0 2.6,37.5 0,37.5", 24)
        model.add("dark-wood", leg, (x + 0.36 * np.cos(angle), 0.013, z + 0.36 * np.sin(angle)))
    y += GAP
    vase = "0,0 7,0 8,1.5 5.5,6 9.5,14 8.5,22 5,27 7.5,31 6.6,31 4,27 7.5,22 8.4,14 4.2,7 0,5.5"
    model.add("amber", turned(vase, 96), (x - 0.24, y, z - 0.1))
    model.add("glass", ball(0.075), (x + 0.08, y + 0.075, z + 0.2))
    bowl = "0,0 5,0 5.5,1.2 15,7 16.5,10 15.8,10 14,7.5 4.5,2.4 0,2.2"
    model.add("sea", turned(bowl, 96), (x + 0.24, y, z - 0.12))
    wine_glass(model, x - 0.2, y, z + 0.22)
    wine_glass(model, x - 0.06, y, z + 0.34)
    model.add("book-1", box((0.24, 0.028, 0.17), 0.003), (x + 0.3, y + 0.014, z + 0.2), about(1, -20))


def _shelf(model: Model) -> None:
    """Boards with books, bowls and the lamp in its globe, in the corner."""
    x, z, depth = -1.9, _BACK + 0.18, 0.34
    for y in (0.06, 0.56, 1.06, 1.9):
        model.add("light-wood", box((0.86, 0.028, depth), 0.004), (x, y, z))
    for side in (-1, 1):
        model.add("light-wood", box((0.028, 1.95, depth), 0.004), (x + side * 0.445, 0.975 + GAP, z))
    rng = np.random.default_rng(5)
    for y, first, last in ((0.574, -0.41, 0.12), (0.074, -0.3, 0.4), (1.914, -0.38, 0.0)):
        books(model, rng, (x, y, z), first, last)
    vase = "0,0 6,0 10,10 8.5,20 3.5,26 4.5,30 3.5,30 2.5,26 0,10"
    model.add("china", turned(vase, 64), (x + 0.27, 0.574 + GAP, z))
    model.add("glass", ball(0.115), _GLOBE)
    model.add("glass", inside_out(ball(0.107)), _GLOBE)
    foot = turned("0,0 7.5,0 7.5,1.2 3,3 3,10 5.5,11.8 0,11.8", 64)
    model.add("steel", foot, (_GLOBE[0], 1.074 + GAP, _GLOBE[2]))


def _pendant(model: Model) -> None:
    """A brass shade, open below and a little above, where its lamp lights the ceiling."""
    x, y, z = _PENDANT
    outside, inside = "20,-7 19,0 13,9 7,13 6,14.5", "5.5,14 6.6,12.3 12.5,8.5 18.4,-.2 19.5,-7"
    model.add("brass", ring(f"{outside} {inside}", 96, 5), (x, y + 0.02, z))
    model.add("steel", turned("0,0 1.2,0 1.2,10 0,10", 24), (x, y + 0.0525, z))
    model.add("steel", turned("0,0 .4,0 .4,124 0,124", 16), (x, y + 0.153, z))


def sitting_room() -> dict[str, Any]:
    """A sofa, an armchair, a table with a glass top and a television, lit by two windows."""
    model = furniture()
    model.put(seat(), (-0.45, 0.0, 0.5))
    for x, turn, tilt, colour in ((-1.15, 20, 62, "pillow"), (0.2, -24, 62, "pale-pillow")):
        pillow(model, colour, (x, 0.74, 0.53), turn, tilt)
    model.put(seat(1, 0.82), (-1.75, 0.0, 2.15), about(1, 76))
    model.put(_glass_table(), (-0.3, 0.0, 1.8))
    model.put(_television(), (1.72, 0.0, 0.72), about(1, -38))
    model.add("pale-pillow", box((2.3, 0.012, 1.7), 0.004), (-0.3, 0.0065, 1.85))
    plant(model, 0.95, 0.36, 0.8)
    skirting(model, (-_HALF, _HALF), (_BACK, _FRONT))
    lead = np.array([[1.95, 0.6, 0.3], [1.97, 0.2, 0.18], [1.9, 0.02, 0.1], [1.6, 0.02, 0.05], [1.42, 0.2, 0.022]])
    model.add("black", tube(smooth(lead, 12, closed=False), 0.004, 12))
    model.add("white", box((0.15, 0.085, 0.016), 0.004), (1.42, 0.22, _BACK + 0.0085))
    for x in (1.385, 1.455):
        model.add("black", ball(0.014, 24, 12), (x, 0.22, _BACK + 0.009))
    windows: dict[str, Any] = {}
    for name, z in (("window-far", 0.9), ("window-near", 2.6)):
        pane = ((2.39, 0.95, z), (0.0, 0.0, 1.1), (0.0, 1.25, 0.0), diffuse(0.0, 0.0, 0.0))
        windows[name] = rectangle(*pane, 7.0, 7.6, 8.4)
        for at in (-0.02, 0.55, 1.12):
            model.add("white", box((0.05, 1.37, 0.06), 0.012), (2.37, 1.575, z + at))
        for at in (0.93, 1.8, 2.22):
            model.add("white", box((0.045, 0.06, 1.14), 0.012), (2.37, at, z + 0.55))
        model.add("white", box((0.16, 0.03, 1.3), 0.008), (2.32, 0.88, z + 0.55))
        for at in (-0.18, 1.28):
            model.add("cloth", _curtain(0.34, 1.65), (2.33, 1.45, z + at), about(1, 90))
    wood = textured(planks(4, 16, tone=(0.52, 0.36, 0.22)), (1.5, 2.0))
    other = {"ceiling": matt(0.78, 0.77, 0.74), "back": matt(0.48, 0.54, 0.50)}
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((-0.75, 1.5, 4.75), (0.12, 0.82, 0.9), 58.0),
        **walls((-_HALF, _HALF), (0.0, _HEIGHT), (_BACK, _FRONT), matt(0.66, 0.62, 0.54), floor=wood, **other),
        "picture": painting(model, 3, (-0.45, 1.6, _BACK + 0.022), np.eye(3)),
        **windows,
        **model.shapes(),
    }


def _glass_table() -> Model:
    """A plate of glass on a steel frame, with things on it."""
    model = furniture()
    model.add("glass", box((1.1, 0.012, 0.62), 0.005), (0.0, 0.426, 0.0))
    for side in (-1, 1):
        leg = np.array([[0, 0, -0.27], [0, 0.41, -0.27], [0, 0.41, 0.27], [0, 0, 0.27]])
        bent = np.concatenate([np.linspace(a, b, 12) for a, b in pairwise(leg)])
        model.add("steel", tube(bent, 0.009), (0.48 * side, 0.009, 0.0))
    y = 0.432 + GAP
    bowl = "0,0 5,0 5.5,1.2 15,7 16.5,10 15.8,10 14,7.5 4.5,2.4 0,2.2"
    model.add("sea", turned(bowl, 96), (0.22, y, -0.06))
    model.add("book-0", box((0.24, 0.028, 0.17), 0.003), (-0.25, y + 0.014, 0.02), about(1, 15))
    model.add("book-2", box((0.21, 0.022, 0.15), 0.003), (-0.26, y + 0.0395, 0.02), about(1, -8))
    model.add("china", turned("0,0 2.5,0 4,3 4.2,8 3.9,8 3.6,3 2.2,.8 0,.6"), (-0.02, y, 0.18))
    return model


def _television() -> Model:
    """A tube with buttons and an aerial, on a low cupboard; it looks along z."""
    model = furniture()
    model.add("light-wood", box((0.86, 0.42, 0.46), 0.008), (0, 0.211, 0))
    for side in (-1, 1):
        model.add("light-wood", box((0.4, 0.36, 0.02), 0.006), (side * 0.207, 0.215, 0.228))
        model.add("steel", ball(0.012, 32, 16), (side * 0.04, 0.22, 0.25))
    model.add("grey", box((0.68, 0.5, 0.12), 0.03), (0, 0.673, 0.13))
    model.add("grey", stretched(ball(1.0), 0.27, 0.21, 0.2), (0, 0.67, -0.03))
    model.add("black", cushion((0.5, 0.02, 0.385), 0.009, 0.022), (-0.065, 0.685, 0.189), about(0, 90))
    for k in range(4):
        model.add("black", ball(0.014, 24, 12), (0.27, 0.82 - 0.055 * k, 0.19))
    model.add("black", stretched(ball(0.05, 48, 24), 1, 0.5, 1), (0, 0.928, 0.1))
    for side in (-1, 1):
        model.add("steel", tube([[0, 0.94, 0.1], [side * 0.1, 1.15, 0.09], [side * 0.2, 1.36, 0.08]], 0.003, 10))
    return model


def _curtain(width: float, height: float) -> tuple[Array, Any, Array]:
    """Cloth in folds, hanging in the plane of x and y."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.5, 0.5, 120), np.linspace(-0.5, 0.5, 9), indexing="ij"))
    z = 0.02 * np.sin(9 * np.pi * x) * (1.1 - 0.4 * y)
    points, faces = np.stack([width * x, height * y, z], -1), grid(120, 9)
    return points, faces, smooth_normals(points, faces)
