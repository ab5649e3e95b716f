"""Two furnished rooms whose patches know their objects, for hierarchies: the thesis's Room with two groups of objects
and Office with five, made anew as in ``scenes``.

====== =========================================================================================== ======= ========
scene  content                                                                                     patches channels
====== =========================================================================================== ======= ========
room   that of ``scenes``: a table with four chairs, a desk with a chair, five things, a lamp        10122   3
office three, two and one desks with chairs beside each other, two shelves with boards, a lamp       6790   3
====== =========================================================================================== ======= ========
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue.radiosity import Patches

from .scenes import GAP, Mesh, _Builder, _chair, _desk, _table, placed

Furnished = tuple[Patches, NDArray[np.int64]]


class _Furnisher(_Builder):
    """A builder that numbers objects; walls, that is the room, have -1."""

    def __init__(self, detail: float) -> None:
        super().__init__(detail)
        self.numbers: list[NDArray[np.int64]] = []
        self.object = -1

    def add(self, mesh: Mesh, reflectance: ArrayLike, emission: ArrayLike = 0.0) -> None:
        """Of the object that was begun last."""
        super().add(mesh, reflectance, emission)
        self.numbers.append(np.full(len(mesh[1]), self.object))

    def put(self, meshes: list[Mesh], x: float, y: float, colour: ArrayLike, turn: float = 0.0, z: float = 0.0) -> None:
        """An object."""
        self.object += 1
        for mesh in meshes:
            self.add(placed(mesh, x, y, z, turn), colour)

    def finished(self) -> Furnished:
        """Patches, and the object of each."""
        return self.patches(), np.concatenate(self.numbers)


def room(detail: float = 1.0) -> Furnished:
    """Room of 5 x 4 x 2.6 m, see ``scenes.room``, walls in patches of 0.2 m, furniture of 0.03 to 0.05 m; every chair,
    table and thing is an object."""
    cream, wood, brown, grey = (0.7, 0.68, 0.6), (0.45, 0.32, 0.2), (0.4, 0.25, 0.15), (0.5, 0.5, 0.52)
    scene = _Furnisher(6.5 * detail)
    scene.room((5, 4, 2.6), 1.25, [(0.6, 0.2, 0.15), (0.2, 0.3, 0.6), cream, cream, wood, (0.8, 0.8, 0.8)])
    scene.put(_table(scene, 1.4, 0.9), 1.7, 1.9, brown)
    for x, y, turn in ((1.3, 2.75, 0), (2.1, 2.75, 10), (1.3, 1.05, 180), (2.1, 1.05, 170)):
        scene.put(_chair(scene), x, y, brown, turn)
    scene.put(_desk(scene), 4.55, 2.0, grey, 90)
    scene.put(_chair(scene), 3.75, 2.0, grey, 80)
    for x, y, size, colour in (
        (1.4, 1.8, (0.25, 0.18, 0.12), (0.7, 0.6, 0.1)),
        (1.9, 2.1, (0.12, 0.12, 0.25), (0.15, 0.6, 0.25)),
        (2.1, 1.7, (0.2, 0.3, 0.04), (0.75, 0.75, 0.7)),
        (4.6, 1.6, (0.3, 0.3, 0.35), (0.1, 0.1, 0.12)),
        (4.5, 2.4, (0.21, 0.3, 0.06), (0.6, 0.1, 0.3)),
    ):
        low = np.array([-size[0] / 2, -size[1] / 2, 0])
        scene.put([scene.block(low, low + size, 0.2)], x, y, colour, 100 * x, 0.75 + GAP)
    scene.object += 1
    scene.lamp(2.5, 2.0, 2.5, 0.8, 0.4, (100, 95, 85))
    return scene.finished()


def office(detail: float = 1.0) -> Furnished:
    """Office of 8 x 6 x 2.8 m: desks with chairs, three in a row, two and one by itself, and two shelves of five boards
    at the walls. A lamp of 1.6 x 1.6 m at 2.7 m emits (60, 60, 55) W/m^2."""
    pale, carpet, wood, grey = (0.7, 0.7, 0.65), (0.3, 0.3, 0.35), (0.5, 0.38, 0.25), (0.4, 0.4, 0.42)
    scene = _Furnisher(3.0 * detail)
    scene.room((8, 6, 2.8), 1.05, [pale, pale, (0.3, 0.5, 0.4), pale, carpet, (0.8, 0.8, 0.8)])
    for x, y in ((1.3, 1.6), (2.9, 1.6), (4.5, 1.6), (1.5, 4.4), (3.1, 4.4), (6.2, 3.6)):
        scene.put(_desk(scene), x, y, wood)
        scene.put(_chair(scene), x, y - 0.6, grey, 180)
    for x in (6.6, 7.3):
        scene.put(_shelf(scene), x, 5.75 if x < 7 else 0.25, wood)
    scene.object += 1
    scene.lamp(4.0, 3.0, 2.7, 1.6, 0.4, (60, 60, 55))
    return scene.finished()


def _shelf(scene: _Builder) -> list[Mesh]:
    """1 m wide, 2 m high, 0.3 m deep: two sides and five boards."""
    sides = [scene.block((x, -0.15, GAP), (x + 0.03, 0.15, 2.0), 0.3) for x in (-0.5, 0.47)]
    inside = 0.47 - GAP
    return [
        *sides,
        *(scene.block((-inside, -0.15, z), (inside, 0.15, z + 0.03), 0.3) for z in (0.1, 0.55, 1.0, 1.45, 1.9)),
    ]


FURNISHED: dict[str, Callable[[float], Furnished]] = {"room": room, "office": office}
#: Patches that a box is worth: the lamps are not.
LEAST = 400
