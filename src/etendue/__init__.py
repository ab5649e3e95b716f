"""étendue: global illumination for Mitsuba 3 scenes.

``import etendue`` registers the Mitsuba integrators of all methods but ``path``; :func:`render` renders any scene with
any method without them. The names below, and the packages, are imported when they are first used.
"""

import gc as _gc
from typing import TYPE_CHECKING, Any as _Any

_collects = _gc.isenabled()
_gc.disable()  # imports make many objects and no cycles
try:
    from . import core as core  # first: it finds Dr.Jit an LLVM before anything imports Dr.Jit
    from .plugins import register as _register_plugins, register_method as register_method
finally:
    if _collects:
        _gc.enable()

if TYPE_CHECKING:
    from . import (
        conformance as conformance,
        density as density,
        display as display,
        distributed as distributed,
        engine as engine,
        film as film,
        formats as formats,
        integration as integration,
        lighting as lighting,
        methods as methods,
        particles as particles,
        plugins as plugins,
        points as points,
        products as products,
        radiosity as radiosity,
        scene as scene,
        surfaces as surfaces,
        transport as transport,
        viewer as viewer,
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
    from .products import (
        DaylightResult as DaylightResult,
        FormFactorResult as FormFactorResult,
        HeatResult as HeatResult,
        RadiosityResult as RadiosityResult,
        Readings as Readings,
        Rendering as Rendering,
        Update as Update,
    )
    from .verbs import (
        compute_form_factors as compute_form_factors,
        compute_point_factors as compute_point_factors,
        daylight as daylight,
        map_particles as map_particles,
        measure as measure,
        read_particles as read_particles,
        render as render,
        resume as resume,
        solve_heat as solve_heat,
        solve_radiosity as solve_radiosity,
        sunlight as sunlight,
        trace_particles as trace_particles,
        view as view,
    )
else:
    __getattr__, __dir__ = core.on_use(__name__)

__version__ = core.VERSION
register = register_method
_register_plugins()  # in every Mitsuba variant that is set, now or later


def _html_of(thing: _Any) -> str | None:
    from .products.pages.notebook import html_of

    return html_of(thing)


core.InNotebooks.make_html = staticmethod(_html_of)
