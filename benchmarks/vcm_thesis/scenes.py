"""The scenes of the experiments: three with caustics that are seen in mirrors and through glass, and one that is all
matt."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from etendue.scene import bundled_scene

#: Every scene by the name that the commands take. A builder returns a fresh Mitsuba dictionary; a variant must be set.
SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    name: bundled_scene(name).build for name in ("mirror-balls", "living-room", "bathroom")
} | {"diffuse": bundled_scene("diffuse-room").build}
