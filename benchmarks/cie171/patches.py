"""The cases of diffuse reflection by radiosity: patches of half a metre or less, and means of surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from etendue import scene as loading
from etendue.lighting import EFFICACY
from etendue.radiosity import ABuffer, Patches, exact_form_factors, lamp_light, scene_patches, solve

from . import rooms
from .cases import REFLECTANCES, SUN_LUX, cube, floor_lit, wall_lit, wall_seen
from .references import configuration_factor, gauss
from .rooms import DEPTH, HEIGHT, WIDTH, Array, Scene, X, Y, Z

#: Largest area of a patch, bundles of lines where surfaces hide each other, and rays to a lamp from all patches.
_AREA, _BUNDLES, _RAYS = 0.26, 8192, 1 << 22


@dataclass(frozen=True)
class Solved:
    """Illuminances in lux of patches, or their mean: value, standard error and reference (n,)."""

    number: str
    row: str
    what: str
    values: Array
    errors: Array
    expected: Array


def solved(number: str, folder: Path, seed: int = 0) -> Iterator[Solved]:
    """The cases of a number; none for those that are not of diffuse surfaces."""
    if number == "5.6":
        yield _floor(seed)
    elif number == "5.7":
        yield _wall(seed)
    elif number == "5.8":
        for value in REFLECTANCES:
            yield _cube(value, folder, seed)


def _illuminance(scene: Scene, seed: int, hidden: bool) -> tuple[Patches, Array, Array]:
    """Patches of a scene with lamps without a surface, and illuminance and standard error (n,) in lux."""
    problem = loading.load(scene, sensor=None)
    patches = scene_patches(problem, max_area=_AREA, lamps_apart=True)
    shot = lamp_light(problem, patches, _RAYS, seed)
    if hidden:
        lines = ABuffer(patches).cast(_BUNDLES)
        solution = solve(patches, lines, shot=shot)
        error = solution.irradiance_error(lines)
    else:
        solution = solve(patches, exact_form_factors(patches), shot=shot)
        error = shot.error
    return patches, EFFICACY * solution.irradiance[:, 1], EFFICACY * error[:, 1]


def _measuring(patches: Patches) -> Array:
    """Indices of the patches of the surfaces on which light is measured."""
    names = np.array(patches.shape_names)
    return np.flatnonzero(np.char.startswith(names[patches.shapes], "meter"))


def _cells(patches: Patches, index: Array) -> Iterator[tuple[Array, Array]]:
    """Points and weights for the mean over each patch, which is a parallelogram."""
    x, w = gauss([0.0, 1.0], 6)
    for face in [int(np.flatnonzero(patches.front == k)[0]) for k in index]:
        a, b, _, d = patches.vertices[patches.faces[face]]
        u, v = x[:, None, None], x[None, :, None]
        yield (a + u * (b - a) + v * (d - a)).reshape(-1, 3), np.outer(w, w).ravel()


def _floor(seed: int) -> Solved:
    scene, corners = floor_lit(WIDTH)
    scene |= rooms.wall("meter wall", (0, 0, 0.5), 2.5 * Z, WIDTH * X)
    scene |= rooms.wall("meter ceiling", (0, 0, HEIGHT), DEPTH * Y, WIDTH * X)
    patches, lux, error = _illuminance(scene, seed, hidden=False)
    index = _measuring(patches)
    expected = [
        w @ configuration_factor(p, patches.normals[k], corners)
        for k, (p, w) in zip(index, _cells(patches, index), strict=True)
    ]
    expected = SUN_LUX * 0.3 * np.array(expected)
    return Solved("5.6", "one diffuse reflection", "4 m", lux[index], error[index] + 0.0 * expected, expected)


def _wall(seed: int) -> Solved:
    """The means of both surfaces: few lines pass between a small patch behind the box and the lit wall."""
    scene = wall_lit() | rooms.wall("meter wall", (0, 0, 0), HEIGHT * Z, WIDTH * X)
    scene |= rooms.wall("meter floor", (0, 0, 0), WIDTH * X, 2.5 * Y)
    patches, lux, error = _illuminance(scene, seed, hidden=True)
    index = _measuring(patches)
    means = np.array(
        [
            w @ wall_seen(p, np.broadcast_to(patches.normals[k], p.shape))
            for k, (p, w) in zip(index, _cells(patches, index), strict=True)
        ]
    )
    found = []
    for normal in (Y, Z):
        chosen = patches.normals[index] @ normal > 0.5
        share = patches.areas[index][chosen] / patches.areas[index][chosen].sum()
        part = index[chosen]
        found.append((share @ lux[part], np.linalg.norm(share * error[part]), SUN_LUX * 0.6 * share @ means[chosen]))
    values, errors, expected = np.array(found).T
    return Solved("5.7", "the same with an obstruction", "", values, errors, expected)


def _cube(value: float, folder: Path, seed: int) -> Solved:
    patches, lux, error = _illuminance(cube(value, folder), seed, hidden=False)
    share = patches.areas / patches.areas.sum()
    expected = np.array([1e4 / (6.0 * WIDTH**2 * (1.0 - value))])
    # What is reflected has the relative error of what arrives from the lamp.
    scatter = np.sqrt(((share * error) ** 2).sum()) / (1.0 - value)
    return Solved("5.8", "closed cube", f"{value:g}", np.array([share @ lux]), np.array([scatter]), expected)
