"""The errors of file formats."""

from __future__ import annotations

from etendue.core import OptionError


class FormatError(OptionError):
    """A file that cannot be read, or arrays that a format cannot hold. The message is one line with the reason and a
    remedy."""
