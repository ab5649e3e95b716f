"""The image methods, by name."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from .adaptive.stratified import StratifiedPath
from .adaptive.vegas import VegasPath
from .auto import Auto
from .base import CameraSettings, ImageMethod, ImageSettings, Layer, total
from .bidirectional import Bidirectional, Bpm, Bpt, Vcm
from .guided import Guided
from .light import LightTracing
from .metropolis.filmchains import FilmMetropolis
from .path import Path
from .photon.hits import photon_hits
from .photon.map import Pm
from .photon.progressive import Ppm, Sppm
from .rays import MOST_RECORDED, LightRays, ShowsRays, rays_through
from .registry import by_plugin, get, register, table

if TYPE_CHECKING:
    from .box_tracing import box_arguments, check_divisible, gathered, make_box_tracing
    from .metropolis.particles import MetropolisParticles
    from .particles import ParticleTracing
else:
    #: Modules of methods that make no picture; imported when one of their names is used.
    _LATER = {
        "MetropolisParticles": "metropolis.particles",
        "ParticleTracing": "particles",
        "box_arguments": "box_tracing",
        "check_divisible": "box_tracing",
        "gathered": "box_tracing",
        "make_box_tracing": "box_tracing",
    }

    def __getattr__(name):
        """See :data:`_LATER`."""
        if name in _LATER:
            return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "MOST_RECORDED",
    "Auto",
    "Bidirectional",
    "Bpm",
    "Bpt",
    "CameraSettings",
    "FilmMetropolis",
    "Guided",
    "ImageMethod",
    "ImageSettings",
    "Layer",
    "LightRays",
    "LightTracing",
    "MetropolisParticles",
    "ParticleTracing",
    "Path",
    "Pm",
    "Ppm",
    "ShowsRays",
    "Sppm",
    "StratifiedPath",
    "Vcm",
    "VegasPath",
    "box_arguments",
    "by_plugin",
    "check_divisible",
    "gathered",
    "get",
    "make_box_tracing",
    "photon_hits",
    "rays_through",
    "register",
    "table",
    "total",
]
