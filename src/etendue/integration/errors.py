"""The error of the integrators."""

from __future__ import annotations

from etendue.core import EtendueError


class IntegrationError(EtendueError):
    """An integral that cannot be computed as requested: an empty domain, too few samples, an invalid density, values
    that are not finite. The message is one line with the reason and a remedy."""
