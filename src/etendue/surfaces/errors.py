"""The errors of this room."""

from __future__ import annotations

from etendue.core import OptionError, SceneError


class PatchError(SceneError):
    """Patches that are broken: a vertex that is not finite, a face without area, a reflectance outside [0, 1]. One line
    that says which, and what to do."""


class SurfaceError(OptionError):
    """Values, texture coordinates or temperatures that do not fit the surfaces. One line that says why, and what to
    do."""
