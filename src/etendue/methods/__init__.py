"""The image methods, by name."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from .adaptive.stratified import StratifiedPath as StratifiedPath
from .adaptive.vegas import VegasPath as VegasPath
from .auto import Auto as Auto
from .base import (
    CameraSettings as CameraSettings,
    ImageMethod as ImageMethod,
    ImageSettings as ImageSettings,
    Layer as Layer,
    total as total,
)
from .bidirectional import Bidirectional as Bidirectional, Bpm as Bpm, Bpt as Bpt, Vcm as Vcm
from .guided import Guided as Guided
from .light import LightTracing as LightTracing
from .metropolis.filmchains import FilmMetropolis as FilmMetropolis
from .path import Path as Path
from .photon.hits import photon_hits as photon_hits
from .photon.map import Pm as Pm
from .photon.progressive import Ppm as Ppm, Sppm as Sppm
from .rays import (
    MOST_RECORDED as MOST_RECORDED,
    LightRays as LightRays,
    ShowsRays as ShowsRays,
    rays_through as rays_through,
)
from .registry import by_plugin as by_plugin, get as get, register as register, table as table

if TYPE_CHECKING:
    from .box_tracing import (
        box_arguments as box_arguments,
        check_divisible as check_divisible,
        gathered as gathered,
        make_box_tracing as make_box_tracing,
    )
    from .metropolis.particles import MetropolisParticles as MetropolisParticles
    from .particles import ParticleTracing as ParticleTracing
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
