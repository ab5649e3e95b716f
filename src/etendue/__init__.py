"""étendue: global illumination for Mitsuba 3 scenes.

``import etendue`` registers the Mitsuba integrators of all methods but ``path``; :func:`render` and :func:`start`
render any scene with any method without them.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from . import core as core, plugins as plugins
from .api import render as render, resume as resume, start as start
from .core import (
    BackendError as BackendError,
    CheckpointError as CheckpointError,
    ClusterError as ClusterError,
    EtendueError as EtendueError,
    OptionError as OptionError,
    OutputError as OutputError,
    SceneError as SceneError,
    UnsupportedError as UnsupportedError,
)
from .engine import Session as Session
from .jobs import (
    FormFactorResult as FormFactorResult,
    RadiosityResult as RadiosityResult,
    Rendering as Rendering,
    Update as Update,
)
from .plugins import register_method

if TYPE_CHECKING:
    from .conformance import check as check
    from .jobs import ParticleResult as ParticleResult
    from .mapping import map_particles as map_particles
    from .solving import (
        compute_form_factors as compute_form_factors,
        solve_radiosity as solve_radiosity,
        start_form_factors as start_form_factors,
        start_radiosity as start_radiosity,
    )
    from .tracing import read_particles as read_particles, trace_particles as trace_particles
    from .viewer import Viewer as Viewer, view as view
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


register = register_method
plugins.register()  # in every Mitsuba variant that is set, now or later
