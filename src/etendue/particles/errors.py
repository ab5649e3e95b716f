"""Errors of particles."""

from __future__ import annotations

from etendue.core import OptionError


class ParticleError(OptionError):
    """Particles, or a file of particles, that cannot be used."""
