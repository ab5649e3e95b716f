"""Alpha: how much of each pixel is covered, in closed form. (Whole pictures beside Mitsuba's: tests/plugins.)"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support import scenes

from etendue.transport import CameraSampler, Visibility, coverage

SIGMA = (0.1, 0.2, 0.5)


def covered(name: str, shows_lights: bool) -> np.ndarray:
    camera = scenes.camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), 40.0, size=(8, 6))
    shapes = parts(name)
    sky = {} if name == "lamp" else {"sky": {"type": "constant"}}
    medium = {"medium": {"type": "ref", "id": "fog"}} if "fog" in shapes else {}
    problem = scenes.load({"type": "scene"} | shapes | {"sensor": camera | medium | {"near_clip": 1e-4}} | sky)
    return coverage(CameraSampler(problem), Visibility(problem.scene, problem.sensor, hides_lights=not shows_lights))


def wall(bsdf: dict[str, Any], z: float = 0.0) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": scenes.transform().translate([0, 0, z]).scale(9.0), "bsdf": bsdf}


def mask(opacity: float) -> dict[str, Any]:
    return {"type": "mask", "opacity": opacity, "nested": scenes.diffuse(0.5, 0.5, 0.5)}


def black(z: float) -> dict[str, Any]:
    return wall(scenes.diffuse(0, 0, 0), z)


def parts(name: str) -> dict[str, Any]:
    match name:
        case "wall":
            return {"wall": black(0.0)}
        case "glass":
            return {"wall": wall({"type": "dielectric"})}
        case "masks":
            return {"near": wall(mask(0.25)), "far": wall(mask(0.5), -1.0)}
        case "lamp":
            return {"near": wall(mask(0.25)), "lamp": black(-1.0) | {"emitter": scenes._area(1, 1, 1)}}
        case "fog":  # the camera in the middle of a ball
            fog = {"type": "homogeneous", "sigma_t": {"type": "rgb", "value": SIGMA}, "albedo": 0.5}
            ball = {"type": "sphere", "center": [0, 0, 4], "radius": 3.0, "bsdf": {"type": "null"}}
            return {"fog": fog, "ball": ball | {"interior": {"type": "ref", "id": "fog"}}}
    return {"wall": black(8.0)}  # behind the camera


@pytest.mark.parametrize(
    ("name", "shows_lights", "expected"),
    [
        ("sky", True, 1.0),
        ("sky", False, 0.0),
        ("wall", False, 1.0),
        ("glass", False, 1.0),
        ("masks", False, 1 - 0.75 * 0.5),
        ("lamp", True, 1.0),
        ("lamp", False, 0.25),
        ("fog", False, 1.0 - np.exp(-3.0 * np.array(SIGMA)).mean()),
    ],
)
def test_in_closed_form(name, shows_lights, expected):
    np.testing.assert_allclose(covered(name, shows_lights), expected, rtol=1e-4)
