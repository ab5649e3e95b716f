"""The errors of lighting data."""

from __future__ import annotations

from etendue.core import OptionError


class LightingError(OptionError):
    """Photometric files, weather data, skies or meters that are invalid. The message is one line with the reason and a
    remedy."""
