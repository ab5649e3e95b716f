"""The image methods by name: those of étendue and those of other packages.

A package adds a method by an entry point of the group ``etendue.methods``, named like the method::

    [project.entry-points."etendue.methods"]
    occlusion = "my_package:Occlusion"

A program can add one by :func:`register`. The method can then be used in the command line, ``compare``, run files,
checkpoints and as a Mitsuba plugin like any other.
"""

from __future__ import annotations

import functools
import inspect
import re
from importlib.metadata import EntryPoint, entry_points

from etendue.core import OptionError, bibliography, describe, logger, suggest

from .adaptive.stratified import StratifiedPath
from .adaptive.vegas import VegasPath
from .ambient import AmbientLight, AmbientPath
from .auto import Auto
from .base import ImageMethod, ImageSettings
from .bidirectional import Bpm, Bpt, Vcm
from .caching import IrradianceCaching
from .guided import Guided
from .light import LightTracing
from .metropolis.filmchains import FilmMetropolis
from .metropolis.mmlt import Mmlt
from .metropolis.pssmlt import Pssmlt
from .path import Path
from .photon.map import Pm
from .photon.progressive import Ppm, Sppm

#: Entry points of other packages.
GROUP = "etendue.methods"

_OWN: tuple[type[ImageMethod], ...] = (
    Auto,
    Path,
    Guided,
    VegasPath,
    StratifiedPath,
    LightTracing,
    Pm,
    Ppm,
    Sppm,
    Bpt,
    Bpm,
    Vcm,
    Pssmlt,
    Mmlt,
    FilmMetropolis,
    IrradianceCaching,
    AmbientPath,
    AmbientLight,
)
_methods: dict[str, type[ImageMethod]] = {cls.name: cls for cls in _OWN}
#: Methods of other packages that could not be loaded, with the cause.
_broken: dict[str, str] = {}


def register(method: type[ImageMethod]) -> type[ImageMethod]:
    """Add a method under its ``name``, and return it; can be used as a decorator.

    A class of the same module and name replaces an earlier one. Raises :class:`OptionError` if the argument is not a
    subclass of :class:`ImageMethod` with ``render_pass`` and ``Settings``, if its name is not valid or already used, or
    if it cites a paper that is not in étendue's bibliography.
    """
    if not (isinstance(method, type) and issubclass(method, ImageMethod)):
        raise OptionError(f"a method is a subclass of etendue.methods.ImageMethod, not {method!r}")
    where, name = _place(method), getattr(method, "name", None)
    if inspect.isabstract(method):
        raise OptionError(f"method {where} has no render_pass")
    settings = getattr(method, "Settings", None)
    if not (isinstance(settings, type) and issubclass(settings, ImageSettings)):
        raise OptionError(f"method {where} needs Settings, a subclass of etendue.methods.ImageSettings")
    if not (isinstance(name, str) and re.fullmatch(r"[a-z][a-z0-9_]*", name)):
        raise OptionError(f"method {where} needs a name of small letters, digits and underscores, not {name!r}")
    for other in _methods.values():
        if ({name, method.plugin_name()} - {""}) & {other.name, other.plugin_name()} and _place(other) != where:
            raise OptionError(f"method {where}: the name '{name}' is used by {_place(other)}; choose another name")
    unknown = sorted(set(method.citations) - bibliography().keys())
    if unknown:
        raise OptionError(
            f"method {where} cites {unknown[0]}, which is not in étendue's bibliography; remove the citation"
        )
    _methods[name] = method
    return method


def _place(method: type[ImageMethod]) -> str:
    """Module and name of a class."""
    return f"{method.__module__}.{method.__qualname__}"


def table() -> dict[str, type[ImageMethod]]:
    """Names and classes: étendue's own in the order of the manual, then those of other packages."""
    _load_entry_points()
    return dict(_methods)


def get(name: str) -> type[ImageMethod]:
    """The class of a method. Raises :class:`OptionError` if there is none, with the nearest name, or if its package
    cannot be loaded, with the cause."""
    methods = table()
    if not isinstance(name, str):
        raise OptionError(f"a method is chosen by its name, not by {name!r}")
    if name in methods:
        return methods[name]
    if name in _broken:
        raise OptionError(f"method '{name}' cannot be loaded: {_broken[name]}")
    raise OptionError(f"no method '{name}'; {suggest(name, methods)}")


def by_plugin(name: str) -> type[ImageMethod] | None:
    """The class of the method whose Mitsuba integrator has the name ``name``; None if there is none."""
    return next((method for method in table().values() if name and method.plugin_name() == name), None)


@functools.cache
def _load_entry_points() -> None:
    """Register the methods of other packages, once per process. A method that cannot be loaded causes a warning, and an
    error when it is used."""
    for point in entry_points(group=GROUP):
        try:
            _register_entry_point(point)
        except Exception as error:  # the code of another package can raise anything
            _broken[point.name] = f"{point.value}: {describe(error)}"
            logger.warning("method '%s' of another package cannot be loaded: %s", point.name, _broken[point.name])


def _register_entry_point(point: EntryPoint) -> None:
    method = point.load()
    name = getattr(method, "name", None)
    if name != point.name:
        raise OptionError(f"the entry point '{point.name}' refers to a method with the name {name!r}; both must agree")
    register(method)
