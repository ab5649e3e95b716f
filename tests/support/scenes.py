"""Small scenes by rows: emitters x materials x sensors x filters. Every entry is built when asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from etendue.scene import Material, Problem, bsdfs, load

Dict = dict[str, Any]
SIZE = (16, 12)


def rgb(*value: float) -> Dict:
    return {"type": "rgb", "value": list(value)}


def diffuse(*value: float) -> Dict:
    return {"type": "diffuse", "reflectance": rgb(*value)}


def transform() -> Any:
    return mi.ScalarTransform4f()


def bitmap(pixels: np.ndarray, raw: bool = True) -> Dict:
    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(pixels, np.float32)), "raw": raw}


def mesh(
    points: np.ndarray,
    faces: np.ndarray,
    bsdf: Dict,
    normals: np.ndarray | None = None,
    colours: np.ndarray | None = None,
    emitter: Dict | None = None,
) -> Any:
    """A mesh from arrays, with vertex normals, the attribute ``vertex_color`` and an emitter where given."""
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(bsdf)
    if emitter is not None:
        properties["mesh_emitter"] = mi.load_dict(emitter)
    result = mi.Mesh("mesh", len(points), len(faces), has_vertex_normals=normals is not None, props=properties)
    parameters = mi.traverse(result)
    parameters["vertex_positions"] = np.ascontiguousarray(points, np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = np.ascontiguousarray(normals, np.float32).ravel()
    parameters.update()
    if colours is not None:
        result.add_attribute("vertex_color", 3, np.ascontiguousarray(colours, np.float32).ravel())
    return result


# ---------------------------------------------------------------------------------------------------- sensors

SENSORS: dict[str, Dict] = {
    "perspective": {"type": "perspective"},
    "thinlens": {"type": "thinlens", "aperture_radius": 0.12, "focus_distance": 3.6},
    "orthographic": {"type": "orthographic"},
    "spherical": {"type": "spherical"},
}
FILTERS = ("box", "tent", "gaussian", "mitchell")


def camera(
    origin: Any = (0.0, 1.6, 4.2),
    target: Any = (0.0, 0.45, 0.0),
    fov: float = 36.0,
    sensor: str = "perspective",
    rfilter: str = "box",
    size: tuple[int, int] = SIZE,
) -> Dict:
    film = {
        "type": "hdrfilm",
        "width": size[0],
        "height": size[1],
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": rfilter},
    }
    if sensor == "spherical":  # in the middle of it: from afar, a lamp is a fraction of a pixel
        origin = (0.2, 1.0, 1.0)
    up = [0, 0, 1] if abs(origin[0] - target[0]) + abs(origin[2] - target[2]) < 1e-6 else [0, 1, 0]
    look = transform().look_at(list(origin), list(target), up)
    # An orthographic film is two units wide: scaled to what the others see of the middle of the room.
    views: dict[str, Dict] = {"orthographic": {"to_world": look @ transform().scale([1.4, 1.4, 1.0])}, "spherical": {}}
    view = views.get(sensor, {"fov": fov})
    return {"to_world": look, "film": film, "sampler": {"type": "independent"}} | SENSORS[sensor] | view


# ---------------------------------------------------------------------------------------------------- emitters


def _area(*radiance: float) -> Dict:
    return {"type": "area", "radiance": rgb(*radiance)}


def _down(y: float, scale: float) -> Any:
    return transform().translate([0.1, y, -0.1]).rotate([1, 0, 0], 90).scale([scale, scale, 1.0])


def _textured() -> Dict:
    x, y = np.meshgrid(np.linspace(0, 1, 8), np.linspace(0, 1, 8))
    pixels = np.stack([4 + 6 * x, 4 + 4 * y, 6 - 3 * x * y], -1)
    light = {"type": "area", "radiance": bitmap(pixels)}
    return {"light": {"type": "rectangle", "to_world": _down(2.2, 0.6), "emitter": light}}


def _sky() -> Dict:
    theta, phi = np.meshgrid((np.arange(8) + 0.5) / 8 * np.pi, (np.arange(16) + 0.5) / 16 * 2 * np.pi, indexing="ij")
    base = 0.5 + 0.4 * np.cos(theta)
    pixels = np.stack([base + 2.5 * np.exp(-((phi - 2) ** 2) - (theta - 0.8) ** 2), base, 1.3 * base], -1)
    return {"light": {"type": "envmap", "bitmap": mi.Bitmap(pixels.astype(np.float32))}}


def _spot() -> Dict:
    look = transform().look_at([1.2, 2.6, 1.5], [0, 0, -0.2], [0, 1, 0])
    spot = {"type": "spot", "to_world": look, "intensity": rgb(30, 25, 20), "cutoff_angle": 40.0, "beam_width": 20.0}
    return {"light": spot}


def _rectangle() -> Dict:
    return {"light": {"type": "rectangle", "to_world": _down(2.2, 0.6), "emitter": _area(7, 6, 5)}}


def _cube() -> Dict:
    place = transform().translate([-1.3, 1.2, -0.6]).rotate([0, 1, 0], 25).scale([0.15, 0.35, 0.25])
    return {"light": {"type": "cube", "to_world": place, "emitter": _area(9, 7, 4)}}


def _point() -> Dict:
    return {"light": {"type": "point", "position": [0.4, 1.9, 0.9], "intensity": rgb(6, 5, 4)}}


def _projector() -> Dict:
    look = transform().look_at([1.2, 2.6, 1.5], [0, 0, -0.2], [0, 1, 0])
    pixels = np.stack([np.eye(6) * 3 + 0.5, np.full((6, 6), 1.0), np.tri(6) * 2], -1)
    return {"light": {"type": "projector", "irradiance": bitmap(4 * pixels), "fov": 60, "to_world": look}}


def _sunsky() -> Dict:
    up = transform().rotate([1, 0, 0], -90)  # the sky's zenith is +z
    sky = {
        "type": "sunsky",
        "sun_direction": [0.5, 0.3, 0.8],
        "sun_aperture": 20.0,
        "sun_scale": 0.02,
        "sky_scale": 0.1,
    }
    return {"light": sky | {"to_world": up}}


def _cie_sky() -> Dict:
    up = transform().rotate([1, 0, 0], -90)
    sky = {"type": "sky", "kind": 12, "sun_direction": [0.5, 0.3, 0.8], "diffuse_illuminance": 1500.0}
    return {"light": sky | {"color": rgb(0.8, 1.0, 1.3), "to_world": up}}


#: Every kind of emitter, each the contents of a scene dictionary.
EMITTERS: dict[str, Callable[[], Dict]] = {
    "rectangle": _rectangle,
    "mesh": _cube,
    "disk": lambda: {"light": {"type": "disk", "to_world": _down(2.2, 0.65), "emitter": _area(5, 6, 7)}},
    "sphere": lambda: {
        "light": {"type": "sphere", "center": [1.2, 1.25, -0.5], "radius": 0.3, "emitter": _area(8, 7, 6)}
    },
    "textured": _textured,
    "point": _point,
    "spot": _spot,
    "constant": lambda: {"light": {"type": "constant", "radiance": rgb(0.7, 0.8, 1.0)}},
    "envmap": _sky,
    "two": lambda: _rectangle() | {"other": {"type": "constant", "radiance": rgb(0.2, 0.3, 0.4)}},
    "mixed": lambda: _cube() | {"other": _spot()["light"]},
    "directional": lambda: {
        "light": {"type": "directional", "direction": [-0.5, -1.0, -0.6], "irradiance": rgb(3, 2, 2)}
    },
    "projector": _projector,
    "focused": lambda: {
        "light": {
            "type": "rectangle",
            "to_world": _down(2.2, 0.5),
            "emitter": {"type": "focusarea", "radiance": rgb(7, 6, 5), "exponent": 4.0},
        }
    },
    "sunsky": _sunsky,
    "sky": _cie_sky,
    "cylinder": lambda: {
        "light": {
            "type": "cylinder",
            "p0": [-1, 1.4, -0.6],
            "p1": [0.8, 1.6, -0.7],
            "radius": 0.1,
            "emitter": _area(6, 5, 7),
        }
    },
}
#: Emitters that no ray can hit: what they send through a mirror or glass is out of reach of ``path``.
DELTA_EMITTERS = ("point", "spot", "mixed", "directional", "projector")

# ---------------------------------------------------------------------------------------------------- materials


def _waves(amplitude: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(32), np.arange(32))
    return (amplitude * np.sin(x * 2 * np.pi / 16) * np.cos(y * 2 * np.pi / 8))[..., None]


def _normals() -> np.ndarray:
    x, y = np.meshgrid(np.arange(16), np.arange(16))
    n = np.stack([0.4 * np.sin(x * 2 * np.pi / 8), 0.4 * np.cos(y * 2 * np.pi / 8), np.ones_like(x, float)], -1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return 0.5 * n + 0.5


def _pattern() -> np.ndarray:
    x, y = np.meshgrid(np.arange(8), np.arange(8))
    return np.stack([0.2 + 0.6 * ((x + y) % 2), 0.3 + 0.05 * x, 0.7 - 0.05 * y], -1)


_SLOPES = {"alpha_u": 0.15, "alpha_v": 0.35}
#: Every kind of material, by name.
MATERIALS: dict[str, Callable[[], Dict]] = {
    "diffuse": lambda: diffuse(0.6, 0.4, 0.2),
    "roughconductor": lambda: {"type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.3},
    "anisotropic": lambda: {"type": "roughconductor", "material": "Al", "alpha_u": 0.15, "alpha_v": 0.45},
    "conductor": lambda: {"type": "conductor", "material": "Cu"},
    "roughdielectric": lambda: {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.35},
    "dielectric": lambda: {"type": "dielectric"},
    "plastic": lambda: {"type": "plastic", "diffuse_reflectance": rgb(0.2, 0.5, 0.3)},
    "roughplastic": lambda: {"type": "roughplastic", "diffuse_reflectance": rgb(0.2, 0.3, 0.6), "alpha": 0.25},
    "principled": lambda: {
        "type": "principled",
        "base_color": rgb(0.6, 0.2, 0.3),
        "roughness": 0.4,
        "metallic": 0.3,
        "anisotropic": 0.4,
        "sheen": 0.3,
        "clearcoat": 0.5,
        "clearcoat_gloss": 0.2,
    },
    "phong": lambda: {"type": "phong", "specular_reflectance": rgb(0.5, 0.3, 0.6), "exponent": 20.0},
    "ward": lambda: {"type": "ward", "diffuse_reflectance": rgb(0.2, 0.3, 0.5), "specular_reflectance": 0.5} | _SLOPES,
    "twosided": lambda: {"type": "twosided", "front": diffuse(0.7, 0.3, 0.3), "back": diffuse(0.3, 0.3, 0.7)},
    "blendbsdf": lambda: {
        "type": "blendbsdf",
        "weight": 0.4,
        "first": diffuse(0.5, 0.6, 0.2),
        "second": {"type": "roughconductor", "material": "Cr", "alpha": 0.3},
    },
    "bumpmap": lambda: {"type": "bumpmap", "height": bitmap(_waves(0.04)), "nested": diffuse(0.6, 0.5, 0.5)},
    "normalmap": lambda: {"type": "normalmap", "normalmap": bitmap(_normals()), "nested": diffuse(0.5, 0.6, 0.5)},
    "bumpmap unflipped": lambda: MATERIALS["bumpmap"]() | {"flip_invalid_normals": False},
    "normalmap unflipped": lambda: MATERIALS["normalmap"]() | {"flip_invalid_normals": False},
    "textured": lambda: {"type": "diffuse", "reflectance": bitmap(_pattern())},
    "mask": lambda: {"type": "mask", "opacity": bitmap(_pattern()), "nested": diffuse(0.7, 0.5, 0.2)},
    "cutout": lambda: {"type": "mask", "opacity": 0.6, "nested": {"type": "roughconductor", "alpha": 0.3}},
    "pane": lambda: {"type": "thindielectric"},
    "null": lambda: {"type": "null"},
    "veil": lambda: {"type": "blendbsdf", "weight": 0.5, "a": diffuse(0.3, 0.6, 0.3), "b": {"type": "null"}},
    "twosided mask": lambda: {
        "type": "mask",
        "opacity": 0.7,
        "nested": {"type": "twosided", "front": diffuse(0.7, 0.3, 0.3), "back": diffuse(0.3, 0.3, 0.7)},
    },
    "vertexcolours": lambda: {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}},
}
#: Six materials fit into one picture, so a scene of a group crosses an emitter with all of them.
GROUPS: dict[str, tuple[str, ...]] = {
    "rough": ("roughconductor", "anisotropic", "roughdielectric", "roughplastic", "principled", "twosided"),
    "wrapped": ("blendbsdf", "bumpmap", "normalmap", "textured", "vertexcolours", "ward"),
    "specular": ("conductor", "dielectric", "plastic", "pane"),
    "transparent": ("mask", "cutout", "null", "veil", "twosided mask", "phong"),
}
#: For tests that materials do not matter to: a glossy one and one that light goes through, no delta component. Each
#: kind of material makes every kernel larger; with these two they take half as long to compile as with a group above.
FEW = ("roughconductor", "roughdielectric")
_PLACES = [(x, 0.302, z) for z in (0.45, -0.5) for x in (-0.9, 0.0, 0.9)]


def thing(material: str, place: tuple[float, float, float]) -> Any:
    """The object that shows a material: a ball; a tilted plate for two sides; a tent for colours of vertices."""
    x, y, z = place
    bsdf = MATERIALS[material]()
    if "twosided" in material:
        to_world = transform().translate([x, y + 0.1, z]).rotate([0, 1, 0], 65).rotate([1, 0, 0], -20).scale(0.32)
        return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}
    if material == "vertexcolours":
        corners = np.array(
            [[-0.35, -0.3, 0.3], [0.35, -0.3, 0.3], [0.35, -0.3, -0.3], [-0.35, -0.3, -0.3], [0, 0.4, 0]]
        )
        faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        colours = np.array([[0.8, 0.2, 0.2], [0.2, 0.8, 0.2], [0.2, 0.2, 0.8], [0.8, 0.8, 0.1], [0.7, 0.7, 0.7]])
        return mesh(corners + np.array(place), faces, bsdf, colours=colours)
    return {"type": "sphere", "center": list(place), "radius": 0.3, "bsdf": bsdf}


def room(emitter: str, group: str | tuple[str, ...], **view: Any) -> Problem:
    """A floor and a wall with a group's materials on show under one emitter."""
    scene: Dict = {"type": "scene", "sensor": camera(**view)} | EMITTERS[emitter]()
    scene["floor"] = {
        "type": "rectangle",
        "to_world": transform().rotate([1, 0, 0], -90).scale(2.0),
        "bsdf": diffuse(0.5, 0.5, 0.45),
    }
    scene["wall"] = {
        "type": "rectangle",
        "to_world": transform().translate([0, 1.5, -1.3]).scale([2.0, 1.5, 1.0]),
        "bsdf": diffuse(0.4, 0.5, 0.6),
    }
    names = GROUPS[group] if isinstance(group, str) else group
    for name, place in zip(names, _PLACES, strict=False):
        scene[name] = thing(name, place)
    return load(scene)


def plate(centre: Any, side: float, up: bool) -> Dict:
    """A grey square that faces up or down."""
    place = transform().translate(list(centre)).rotate([1, 0, 0], -90 if up else 90).scale(side)
    return {"type": "rectangle", "to_world": place, "bsdf": diffuse(0.5, 0.5, 0.45)}


def lamp(centre: Any, side: float, radiance: float) -> Dict:
    """A square lamp that faces down."""
    place = transform().translate(list(centre)).rotate([1, 0, 0], 90).scale(side)
    return {"type": "rectangle", "to_world": place, "emitter": _area(radiance, radiance, 0.8 * radiance)}


def hut(
    *emitters: str,
    size: tuple[int, int] = (16, 12),
    pane: bool = False,
    window: float = 0.7,
    plain: float = 8.0,
    **things: Dict,
) -> Problem:
    """Inside a room on a ``plain`` of this half-width with one square window, open or with a ``pane`` of glass, under
    skies and suns of :data:`EMITTERS`; with ``things``."""
    low, high, left, right = 0.25 - window / 2, 0.25 + window / 2, -0.05 - window / 2, -0.05 + window / 2
    scene: Dict = {"type": "scene", "sensor": camera((0.9, 0.6, 0.9), (-0.6, -0.1, -0.6), 80.0, size=size)}
    for name in emitters:
        scene |= {f"{name}-{key}": value for key, value in EMITTERS[name]().items()}

    def wall(x: Any, y: Any, z: Any, bsdf: Dict | None = None) -> Dict:
        first, last = np.array([x, y, z]).T
        to_world = transform().translate(list((first + last) / 2)).scale(list((last - first) / 2))
        return {"type": "cube", "to_world": to_world, "bsdf": bsdf or diffuse(0.6, 0.55, 0.5)}

    if pane:
        scene["pane"] = wall((1.04, 1.06), (low, high), (left, right), {"type": "dielectric"})

    scene["plain"] = plate((0.0, -1.01, 0.0), plain, True)
    walls = (
        *(((-1.1, 1.1), (-1.0, -0.9), (-1.1, 1.1)), ((-1.1, 1.1), (0.9, 1.0), (-1.1, 1.1))),
        *(((-1.1, 1.1), (-0.9, 0.9), (-1.1, -1.0)), ((-1.1, 1.1), (-0.9, 0.9), (1.0, 1.1))),
        ((-1.1, -1.0), (-0.9, 0.9), (-1.0, 1.0)),
        *(((1.0, 1.1), (-0.9, low), (-1.0, 1.0)), ((1.0, 1.1), (high, 0.9), (-1.0, 1.0))),
        *(((1.0, 1.1), (low, high), (-1.0, left)), ((1.0, 1.1), (low, high), (right, 1.0))),
    )
    return load(scene | things | {f"wall{number}": wall(*place) for number, place in enumerate(walls)})


def terrace(*emitters: str, size: tuple[int, int] = (16, 12), side: float = 8.0, ball: Dict | None = None) -> Problem:
    """A ball, by default of glass, on a square plain of the half-width ``side``, under skies and suns of
    :data:`EMITTERS`."""
    scene: Dict = {"type": "scene", "sensor": camera((0.0, 1.2, 2.2), (0.0, -0.3, 0.0), 50.0, size=size)}
    for name in emitters:
        scene |= {f"{name}-{key}": value for key, value in EMITTERS[name]().items()}
    scene["plain"] = plate((0.0, -0.6, 0.0), side, True)
    scene["ball"] = {"type": "sphere", "radius": 0.4, "bsdf": ball or {"type": "dielectric"}}
    return load(scene)


# ---------------------------------------------------------------------------------------------------- closed forms


def furnace(
    shape: str, radiance: float, albedo: float, size: tuple[int, int] = (8, 8), plate: bool = False, **things: Dict
) -> Problem:
    """Inside a closed surface that emits ``radiance`` and reflects ``albedo``: L / (1 - albedo) everywhere. With a null
    ``plate`` through the middle, too, and with ``things`` that keep all light."""
    body: Dict = {"bsdf": diffuse(albedo, albedo, albedo), "emitter": _area(radiance, radiance, radiance)}
    scene: Dict = {"type": "scene", "sensor": camera((0.2, 0.1, 0.3), (-0.5, 0.3, -0.4), 70.0, size=size)}
    if shape == "sphere":
        scene["body"] = {"type": "sphere", "radius": 1.0, "flip_normals": True} | body
    else:
        scene["body"] = {"type": "cube", "flip_normals": True} | body
    if plate:
        scene["plate"] = {"type": "disk", "to_world": transform().scale(0.95), "bsdf": {"type": "null"}}
    return load(scene | things)


def field(albedo: float, radiance: float, size: tuple[int, int] = (8, 8), side: float = 1.0) -> Problem:
    """A plane under a uniform sky, seen from above: irradiance pi L everywhere, albedo L to the camera."""
    scene: Dict = {
        "type": "scene",
        "sensor": camera((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), 40.0, size=size),
        "light": {"type": "constant", "radiance": rgb(radiance, radiance, radiance)},
        "plane": {
            "type": "rectangle",
            "to_world": transform().rotate([1, 0, 0], -90).scale(side),
            "bsdf": diffuse(albedo, albedo, albedo),
        },
    }
    return load(scene)


def material(scene: Any, si: Any, ray: Any = None) -> Material:
    """The materials at surface points of a scene, as the functions of scattering take them."""
    return Material(si.bsdf() if ray is None else si.bsdf(ray), bsdfs(scene))
