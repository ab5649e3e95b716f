"""The scenes of the experiments: two Cornell boxes, a ring on a floor, a sitting room."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue import scene

#: Every scene by the name that the commands take. A builder returns a fresh Mitsuba dictionary; a variant must be set.
SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cornell": scene.bundled_scene("cornell-box").build,
    "cornell-specular": scene.bundled_scene("cornell-specular").build,
    "ring": scene.bundled_scene("ring").build,
    "sitting-room": scene.bundled_scene("sitting-room").build,
}
#: The thesis's sizes of pictures, as far as it states them.
SIZES = {"cornell": (100, 100), "cornell-specular": (100, 100), "ring": (100, 75), "sitting-room": (128, 91)}


def open_scene(name: str, size: tuple[int, int]) -> scene.Problem:
    """A scene of the experiments, loaded at a size."""
    return scene.load(SCENES[name](), size=size)
