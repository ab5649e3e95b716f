"""Registers methods and plugins with Mitsuba when a variant is set, and again when it changes."""

from __future__ import annotations

from typing import Any

from etendue import methods, scene
from etendue.core import logger

from .integrator import integrator_class


def register() -> None:
    """Make all methods but ``path``, which Mitsuba has itself, known to ``mi.load_dict``, ``mi.load_file`` and
    ``mi.render``, ``stratified`` as ``stratified_path``; and the materials, emitters and sensors of
    :func:`etendue.scene.register`.

    May be called before or after ``mi.set_variant`` and any number of times. Under unsupported variants the plugins are
    registered, too, and raise a clear error when one is instantiated.
    """
    import mitsuba as mi

    mi.detail.add_variant_callback(_register)  # a set: the same callback is kept once
    if mi.variant() is not None:
        _register("", mi.variant())


def register_method(method: Any) -> Any:
    """Register a method, a subclass of ``etendue.methods.ImageMethod``, under its ``name``; usable as a decorator. It
    is then available in :func:`etendue.render` and the other functions, and as a Mitsuba integrator.

    For the command line and other processes, a package declares it as an entry point of the group ``etendue.methods``.
    Raises :class:`OptionError` for a name that is taken, and for a class that is no method.
    """
    import mitsuba as mi

    methods.register(method)
    if mi.variant() is not None and method.plugin_name():
        mi.register_integrator(method.plugin_name(), _constructor(method))
    return method


def _register(old: str | None, new: str | None) -> None:
    """Mitsuba's variant callback: register with the variant that is current."""
    import mitsuba as mi

    for method in methods.table().values():
        if method.plugin_name():
            mi.register_integrator(method.plugin_name(), _constructor(method))
    scene.register()
    logger.debug("registered with Mitsuba under %s", new)


def _constructor(method: Any) -> Any:
    def construct(props: Any) -> Any:
        return integrator_class(method)(props)

    return construct
