"""Registers methods and plugins with Mitsuba when a variant is set, and again when it changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from etendue import methods, scene
from etendue.core import logger

if TYPE_CHECKING:
    import mitsuba as mi

    from etendue.methods import ImageMethod


def register() -> None:
    """Register the methods as Mitsuba integrators, and the materials, emitters and sensors of
    :func:`etendue.scene.register`, for ``mi.load_dict``, ``mi.load_file`` and ``mi.render``. ``path`` is left out,
    because Mitsuba has a plugin of this name; ``stratified`` is ``stratified_path``.

    Can be called before or after ``mi.set_variant`` and repeatedly. Under unsupported variants the plugins are
    registered, too, and raise :class:`BackendError` when they are instantiated.
    """
    import mitsuba as mi

    mi.detail.add_variant_callback(_register)  # the callbacks are a set: repeated calls have no effect
    if mi.variant() is not None:
        _register("", mi.variant())


def register_method(method: type[ImageMethod]) -> type[ImageMethod]:
    """Register a method, a subclass of ``etendue.methods.ImageMethod``, under its ``name``; can be used as a decorator.
    The method is then available in :func:`etendue.render` and other functions, and as a Mitsuba integrator.

    For the command line and other processes, a package declares it as an entry point of the group ``etendue.methods``.
    Raises :class:`OptionError` if the name is already used or the class is not a method.
    """
    import mitsuba as mi

    methods.register(method)
    if mi.variant() is not None and method.plugin_name():
        mi.register_integrator(method.plugin_name(), _constructor(method.name))
    return method


def _register(old: str | None, new: str | None) -> None:
    """Mitsuba's callback for a change of the variant: register under the new one."""
    import mitsuba as mi

    for plugin, name in methods.plugins().items():
        mi.register_integrator(plugin, _constructor(name))
    scene.register()
    logger.debug("registered with Mitsuba under %s", new)


def _constructor(method: str) -> Callable[[mi.Properties], mi.Integrator]:
    def construct(props: mi.Properties) -> mi.Integrator:
        from .integrator import integrator_class  # imported late, as the methods are: each takes time

        return integrator_class(methods.get(method))(props)

    return construct
