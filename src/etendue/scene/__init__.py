"""Scenes: loading, the capability check, fingerprints, bundled scenes and the light table."""

from .bundled import BundledScene, bundled
from .capability import check
from .fingerprint import fingerprint
from .lights import Light, LightTable
from .loading import integrator_of, load
from .problem import Problem

__all__ = [
    "BundledScene",
    "Light",
    "LightTable",
    "Problem",
    "bundled",
    "check",
    "fingerprint",
    "integrator_of",
    "load",
]
