"""Geometry of the test cases as Mitsuba dictionaries: a room of 4 m x 4 m x 3 m without thickness, its openings, masks,
and the points at which light is measured.

x is along the walls y = 0 and y = 4, z is up. Points A to F are in the middle of a wall, G to N of the floor, half a
metre apart, G' to N' above them on the ceiling.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Scene = dict[str, Any]
#: Low and high ends along the two edges of a rectangle.
Hole = tuple[tuple[float, float], tuple[float, float]]

WIDTH = DEPTH = 4.0
HEIGHT = 3.0
#: Half the length of masks that are said to have no end: all that a point sees of them is within 26 m.
_FAR = 100.0
X, Y, Z = np.eye(3)


def grey(value: float) -> Scene:
    """A diffuse material."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}


def rectangle(corner: ArrayLike, u: ArrayLike, v: ArrayLike, bsdf: Scene, **more: Any) -> Scene:
    """A parallelogram with a corner and two edges, that faces u x v."""
    import mitsuba as mi

    a, b = np.asarray(u, float) / 2.0, np.asarray(v, float) / 2.0
    matrix = np.eye(4)
    normal = np.cross(a, b)
    matrix[:3] = np.stack([a, b, normal / np.linalg.norm(normal), np.asarray(corner, float) + a + b], axis=1)
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf, **more}


def wall(name: str, corner: ArrayLike, u: Array, v: Array, hole: Hole | None = None, value: float = 0.0) -> Scene:
    """A rectangle with edges ``u`` and ``v``, around a hole if there is one: a part of a scene."""
    lengths = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    (a0, a1), (b0, b1) = hole or ((0.0, 0.0), (0.0, 0.0))
    pieces = {"": ((0.0, lengths[0]), (0.0, lengths[1]))}
    if hole is not None:
        pieces = {
            " below": ((0.0, lengths[0]), (0.0, b0)),
            " above": ((0.0, lengths[0]), (b1, lengths[1])),
            " left": ((0.0, a0), (b0, b1)),
            " right": ((a1, lengths[0]), (b0, b1)),
        }
    start, along, up = np.asarray(corner, float), u / lengths[0], v / lengths[1]
    return {
        name + piece: rectangle(start + s0 * along + t0 * up, (s1 - s0) * along, (t1 - t0) * up, grey(value))
        for piece, ((s0, s1), (t0, t1)) in pieces.items()
        if s1 > s0 and t1 > t0
    }


def room(roof: Hole | None = None, facade: Hole | None = None, height: float = HEIGHT, value: float = 0.0) -> Scene:
    """The room, seen from inside, with an opening in its ceiling or in its wall y = 0."""
    w, d, h = WIDTH * X, DEPTH * Y, height * Z
    return {
        "type": "scene",
        **wall("floor", (0, 0, 0), w, d, value=value),
        **_turned(wall("ceiling", (0, 0, height), w, d, roof, value=value)),
        **_turned(wall("facade", (0, 0, 0), w, h, facade, value=value)),
        **wall("back", (0, DEPTH, 0), w, h, value=value),
        **wall("left", (0, 0, 0), d, h, value=value),
        **_turned(wall("right", (WIDTH, 0, 0), d, h, value=value)),
    }


def _turned(parts: Scene) -> Scene:
    return {name: part | {"flip_normals": True} for name, part in parts.items()}


def glass(corner: ArrayLike, u: ArrayLike, v: ArrayLike, index: float) -> Scene:
    """A clear pane without thickness."""
    return rectangle(corner, u, v, {"type": "thindielectric", "int_ior": index, "ext_ior": 1.0})


def sky(kind: int, sun: Sequence[float], illuminance: float, ground: float) -> Scene:
    """A CIE general sky without the sun's own light."""
    import mitsuba as mi

    return {
        "type": "sky",
        "kind": kind,
        "sun_direction": mi.ScalarVector3f(*sun),
        "diffuse_illuminance": illuminance,
        "ground_reflectance": ground,
    }


def mask(reach: float, level: float, top: float, value: float) -> Scene:
    """See :class:`benchmarks.cie171.masks.Mask`."""
    if level:
        return rectangle((_FAR, -reach, level), -2.0 * _FAR * X, reach * Y, grey(value))
    return rectangle((_FAR, -reach, 0.0), -2.0 * _FAR * X, top * Z, grey(value))


def wall_points(y: float, names: str = "ABCDEF") -> dict[str, tuple[float, float, float]]:
    """From the top of a wall to its foot."""
    return {name: (2.0, y, 2.75 - 0.5 * k) for k, name in enumerate(names)}


def floor_points(z: float = 0.0, names: Sequence[str] = "GHIJKLMN", back: bool = False) -> dict[str, Any]:
    """From y = 0.25 on, or from y = 3.75 on back to there."""
    return {name: (2.0, 3.75 - 0.5 * k if back else 0.25 + 0.5 * k, z) for k, name in enumerate(names)}
