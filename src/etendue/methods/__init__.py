"""The image methods, by name."""

from __future__ import annotations

from .adaptive.stratified import StratifiedPath
from .adaptive.vegas import VegasPath
from .auto import Auto
from .base import CameraSettings, ImageMethod, ImageSettings, Layer, total
from .bidirectional import Bidirectional, Bpm, Bpt, Vcm
from .guided import Guided
from .light import LightTracing
from .metropolis.filmchains import FilmMetropolis
from .metropolis.particles import MetropolisParticles
from .particles import ParticleTracing
from .path import Path
from .photon.hits import photon_hits
from .photon.map import Pm
from .photon.progressive import Ppm, Sppm
from .registry import by_plugin, get, register, table

__all__ = [
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
    "LightTracing",
    "MetropolisParticles",
    "ParticleTracing",
    "Path",
    "Pm",
    "Ppm",
    "Sppm",
    "StratifiedPath",
    "Vcm",
    "VegasPath",
    "by_plugin",
    "get",
    "photon_hits",
    "register",
    "table",
    "total",
]
