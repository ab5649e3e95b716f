"""Scenes: loading, the capability check, fingerprints, bundled scenes, the light table, Mitsuba plugins of our own."""

from .bundled import BundledScene, bundled
from .camera import Camera
from .capability import check
from .fingerprint import fingerprint
from .graph import materials
from .lights import Light, LightTable
from .loading import integrator_of, load, resized
from .plugins import register
from .problem import Problem

__all__ = [
    "BundledScene",
    "Camera",
    "Light",
    "LightTable",
    "Problem",
    "bundled",
    "check",
    "fingerprint",
    "integrator_of",
    "load",
    "materials",
    "register",
    "resized",
]
