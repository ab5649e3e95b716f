"""The scenes of the experiments: two Cornell boxes, a ring on a floor, a sitting room. Their pixel filter is a box, as
that of a histogram of samples on the film, so that all methods make the same picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue import scene


def _boxed(name: str) -> Callable[[], dict[str, Any]]:
    """The builder of a bundled scene with a box filter."""

    def build() -> dict[str, Any]:
        made = scene.bundled_scene(name).build()
        made["sensor"]["film"]["rfilter"] = {"type": "box"}
        return made

    return build


#: Every scene by the name that the commands take. A builder returns a fresh Mitsuba dictionary; a variant must be set.
SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "cornell": _boxed("cornell-box"),
    "cornell-specular": _boxed("cornell-specular"),
    "ring": _boxed("ring"),
    "sitting-room": _boxed("sitting-room"),
}
#: The thesis's sizes of pictures, as far as it states them.
SIZES = {"cornell": (100, 100), "cornell-specular": (100, 100), "ring": (100, 75), "sitting-room": (128, 91)}


def open_scene(name: str, size: tuple[int, int]) -> scene.Problem:
    """A scene of the experiments, loaded at a size."""
    return scene.load(SCENES[name](), size=size)
