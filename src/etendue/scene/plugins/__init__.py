"""étendue's own Mitsuba plugins: BSDFs ``phong``, ``ward``, ``dispersive`` and ``roughdispersive``, emitters
``focusarea``, ``luminaire`` and ``sky``, sensors ``spherical`` and ``meters``, texture ``mipmap``; and materials from
functions.

Mitsuba 3.9.1 has no plugins of these names. Each class is created when a plugin is first used under a variant, because
its base class depends on the variant.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

from etendue.core import check_variant

from .composed import composed_bsdf as composed_bsdf
from .dispersive import make_dispersive
from .focusarea import make_focusarea
from .luminaire import make_luminaire
from .meters import make_meters
from .mipmap import make_mipmap
from .phong import PhongLobe
from .reflection import make_reflection
from .sky import make_sky
from .spherical import make_spherical
from .ward import WardLobe

if TYPE_CHECKING:
    import mitsuba as mi


_BSDFS = {
    "phong": lambda: make_reflection(PhongLobe),
    "ward": lambda: make_reflection(WardLobe),
    "dispersive": lambda: make_dispersive(is_rough=False),
    "roughdispersive": lambda: make_dispersive(is_rough=True),
}
_EMITTERS = {"focusarea": make_focusarea, "luminaire": make_luminaire, "sky": make_sky}
_SENSORS = {"spherical": make_spherical, "meters": make_meters}
_TEXTURES = {"mipmap": make_mipmap}


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
        for name, make in table.items():
            announce(name, _constructor(make))


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


def _constructor(make: Callable[[], type]) -> Callable[[mi.Properties], mi.Object]:
    def construct(props: mi.Properties) -> mi.Object:
        import mitsuba as mi

        check_variant(mi.variant())
        return _class(make, mi.variant())(props)

    return construct


@lru_cache(maxsize=64)
def _class(make: Callable[[], type], variant: str) -> type:
    return make()
