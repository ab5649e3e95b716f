"""Scenes of the chapter on ambient terms, like those of :mod:`benchmarks.radiosity.scenes`.

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
from dataclasses import dataclass
from functools import partial
from typing import Any

from etendue.core import Array
from etendue.radiosity import Patches
from etendue.scene import BundledScene, Problem, load
from etendue.scene.builtin.theses import blocks

from .scenes import patches_of


@dataclass(frozen=True)
class Shown:
    """A scene with its patches. ``parts``: (n,) the sub-scene of each patch, -1 for none, if it has some."""

    scene: blocks.Blocks
    patches: Patches
    parts: Array | None

    def mitsuba(self, size: tuple[int, int]) -> Problem:
        """With its camera."""
        return load(BundledScene("ambient", "", self.scene.scene), size=size)


def _shown(build: Callable[..., blocks.Blocks], detail: float = 1.0, has_parts: bool = False, **how: Any) -> Shown:
    scene = build(detail, **how)
    patches, parts = patches_of(scene)
    return Shown(scene, patches, parts if has_parts else None)


AMBIENT_SCENES: dict[str, Callable[..., Shown]] = {
    "interior": partial(_shown, blocks.room),
    "bleed-box": partial(_shown, blocks.bleed_box),
    "curved": partial(_shown, blocks.curved),
    "curved-colour": partial(_shown, blocks.curved, colour=True),
    "three-lamps": partial(_shown, blocks.three_lamps, has_parts=True),
}
