"""Scenes of the thesis, made anew: it names what is in them, but no measures, reflectances or lights.

Lengths are metres, z is up, a lamp is a flat box under the ceiling whose underside shines. Solids end some millimetres
before each other: rays cannot tell apart faces in the same place. ``detail`` divides the size of the patches.

================== =============================================================================== ======= ========
scene              content                                                                         patches channels
================== =============================================================================== ======= ========
six-cubes          grey room with six grey cubes on its floor and one lamp                             740 1
room               coloured room: table with four chairs, desk with a chair, small objects, a lamp    1110 3
four-chairs        table and four chairs in a plain room, a lamp                                       664 1
nine-cubes         cubic room, two groups of four cubes and one by itself, a lamp                      156 1
test-one           cubic room with a large lamp, a cube and a pyramid                                  185 1
six-cubes-factors  for form factors: larger patches on walls, four on a face of a cube                 174 1
nine-cubes-factors the same                                                                            276 1
test-one-factors   larger patches on walls, four on a side of the pyramid                               74 1
================== =============================================================================== ======= ========
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.core import Array
from etendue.radiosity import Patches, box, joined

Mesh = tuple[Array, NDArray[np.int64]]

#: How far solids end before each other.
GAP = 0.005


class _Builder:
    """Meshes with a reflectance and an emission for every face."""

    def __init__(self, detail: float) -> None:
        self.detail = detail
        self.meshes: list[Mesh] = []
        self.reflectance: list[Array] = []
        self.emission: list[Array] = []

    def add(self, mesh: Mesh, reflectance: ArrayLike, emission: ArrayLike = 0.0) -> None:
        """Properties are one colour, or one for each face."""
        count = len(mesh[1])
        rho, light = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (reflectance, emission))
        self.meshes.append(mesh)
        self.reflectance.append(np.broadcast_to(rho, (count, rho.shape[1])))
        self.emission.append(np.broadcast_to(light, (count, light.shape[1])))

    def block(self, low: ArrayLike, high: ArrayLike, cell: float, inward: bool = False) -> Mesh:
        """A box, its edges cut into parts of about ``cell``."""
        size = np.asarray(high, dtype=float) - np.asarray(low, dtype=float)
        return box(low, high, np.maximum(np.rint(size / cell * self.detail), 1).astype(int), inward)

    def room(self, size: Sequence[float], cell: float, walls: Sequence[ArrayLike]) -> None:
        """From the origin on; ``walls`` are the reflectances of low x, high x, low y, high y, floor, ceiling."""
        mesh = self.block((0, 0, 0), size, cell, inward=True)
        corner = mesh[0][mesh[1]]
        flat = [(corner[:, :, axis] == end).all(axis=1) for axis in range(3) for end in (0, size[axis])]
        self.add(mesh, np.array([np.atleast_1d(wall) for wall in walls], dtype=float)[np.argmax(flat, axis=0)])

    def cube(self, x: float, y: float, edge: float, cell: float, colour: ArrayLike, turn: float = 0.0) -> None:
        """On the floor, around (x, y), turned by degrees."""
        half = edge / 2
        mesh = self.block((-half, -half, GAP), (half, half, GAP + edge), cell)
        self.add(placed(mesh, x, y, turn=turn), colour)

    def lamp(self, x: float, y: float, z: float, size: float, cell: float, light: ArrayLike) -> None:
        """A square whose underside at height z emits ``light``; all of it is white."""
        half = size / 2
        mesh = self.block((x - half, y - half, z), (x + half, y + half, z + 0.03), cell)
        below = (mesh[0][mesh[1]][:, :, 2] == z).all(axis=1)
        self.add(mesh, np.full(np.size(light), 0.8), below[:, None] * np.atleast_1d(light))

    def patches(self) -> Patches:
        """All of it."""
        channels = max(rho.shape[1] for rho in self.reflectance)
        rho, light = (
            np.concatenate([np.broadcast_to(rows, (len(rows), channels)) for rows in lists])
            for lists in (self.reflectance, self.emission)
        )
        return Patches(*joined(*self.meshes), reflectance=rho, emission=light)


def placed(mesh: Mesh, x: float, y: float, z: float = 0.0, turn: float = 0.0) -> Mesh:
    """Turned by degrees about the vertical through the origin, and moved."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return mesh[0] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [x, y, z], mesh[1]


def six_cubes(detail: float = 1.0, for_factors: bool = False) -> Patches:
    """Room of 5 x 4 x 3 m: walls reflect 0.6, the floor 0.4, the ceiling 0.75. Six cubes with edges of 0.5 to 0.9 m,
    turned at will, that reflect 0.2 to 0.8. A lamp of 0.8 x 0.8 m at 2.9 m emits 100 W/m^2.

    for_factors: walls in patches of about 2 m, cubes in four a face.
    """
    scene = _Builder(detail)
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
    return scene.patches()


def room(detail: float = 1.0) -> Patches:
    """Room of 5 x 4 x 2.6 m: a red wall (0.6, 0.2, 0.15) and a blue one (0.2, 0.3, 0.6), the others cream, the floor
    wood, the ceiling white. A brown table with four chairs, a grey desk with one, and on them five coloured things. A
    lamp of 0.8 x 0.8 m at 2.5 m emits (100, 95, 85) W/m^2."""
    cream, wood, brown, grey = (0.7, 0.68, 0.6), (0.45, 0.32, 0.2), (0.4, 0.25, 0.15), (0.5, 0.5, 0.52)
    scene = _Builder(detail)
    scene.room((5, 4, 2.6), 0.35, [(0.6, 0.2, 0.15), (0.2, 0.3, 0.6), cream, cream, wood, (0.8, 0.8, 0.8)])
    for mesh in _table(scene, 1.4, 0.9):
        scene.add(placed(mesh, 1.7, 1.9), brown)
    for x, y, turn in ((1.3, 2.75, 0), (2.1, 2.75, 10), (1.3, 1.05, 180), (2.1, 1.05, 170)):
        for mesh in _chair(scene):
            scene.add(placed(mesh, x, y, turn=turn), brown)
    for mesh in _desk(scene):
        scene.add(placed(mesh, 4.55, 2.0, turn=90), grey)
    for mesh in _chair(scene):
        scene.add(placed(mesh, 3.75, 2.0, turn=80), grey)
    for x, y, size, colour in (
        (1.4, 1.8, (0.25, 0.18, 0.12), (0.7, 0.6, 0.1)),
        (1.9, 2.1, (0.12, 0.12, 0.25), (0.15, 0.6, 0.25)),
        (2.1, 1.7, (0.2, 0.3, 0.04), (0.75, 0.75, 0.7)),
        (4.6, 1.6, (0.3, 0.3, 0.35), (0.1, 0.1, 0.12)),
        (4.5, 2.4, (0.21, 0.3, 0.06), (0.6, 0.1, 0.3)),
    ):
        low = np.array([-size[0] / 2, -size[1] / 2, 0])
        scene.add(placed(scene.block(low, low + size, 0.2), x, y, 0.75 + GAP, turn=100 * x), colour)
    scene.lamp(2.5, 2.0, 2.5, 0.8, 0.4, (100, 95, 85))
    return scene.patches()


def four_chairs(detail: float = 1.0) -> Patches:
    """Room of 3.6 x 3.6 x 2.5 m that reflects 0.6, floor 0.3. A table of 1.2 x 0.8 m (0.5) and a chair at each of its
    sides (0.4). A lamp of 0.6 x 0.6 m at 2.4 m emits 100 W/m^2."""
    scene = _Builder(detail)
    scene.room((3.6, 3.6, 2.5), 0.4, [0.6, 0.6, 0.6, 0.6, 0.3, 0.6])
    for mesh in _table(scene, 1.2, 0.8):
        scene.add(placed(mesh, 1.8, 1.8), 0.5)
    for x, y, turn in ((1.8, 2.7, 0), (1.8, 0.9, 180), (2.8, 1.8, -90), (0.8, 1.8, 90)):
        for mesh in _chair(scene):
            scene.add(placed(mesh, x, y, turn=turn), 0.4)
    scene.lamp(1.8, 1.8, 2.4, 0.6, 0.3, 100.0)
    return scene.patches()


def nine_cubes(detail: float = 1.0, for_factors: bool = False) -> Patches:
    """Cubic room of 4 m that reflects 0.5, walls in patches of 1 m. Two groups of four cubes of 0.4 m, 0.2 m apart, in
    opposite corners, and one of 0.6 m by itself, one patch a face; they reflect 0.7. A lamp of 0.8 x 0.8 m at 3.9 m
    emits 100 W/m^2.

    for_factors: walls in patches of 4/3 m, cubes in four a face.
    """
    scene, parts = _Builder(detail), 2 if for_factors else 1
    scene.room((4, 4, 4), 4 / 3 if for_factors else 1.0, [0.5] * 6)
    for x, y in ((0.9, 0.9), (3.1, 3.1)):
        for dx, dy in ((-0.3, -0.3), (0.3, -0.3), (-0.3, 0.3), (0.3, 0.3)):
            scene.cube(x + dx, y + dy, 0.4, 0.4 / parts, 0.7)
    scene.cube(3.0, 1.0, 0.6, 0.6 / parts, 0.7, turn=25)
    scene.lamp(2.0, 2.0, 3.9, 0.8, 0.8, 100.0)
    return scene.patches()


def test_one(detail: float = 1.0, for_factors: bool = False) -> Patches:
    """Cubic room of 3 m that reflects 0.6. A cube of 0.8 m (0.7), a pyramid of four sides, 1 m high on a square of
    0.9 m (0.4), and a lamp of 1 x 1 m at 2.9 m that emits 50 W/m^2.

    for_factors: walls in patches of 1.5 m, the pyramid in four a side.
    """
    scene = _Builder(detail)
    scene.room((3, 3, 3), 1.5 if for_factors else 0.6, [0.6] * 6)
    scene.cube(0.9, 0.9, 0.8, 0.4, 0.7, turn=20)
    corners = np.array([[-0.45, -0.45, 0], [0.45, -0.45, 0], [0.45, 0.45, 0], [-0.45, 0.45, 0], [0, 0, 1.0]])
    sides = np.array([[0, 3, 2, 1], [0, 1, 4, 4], [1, 2, 4, 4], [2, 3, 4, 4], [3, 0, 4, 4]])
    pyramid = Patches(corners, sides).subdivided(0.25 / detail**2 if for_factors else 1.0)
    scene.add(placed((pyramid.vertices, pyramid.faces), 2.1, 2.0, GAP, turn=10), 0.4)
    scene.lamp(1.5, 1.5, 2.9, 1.0, 1.0, 50.0)
    return scene.patches()


def _legs(width: float, depth: float, height: float, thick: float) -> list[Mesh]:
    """Four, from the floor up to ``height``, one patch a side."""
    x, y = (width - thick) / 2, (depth - thick) / 2
    ends = np.array([(-x, -y), (x, -y), (x, y), (-x, y)])
    half = np.full(2, thick / 2)
    return [box([*(end - half), GAP], [*(end + half), height - GAP]) for end in ends]


def _table(scene: _Builder, width: float, depth: float) -> list[Mesh]:
    """0.75 m high, around the origin."""
    top = scene.block((-width / 2, -depth / 2, 0.71), (width / 2, depth / 2, 0.75), 0.35)
    return [top, *_legs(width - 0.1, depth - 0.1, 0.71, 0.06)]


def _chair(scene: _Builder) -> list[Mesh]:
    """Its back on the side of high y."""
    seat = scene.block((-0.21, -0.21, 0.42), (0.21, 0.21, 0.45), 0.25)
    back = scene.block((-0.21, 0.18, 0.45 + GAP), (0.21, 0.21, 0.9), 0.25)
    return [seat, back, *_legs(0.42, 0.42, 0.42, 0.04)]


def _desk(scene: _Builder) -> list[Mesh]:
    """0.75 m high, a plate on a panel at one side and drawers at the other."""
    top = scene.block((-0.75, -0.35, 0.71), (0.75, 0.35, 0.75), 0.35)
    panel = scene.block((-0.75, -0.35, GAP), (-0.71, 0.35, 0.71 - GAP), 0.35)
    drawers = scene.block((0.35, -0.3, GAP), (0.75, 0.35, 0.71 - GAP), 0.35)
    return [top, panel, drawers]


def _for_factors(scene: Callable[..., Patches]) -> Callable[[float], Patches]:
    return lambda detail: scene(detail, for_factors=True)


SCENES: dict[str, Callable[[float], Patches]] = {
    "six-cubes": six_cubes,
    "room": room,
    "four-chairs": four_chairs,
    "nine-cubes": nine_cubes,
    "test-one": test_one,
    "six-cubes-factors": _for_factors(six_cubes),
    "nine-cubes-factors": _for_factors(nine_cubes),
    "test-one-factors": _for_factors(test_one),
}
