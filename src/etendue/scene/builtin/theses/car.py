"""A car on a square under a sky with a low sun.

Its body is wound from rounded sections along its length (x), as are its roof and windows, which are told apart by where
they lie on the sections.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...meshes import MeshDescription, grid, smooth
from ..pieces import Array, glass, glazed, matt, metal, palette, rgb, sky, textured
from ..solids import GAP, Model, Part, about, ball, box, cushion, ring, smooth_normals, stretched, tube, turned
from .furniture import view

#: x of the axles, half the track, radius of a tyre and of its arch.
_AXLES, _TRACK, _TYRE, _ARCH = (1.32, -1.3), 0.74, 0.325, 0.375
#: Stations along the car: x, half the width, height of the underside, height of the shoulder.
_BODY = np.array(
    [
        (2.12, 0.62, 0.42, 0.56), (2.06, 0.72, 0.28, 0.66), (1.9, 0.80, 0.20, 0.73), (1.32, 0.86, 0.18, 0.83),
        (0.75, 0.87, 0.17, 0.90), (-0.2, 0.87, 0.17, 0.93), (-1.3, 0.86, 0.19, 0.95), (-1.85, 0.81, 0.23, 0.94),
        (-2.05, 0.74, 0.32, 0.88), (-2.1, 0.66, 0.45, 0.76),
    ]
)  # fmt: skip
#: The roof with its windows: x, half the width, height of its lower edge, height of its middle.
_CABIN = np.array(
    [
        (1.02, 0.70, 0.72, 0.85), (0.55, 0.75, 0.77, 1.15), (0.15, 0.76, 0.80, 1.35), (-0.35, 0.765, 0.82, 1.42),
        (-0.9, 0.75, 0.83, 1.37), (-1.45, 0.71, 0.83, 1.18), (-1.98, 0.62, 0.78, 0.90),
    ]
)  # fmt: skip


#: Exponents of the rounded sections of body and cabin; points of a section.
_ROUND, _CABIN_ROUND, _POINTS = 3.4, 2.7, 161


def car() -> dict[str, Any]:
    """The scene as a Mitsuba dictionary; about 270 000 triangles."""
    import mitsuba as mi

    paint = {"type": "principled", "base_color": rgb(0.33, 0.012, 0.018), "roughness": 0.32, "metallic": 0.35}
    model = Model(
        {
            **palette(glazed, "window .012 .014 .016, black .015 .015 .016, red .40 .01 .01"),
            **palette(matt, "rubber .022 .022 .023, line .62 .62 .58"),
            **{"alloy": metal("Al", 0.18), "chrome": metal("Cr", 0.04), "glass": glass()},
            "paint": {"type": "twosided", "bsdf": paint | {"clearcoat": 1.0, "clearcoat_gloss": 0.97}},
        }
    )
    course = _stations(_BODY, 240)
    _body(model, course)
    _cabin(model)
    for side in (-1, 1):
        _flank(model, course, side)
        for x in _AXLES:
            model.put(_wheel(model.materials), (x, _TYRE + GAP, side * _TRACK), about(1, 90 - 90 * side))
    for k in range(-3, 4):
        model.add("line", box((4.8, 0.004, 0.1), 0.001, 1), (0.0, 0.0025, 2.6 * k + 1.3))
    ground = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(800.0)
    return {
        "type": "scene",
        "integrator": {"type": "vcm", "max_depth": 12},
        "sensor": view((4.7, 1.5, 4.9), (0.1, 0.6, 0.0), 38.0),
        "sky": sky((0.75, 0.42, 0.25), (6000.0, 4700.0, 3100.0), 256, 0.0002, 0.9),
        "ground": {"type": "rectangle", "to_world": ground, "bsdf": textured(_asphalt(), (3600.0, 3600.0))},
        "hills": _hills(),
        **model.shapes(),
    }


def _hills() -> MeshDescription:
    """A ridge all around, far away."""
    phi = np.linspace(0, 2 * np.pi, 721)
    high = 16 + 7 * np.sin(3 * phi) + 4 * np.sin(11 * phi + 1) + np.sin(37 * phi) + 0.5 * np.sin(101 * phi + 2)
    feet = np.stack([500 * np.cos(phi), 0 * phi, 500 * np.sin(phi)], -1)
    points = np.stack([feet, feet + high[:, None] * [0, 1, 0]], 1)
    return MeshDescription("hills", points.reshape(-1, 3), grid(721, 2), matt(0.10, 0.15, 0.09))


def _asphalt() -> Array:
    """Grains of three sizes: (128, 128, 3) reflectances."""
    rng, grains = np.random.default_rng(2), np.full((128, 128), 0.2)
    for size in (1, 2, 4):
        grains += np.kron(rng.normal(0, 0.02, (128 // size, 128 // size)), np.ones((size, size)))
    return np.clip(grains, 0.03, 0.6)[..., None] * np.array([1.0, 0.98, 0.94])


def _stations(stations: Array, count: int) -> Array:
    """A smooth course through stations: (4, ``count``), evenly along x."""
    fine = smooth(stations, 16, closed=False)
    x = np.linspace(fine[0, 0], fine[-1, 0], count)
    return np.stack([x, *(np.interp(-x, -fine[:, 0], fine[:, k]) for k in (1, 2, 3))])


def _wound(x: Array, y: Array, z: Array) -> Part:
    """The surface through sections (stations, points) that run from high z over high y."""
    points = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], -1).reshape(-1, 3)
    faces = grid(*y.shape)[:, ::-1]
    return points, faces, smooth_normals(points, faces)


def _rounded(angle: Array, exponent: float) -> tuple[Array, Array]:
    """Cosine and sine of a superellipse."""
    c, s = np.cos(angle), np.sin(angle)
    return np.sign(c) * np.abs(c) ** (2 / exponent), np.sign(s) * np.abs(s) ** (2 / exponent)


def _body(model: Model, course: Array) -> None:
    """A shell with arches cut out for the wheels, and a flat nose and tail behind grille and lamps."""
    half, low, high = (row[:, None] for row in course[1:])
    c, s = _rounded(np.linspace(0, 2 * np.pi, _POINTS), _ROUND)
    points, faces, normals = _wound(course[0], (low + high) / 2 + (high - low) / 2 * s, half * c)
    x, y, z = points[faces].mean(axis=1).T
    arches = [(np.hypot(x - axle, y - _TYRE) < _ARCH) & (np.abs(z) > 0.5) for axle in _AXLES]
    model.add("paint", (points, faces[~np.any(arches, axis=0)], normals))
    k = np.arange(1, _POINTS)
    for rim, sign in ((points[:_POINTS], 1), (points[-_POINTS:], -1)):
        fan = np.stack([0 * k, k, k + 1], -1)[:, ::-sign]
        end = np.concatenate([rim.mean(axis=0)[None], rim])
        model.add("paint", (end, fan, np.broadcast_to([float(sign), 0.0, 0.0], end.shape)))
    model.add("black", box((0.08, 0.13, 0.86), 0.03), (2.09, 0.5, 0.0))
    for level in (0.455, 0.485, 0.515, 0.545):
        model.add("chrome", box((0.02, 0.008, 0.8), 0.003), (2.128, level, 0.0))
    model.add("black", box((0.1, 0.1, 1.1), 0.03), (2.03, 0.27, 0.0))
    model.add("line", box((0.012, 0.11, 0.46), 0.004), (2.12, 0.355, 0.0))


def _flank(model: Model, course: Array, side: int) -> None:
    """Lips and dark insides of the arches, seams and handles of the doors, a sill, lamps, a mirror."""

    def along(x: Any, y: Any, out: float) -> Array:
        """Places on the body's side."""
        half, low, high = (np.interp(-x, -course[0], row) for row in course[1:])
        y_of_section = np.abs((2 * np.maximum(y, 0.24) - low - high) / (high - low))
        z = half * (1 - np.minimum(y_of_section, 1) ** _ROUND) ** (1 / _ROUND)
        return np.stack([x + 0 * y, y, side * (z + out)], -1)

    arc, inside, turn = np.linspace(-0.2, np.pi + 0.2, 60), ring("37,-14 38,-14 38,14 37,14", 96, 2), about(0, 90)
    is_above = (inside[0] @ turn.T)[inside[1]][:, :, 1].min(axis=1) > -0.05
    for axle in _AXLES:
        lip = along(axle + _ARCH * np.cos(arc), _TYRE + _ARCH * np.sin(arc), -0.006)
        model.add("paint", tube(lip, 0.02, 16))
        model.add("rubber", (inside[0], inside[1][is_above], inside[2]), (axle, _TYRE, side * 0.68), turn)
    for x in (0.72, -0.36, -0.86):
        model.add("black", tube(along(x, np.linspace(0.27, 0.9, 30), 0.001), 0.0045, 8))
    for x in (-0.2, -0.98):
        model.add("chrome", cushion((0.19, 0.025, 0.03), 0.01, 0.003, 6), along(x, 0.8, 0.012))
    model.add("black", box((1.8, 0.09, 0.06), 0.02), (0.02, 0.2, side * 0.785))
    globe, lean = ball(1.0, 64, 32), about(1, -28.0 * side)
    model.add("glass", stretched(globe, 0.12, 0.068, 0.19), (1.97, 0.605, 0.56 * side), lean)
    model.add("chrome", stretched(globe, 0.11, 0.06, 0.178), (1.97, 0.605, 0.56 * side), lean)
    model.add("red", stretched(globe, 0.08, 0.07, 0.17), (-2.0, 0.79, 0.58 * side), about(1, 24.0 * side))
    lean = about(1, 8.0 * side)
    model.add("paint", cushion((0.11, 0.13, 0.19), 0.045, 0.01, 8), (0.62, 0.98, 0.93 * side), lean)
    model.add("window", box((0.01, 0.095, 0.145), 0.004), (0.558, 0.98, 0.935 * side), lean)
    model.add("black", tube([[0.62, 0.9, 0.76 * side], [0.62, 0.93, 0.84 * side], [0.62, 0.96, 0.9 * side]], 0.016))


def _cabin(model: Model) -> None:
    """Roof and pillars in paint, windows by where they lie: ``x`` along the car, ``t`` from the side (0) to the top."""
    course = _stations(_CABIN, 160)
    half, low, high = (row[:, None] for row in course[1:])
    c, s = _rounded(np.linspace(0, np.pi, _POINTS), _CABIN_ROUND)
    points, faces, normals = _wound(course[0], low + (high - low) * s, half * c * (1 - 0.2 * s))
    row, column = np.divmod(faces.min(axis=1), _POINTS)
    x, t = course[0][row], 1 - np.abs(2 * column / (_POINTS - 1) - 1)
    is_side = (t > 0.2) & (t < 0.5) & (x < 0.5) & (x > -1.35) & (np.abs(x + 0.36) > 0.045)
    is_window = is_side | ((t > 0.57) & (((x > 0.2) & (x < 0.97)) | ((x < -1.02) & (x > -1.75))))
    model.add("window", (points, faces[is_window], normals))
    model.add("paint", (points, faces[~is_window], normals))


def _wheel(materials: dict[str, Any]) -> Model:
    """It looks along z: a tyre, a rim of ten spokes, a disc brake."""
    model, turn = Model(materials), about(0, 90)
    model.add("rubber", ring("20.5,-9 30,-10 32.5,-8 32.5,-3 32.5,3 32.5,8 30,10 20.5,9", 96), turn=turn)
    model.add("alloy", ring("19.6,-8.5 21,-9 21,9 20.6,9.6 19.6,8.8", 96), turn=turn)
    model.add("alloy", turned("0,3 5,3 5.4,6.4 4,7.4 0,7.6", 64), turn=turn)
    model.add("chrome", ring("8,-1 15,-1 15,0 8,0", 64), turn=turn)
    model.add("black", turned("0,-6 19.6,-6 19.6,-5 0,-5", 64), turn=turn)
    for k in range(10):
        spoke, spin = box((0.165, 0.026 if k % 2 else 0.034, 0.022), 0.006), about(2, 36 * k)
        model.add("alloy", spoke, spin @ np.array([0.122, 0.0, 0.062]), spin @ about(1, -4))
    return model
