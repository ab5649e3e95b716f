"""The bundled scenes by name, built by code on request."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from etendue.core import SceneError, suggest

from ..meshes import built


@dataclass(frozen=True)
class BundledScene:
    """A scene of the library. ``describe()`` returns a new Mitsuba dictionary in which some shapes are
    :class:`MeshDescription`; a variant must be set.

    ``reference`` is a converged picture at the scene's size, if the library has one; ``reference_note`` describes how
    it was rendered. ``is_spectral``: the scene needs a spectral variant.
    """

    name: str
    description: str
    describe: Callable[[], dict[str, Any]]
    reference: Path | None = None
    reference_note: str = ""
    is_spectral: bool = False

    def build(self) -> dict[str, Any]:
        """The dictionary with its meshes built, as Mitsuba loads it."""
        return built(self.describe())

    def __str__(self) -> str:
        return self.name


_DATA = Path(__file__).parent / "data"
_CAUSTICS_NOTE = (
    "vcm with other settings than the picture on show (a smaller first radius of one pixel, weights without discount, "
    "as many light as camera paths, another seed), 1400 samples a pixel, by tools/demo_reference.py"
)


def bundled() -> dict[str, BundledScene]:
    """Every bundled scene by name, the demonstration scene first."""
    from .scenes import OF_SPECTRA, SCENES  # imported late: files do not need them

    scenes = {name: BundledScene(name, text, describe) for name, text, describe in SCENES}
    scenes |= {name: BundledScene(name, text, describe, is_spectral=True) for name, text, describe in OF_SPECTRA}
    scenes["caustics"] = replace(scenes["caustics"], reference=_DATA / "caustics.exr", reference_note=_CAUSTICS_NOTE)
    return scenes


def bundled_scene(name: str) -> BundledScene:
    """The bundled scene of that name. Raises :class:`SceneError` if there is none."""
    scenes = bundled()
    if name not in scenes:
        raise SceneError(f"there is no bundled scene '{name}'; {suggest(name, scenes, 'there are')}")
    return scenes[name]
