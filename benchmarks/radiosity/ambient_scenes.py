"""Scenes of the chapter on ambient terms, made anew like those of :mod:`benchmarks.radiosity.scenes`.

============= ==================================================================================== ======= ========
scene         content                                                                              patches channels
============= ==================================================================================== ======= ========
bleed-box     grey cubic room with a red wall and a green one, a white cube in the middle, a lamp     1062 3
curved        white sphere, column and half-pipe in a grey room, a lamp                               1988 3
curved-colour the same with walls of colour                                                           1988 3
three-lamps   light hall with three booths, each with a table and a lamp of its own power             2154 3
============= ==================================================================================== ======= ========

Figure 6.4 has a scene that is not described; here it is ``room``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from etendue.core import Array
from etendue.radiosity import Patches
from etendue.surfaces import triangles

from .scenes import GAP, Mesh, _Builder, placed, room

_GREY, _WHITE, _RED, _GREEN = (0.5,) * 3, (0.8,) * 3, (0.7, 0.1, 0.1), (0.1, 0.6, 0.1)


@dataclass(frozen=True)
class Shown:
    """A scene and where it is looked at from. ``parts``: (n,) the sub-scene of each patch, -1 for none."""

    patches: Patches
    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float
    parts: Array | None = field(default=None)

    def mitsuba(self, size: tuple[int, int]) -> dict[str, Any]:
        """As a scene of Mitsuba: a mesh of all faces, and a camera."""
        import mitsuba as mi

        corners, _ = triangles(self.patches.faces)
        mesh = mi.Mesh("patches", len(self.patches.vertices), len(corners))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(self.patches.vertices, np.float32).ravel()
        parameters["faces"] = np.ascontiguousarray(corners, np.uint32).ravel()
        parameters.update()
        camera = {
            "type": "perspective",
            "fov": self.fov,
            "fov_axis": "larger",
            "to_world": mi.ScalarTransform4f().look_at(self.origin, self.target, (0, 0, 1)),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1]},
        }
        return {"type": "scene", "patches": mesh, "camera": camera}


def interior(detail: float = 1.0) -> Shown:
    """``room``, without its wall of low y, through which it is seen."""
    return Shown(room(detail), (4.2, 0.25, 1.7), (1.9, 2.6, 0.7), 75)


def bleed_box(detail: float = 1.0) -> Shown:
    """Cubic room of 3 m: grey (0.5), the wall of low x red (0.7, 0.1, 0.1), that of high x green (0.1, 0.6, 0.1). A
    white (0.8) cube of 1 m floats in its middle. A lamp of 0.8 x 0.8 m at 2.9 m emits 100 W/m^2."""
    scene = _Builder(detail)
    scene.room((3, 3, 3), 0.25, [_RED, _GREEN, _GREY, _GREY, _GREY, _GREY])
    scene.add(scene.block((1, 1, 1), (2, 2, 2), 0.2), _WHITE)
    scene.lamp(1.5, 1.5, 2.9, 0.8, 0.2, (100.0,) * 3)
    return Shown(scene.patches(), (0.15, 0.2, 2.45), (1.75, 1.75, 1.3), 80)


def curved(detail: float = 1.0, colour: bool = False) -> Shown:
    """Room of 4 x 4 x 3 m that reflects 0.5; or its wall of low x blue (0.15, 0.25, 0.7), that of high x orange (0.75,
    0.4, 0.1) and its floor green (0.1, 0.6, 0.1). White (0.8) are a sphere with a radius of 0.6 m, a column with one of
    0.35 m, 1.6 m high, and half a pipe of 0.5 m. A lamp of 1 x 1 m at 2.9 m emits 100 W/m^2."""
    scene = _Builder(detail)
    blue, orange = (0.15, 0.25, 0.7), (0.75, 0.4, 0.1)
    scene.room((4, 4, 3), 0.4, [blue, orange, _GREY, _GREY, _GREEN, _GREY] if colour else [_GREY] * 6)
    around = max(round(36 * detail), 8)
    scene.add(placed(_sphere(0.6, around), 1.1, 2.1, 0.75), _WHITE)
    scene.add(placed(_column(0.35, 1.6, around, max(round(10 * detail), 2)), 3.1, 2.2, GAP), _WHITE)
    scene.add(placed(_half_pipe(0.5, 1.4, around // 2, max(round(8 * detail), 2)), 2.0, 3.2, 0.55), _WHITE)
    scene.lamp(2.0, 2.0, 2.9, 1.0, 0.25, (100.0,) * 3)
    return Shown(scene.patches(), (2.0, 0.1, 1.8), (2.0, 2.6, 0.7), 80)


def curved_colour(detail: float = 1.0) -> Shown:
    """:func:`curved` with walls of colour."""
    return curved(detail, colour=True)


def three_lamps(detail: float = 1.0) -> Shown:
    """Hall of 9 x 7 x 3 m that reflects 0.6. Partitions of 3 x 2.2 m (0.7) divide it into three booths that are open to
    the front and above. In each a grey table and, at 2.15 m, a lamp of 0.5 x 0.5 m: 200, 50 and 12 W/m^2. A booth with
    its partitions, table and lamp is a sub-scene."""
    scene = _Builder(detail)
    scene.room((9, 7, 3), 0.5, [(0.6,) * 3] * 6)
    sizes = [sum(len(mesh[1]) for mesh in scene.meshes)]
    parts = [-1]
    for booth, power in enumerate((200.0, 50.0, 12.0)):
        before = sum(len(mesh[1]) for mesh in scene.meshes)
        x = 0.2 + 3 * booth
        for low, high in (
            ((x, 4.0, GAP), (x + 0.05, 6.8, 2.2)),
            ((x + 2.55, 4.0, GAP), (x + 2.6, 6.8, 2.2)),
            ((x, 6.8 + GAP, GAP), (x + 2.6, 6.85, 2.2)),
        ):
            scene.add(scene.block(low, high, 0.35), (0.7,) * 3)
        scene.add(scene.block((x + 0.8, 4.9, 0.7), (x + 1.8, 5.9, 0.75), 0.25), _GREY)
        scene.lamp(x + 1.3, 5.4, 2.15, 0.5, 0.25, (power,) * 3)
        sizes.append(sum(len(mesh[1]) for mesh in scene.meshes) - before)
        parts.append(booth)
    return Shown(scene.patches(), (4.5, 0.1, 1.7), (4.5, 5, 1.2), 85, np.repeat(parts, sizes))


def _wrapped(points: Array, rows: int) -> Mesh:
    """Quadrilaterals between ``rows`` of points that lie around an axis, the last next to the first."""
    around = len(points) // rows
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rows - 1), np.arange(around), indexing="ij"))
    after = (j + 1) % around
    return points, np.stack(
        [i * around + j, i * around + after, (i + 1) * around + after, (i + 1) * around + j], axis=1
    )


def _sphere(radius: float, around: int) -> Mesh:
    """Around the origin; at the poles quadrilaterals shrink to triangles."""
    rows = around // 2
    theta = np.pi * np.arange(1, rows) / rows
    phi = 2 * np.pi * np.arange(around) / around
    ring = np.stack([np.cos(phi), np.sin(phi), np.zeros(around)], axis=1)
    points = np.concatenate([np.sin(t) * ring - [0, 0, np.cos(t)] for t in theta]) * radius
    points, faces = _wrapped(points, rows - 1)
    j = np.arange(around)
    south, north, last = len(points), len(points) + 1, (rows - 2) * around
    low = np.stack([np.full(around, south), (j + 1) % around, j, j], axis=1)
    high = np.stack([np.full(around, north), last + j, last + (j + 1) % around, last + (j + 1) % around], axis=1)
    poles = np.array([[0, 0, -radius], [0, 0, radius]])
    return np.concatenate([points, poles]), np.concatenate([faces, low, high])


def _column(radius: float, height: float, around: int, rows: int) -> Mesh:
    """On the origin, its ends fans of triangles."""
    phi = 2 * np.pi * np.arange(around) / around
    ring = radius * np.stack([np.cos(phi), np.sin(phi), np.zeros(around)], axis=1)
    levels = np.linspace(0, height, rows + 1)
    points, faces = _wrapped(np.concatenate([ring + np.array([0, 0, z]) for z in levels]), rows + 1)
    j, top = np.arange(around), rows * around
    after = (j + 1) % around
    lid = np.stack([np.full(around, len(points)), top + j, top + after, top + after], axis=1)
    base = np.stack([np.full(around, len(points) + 1), after, j, j], axis=1)
    ends = np.array([[0, 0, height], [0, 0, 0]])
    return np.concatenate([points, ends]), np.concatenate([faces, lid, base])


def _half_pipe(radius: float, length: float, around: int, rows: int) -> Mesh:
    """Lying along x, its hollow side up: a shell of 2 cm, closed all round."""
    angle = np.pi + np.pi * np.arange(around + 1) / around
    outer = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius
    profile = np.concatenate([outer, outer[::-1] * (radius - 0.02) / radius])
    count = len(profile)
    xs = np.linspace(-length / 2, length / 2, rows + 1)
    points = np.concatenate([np.column_stack([np.full(count, x), profile]) for x in xs])
    points, faces = _wrapped(points, rows + 1)
    k = np.arange(around)
    near = np.stack([k, k + 1, count - 2 - k, count - 1 - k], axis=1)
    ends = np.concatenate([near[:, ::-1], near + rows * count])
    return points, np.concatenate([faces, ends])


AMBIENT_SCENES: dict[str, Callable[[float], Shown]] = {
    "interior": interior,
    "bleed-box": bleed_box,
    "curved": curved,
    "curved-colour": curved_colour,
    "three-lamps": three_lamps,
}
