"""The bundled scenes, by name. Every one is built by code, at the moment it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class BundledScene:
    """A scene that ships with the library. ``build()`` returns a fresh Mitsuba dictionary; a variant must be set."""

    name: str
    description: str
    build: Callable[[], dict[str, Any]]


def bundled() -> dict[str, BundledScene]:
    """Every bundled scene by name, the one for demonstration first."""
    rows = (
        ("cornell-box", "the Cornell box: diffuse walls, two boxes, an area light", cornell_box),
        ("cornell-glass", "the Cornell box with a glass ball and a box of rough gold", cornell_glass),
    )
    return {name: BundledScene(name, text, build) for name, text, build in rows}


def cornell_box() -> dict[str, Any]:
    """Mitsuba's own Cornell box."""
    import mitsuba as mi

    scene: dict[str, Any] = mi.cornell_box()
    return scene


def cornell_glass() -> dict[str, Any]:
    """The scene that costs are measured on: glass and rough metal under a small light, 512x512, depth 10."""
    import mitsuba as mi

    scene = cornell_box()
    scene["integrator"]["max_depth"] = 10
    scene["sensor"]["film"].update({"width": 512, "height": 512, "rfilter": {"type": "box"}})
    del scene["small-box"]
    scene["glass-ball"] = {
        "type": "sphere",
        "center": [0.4, -0.65, 0.3],
        "radius": 0.35,
        "bsdf": {"type": "dielectric"},
    }
    scene["large-box"]["bsdf"] = {"type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.15}
    assert isinstance(scene["large-box"]["to_world"], mi.ScalarTransform4f)
    return scene
