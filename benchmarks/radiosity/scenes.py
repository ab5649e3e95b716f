"""Scenes of the thesis as patches. They are those of ``etendue scenes``, whose docstrings give dimensions, reflectances
and emission (:mod:`etendue.scene.builtin.theses.blocks`); here a quadrilateral is a patch. ``detail`` divides the size
of the patches.

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

``FURNISHED``: rooms whose patches know their objects, for hierarchies.

====== =========================================================================================== ======= ========
scene  content                                                                                     patches channels
====== =========================================================================================== ======= ========
room   walls in patches of 0.2 m, furniture of 0.03 to 0.05 m; every chair, table, thing an object   10122   3
office three, two and one desks with chairs beside each other, two shelves with boards, a lamp        6790   3
====== =========================================================================================== ======= ========
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.radiosity import Patches
from etendue.scene.builtin.theses import blocks

Furnished = tuple[Patches, NDArray[np.int64]]


def patches_of(scene: blocks.Blocks) -> Furnished:
    """Its patches, and the object of each, -1 for the room."""
    vertices, faces, reflectance, emission, objects = scene.patches()
    return Patches(vertices, faces, reflectance=reflectance, emission=emission), objects


def _patches(build: Callable[..., blocks.Blocks], **how: Any) -> Callable[[float], Patches]:
    return lambda detail: patches_of(build(detail, **how))[0]


SCENES: dict[str, Callable[[float], Patches]] = {
    "six-cubes": _patches(blocks.six_cubes),
    "room": _patches(blocks.room),
    "four-chairs": _patches(blocks.four_chairs),
    "nine-cubes": _patches(blocks.nine_cubes),
    "test-one": _patches(blocks.test_one),
    "six-cubes-factors": _patches(blocks.six_cubes, for_factors=True),
    "nine-cubes-factors": _patches(blocks.nine_cubes, for_factors=True),
    "test-one-factors": _patches(blocks.test_one, for_factors=True),
}
FURNISHED: dict[str, Callable[[float], Furnished]] = {
    "room": lambda detail: patches_of(blocks.room(6.5 * detail, 1.25)),
    "office": lambda detail: patches_of(blocks.office(detail)),
}
#: Patches that a box is worth: the lamps are not.
LEAST = 400
