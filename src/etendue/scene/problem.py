"""The input of a method: a loaded scene seen through one sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mitsuba as mi

from .fingerprints import fingerprint
from .space import RenderSpace


@dataclass(eq=False)
class Problem:
    """A Mitsuba scene, one of its sensors, and the settings of the scene file. Made by :func:`etendue.scene.load`."""

    scene: mi.Scene
    sensor: mi.Sensor  #: not one of ``scene.sensors()`` if a loaded scene was given another size
    size: tuple[int, int]  #: (width, height) of the picture in pixels: the film's crop window
    spp: int  #: the scene's own sample count per pixel
    max_depth: int = -1  #: longest path of the scene's integrator in edges, -1: unlimited
    hide_emitters: bool = False  #: of the scene's integrator
    integrator: str = ""  #: plugin name of the scene's integrator, "" if it has none
    integrator_options: dict[str, Any] = field(default_factory=dict)  #: its other plain parameters
    source: str = "<scene>"  #: path or name of the scene, for messages
    memory: int | None = None  #: memory limit for what a method stores, in bytes; None: no limit
    details: str = ""  #: parameters that only the loader can read; part of the fingerprint
    space: RenderSpace = field(default_factory=RenderSpace)  #: coordinates of ``scene`` and ``sensor``
    remarks: tuple[tuple[str, str], ...] = ()  #: ambiguous elements: (name, what is ambiguous and a remedy)

    @cached_property
    def fingerprint(self) -> str:
        """Hex digest of the scene's parameters, the sensor and the film size; the same in every process."""
        return fingerprint(self.scene, self.sensor, self.details + self._scale)

    @cached_property
    def light_fingerprint(self) -> str:
        """The digest without sensor and film, on which the light on surfaces does not depend. (In a render space other
        than the scene's own coordinates, this digest depends on the position of the sensor.)"""
        return fingerprint(self.scene, None, self.details + self._scale)

    @property
    def _scale(self) -> str:
        return "" if self.space.scale == 1.0 else f"\nscale={self.space.scale!r}"
