"""Names of layers that are not light: étendue's own, and usual names in Mitsuba, where the scene chooses them."""

from __future__ import annotations

from typing import Final

ALBEDO: Final = ("albedo", "alb", "albedos")
NORMAL: Final = ("normal", "normals", "sh_normal", "nn", "sn")
#: Numbers of the first surfaces' shapes.
SHAPE: Final = ("shape", "shapes", "shape_id")
