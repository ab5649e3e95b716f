"""The scenes: those of the adaptive integrators, an office with a glossy floor, and glass in a box."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue import scene

from ..adaptive.scenes import SCENES as ADAPTIVE

#: Every scene by the name that the commands take.
SCENES: dict[str, Callable[[], Any]] = {
    **{name: ADAPTIVE[name] for name in ("cornell", "cornell-specular", "ring")},
    **{name: scene.bundled_scene(name).build for name in ("glossy-office", "cornell-glass", "ajar")},
}
#: Scenes whose materials the thesis did not sample.
WITHOUT_BSDF = ("cornell-specular",)
#: Cells along the sides of a primitive: the thesis has maps of 50 x 50 in the Cornell box.
CELLS = {"cornell": 32, "cornell-specular": 32, "ring": 50, "glossy-office": 40, "cornell-glass": 32, "ajar": 16}


def open_scene(name: str) -> scene.Problem:
    """A scene, loaded."""
    return scene.load(SCENES[name](), size=(64, 48))
