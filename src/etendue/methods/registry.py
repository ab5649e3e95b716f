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
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from etendue.core import OptionError, bibliography, describe, logger, suggest

from .base import ImageMethod, ImageSettings

#: Entry points of other packages.
GROUP = "etendue.methods"

#: étendue's own methods in the order of the manual, each with the place of its class. They are imported when they are
#: used: each takes time.
_OWN = {
    "auto": "auto.method:Auto",
    "path": "path:Path",
    "guided": "guided:Guided",
    "vegas": "adaptive.vegas:VegasPath",
    "stratified": "adaptive.stratified:StratifiedPath",
    "light": "light:LightTracing",
    "pm": "photon.map:Pm",
    "ppm": "photon.progressive:Ppm",
    "sppm": "photon.progressive:Sppm",
    "bpt": "bidirectional.variants:Bpt",
    "bpm": "bidirectional.variants:Bpm",
    "vcm": "bidirectional.variants:Vcm",
    "pssmlt": "metropolis.pssmlt:Pssmlt",
    "mmlt": "metropolis.mmlt:Mmlt",
    "film_metropolis": "metropolis.filmchains:FilmMetropolis",
    "irradiance_cache": "caching:IrradianceCaching",
    "ambient_path": "ambient:AmbientPath",
    "ambient_light": "ambient:AmbientLight",
}
#: Names of Mitsuba integrators that are not those of the methods; "": there is none.
_OWN_PLUGINS = {"path": "", "stratified": "stratified_path", "film_metropolis": ""}
#: The methods that have been used, or registered.
_methods: dict[str, type[ImageMethod]] = {}
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
    used = {own: f"{__package__}.{place.replace(':', '.')}" for own, place in _OWN.items()}
    used |= {_OWN_PLUGINS.get(own, own): place for own, place in used.items()}
    for other in _methods.values():
        used |= dict.fromkeys((other.name, other.plugin_name()), _place(other))
    for taken in {name, method.plugin_name()} - {""}:
        if used.get(taken, where) != where:
            raise OptionError(f"method {where}: the name '{taken}' is used by {used[taken]}; choose another name")
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


def names() -> list[str]:
    """Names of the methods: étendue's own in the order of the manual, then those of other packages."""
    _load_entry_points()
    return [*_OWN, *(name for name in _methods if name not in _OWN)]


def table() -> dict[str, type[ImageMethod]]:
    """Names and classes, in the order of :func:`names`."""
    return {name: get(name) for name in names()}


def get(name: str) -> type[ImageMethod]:
    """The class of a method. Raises :class:`OptionError` if there is none, with the nearest name, or if its package
    cannot be loaded, with the cause."""
    if not isinstance(name, str):
        raise OptionError(f"a method is chosen by its name, not by {name!r}")
    if name not in _methods and name in _OWN:
        module, _, kind = _OWN[name].partition(":")
        _methods[name] = getattr(import_module(f".{module}", __package__), kind)
    if name in _methods or name in names():
        return _methods[name]
    if name in _broken:
        raise OptionError(f"method '{name}' cannot be loaded: {_broken[name]}")
    raise OptionError(f"no method '{name}'; {suggest(name, names())}")


def plugins() -> dict[str, str]:
    """Names of the Mitsuba integrators, and of their methods. Imports none of étendue's own."""
    others = {_methods[name].plugin_name(): name for name in names() if name not in _OWN}
    found = {_OWN_PLUGINS.get(name, name): name for name in _OWN} | others
    return {plugin: name for plugin, name in found.items() if plugin}


def by_plugin(name: str) -> type[ImageMethod] | None:
    """The class of the method whose Mitsuba integrator has the name ``name``; None if there is none."""
    found = plugins().get(name)
    return None if found is None else get(found)


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
