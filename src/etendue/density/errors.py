"""The error of density estimation."""

from __future__ import annotations

from etendue.core import EtendueError


class DensityError(EtendueError):
    """A density that cannot be estimated as requested: no samples, an invalid bandwidth, more neighbours than samples.
    The message is one line with the reason and a remedy."""
