"""Scenes: loading, the capability check, fingerprints, bundled scenes and the light table."""

from .bundled import BundledScene, bundled
from .capability import check
from .fingerprint import fingerprint
from .graph import materials
from .lights import Light, LightTable
from .loading import load
from .problem import Problem

__all__ = ["BundledScene", "Light", "LightTable", "Problem", "bundled", "check", "fingerprint", "load", "materials"]
