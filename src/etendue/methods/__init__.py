"""The image methods, by name."""

from typing import TYPE_CHECKING

from etendue.core import on_use

if TYPE_CHECKING:
    from .adaptive.stratified import StratifiedPath as StratifiedPath
    from .adaptive.vegas import VegasPath as VegasPath
    from .auto import Auto as Auto
    from .base import (
        CameraSettings as CameraSettings,
        ImageMethod as ImageMethod,
        ImageSettings as ImageSettings,
        Layer as Layer,
        total as total,
        warn_of_bands as warn_of_bands,
    )
    from .bidirectional import Bidirectional as Bidirectional, Bpm as Bpm, Bpt as Bpt, Vcm as Vcm
    from .box_tracing import (
        box_arguments as box_arguments,
        check_divisible as check_divisible,
        gathered as gathered,
        make_box_tracing as make_box_tracing,
    )
    from .daylight import SkySettings as SkySettings, SkyTracing as SkyTracing
    from .guided import Guided as Guided
    from .light import LightTracing as LightTracing
    from .metropolis.filmchains import FilmMetropolis as FilmMetropolis
    from .metropolis.particles import MetropolisParticles as MetropolisParticles
    from .particles import ParticleTracing as ParticleTracing
    from .path import Path as Path
    from .photon.hits import photon_hits as photon_hits
    from .photon.map import Pm as Pm
    from .photon.progressive import Ppm as Ppm, Sppm as Sppm
    from .rays import (
        LightRays as LightRays,
        ShowsRays as ShowsRays,
        rays_through as rays_through,
    )
    from .registry import (
        by_plugin as by_plugin,
        get as get,
        names as names,
        plugins as plugins,
        register as register,
        table as table,
    )
else:
    __getattr__, __dir__ = on_use(__name__)
