"""The image methods, by name."""

from __future__ import annotations

from etendue.core import OptionError, suggest

from .adaptive.stratified import Stratified
from .adaptive.vegas import Vegas
from .auto import Auto
from .base import ImageMethod, ImageSettings
from .bidirectional import Bidirectional, Bpm, Bpt, Vcm
from .guided import Guided
from .light import Light
from .path import Path
from .photon.map import Pm
from .photon.progressive import Ppm, Sppm

_METHODS: dict[str, type[ImageMethod]] = {
    cls.name: cls for cls in (Auto, Path, Guided, Vegas, Stratified, Light, Pm, Ppm, Sppm, Bpt, Bpm, Vcm)
}


def table() -> dict[str, type[ImageMethod]]:
    """Name to class, in the order of the manual."""
    return dict(_METHODS)


def get(name: str) -> type[ImageMethod]:
    """The class of a method. Raises :class:`OptionError` with the nearest name if there is none."""
    if name in _METHODS:
        return _METHODS[name]
    raise OptionError(f"no method '{name}'; {suggest(name, _METHODS)}")


__all__ = [
    "Auto",
    "Bidirectional",
    "Bpm",
    "Bpt",
    "Guided",
    "ImageMethod",
    "ImageSettings",
    "Light",
    "Path",
    "Pm",
    "Ppm",
    "Sppm",
    "Stratified",
    "Vcm",
    "Vegas",
    "get",
    "table",
]
