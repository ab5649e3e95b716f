"""Makes the methods and the rooms' plugins known to Mitsuba: once a variant is set, and again when it changes."""

from __future__ import annotations

from typing import Any

from etendue import methods, scene
from etendue.core import logger

from .integrator import integrator_class

#: Mitsuba has an integrator 'path' and a sampler 'stratified' of its own, which must stay what they are.
_MITSUBAS_OWN = ("path", "stratified")


def register() -> None:
    """Make all methods but ``path`` and ``stratified`` known to ``mi.load_dict``, ``mi.load_file`` and ``mi.render``,
    and the materials, emitters and sensors of :func:`etendue.scene.register`.

    May be called before or after ``mi.set_variant`` and any number of times. Under variants that are not supported the
    plugins are known as well, and raise one clear error when one is asked for.
    """
    import mitsuba as mi

    mi.detail.add_variant_callback(_register)  # a set: the same callback is kept once
    if mi.variant() is not None:
        _register("", mi.variant())


def _register(old: str | None, new: str | None) -> None:
    """Mitsuba's variant callback: register with the variant that is current."""
    import mitsuba as mi

    for name, method in methods.table().items():
        if name not in _MITSUBAS_OWN:
            mi.register_integrator(name, _constructor(method))
    scene.register()
    logger.debug("registered with Mitsuba under %s", new)


def _constructor(method: Any) -> Any:
    def construct(props: Any) -> Any:
        return integrator_class(method)(props)

    return construct
