"""The error of this room."""

from __future__ import annotations

from etendue.core import EtendueError


class DensityError(EtendueError):
    """A density that cannot be estimated as asked: no samples, a bandwidth that is none, more neighbours than samples.
    One line that says which, and what to do."""
