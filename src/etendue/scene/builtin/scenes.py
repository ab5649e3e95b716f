"""All bundled scenes, and the short ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import theses
from .ajar import ajar
from .caustics import caustics
from .flat import flat
from .gaps import gaps
from .pieces import camera, diffuse, rgb, sky
from .shutters import shutters
from .spectra import diamond, prism
from .street import street
from .volumes import aquarium, fog, smoke
from .yard import yard

if TYPE_CHECKING:
    import mitsuba as mi


def cornell_box() -> dict[str, Any]:
    """Mitsuba's own Cornell box."""
    import mitsuba as mi

    scene: dict[str, Any] = mi.cornell_box()
    return scene


def cornell_glass() -> dict[str, Any]:
    """The scene of the timing benchmarks: glass and rough metal under a small light, 512x512, depth 10."""
    scene = cornell_box()
    scene["integrator"]["max_depth"] = 10
    scene["sensor"]["film"] |= {"width": 512, "height": 512, "rfilter": {"type": "box"}}
    del scene["small-box"]
    scene["glass-ball"] = {
        "type": "sphere",
        "center": [0.4, -0.65, 0.3],
        "radius": 0.35,
        "bsdf": {"type": "dielectric"},
    }
    scene["large-box"]["bsdf"] = {"type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.15}
    return scene


def skylight() -> dict[str, Any]:
    """An environment map with a sun, frosted and clear glass, a principled lacquer and a thin lens."""
    import mitsuba as mi

    def ball(x: float, z: float, radius: float, bsdf: dict[str, Any]) -> dict[str, Any]:
        return {"type": "sphere", "center": [x, radius + 0.002, z], "radius": radius, "bsdf": bsdf}

    checkers = {
        "type": "checkerboard",
        "color0": rgb(0.32, 0.30, 0.28),
        "color1": rgb(0.62, 0.60, 0.55),
        "to_uv": mi.ScalarTransform4f().scale([16, 16, 1]),
    }
    lacquer = {"type": "principled", "base_color": rgb(0.55, 0.06, 0.05), "roughness": 0.25, "clearcoat": 1.0}
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 10},
        "sensor": camera((0.0, 1.6, 5.2), (0.0, 0.55, 0.0), 38.0)
        | {"type": "thinlens", "aperture_radius": 0.03, "focus_distance": 5.0},
        "sky": sky((-0.75, 0.55, -0.35), (260.0, 220.0, 165.0)),
        "ground": {
            "type": "disk",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(9.0),
            "bsdf": {"type": "diffuse", "reflectance": checkers},
        },
        "frosted": ball(-1.25, 0.0, 0.6, {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.08}),
        "clear": ball(0.05, 0.5, 0.5, {"type": "dielectric"}),
        "lacquer": ball(1.25, -0.1, 0.6, lacquer),
        "steel": ball(0.3, -1.4, 0.75, {"type": "roughconductor", "material": "Cr", "alpha": 0.15}),
    }


def stage() -> dict[str, Any]:
    """Delta lights only: two spots and a point light over glass, plastic and steel on a bare stage."""
    import mitsuba as mi

    def spot(origin: list[float], target: list[float], colour: dict[str, Any]) -> dict[str, Any]:
        look = mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0])
        return {"type": "spot", "to_world": look, "intensity": colour, "cutoff_angle": 20.0, "beam_width": 14.0}

    def wall(transform: mi.ScalarTransform4f, *value: float) -> dict[str, Any]:
        return {"type": "rectangle", "to_world": transform, "bsdf": diffuse(*value)}

    floor = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(6.0)
    back = mi.ScalarTransform4f().translate([0, 2, -2.5]).scale([6.0, 4.0, 1.0])
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 10},
        "sensor": camera((0.0, 2.2, 6.0), (0.0, 0.6, 0.0), 36.0),
        "warm": spot([-3.0, 4.0, 1.5], [-0.6, 0.4, 0.0], rgb(90.0, 62.0, 38.0)),
        "cool": spot([3.0, 4.0, 0.5], [0.8, 0.4, 0.2], rgb(30.0, 52.0, 90.0)),
        "candle": {"type": "point", "position": [0.1, 0.5, 1.5], "intensity": rgb(1.2, 0.8, 0.4)},
        "floor": wall(floor, 0.5, 0.48, 0.45),
        "back": wall(back, 0.35, 0.12, 0.12),
        "glass": {"type": "sphere", "center": [-0.7, 0.552, 0.1], "radius": 0.55, "bsdf": {"type": "dielectric"}},
        "plastic": {
            "type": "cube",
            "to_world": mi.ScalarTransform4f().translate([0.25, 0.402, -0.9]).rotate([0, 1, 0], 30).scale(0.4),
            "bsdf": {"type": "roughplastic", "diffuse_reflectance": rgb(0.1, 0.35, 0.15), "alpha": 0.1},
        },
        "steel": {
            "type": "cylinder",
            "p0": [1.1, 0.002, 0.3],
            "p1": [1.1, 0.7, 0.3],
            "radius": 0.5,
            "bsdf": {"type": "twosided", "bsdf": {"type": "conductor", "material": "Cr"}},
        },
    }


#: Names, descriptions and functions, the demonstration scene first.
SCENES = (
    (
        "caustics",
        "glass, gold and water lit by a lamp in a glass bulb: nearly all of its light is caustic",
        caustics,
    ),
    ("cornell-box", "the Cornell box: diffuse walls, two boxes, an area light", cornell_box),
    ("cornell-glass", "the Cornell box with a glass ball and a box of rough gold", cornell_glass),
    ("ajar", "a room lit through a half-open door, by a lamp in the next room that faces a wall", ajar),
    ("gaps", "a room lit through two narrow gaps, from a lamp in the second chamber behind its wall", gaps),
    ("flat", "a living room lit through a hall, by a lamp in the bedroom behind it", flat),
    ("street", "a street at night among 1,024 lanterns, most of them hidden by houses", street),
    ("yard", "a yard at dusk: a sky, a low sun, and ten lamps, one of them near", yard),
    ("shutters", "a classroom lit by sky and sun through three windows, one of them behind blinds", shutters),
    ("skylight", "frosted glass and lacquer under a sky with a low sun, through a thin lens", skylight),
    ("stage", "glass, plastic and steel under two spot lights and a point light", stage),
    ("fog", "a spot light in a foggy room: a glass ball focuses its beam in the air", fog),
    ("aquarium", "a tank of green water under the sun, whose waves focus sunlight into beams", aquarium),
    ("smoke", "smoke above a bulb of clear glass, whose light is focused on smoke and walls", smoke),
    *theses.SCENES,
)
#: Those that need a spectral variant.
OF_SPECTRA = (
    ("prism", "a sheet of white light through a prism of flint glass, onto the floor and a screen", prism),
    ("diamond", "a diamond, a sapphire and a stone of flint glass under seven small lamps", diamond),
)
