"""The errors of this room."""

from __future__ import annotations

from etendue.core import OptionError, SceneError


class PatchError(SceneError):
    """Patches that are broken: a vertex that is no number, a face without area, a reflectance that is none. One line
    that says which, and what to do."""


class RadiosityError(OptionError):
    """Lines, form factors or a solution that cannot be had as asked. One line that says why, and what to do."""
