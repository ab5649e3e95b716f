"""The errors of patches and surfaces."""

from __future__ import annotations

from etendue.core import OptionError, SceneError


class PatchError(SceneError):
    """Invalid patches: a vertex that is not finite, a face without area, a reflectance outside [0, 1]. The message is
    one line with the element and a remedy."""


class SurfaceError(OptionError):
    """Values, texture coordinates or temperatures that do not fit the surfaces. The message is one line with the reason
    and a remedy."""
