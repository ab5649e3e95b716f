"""The scenes of the experiments, built by code: three with caustics that are seen in mirrors and through glass, and one
that is all matt. Lengths are metres."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .bathroom import bathroom
from .living_room import living_room
from .mirror_balls import mirror_balls
from .plain import diffuse_room

#: Every scene by the name that the commands take. A builder returns a fresh Mitsuba dictionary; a variant must be set.
SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "mirror-balls": mirror_balls,
    "living-room": living_room,
    "bathroom": bathroom,
    "diffuse": diffuse_room,
}

__all__ = ["SCENES", "bathroom", "diffuse_room", "living_room", "mirror_balls"]
