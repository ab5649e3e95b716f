"""Particles on surfaces: records of light paths, their files and codecs."""

from .errors import ParticleError
from .particles import LAYOUT, RAW_BYTES, Particles

__all__ = ["LAYOUT", "RAW_BYTES", "ParticleError", "Particles"]
