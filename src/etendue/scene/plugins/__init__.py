"""étendue's own Mitsuba plugins: BSDFs ``phong``, ``ward``, ``dispersive`` and ``roughdispersive``, emitters
``focusarea``, ``luminaire`` and ``sky``, sensors ``spherical`` and ``meters``, texture ``mipmap``; and materials from
functions.

Mitsuba 3.9.1 has no plugins of these names. Each class is created when a plugin is first used under a variant, because
its base class depends on the variant; until then its module is not imported.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING

from etendue.core import check_variant

if TYPE_CHECKING:
    import mitsuba as mi

#: The module of each plugin, in which ``make_<name>`` makes its class.
_BSDFS = {"phong": "reflection", "ward": "reflection", "dispersive": "dispersive", "roughdispersive": "dispersive"}
_EMITTERS = {"focusarea": "focusarea", "luminaire": "luminaire", "sky": "sky"}
_SENSORS = {"spherical": "spherical", "meters": "meters"}
_TEXTURES = {"mipmap": "mipmap"}


def register() -> None:
    """Register the plugins with Mitsuba for the current variant; can be repeated.

    Under unsupported variants the names are registered, too, and using one raises :class:`BackendError`.
    """
    import mitsuba as mi

    tables = (
        (mi.register_bsdf, _BSDFS),
        (mi.register_emitter, _EMITTERS),
        (mi.register_sensor, _SENSORS),
        (mi.register_texture, _TEXTURES),
    )
    for announce, table in tables:
        for name, module in table.items():
            announce(name, _constructor(module, name))


def object_type(name: str) -> mi.ObjectType | None:
    """The type of object that a plugin of étendue makes; ``None`` for other names. Mitsuba knows the type only once the
    object is built."""
    import mitsuba as mi

    types = (
        (_BSDFS, mi.ObjectType.BSDF),
        (_EMITTERS, mi.ObjectType.Emitter),
        (_SENSORS, mi.ObjectType.Sensor),
        (_TEXTURES, mi.ObjectType.Texture),
    )
    return next((kind for table, kind in types if name in table), None)


def _constructor(module: str, name: str) -> Callable[[mi.Properties], mi.Object]:
    def construct(props: mi.Properties) -> mi.Object:
        import mitsuba as mi

        check_variant(mi.variant())
        return _class(module, name, mi.variant())(props)

    return construct


@lru_cache(maxsize=64)
def _class(module: str, name: str, variant: str) -> type:
    made: type = getattr(import_module(f".{module}", __name__), f"make_{name}")()
    return made
