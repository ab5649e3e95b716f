"""Hallway: a long passage with a polished floor, doors, a console with glass on it, sconces, and a window at its end.

The lamps of the sconces shine at the wall and the ceiling only; the window lights the floor at a grazing angle.
"""

from __future__ import annotations

from typing import Any

from ..pieces import diffuse, lamp, matt, rectangle, rgb, walls
from ..solids import GAP, Model, about, ball, box, ring, turned
from .furniture import framed, furniture, painting, plant, view

#: Half the width, height, z of the end and of the wall behind the camera.
_HALF, _HEIGHT, _BACK, _FRONT = 1.2, 2.8, -13.0, 2.0
#: Middles of the doors in the left and the right wall, half their width, and the sconces between them.
_DOORS, _DOOR = ((-2.6, -6.6, -10.6), (-4.6, -8.6)), 0.5
_SCONCES = ((-1, -4.6), (1, -2.6), (-1, -8.6), (1, -6.6), (1, -10.6), (-1, -0.6))


def hallway() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 240 000 triangles."""
    import mitsuba as mi

    model = furniture(carpet=matt(0.33, 0.05, 0.05), border=matt(0.45, 0.33, 0.16))
    for side, doors in zip((-1, 1), _DOORS, strict=True):
        turn = about(1, -90.0 * side)
        for z in doors:
            model.put(_door(), (side * (_HALF - 0.001), 0.0, z), turn)
        edges = [_BACK, *(z + end * (_DOOR + 0.09) for z in doors[::-1] for end in (-1, 1)), _FRONT]
        for z0, z1 in zip(edges[::2], edges[1::2], strict=True):
            _panelling(model, side, z0, z1)
    shapes = {f"lamp-{k}": _sconce(model, side, z) for k, (side, z) in enumerate(_SCONCES)}
    _console(model)
    for width, material, y in ((1.1, "border", 0.008), (0.96, "carpet", 0.011)):
        model.add(material, box((width, 0.006, 10.5), 0.002), (0.0, y - 0.003, -5.6))
    floor = {
        "type": "checkerboard",
        "color0": rgb(0.60, 0.57, 0.51),
        "color1": rgb(0.11, 0.11, 0.12),
        "to_uv": mi.ScalarTransform4f().scale([6, 37.5, 1]),
    }
    wall, ceiling = matt(0.62, 0.50, 0.34), matt(0.80, 0.79, 0.76)
    stone = {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": floor}}
    return {
        "type": "scene",
        "integrator": {"type": "vcm"},
        "sensor": view((0.3, 1.5, 1.6), (-0.05, 1.2, -5.0), 60.0),
        **walls((-_HALF, _HALF), (0.0, _HEIGHT), (_BACK, _FRONT), wall, floor=stone, ceiling=ceiling),
        **_window(model),
        **shapes,
        **model.shapes(),
    }


def _door() -> Model:
    """A white door of four panels in its frame, with a brass knob."""
    model = furniture()
    for side in (-1, 1):
        model.add("white", box((0.09, 2.19, 0.05), 0.01), (side * (_DOOR + 0.045), 1.095, 0.02))
    model.add("white", box((2 * _DOOR, 0.09, 0.05), 0.01), (0.0, 2.145, 0.02))
    model.add("white", box((2 * _DOOR - 0.006, 2.094, 0.02), 0.002), (0.0, 1.05, 0.0))
    for x in (-0.23, 0.23):
        for y, high in ((0.5, 0.66), (1.48, 0.98)):
            model.add("white", box((0.34, high, 0.02), 0.009), (x, y, 0.009))
    model.add("brass", turned("0,0 2.4,0 2.4,.4 .9,.8 .9,3 2.6,4 2.8,5.5 2,6.8 0,7"), (0.43, 1.03, 0.01), about(0, 90))
    return model


def _panelling(model: Model, side: int, z0: float, z1: float) -> None:
    """Wooden boards up to the height of a chair's back, with raised panels and a rail."""
    x, middle, length = side * (_HALF - 0.011), (z0 + z1) / 2, z1 - z0
    model.add("white", box((0.02, 0.86, length), 0.003), (x, 0.431, middle))
    model.add("white", box((0.06, 0.045, length), 0.012), (x - side * 0.02, 0.885, middle))
    model.add("white", box((0.035, 0.13, length), 0.008), (x - side * 0.012, 0.066, middle))
    count = max(round(length / 0.62), 1)
    for k in range(count):
        z = z0 + (k + 0.5) * length / count
        model.add("white", box((0.02, 0.52, length / count - 0.14), 0.009), (x - side * 0.009, 0.5, z))


def _sconce(model: Model, side: int, z: float) -> dict[str, Any]:
    """A brass bowl on the wall, open above; its lamp."""
    x, y = side * (_HALF - 0.16), 1.95
    bowl = "1,-7 6,-5 11,2 12,6 11.6,6 10.5,2.2 5.7,-4.6 1,-6.6"
    model.add("brass", ring(bowl, 64, 5), (x, y, z))
    model.add("brass", ball(0.018, 32, 16), (x, y - 0.068, z))
    model.add("brass", box((0.13, 0.016, 0.016), 0.004), (x + side * 0.085, y - 0.067, z))
    model.add("brass", box((0.012, 0.16, 0.09), 0.004), (side * (_HALF - 0.006), y - 0.05, z))
    return lamp((x, y + 0.015, z), 0.03, 520.0, 390.0, 240.0)


def _console(model: Model) -> None:
    """A narrow table under a mirror, with glass and a plant; pictures farther on."""
    x, z = _HALF - 0.2, -0.9
    model.add("dark-wood", box((0.34, 0.03, 1.1), 0.008), (x, 0.8, z))
    model.add("dark-wood", box((0.28, 0.09, 1.0), 0.004), (x, 0.739, z))
    leg = turned("0,0 1.2,0 1.6,2 1,6 2.2,55 2.4,66 2.4,69.4 0,69.4", 32)
    for dx in (-0.11, 0.11):
        for dz in (-0.45, 0.45):
            model.add("dark-wood", leg, (x + dx, GAP, z + dz))
    y = 0.815 + GAP
    vase = "0,0 6,0 7,1 4.5,5 9,14 8,24 4,30 6,35 5.2,35 3.2,30 7,24 8,14 3.6,6 0,3"
    model.add("sea", turned(vase, 96), (x, y, z - 0.3))
    model.add("amber", turned("0,0 5,0 5.5,1 12,6 13,9 12.3,9 11.2,6.4 4.8,2.2 0,2", 96), (x - 0.02, y, z + 0.25))
    model.add("book-1", box((0.17, 0.03, 0.24), 0.003), (x, y + 0.015, z - 0.04), about(1, 12))
    framed(model, "mirror", (0.8, 1.0), (_HALF - 0.03, 1.5, z), about(1, -90), "brass")
    plant(model, -_HALF + 0.3, -1.5, 0.8)


def _window(model: Model) -> dict[str, Any]:
    """A tall window in the end wall: a bright sky behind white bars; pictures on the walls."""
    z, black = _BACK + 0.02, diffuse(0.0, 0.0, 0.0)
    for x in (-0.5, 0.0, 0.5):
        model.add("white", box((0.06, 2.1, 0.06), 0.012), (x, 1.25, z + 0.03))
    for y in (0.2, 0.8, 1.4, 2.0, 2.3):
        model.add("white", box((1.06, 0.05, 0.05), 0.01), (0.0, y, z + 0.03))
    found = {"window": rectangle((-0.5, 0.2, z), (1.0, 0.0, 0.0), (0.0, 2.1, 0.0), black, 9.0, 10.0, 11.5)}
    for k, (side, at) in enumerate(((-1, -4.6), (1, -6.6), (-1, -8.6))):
        found[f"picture-{k}"] = painting(model, k, (side * (_HALF - 0.02), 1.45, at), about(1, -90.0 * side))
    return found
