"""The errors of this room."""

from __future__ import annotations

from etendue.core import OptionError


class FormatError(OptionError):
    """A file that cannot be read, or arrays that a format cannot hold. One line that says why, and what to do."""
