"""Pieces of the bundled scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import mitsuba as mi


def placed(centre: tuple[float, ...], size: tuple[float, ...]) -> mi.ScalarTransform4f:
    """Transform of Mitsuba's cube to a box of these sides."""
    import mitsuba as mi

    return mi.ScalarTransform4f().translate(list(centre)).scale([side / 2 for side in size])


def box(centre: tuple[float, ...], size: tuple[float, ...], bsdf: dict[str, Any]) -> dict[str, Any]:
    """A box of these sides."""
    return {"type": "cube", "to_world": placed(centre, size), "bsdf": bsdf}


def rgb(*value: float) -> dict[str, Any]:
    """A colour."""
    return {"type": "rgb", "value": list(value)}


def diffuse(*value: float) -> dict[str, Any]:
    """A diffuse material of this reflectance."""
    return {"type": "diffuse", "reflectance": rgb(*value)}
