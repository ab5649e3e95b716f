"""The error of this room."""

from __future__ import annotations

from etendue.core import EtendueError


class IntegrationError(EtendueError):
    """An integral that cannot be computed as asked: an empty domain, too few samples, a density that is none, values
    that are not numbers. One line that says which, and what to do."""
