"""Scenes of the thesis on global lines [Castro 2002], made anew: it names what is in them, but no measures,
reflectances or lights.

Lengths are metres, z is up, a lamp is a flat box under the ceiling whose underside shines. Solids end some millimetres
before each other: rays cannot tell apart faces in the same place. All is diffuse and cut into patches, whose size
``detail`` divides.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...meshes import Mesh, MeshDescription, box, joined
from ..pieces import Array, Range, camera, diffuse, rgb
from ..solids import about

#: How far solids end before each other.
GAP = 0.005
_GREY, _WHITE, _PALE = (0.5,) * 3, (0.8,) * 3, (0.7,) * 3
_CREAM, _BROWN = (0.7, 0.68, 0.6), (0.4, 0.25, 0.15)


class Blocks:
    """Things made of quadrilaterals, with a reflectance and an emission (W/m^2) of each. ``view``: origin, target and
    angle of the camera."""

    def __init__(self, detail: float, *view: Any) -> None:
        self.detail = detail
        self.view = view
        self._parts: list[tuple[str, Mesh, Array, Array]] = []

    def add(self, name: str, mesh: Mesh, reflectance: ArrayLike, emission: ArrayLike = 0.0) -> None:
        """A part of a thing; properties are one colour, or one for each face."""
        faces = np.zeros((len(mesh[1]), 1))
        self._parts.append((name, mesh, faces + np.atleast_2d(reflectance), faces + np.atleast_2d(emission)))

    def block(self, low: ArrayLike, high: ArrayLike, cell: float, inward: bool = False) -> Mesh:
        """A box, its edges cut into parts of about ``cell``."""
        size = np.asarray(high, dtype=float) - np.asarray(low, dtype=float)
        return box(low, high, np.maximum(np.rint(size / cell * self.detail), 1).astype(int), inward)

    def room(self, size: Sequence[float], cell: float, walls: Sequence[ArrayLike]) -> None:
        """From the origin on; ``walls`` are the reflectances of low x, high x, low y, high y, floor, ceiling."""
        mesh = self.block((0, 0, 0), size, cell, inward=True)
        corner = mesh[0][mesh[1]]
        flat = [(corner[:, :, axis] == end).all(axis=1) for axis in range(3) for end in (0, size[axis])]
        self.add("room", mesh, np.array([np.atleast_1d(wall) for wall in walls], dtype=float)[np.argmax(flat, axis=0)])

    def put(
        self, name: str, meshes: list[Mesh], x: float, y: float, colour: Any, turn: float = 0, z: float = 0
    ) -> None:
        """A thing, turned by degrees about the vertical and moved."""
        for points, faces in meshes:
            self.add(name, (points @ about(2, turn).T + [x, y, z], faces), colour)

    def cube(self, x: float, y: float, edge: float, cell: float, colour: ArrayLike, turn: float = 0.0) -> None:
        """On the floor, around (x, y)."""
        mesh = self.block((-edge / 2, -edge / 2, GAP), (edge / 2, edge / 2, GAP + edge), cell)
        self.put(f"cube-{len(self._parts)}", [mesh], x, y, colour, turn)

    def lamp(self, x: float, y: float, z: float, size: float, cell: float, light: ArrayLike) -> None:
        """A square whose underside at height z emits ``light``; all of it is white."""
        mesh = self.block((x - size / 2, y - size / 2, z), (x + size / 2, y + size / 2, z + 0.03), cell)
        below = (mesh[0][mesh[1]][:, :, 2] == z).all(axis=1)
        rho = np.full(np.size(light), 0.8)
        self.add(f"lamp-{len(self._parts)}", mesh, rho, below[:, None] * np.atleast_1d(light))

    def patches(self) -> tuple[Array, NDArray[np.int64], Array, Array, NDArray[np.int64]]:
        """Vertices (v, 3), quadrilaterals (m, 4), reflectances and emissions (m, c), and for each the number of its
        thing, -1 for the room."""
        channels = max(rho.shape[1] for _, _, rho, _ in self._parts)
        rho, light = (
            np.concatenate([np.broadcast_to(part[k], (len(part[k]), channels)) for part in self._parts]) for k in (2, 3)
        )
        names = [name for name, *_ in self._parts]
        things = dict(zip(dict.fromkeys(n for n in names if n != "room"), range(len(names)), strict=False))
        numbers = [np.full(len(part[2]), things.get(part[0], -1)) for part in self._parts]
        return *joined(*(part[1] for part in self._parts)), rho, light, np.concatenate(numbers)

    def scene(self) -> dict[str, Any]:
        """As a scene of Mitsuba: a mesh for each thing, or for what of it has one colour and light."""
        origin, target, fov = self.view
        found: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "path"},
            "sensor": camera(origin, target, fov, up=(0, 0, 1)),
        }
        vertices, faces, rho, light, things = self.patches()
        look = np.column_stack([things, np.broadcast_to(rho, (len(rho), 3)), np.broadcast_to(light, (len(rho), 3))])
        kinds, kind = np.unique(look, axis=0, return_inverse=True)
        names = list(dict.fromkeys(name for name, *_ in self._parts if name != "room"))
        for k, (thing, *colours) in enumerate(kinds):
            quads = faces[kind.ravel() == k]
            triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
            used, triangles = np.unique(triangles[triangles[:, 1] != triangles[:, 2]], return_inverse=True)
            name = f"{names[int(thing)] if thing >= 0 else 'room'}-{k}"
            emitter = rgb(*(x / np.pi for x in colours[3:])) if any(colours[3:]) else None
            found[name] = MeshDescription(
                name, vertices[used], triangles.reshape(-1, 3), diffuse(*colours[:3]), emitter=emitter
            )
        return found


# -- furniture, around the origin


def _legs(width: float, depth: float, height: float, thick: float) -> list[Mesh]:
    """Four, from the floor up to ``height``, one patch a side."""
    x, y, half = (width - thick) / 2, (depth - thick) / 2, np.full(2, thick / 2)
    ends = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    return [box([*(end - half), GAP], [*(end + half), height - GAP]) for end in ends]


def _table(scene: Blocks, width: float, depth: float) -> list[Mesh]:
    """0.75 m high."""
    top = scene.block((-width / 2, -depth / 2, 0.71), (width / 2, depth / 2, 0.75), 0.35)
    return [top, *_legs(width - 0.1, depth - 0.1, 0.71, 0.06)]


def _chair(scene: Blocks) -> list[Mesh]:
    """Its back on the side of high y."""
    seat = scene.block((-0.21, -0.21, 0.42), (0.21, 0.21, 0.45), 0.25)
    back = scene.block((-0.21, 0.18, 0.45 + GAP), (0.21, 0.21, 0.9), 0.25)
    return [seat, back, *_legs(0.42, 0.42, 0.42, 0.04)]


def _desk(scene: Blocks) -> list[Mesh]:
    """0.75 m high, a plate on a panel at one side and drawers at the other."""
    top = scene.block((-0.75, -0.35, 0.71), (0.75, 0.35, 0.75), 0.35)
    panel = scene.block((-0.75, -0.35, GAP), (-0.71, 0.35, 0.71 - GAP), 0.35)
    return [top, panel, scene.block((0.35, -0.3, GAP), (0.75, 0.35, 0.71 - GAP), 0.35)]


def _shelf(scene: Blocks) -> list[Mesh]:
    """1 m wide, 2 m high, 0.3 m deep: two sides and five boards."""
    sides = [scene.block((x, -0.15, GAP), (x + 0.03, 0.15, 2.0), 0.3) for x in (-0.5, 0.47)]
    boards = [((-0.47 + GAP, -0.15, z), (0.47 - GAP, 0.15, z + 0.03)) for z in (0.1, 0.55, 1.0, 1.45, 1.9)]
    return [*sides, *(scene.block(*board, 0.3) for board in boards)]


# -- scenes


def six_cubes(detail: float = 1.0, for_factors: bool = False) -> Blocks:
    """Room of 5 x 4 x 3 m: walls reflect 0.6, the floor 0.4, the ceiling 0.75. Six cubes with edges of 0.5 to 0.9 m,
    turned at will, that reflect 0.2 to 0.8. A lamp of 0.8 x 0.8 m at 2.9 m emits 100 W/m^2.

    for_factors: walls in patches of about 2 m, cubes in four a face.
    """
    scene = Blocks(detail, (0.1, 1.95, 2.5), (2.9, 2.0, 0.4), 80.0)
    scene.room((5, 4, 3), 2.0 if for_factors else 0.5, [0.6, 0.6, 0.6, 0.6, 0.4, 0.75])
    for x, y, edge, colour, turn in (
        (0.9, 0.8, 0.8, 0.3, 20),
        (2.5, 0.9, 0.6, 0.6, -15),
        (4.1, 0.8, 0.9, 0.5, 40),
        (0.9, 3.1, 0.7, 0.8, 0),
        (2.6, 2.9, 0.9, 0.2, 30),
        (4.2, 3.2, 0.5, 0.7, -35),
    ):
        scene.cube(x, y, edge, edge / 2 if for_factors else 0.25, colour, turn)
    scene.lamp(2.5, 2.0, 2.9, 0.8, 0.8 if for_factors else 0.4, 100.0)
    return scene


def room(detail: float = 1.0, cell: float = 0.35) -> Blocks:
    """Room of 5 x 4 x 2.6 m: a red wall (0.6, 0.2, 0.15) and a blue one (0.2, 0.3, 0.6), the others cream, the floor
    wood, the ceiling white. A brown table with four chairs, a grey desk with one, and on them five coloured things. A
    lamp of 0.8 x 0.8 m at 2.5 m emits (100, 95, 85) W/m^2. ``cell``: of the walls."""
    scene, grey = Blocks(detail, (3.7, 0.15, 2.1), (2.4, 2.4, 0.5), 80.0), (0.5, 0.5, 0.52)
    scene.room((5, 4, 2.6), cell, [(0.6, 0.2, 0.15), (0.2, 0.3, 0.6), _CREAM, _CREAM, (0.45, 0.32, 0.2), _WHITE])
    scene.put("table", _table(scene, 1.4, 0.9), 1.7, 1.9, _BROWN)
    for k, (x, y, turn) in enumerate(((1.3, 2.75, 0), (2.1, 2.75, 10), (1.3, 1.05, 180), (2.1, 1.05, 170))):
        scene.put(f"chair-{k}", _chair(scene), x, y, _BROWN, turn)
    scene.put("desk", _desk(scene), 4.55, 2.0, grey, 90)
    scene.put("desk-chair", _chair(scene), 3.75, 2.0, grey, 80)
    for name, x, y, size, colour in (
        ("box", 1.4, 1.8, (0.25, 0.18, 0.12), (0.7, 0.6, 0.1)),
        ("can", 1.9, 2.1, (0.12, 0.12, 0.25), (0.15, 0.6, 0.25)),
        ("tray", 2.1, 1.7, (0.2, 0.3, 0.04), (0.75, 0.75, 0.7)),
        ("screen", 4.6, 1.6, (0.3, 0.3, 0.35), (0.1, 0.1, 0.12)),
        ("books", 4.5, 2.4, (0.21, 0.3, 0.06), (0.6, 0.1, 0.3)),
    ):
        low = np.array([-size[0] / 2, -size[1] / 2, 0])
        scene.put(name, [scene.block(low, low + size, 0.2)], x, y, colour, 100 * x, 0.75 + GAP)
    scene.lamp(2.5, 2.0, 2.5, 0.8, 0.4, (100, 95, 85))
    return scene


def office(detail: float = 1.0) -> Blocks:
    """Office of 8 x 6 x 2.8 m: desks with chairs, three in a row, two and one by itself, and two shelves of five boards
    at the walls. A lamp of 1.6 x 1.6 m at 2.7 m emits (60, 60, 55) W/m^2."""
    pale, wood, grey = (0.7, 0.7, 0.65), (0.5, 0.38, 0.25), (0.4, 0.4, 0.42)
    scene = Blocks(3.0 * detail, (0.3, 0.25, 2.1), (4.4, 3.7, 0.6), 76.0)
    scene.room((8, 6, 2.8), 1.05, [pale, pale, (0.3, 0.5, 0.4), pale, (0.3, 0.3, 0.35), _WHITE])
    for k, (x, y) in enumerate(((1.3, 1.6), (2.9, 1.6), (4.5, 1.6), (1.5, 4.4), (3.1, 4.4), (6.2, 3.6))):
        scene.put(f"desk-{k}", _desk(scene), x, y, wood)
        scene.put(f"chair-{k}", _chair(scene), x, y - 0.6, grey, 180)
    for x, y in ((6.6, 5.75), (7.3, 0.25)):
        scene.put(f"shelf-{y:.0f}", _shelf(scene), x, y, wood)
    scene.lamp(4.0, 3.0, 2.7, 1.6, 0.4, (60, 60, 55))
    return scene


def four_chairs(detail: float = 1.0) -> Blocks:
    """Room of 3.6 x 3.6 x 2.5 m that reflects 0.6, floor 0.3. A table of 1.2 x 0.8 m (0.5) and a chair at each of its
    sides (0.4). A lamp of 0.6 x 0.6 m at 2.4 m emits 100 W/m^2."""
    scene = Blocks(detail, (0.2, 0.25, 1.9), (2.1, 2.1, 0.55), 72.0)
    scene.room((3.6, 3.6, 2.5), 0.4, [0.6, 0.6, 0.6, 0.6, 0.3, 0.6])
    scene.put("table", _table(scene, 1.2, 0.8), 1.8, 1.8, 0.5)
    for k, (x, y, turn) in enumerate(((1.8, 2.7, 0), (1.8, 0.9, 180), (2.8, 1.8, -90), (0.8, 1.8, 90))):
        scene.put(f"chair-{k}", _chair(scene), x, y, 0.4, turn)
    scene.lamp(1.8, 1.8, 2.4, 0.6, 0.3, 100.0)
    return scene


def nine_cubes(detail: float = 1.0, for_factors: bool = False) -> Blocks:
    """Cubic room of 4 m that reflects 0.5, walls in patches of 1 m. Two groups of four cubes of 0.4 m, 0.2 m apart, in
    opposite corners, and one of 0.6 m by itself, one patch a face; they reflect 0.7. A lamp of 0.8 x 0.8 m at 3.9 m
    emits 100 W/m^2.

    for_factors: walls in patches of 4/3 m, cubes in four a face.
    """
    scene, parts = Blocks(detail, (0.2, 3.75, 2.6), (2.3, 1.7, 0.5), 78.0), 2 if for_factors else 1
    scene.room((4, 4, 4), 4 / 3 if for_factors else 1.0, [0.5] * 6)
    for x, y in ((0.9, 0.9), (3.1, 3.1)):
        for dx, dy in ((-0.3, -0.3), (0.3, -0.3), (-0.3, 0.3), (0.3, 0.3)):
            scene.cube(x + dx, y + dy, 0.4, 0.4 / parts, 0.7)
    scene.cube(3.0, 1.0, 0.6, 0.6 / parts, 0.7, turn=25)
    scene.lamp(2.0, 2.0, 3.9, 0.8, 0.8, 100.0)
    return scene


def test_one(detail: float = 1.0, for_factors: bool = False) -> Blocks:
    """Cubic room of 3 m that reflects 0.6. A cube of 0.8 m (0.7), a pyramid of four sides, 1 m high on a square of
    0.9 m (0.4), and a lamp of 1 x 1 m at 2.9 m that emits 50 W/m^2.

    for_factors: walls in patches of 1.5 m, the pyramid in four a side.
    """
    scene = Blocks(detail, (0.15, 2.7, 1.8), (1.75, 1.2, 0.5), 80.0)
    scene.room((3, 3, 3), 1.5 if for_factors else 0.6, [0.6] * 6)
    scene.cube(0.9, 0.9, 0.8, 0.4, 0.7, turn=20)
    scene.put("pyramid", [_pyramid(0.45, 1.0, for_factors)], 2.1, 2.0, 0.4, 10, GAP)
    scene.lamp(1.5, 1.5, 2.9, 1.0, 1.0, 50.0)
    return scene


def bleed_box(detail: float = 1.0) -> Blocks:
    """Cubic room of 3 m: grey (0.5), the wall of low x red (0.7, 0.1, 0.1), that of high x green (0.1, 0.6, 0.1). A
    white (0.8) cube of 1 m floats in its middle. A lamp of 0.8 x 0.8 m at 2.9 m emits 100 W/m^2."""
    scene = Blocks(detail, (0.15, 0.2, 2.45), (1.75, 1.75, 1.3), 80.0)
    scene.room((3, 3, 3), 0.25, [(0.7, 0.1, 0.1), (0.1, 0.6, 0.1), _GREY, _GREY, _GREY, _GREY])
    scene.add("cube", scene.block((1, 1, 1), (2, 2, 2), 0.2), _WHITE)
    scene.lamp(1.5, 1.5, 2.9, 0.8, 0.2, (100.0,) * 3)
    return scene


def curved(detail: float = 1.0, colour: bool = False) -> Blocks:
    """Room of 4 x 4 x 3 m that reflects 0.5; or its wall of low x blue (0.15, 0.25, 0.7), that of high x orange (0.75,
    0.4, 0.1) and its floor green (0.1, 0.6, 0.1). White (0.8) are a sphere with a radius of 0.6 m, a column with one of
    0.35 m, 1.6 m high, and half a pipe of 0.5 m. A lamp of 1 x 1 m at 2.9 m emits 100 W/m^2."""
    scene = Blocks(detail, (2.0, 0.1, 1.8), (2.0, 2.6, 0.7), 80.0)
    coloured = [(0.15, 0.25, 0.7), (0.75, 0.4, 0.1), _GREY, _GREY, (0.1, 0.6, 0.1), _GREY]
    scene.room((4, 4, 3), 0.4, coloured if colour else [_GREY] * 6)
    around = max(round(36 * detail), 8)
    angle = np.pi * np.arange(around // 2 + 1) / (around // 2)
    sphere = [(0.6 * np.sin(t), -0.6 * np.cos(t)) for t in angle]
    rows = max(round(10 * detail), 2)
    column = [(0, 0), *((0.35, z) for z in np.linspace(0, 1.6, rows + 1)), (0, 1.6)]
    scene.put("sphere", [_wound(sphere, around)], 1.1, 2.1, _WHITE, z=0.75)
    scene.put("column", [_wound(column, around)], 3.1, 2.2, _WHITE, z=GAP)
    scene.put("pipe", [_half_pipe(0.5, 1.4, around // 2, max(round(8 * detail), 2))], 2.0, 3.2, _WHITE, z=0.55)
    scene.lamp(2.0, 2.0, 2.9, 1.0, 0.25, (100.0,) * 3)
    return scene


def three_lamps(detail: float = 1.0) -> Blocks:
    """Hall of 9 x 7 x 3 m that reflects 0.6. Partitions of 3 x 2.2 m (0.7) divide it into three booths that are open to
    the front and above. In each a grey table and, at 2.15 m, a lamp of 0.5 x 0.5 m: 200, 50 and 12 W/m^2. A booth with
    its partitions, table and lamp is a thing."""
    scene = Blocks(detail, (4.5, 0.2, 1.75), (4.5, 5.0, 1.15), 82.0)
    scene.room((9, 7, 3), 0.5, [(0.6,) * 3] * 6)
    for booth, power in enumerate((200.0, 50.0, 12.0)):
        x, name, first = 0.2 + 3 * booth, f"booth-{booth}", len(scene._parts)
        for low, high in (
            ((x, 4.0, GAP), (x + 0.05, 6.8, 2.2)),
            ((x + 2.55, 4.0, GAP), (x + 2.6, 6.8, 2.2)),
            ((x, 6.8 + GAP, GAP), (x + 2.6, 6.85, 2.2)),
        ):
            scene.add(name, scene.block(low, high, 0.35), _PALE)
        scene.add(name, scene.block((x + 0.8, 4.9, 0.7), (x + 1.8, 5.9, 0.75), 0.25), _GREY)
        scene.lamp(x + 1.3, 5.4, 2.15, 0.5, 0.25, (power,) * 3)
        scene._parts[first:] = [(name, *part[1:]) for part in scene._parts[first:]]
    return scene


# -- solids that are no boxes


def _pyramid(half: float, height: float, is_cut: bool) -> Mesh:
    """On a square; if it ``is_cut``, its sides and base consist of four faces each."""
    k, n = np.arange(4), (np.arange(4) + 1) % 4
    points = np.zeros((14, 3))  # corners, tip, middles of the edges below and above, middle of the base
    points[:4, :2], points[4, 2] = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]), height
    points[5:9], points[9:13] = (points[k] + points[n]) / 2, (points[k] + points[4]) / 2
    if not is_cut:
        return points[:5], np.array([[0, 3, 2, 1], *np.stack([k, n, 0 * k + 4, 0 * k + 4], 1)])
    corners = [(k, 5 + k, 9 + k, 9 + k), (5 + k, n, 9 + n, 9 + n), (5 + k, 9 + n, 9 + k, 9 + k)]
    corners += [(9 + k, 9 + n, 0 * k + 4, 0 * k + 4), (k, 5 + (k + 3) % 4, 0 * k + 13, 5 + k)]
    return points, np.concatenate([np.stack(faces, 1) for faces in corners])


def _wound(profile: Sequence[Range], around: int) -> Mesh:
    """The solid of a (radius, height) profile from below, about the vertical; it ends in fans of triangles."""
    phi = 2 * np.pi * np.arange(around) / around
    ways = np.stack([np.cos(phi), np.sin(phi), np.zeros(around)], axis=1)
    points, faces = _wrapped(np.concatenate([r * ways + [0, 0, z] for r, z in profile[1:-1]]), len(profile) - 2)
    j, after, last = np.arange(around), (np.arange(around) + 1) % around, len(points) - around
    low = np.stack([np.full(around, len(points)), after, j, j], axis=1)
    high = np.stack([np.full(around, len(points) + 1), last + j, last + after, last + after], axis=1)
    ends = [(0, 0, profile[0][1]), (0, 0, profile[-1][1])]
    return np.concatenate([points, ends]), np.concatenate([faces, low, high])


def _wrapped(points: Array, rows: int) -> Mesh:
    """Quadrilaterals between ``rows`` of points that lie around an axis, the last next to the first."""
    around = len(points) // rows
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rows - 1), np.arange(around), indexing="ij"))
    a, b = i * around + j, i * around + (j + 1) % around
    return points, np.stack([a, b, b + around, a + around], axis=1)


def _half_pipe(radius: float, length: float, around: int, rows: int) -> Mesh:
    """Lying along x, its hollow side up: a shell of 2 cm, closed all round."""
    angle = np.pi + np.pi * np.arange(around + 1) / around
    outer = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius
    profile = np.concatenate([outer, outer[::-1] * (radius - 0.02) / radius])
    count = len(profile)
    xs = np.linspace(-length / 2, length / 2, rows + 1)
    points, faces = _wrapped(np.concatenate([np.column_stack([np.full(count, x), profile]) for x in xs]), rows + 1)
    k = np.arange(around)
    near = np.stack([k, k + 1, count - 2 - k, count - 1 - k], axis=1)
    return points, np.concatenate([faces, near[:, ::-1], near + rows * count])
