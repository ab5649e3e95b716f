"""Names of layers that are not light: étendue's own, and usual names in Mitsuba, where the scene chooses them."""

from __future__ import annotations

from typing import Final

#: The first of those that a picture has guides denoisers: what is seen in mirrors and through glass, if it is known.
ALBEDO: Final = ("seen_albedo", "albedo", "alb", "albedos")
NORMAL: Final = ("seen_normal", "normal", "normals", "sh_normal", "nn", "sn")
#: Variance of the picture's pixels, and with ``.`` and the name of a part of the picture, of the part's pixels.
VARIANCE: Final = "variance"
#: Numbers of the first surfaces' shapes.
SHAPE: Final = ("shape", "shapes", "shape_id")
#: Share of a pixel that is covered, by which a picture is multiplied.
ALPHA: Final = "alpha"


def variance_of(layer: str) -> str:
    """Name of the layer with the variance of ``layer``, which is the picture or a part of it."""
    return VARIANCE if layer == "image" else f"{VARIANCE}.{layer}"


def is_variance(layer: str) -> bool:
    """Whether a layer is the variance of another one."""
    return layer.partition(".")[0] == VARIANCE
