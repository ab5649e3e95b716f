"""Pieces of the bundled scenes: flat things and boxes, materials, textures, lights, cameras."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import mitsuba as mi

Array = NDArray[np.float64]
Dict = dict[str, Any]
Vector = tuple[float, float, float]
Range = tuple[float, float]


def placed(centre: tuple[float, ...], size: tuple[float, ...]) -> mi.ScalarTransform4f:
    """Transform of Mitsuba's cube to a box of these sides."""
    import mitsuba as mi

    return mi.ScalarTransform4f().translate(list(centre)).scale([side / 2 for side in size])


def box(centre: tuple[float, ...], size: tuple[float, ...], bsdf: Dict) -> Dict:
    """A box of these sides."""
    return {"type": "cube", "to_world": placed(centre, size), "bsdf": bsdf}


def rectangle(corner: ArrayLike, along: ArrayLike, across: ArrayLike, bsdf: Dict, *radiance: float) -> Dict:
    """The parallelogram of two edges from a corner, which looks along ``along`` x ``across``, and shines there."""
    import mitsuba as mi

    u, v = np.array(along) / 2, np.array(across) / 2
    normal = np.cross(u, v)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = u, v
    matrix[:3, 2] = normal / np.linalg.norm(normal)
    matrix[:3, 3] = np.array(corner) + u + v
    light = {"emitter": {"type": "area", "radiance": rgb(*radiance)}} if radiance else {}
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix), "bsdf": bsdf, **light}


def shell(half: float, height: float, z: Range, thick: float, paint: Dict, **other: Dict) -> Dict:
    """The same of boxes, around x = 0 and on y = 0, all but floor and ceiling as they are named in ``other``."""
    middle, depth, far = (z[0] + z[1]) / 2, z[1] - z[0], thick / 2
    sides = {
        "floor": ((0.0, -far, middle), (2 * half, thick, depth)),
        "ceiling": ((0.0, height + far, middle), (2 * half, thick, depth)),
        "left": ((-half - far, height / 2, middle), (thick, height, depth)),
        "right": ((half + far, height / 2, middle), (thick, height, depth)),
        "front": ((0.0, height / 2, z[1] + far), (2 * half, height, thick)),
        "far": ((0.0, height / 2, z[0] - far), (2 * half, height, thick)),
    }
    return {name: box(*place, other.get(name, paint)) for name, place in sides.items()}


def pierced(name: str, half: float, height: float, z: float, thick: float, x: Range, y: Range, paint: Dict) -> Dict:
    """A wall of boxes across the room at z, around an opening."""
    parts = {
        "left": ((-half, x[0]), (0.0, height)),
        "right": ((x[1], half), (0.0, height)),
        "below": (x, (0.0, y[0])),
        "above": (x, (y[1], height)),
    }
    return {
        f"{name}-{part}": box(((x0 + x1) / 2, (y0 + y1) / 2, z), (x1 - x0, y1 - y0, thick), paint)
        for part, ((x0, x1), (y0, y1)) in parts.items()
        if y1 > y0
    }


def walls(x: Range, y: Range, z: Range, wall: Dict, **other: Dict | None) -> Dict:
    """The inside of a room; ``other`` materials of floor, ceiling, back (low z), front, left (low x) and right. A wall
    is left out if its material is None."""
    (x0, x1), (y0, y1), (z0, z1) = x, y, z
    width, height, depth = x1 - x0, y1 - y0, z1 - z0
    sides: dict[str, tuple[Vector, Vector, Vector]] = {
        "back": ((x0, y0, z0), (width, 0, 0), (0, height, 0)),
        "front": ((x1, y0, z1), (-width, 0, 0), (0, height, 0)),
        "left": ((x0, y0, z1), (0, 0, -depth), (0, height, 0)),
        "right": ((x1, y0, z0), (0, 0, depth), (0, height, 0)),
        "floor": ((x0, y0, z1), (width, 0, 0), (0, 0, -depth)),
        "ceiling": ((x0, y1, z0), (width, 0, 0), (0, 0, depth)),
    }
    bsdfs = {name: other.get(name, wall) for name in sides}
    return {name: rectangle(*edges, bsdf) for name, edges in sides.items() if (bsdf := bsdfs[name])}


# -- materials


def rgb(*value: float) -> Dict:
    """A colour."""
    return {"type": "rgb", "value": list(value)}


def diffuse(*value: float) -> Dict:
    """A diffuse material of this reflectance."""
    return {"type": "diffuse", "reflectance": rgb(*value)}


def matt(*value: float) -> Dict:
    """The same on both sides."""
    return {"type": "twosided", "bsdf": diffuse(*value)}


def glass(index: float = 1.5, *tint: float, outside: float = 1.0) -> Dict:
    """Clear or tinted glass."""
    colour = {"specular_transmittance": rgb(*tint)} if tint else {}
    return {"type": "dielectric", "int_ior": index, "ext_ior": outside, **colour}


def mirror(*value: float) -> Dict:
    """A perfect mirror."""
    reflectance = rgb(*(value or (0.92, 0.92, 0.92)))
    return {"type": "twosided", "bsdf": {"type": "conductor", "material": "none", "specular_reflectance": reflectance}}


def metal(material: str, alpha: float = 0.0) -> Dict:
    """A metal, polished or rough, on both sides."""
    rough = {"type": "roughconductor", "distribution": "ggx", "alpha": alpha}
    inner = rough if alpha > 0.0 else {"type": "conductor"}
    return {"type": "twosided", "bsdf": inner | {"material": material}}


def glazed(*value: float) -> Dict:
    """A colour under a clear smooth coat: china, lacquer."""
    return {"type": "twosided", "bsdf": {"type": "plastic", "diffuse_reflectance": rgb(*value)}}


def palette(make: Callable[..., Dict], text: str) -> dict[str, Dict]:
    """Materials that ``make`` makes of numbers: "name red green blue, name ..."."""
    rows = (row.split() for row in text.split(","))
    return {name: make(*map(float, values)) for name, *values in rows}


def textured(pixels: Array, repeat: Range = (1.0, 1.0), plugin: str = "diffuse") -> Dict:
    """A picture of (height, width, 3) reflectances on both sides, bare or under a coat of ``plugin``."""
    import mitsuba as mi

    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(pixels.astype(np.float32))}
    bitmap |= {"to_uv": mi.ScalarTransform4f().scale([*repeat, 1.0])}
    return {
        "type": "twosided",
        "bsdf": {"type": plugin, "reflectance" if plugin == "diffuse" else "diffuse_reflectance": bitmap},
    }


def planks(seed: int, boards: int = 12, *, tone: Vector, length: int = 512) -> Array:
    """Wooden boards side by side, each with its own tone, grain and joint: (512, length, 3) reflectances."""
    rng, height = np.random.default_rng(seed), 512
    rows = np.arange(height) * boards // height
    shade = rng.uniform(0.75, 1.15, boards)[rows][:, None]
    grain = rng.normal(0.0, 1.0, (height, 1)) * 0.045 + rng.normal(0.0, 1.0, (height, 8)).repeat(length // 8, 1) * 0.02
    value = np.broadcast_to(shade * (1.0 + grain), (height, length)).copy()
    value[(np.arange(height) * boards % height) < boards * 2] *= 0.45
    for board in range(boards):
        joint = rng.integers(0, length)
        value[rows == board, joint : joint + 2] *= 0.45
        value[rows == board, joint:] *= rng.uniform(0.85, 1.1)
    return np.clip(value[..., None] * np.array(tone), 0.02, 0.9)


# -- lights and cameras


def lamp(centre: Vector, radius: float, *radiance: float) -> Dict:
    """A glowing ball."""
    ball = {"type": "sphere", "center": list(centre), "radius": radius, "bsdf": diffuse(0.0, 0.0, 0.0)}
    return ball | {"emitter": {"type": "area", "radiance": rgb(*radiance)}}


def sky(sun: Vector, light: Vector, height: int = 64, width: float = 0.0012, clouds: float = 0.0) -> Dict:
    """A sky that is blue and brightens to the horizon, over dark ground, with a soft sun in a direction; ``light`` is
    the sun's radiance, ``width`` one minus the cosine at which it has fallen to 37 %, ``clouds`` how white they are."""
    import mitsuba as mi

    theta = (np.arange(height) + 0.5) / height * np.pi
    phi = (np.arange(2 * height) + 0.5) / (2 * height) * 2 * np.pi
    up = np.cos(theta)[:, None, None]
    zenith, horizon, ground = np.array([0.10, 0.22, 0.50]), np.array([0.65, 0.68, 0.70]), np.array([0.09, 0.08, 0.07])
    colours = np.where(up > 0, horizon + (zenith - horizon) * np.clip(up, 0, 1) ** 0.5, ground)
    pixels = np.broadcast_to(colours, (height, 2 * height, 3)).copy()
    level = np.broadcast_to(np.cos(theta)[:, None], (height, 2 * height))
    direction = np.stack([np.sin(theta)[:, None] * np.sin(phi), level, -np.sin(theta)[:, None] * np.cos(phi)], -1)
    if clouds:
        rng, places, cover = np.random.default_rng(1), direction[..., ::2] / (level[..., None] + 0.25), 0.0 * level
        for octave in range(6):
            for way in rng.normal(size=(5, 2)) * 1.3 * 1.9**octave:
                cover = cover + np.sin(places @ way + rng.uniform(0, 6) + 2 * cover) * 0.62**octave
        share = np.clip(cover / 3.0 - 0.35, 0, 1) * np.clip(5 * level, 0, 1)
        pixels += clouds * share[..., None] * (np.array([1.0, 0.98, 0.95]) - pixels)
    cosine = direction @ (np.array(sun) / np.linalg.norm(sun))
    pixels += np.exp((cosine - 1.0) / width)[..., None] * np.array(light)
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels.astype(np.float32))}


def camera(
    origin: Vector,
    target: Vector,
    fov: float,
    size: tuple[int, int] = (512, 384),
    rfilter: str = "gaussian",
    up: Vector = (0, 1, 0),
    **more: Any,
) -> Dict:
    """A pinhole camera; ``fov`` is across, in degrees."""
    import mitsuba as mi

    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "pixel_format": "rgb"}
    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(list(origin), list(target), list(up)),
        "sampler": {"type": "independent", "sample_count": 64},
        "film": film | {"component_format": "float32", "rfilter": {"type": rfilter}},
        **more,
    }
