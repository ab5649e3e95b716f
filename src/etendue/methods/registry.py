"""The image methods by name: étendue's own, and those of other packages.

A package adds a method by an entry point of the group ``etendue.methods``, whose name is the method's::

    [project.entry-points."etendue.methods"]
    occlusion = "my_package:Occlusion"

or a program calls :func:`register`. From then on the method is in the command line, ``compare``, run files, checkpoints
and Mitsuba's plugins like any other.
"""

from __future__ import annotations

import functools
import inspect
import re
from importlib.metadata import EntryPoint, entry_points

from etendue.core import OptionError, bibliography, describe, logger, suggest

from .adaptive.stratified import StratifiedPath
from .adaptive.vegas import VegasPath
from .auto import Auto
from .base import ImageMethod, ImageSettings
from .bidirectional import Bpm, Bpt, Vcm
from .guided import Guided
from .light import LightTracing
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
)
_methods: dict[str, type[ImageMethod]] = {cls.name: cls for cls in _OWN}
#: Methods of other packages that could not be loaded, and why.
_broken: dict[str, str] = {}


def register(method: type[ImageMethod]) -> type[ImageMethod]:
    """Add a method under its ``name``, and return it, so that it serves as a decorator.

    The same class, or a later version of its source, takes the place of an earlier one. Raises :class:`OptionError` for
    what is no subclass of :class:`ImageMethod` with ``render_pass`` and ``Settings``, a name that is taken or none, and
    citations that are not in étendue's bibliography.
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
            raise OptionError(f"method {where}: the name '{name}' is taken by {_place(other)}; choose another")
    unknown = sorted(set(method.citations) - bibliography().keys())
    if unknown:
        raise OptionError(f"method {where} cites {unknown[0]}, which is not in étendue's bibliography; leave it out")
    _methods[name] = method
    return method


def _place(method: type[ImageMethod]) -> str:
    """Where a class is from."""
    return f"{method.__module__}.{method.__qualname__}"


def table() -> dict[str, type[ImageMethod]]:
    """Name to class: étendue's own in the order of the manual, then those of other packages."""
    _load_entry_points()
    return dict(_methods)


def get(name: str) -> type[ImageMethod]:
    """The class of a method. Raises :class:`OptionError`, with the nearest name, if there is none, or with the cause if
    its package cannot be loaded."""
    methods = table()
    if name in methods:
        return methods[name]
    if name in _broken:
        raise OptionError(f"method '{name}' cannot be loaded: {_broken[name]}")
    raise OptionError(f"no method '{name}'; {suggest(name, methods)}")


def by_plugin(name: str) -> type[ImageMethod] | None:
    """The class of the method that Mitsuba knows as the integrator ``name``, if there is one."""
    return next((method for method in table().values() if name and method.plugin_name() == name), None)


@functools.cache
def _load_entry_points() -> None:
    """Once a process. A package that cannot be loaded costs a warning, and an error where its method is asked for."""
    for point in entry_points(group=GROUP):
        try:
            _register_entry_point(point)
        except Exception as error:  # a package of others may fail in any way
            _broken[point.name] = f"{point.value}: {describe(error)}"
            logger.warning("method '%s' of another package cannot be loaded: %s", point.name, _broken[point.name])


def _register_entry_point(point: EntryPoint) -> None:
    method = point.load()
    name = getattr(method, "name", None)
    if name != point.name:
        raise OptionError(f"the entry point '{point.name}' names a method that calls itself {name!r}")
    register(method)
