"""The scenes: those of the adaptive integrators, offices, a glass of water, and glass in a box."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue import scene

from ..adaptive.scenes import SCENES as ADAPTIVE

_BUNDLED = ("glossy-office", "diffuse-office", "glass-of-water", "cornell-glass", "ajar")
#: Every scene by the name that the commands take.
SCENES: dict[str, Callable[[], Any]] = {
    **{name: ADAPTIVE[name] for name in ("cornell", "cornell-specular", "ring")},
    **{name: scene.bundled_scene(name).build for name in _BUNDLED},
    "glossy-office-sampled": scene.bundled_scene("glossy-office").build,
}
#: Scenes whose materials the thesis did not sample: its glossy floor, too, is "a non-ideal situation for the random
#: sampler" (section 6.2.4).
WITHOUT_BSDF = ("cornell-specular", "glossy-office")
#: Cells along the sides of a primitive: the thesis has maps of 50 x 50 in the Cornell box.
CELLS = {
    **{name: 32 for name in ("cornell", "cornell-specular", "glass-of-water", "cornell-glass")},
    **{name: 40 for name in ("glossy-office", "glossy-office-sampled", "diffuse-office")},
    "ring": 50,
    "ajar": 16,
}


def open_scene(name: str) -> scene.Problem:
    """A scene, loaded."""
    return scene.load(SCENES[name](), size=(64, 48))
