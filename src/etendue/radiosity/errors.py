"""The errors of radiosity."""

from __future__ import annotations

from etendue.core import OptionError


class RadiosityError(OptionError):
    """Lines, form factors or a solution that cannot be computed as requested. The message is one line with the reason
    and a remedy."""
