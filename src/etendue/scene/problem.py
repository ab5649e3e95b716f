"""The input of a method: a loaded scene seen through one sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from .fingerprint import fingerprint
from .space import RenderSpace


@dataclass(eq=False)
class Problem:
    """A Mitsuba scene, one of its sensors, and the settings of the scene file. Made by :func:`etendue.scene.load`."""

    scene: Any  #: ``mi.Scene``
    sensor: Any  #: ``mi.Sensor``; not one of ``scene.sensors()`` if a loaded scene was given another size
    size: tuple[int, int]  #: (width, height) of the picture in pixels: the film's crop window
    spp: int  #: the scene's own sample count per pixel
    max_depth: int = -1  #: longest path in edges that the scene's integrator names, -1 for unlimited
    integrator: str = ""  #: plugin name of the scene's integrator, "" if it names none
    integrator_options: dict[str, Any] = field(default_factory=dict)  #: its other plain parameters
    source: str = "<scene>"  #: path or name it was loaded from, for people
    memory: int | None = None  #: bytes that a method may use for what it stores, ``None`` for no bound
    details: str = ""  #: parameters that only the loader sees; part of the fingerprint
    space: RenderSpace = field(default_factory=RenderSpace)  #: coordinates of ``scene`` and ``sensor``

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of the scene's parameters, the sensor and the film size; the same in every process."""
        scale = "" if self.space.scale == 1.0 else f"\nscale={self.space.scale!r}"
        return fingerprint(self.scene, self.sensor, self.details + scale)
