"""étendue: global illumination for Mitsuba 3 scenes.

``import etendue`` registers the Mitsuba integrators of all methods but ``path``; :func:`render` and :func:`start`
render any scene with any method without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from . import core as core  # first: it finds Dr.Jit an LLVM before anything imports Dr.Jit
from . import plugins as plugins
from .api import render, resume, start
from .core import (
    BackendError,
    CheckpointError,
    ClusterError,
    EtendueError,
    OptionError,
    OutputError,
    SceneError,
    UnsupportedError,
)
from .engine import Session
from .jobs import FormFactorResult, RadiosityResult, Rendering, Update
from .plugins import register_method as register

if TYPE_CHECKING:
    from .conformance import check
    from .jobs import ParticleResult
    from .mapping import map_particles
    from .solving import compute_form_factors, solve_radiosity, start_form_factors, start_radiosity
    from .tracing import read_particles, trace_particles
    from .viewer import Viewer, view
else:
    #: Module of each name that rendering does not need; imported when the name is used.
    _LATER = {
        "check": "conformance",
        "ParticleResult": "jobs",
        "map_particles": "mapping",
        **dict.fromkeys(
            ("compute_form_factors", "solve_radiosity", "start_form_factors", "start_radiosity"), "solving"
        ),
        **dict.fromkeys(("read_particles", "trace_particles"), "tracing"),
        **dict.fromkeys(("Viewer", "view"), "viewer"),
    }

    def __getattr__(name):
        """See :data:`_LATER`."""
        if name in _LATER:
            return getattr(import_module(f"{__name__}.{_LATER[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


plugins.register()  # in every Mitsuba variant that is set, now or later

__all__ = [
    "BackendError",
    "CheckpointError",
    "ClusterError",
    "EtendueError",
    "FormFactorResult",
    "OptionError",
    "OutputError",
    "ParticleResult",
    "RadiosityResult",
    "Rendering",
    "SceneError",
    "Session",
    "UnsupportedError",
    "Update",
    "Viewer",
    "check",
    "compute_form_factors",
    "map_particles",
    "read_particles",
    "register",
    "render",
    "resume",
    "solve_radiosity",
    "start",
    "start_form_factors",
    "start_radiosity",
    "trace_particles",
    "view",
]
