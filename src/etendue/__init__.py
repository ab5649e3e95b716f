"""étendue: global illumination for Mitsuba 3 scenes.

``import etendue`` registers the Mitsuba integrators of all methods but ``path``; :func:`render` renders any scene with
any method without them.
"""

from typing import Any as _Any

from . import (
    core as core,  # first: it finds Dr.Jit an LLVM before anything imports Dr.Jit
    plugins as plugins,
)
from .conformance import check as check
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
from .plugins import register_method as register_method
from .products import (
    FormFactorResult as FormFactorResult,
    RadiosityResult as RadiosityResult,
    Rendering as Rendering,
    Update as Update,
)
from .verbs import (
    compute_form_factors as compute_form_factors,
    map_particles as map_particles,
    read_particles as read_particles,
    render as render,
    resume as resume,
    solve_radiosity as solve_radiosity,
    trace_particles as trace_particles,
    view as view,
)

__version__ = core.VERSION
register = register_method
plugins.register()  # in every Mitsuba variant that is set, now or later


def _html_of(thing: _Any) -> str | None:
    from .products.pages.notebook import html_of  # imported late: most of it is for pages and plots

    return html_of(thing)


core.InNotebooks.make_html = staticmethod(_html_of)
