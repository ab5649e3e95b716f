"""Scenes with participating media."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .scenes import Dict, diffuse, rgb, transform

#: The medium of the scenes' fog.
FOG = {"type": "ref", "id": "fog"}
BLACK = diffuse(0.0, 0.0, 0.0)
#: A medium that is not supported.
FLAKES = {"type": "homogeneous", "phase": {"type": "sggx", "S": {"type": "constvolume", "value": 1.0}}}


def fog(extinction: Any = 1.0, albedo: Any = 0.8, **more: Any) -> Dict:
    """A homogeneous medium. Colours are tuples, whose extinction is at most 1; ``scale`` multiplies it."""
    given = {"sigma_t": extinction, "albedo": albedo}
    return {"type": "homogeneous"} | {k: rgb(*v) if isinstance(v, tuple) else v for k, v in given.items()} | more


def camera(origin: Any, target: Any, size: int = 8, fov: float = 60.0, **more: Any) -> Dict:
    """A perspective sensor with a box filter."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    to_world = transform().look_at(list(origin), list(target), [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": to_world, "film": film} | more


def closed(medium: Dict, emission: float = 0.0, albedo: float = 0.5, **more: Any) -> Dict:
    """A cube of half-width 1, full of fog, seen from inside, with a lamp at its ceiling or emitting itself."""
    walls: Dict = {"type": "cube", "flip_normals": True, "bsdf": diffuse(*[albedo] * 3), "exterior": FOG}
    parts: Dict = {"fog": medium, "camera": camera((0, 0, 0.95), (0, 0, -1), 8, 70.0, medium=FOG)}
    if emission:
        walls |= {"emitter": {"type": "area", "radiance": rgb(*[emission] * 3)}}
    else:
        facing = transform().translate([0, 0.99, 0]).rotate([1, 0, 0], 90).scale(0.3)
        emitter = {"type": "area", "radiance": rgb(4.0, 4.0, 4.0)}
        parts["lamp"] = {"type": "rectangle", "to_world": facing, "bsdf": BLACK, "emitter": emitter, "exterior": FOG}
    return {"type": "scene", "walls": walls} | parts | more


def slab(medium: Dict, **more: Any) -> Dict:
    """A slab of a medium, 1 thick, between the camera and a lamp that fills the view."""
    behind = transform().translate([0, 0, -3]).scale(4)
    lamp = {
        "type": "rectangle",
        "to_world": behind,
        "bsdf": BLACK,
        "emitter": {"type": "area", "radiance": rgb(1, 1, 1)},
    }
    body = {"type": "cube", "to_world": transform().scale([3, 3, 0.5]), "bsdf": {"type": "null"}, "interior": FOG}
    parts = {"fog": medium, "camera": camera((0, 0, 5), (0, 0, 0), 4, 10.0), "lamp": lamp, "slab": body}
    return {"type": "scene"} | parts | more


def volpath(depth: int = -1) -> mi.Integrator:
    """Mitsuba's own integrator for media."""
    return mi.load_dict({"type": "volpath", "max_depth": depth, "rr_depth": 8})


def smoke(extinction: Any, albedo: Any = 0.8, **more: Any) -> Dict:
    """A heterogeneous medium in the cube of half-width 1. Arrays are grids, by (z, y, x, channel)."""
    given = {"sigma_t": extinction, "albedo": albedo}
    return {"type": "heterogeneous"} | {k: v if isinstance(v, float) else grid(v) for k, v in given.items()} | more


def grid(values: ArrayLike) -> Dict:
    """A grid over the cube of half-width 1."""
    placed = transform().translate([-1, -1, -1]).scale(2)
    return {"type": "gridvolume", "grid": mi.VolumeGrid(np.asarray(values, np.float32)), "to_world": placed}


def clouds(channels: int = 1, seed: int = 0) -> NDArray[np.float64]:
    """Extinctions from 0 to 1, a third of them 0: ``channels`` at 4^3 points, between which a grid interpolates."""
    return np.maximum(np.random.default_rng(seed).uniform(-0.5, 1.0, (4, 4, 4, channels)), 0.0)
